# SPDX-License-Identifier: Apache-2.0
"""The level that `auto` takes gives the electrodes that a solve at 128 x 128 gives."""

import numpy as np
import pytest
from contact_builders import press, rounded_edge
from every_case import every_case

from foretouch.errors import ContactError
from foretouch_lab.simulation.contact.grip import choose_level, solve_contact
from foretouch_lab.simulation.contact.pad import PadConfig
from foretouch_lab.simulation.contact.problem import Command, ContactProblem, ElasticLayer
from foretouch_lab.simulation.fingertip import ThumbConfig, draw_finger, read_contact

FINGER = draw_finger(ThumbConfig(), np.random.default_rng(0))
FOAM = ElasticLayer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
RUBBER = ElasticLayer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01)
CONTACTS = [  # pitch and roll, force, height of the object
    ((0.0, 0.0), 3.0, lambda x, _y: np.zeros_like(x)),
    ((0.3, -0.4), 1.0, lambda x, y: -((np.cos(0.7) * x + np.sin(0.7) * y) ** 2) / (2 * 0.033)),  # a cylinder
    ((-0.2, 0.2), 5.0, lambda x, y: -((np.cos(0.7) * x + np.sin(0.7) * y) ** 2) / (2 * 0.033)),
    ((0.2, 0.3), 2.0, lambda x, y: rounded_edge(np.cos(0.5) * x + np.sin(0.5) * y)),
]


def drops(pad, contact, other, level):
    return FINGER.electrode_rest - read_contact(pad, FINGER, *press(pad, *contact, other, level))[1:]


def test_auto_gives_the_electrodes_of_a_fine_solve():
    def check(_name, other, error, contact):
        pad = PadConfig().soft if other else PadConfig()
        coarse = drops(pad, contact, other, "auto")
        fine = drops(pad.replace(cells=128), contact, other, "layer")
        assert np.linalg.norm(coarse - fine) <= error * np.linalg.norm(fine)

    objects = (("rigid", (), 0.03), ("foam", (FOAM,), 0.02), ("rubber", (RUBBER,), 0.02))
    every_case([(*item, contact) for item in objects for contact in CONTACTS], check)


def test_levels_are_chosen_by_the_layers_and_an_unknown_one_is_refused():
    assert choose_level([PadConfig().layer])[0] == "winkler"
    assert choose_level([PadConfig().layer, ElasticLayer(modulus_pa=1e5, poisson=0.3)])[0] == "layer"
    problem = ContactProblem(np.zeros((4, 4)), 1e-3, (PadConfig().layer,))
    with pytest.raises(ContactError, match="level: 'fem' is not one of auto, winkler, layer"):
        solve_contact(problem, Command(force_n=1.0), "fem")

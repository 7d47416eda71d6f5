# SPDX-License-Identifier: Apache-2.0
"""The level that `auto` takes gives the electrodes that a solve at 128 x 128 gives."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.errors import ContactError
from foretouch.simulation.contact import (
    Command,
    ContactProblem,
    Layer,
    PadConfig,
    choose_level,
    gap_field,
    pad_direction,
    pad_window,
    solve_contact,
)
from foretouch.simulation.fingertip import ThumbConfig, draw_finger, read_contact

FINGER = draw_finger(ThumbConfig(), np.random.default_rng(0))
FOAM = Layer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03)
RUBBER = Layer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01)
CONTACTS = [  # pitch, roll, force, object
    (0.0, 0.0, 3.0, "plane"),
    (0.3, -0.4, 1.0, "cylinder"),
    (-0.2, 0.2, 5.0, "cylinder"),
    (0.2, 0.3, 2.0, "edge"),
]


def surface(shape, x, y):
    """Height of a plane, of a lying cylinder of 33 mm, or of an edge that falls at 45 degrees, rounded over 2 mm."""
    if shape == "cylinder":
        return -((np.cos(0.7) * x + np.sin(0.7) * y) ** 2) / (2 * 0.033)
    across = np.cos(0.5) * x + np.sin(0.5) * y
    edge = np.clip(across + 0.001, 0.0, 0.002) ** 2 / 0.004 + np.maximum(across - 0.001, 0.0)
    return np.zeros_like(x) if shape == "plane" else -edge


def drops(pad, contact, other, level):
    pitch, roll, force, shape = contact
    window = pad_window(pad, pad_direction(pitch, roll))
    gap = gap_field(window.depth, surface(shape, window.x, window.y))
    solution = solve_contact(ContactProblem(gap, pad.step_m, (pad.layer, *other)), Command(force_n=force), level)
    return FINGER.electrode_rest - read_contact(pad, FINGER, window, solution)[1:]


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
    assert choose_level([PadConfig().layer, Layer(modulus_pa=1e5, poisson=0.3)])[0] == "layer"
    problem = ContactProblem(np.zeros((4, 4)), 1e-3, (PadConfig().layer,))
    with pytest.raises(ContactError, match="level: 'fem' is none of auto, hertz, winkler, layer"):
        solve_contact(problem, Command(force_n=1.0), "fem")

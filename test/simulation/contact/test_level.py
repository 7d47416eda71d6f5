# SPDX-License-Identifier: Apache-2.0
"""The level that `auto` takes gives the electrodes that a solve at 128 x 128 gives."""

from __future__ import annotations

import numpy as np
import pytest

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
from foretouch.simulation.contact.pad import bent_surface, wedge
from foretouch.simulation.fingertip import THUMB, FingertipConfig, draw_finger, read_contact

FINGER = draw_finger(THUMB, np.random.default_rng(0))
CONTACTS = [  # pitch, roll, force, object
    (0.0, 0.0, 3.0, "plane"),
    (0.3, -0.4, 1.0, "cylinder"),
    (-0.2, 0.2, 5.0, "cylinder"),
    (0.2, 0.3, 2.0, "edge"),
]


def drops(pad, contact, other, level):
    pitch, roll, force, shape = contact
    window = pad_window(pad, pad_direction(pitch, roll))
    height = {
        "plane": np.zeros_like(window.x),
        "cylinder": bent_surface(window.x, window.y, 1 / 0.033, 0.0, 0.7),
        "edge": wedge(window.x, window.y, 1.0, 0.5, 0.002),
    }[shape]
    problem = ContactProblem(gap_field(window.depth, height), pad.step_m, (pad.layer, *other))
    solution = solve_contact(problem, Command(force_n=force), level)
    return FINGER.electrode_rest - read_contact(FingertipConfig(), pad, FINGER, window, solution).electrodes


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(
    ("other", "error"),
    [
        ((), 0.03),
        ((Layer(modulus_pa=1e5, poisson=0.3, thickness_m=0.03),), 0.02),
        ((Layer(modulus_pa=1e6, poisson=0.3, thickness_m=0.01),), 0.02),
    ],
    ids=["rigid", "foam", "rubber"],
)
def test_auto_gives_the_electrodes_of_a_fine_solve(contact, other, error):
    pad = PadConfig().soft if other else PadConfig()
    coarse = drops(pad, contact, other, "auto")
    fine = drops(pad.replace(cells=128), contact, other, "layer")
    assert np.linalg.norm(coarse - fine) <= error * np.linalg.norm(fine)


def test_auto_never_takes_the_layer_solver_for_a_rigid_object():
    assert choose_level([PadConfig().layer])[0] == "winkler"
    assert choose_level([PadConfig().layer, Layer(modulus_pa=1e5, poisson=0.3)])[0] == "layer"


def test_unknown_level_is_refused():
    problem = ContactProblem(np.zeros((4, 4)), 1e-3, (PadConfig().layer,))
    with pytest.raises(ContactError, match="level: 'fem' is none of auto, hertz, winkler, layer"):
        solve_contact(problem, Command(force_n=1.0), "fem")

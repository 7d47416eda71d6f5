# SPDX-License-Identifier: Apache-2.0
"""Contact of a fingertip's pad with an object: pressure and displacement at three levels of fidelity.

Hertz, Winkler and the elastic layer share one problem and one solution; `grip` closes two fingers.
"""

from foretouch.simulation.contact.closed_form import bed_stiffness, solve_hertz, solve_winkler
from foretouch.simulation.contact.grip import LEVELS, HeldWeight, choose_level, solve_contact, solve_grip, weigh
from foretouch.simulation.contact.layer import solve_layer
from foretouch.simulation.contact.pad import (
    ContactFrame,
    PadConfig,
    PadWindow,
    contact_frame,
    gap_field,
    pad_depth,
    pad_direction,
    pad_window,
)
from foretouch.simulation.contact.problem import Command, ContactProblem, ContactSolution, Layer

__all__ = [
    "LEVELS",
    "Command",
    "ContactFrame",
    "ContactProblem",
    "ContactSolution",
    "HeldWeight",
    "Layer",
    "PadConfig",
    "PadWindow",
    "bed_stiffness",
    "choose_level",
    "contact_frame",
    "gap_field",
    "pad_depth",
    "pad_direction",
    "pad_window",
    "solve_contact",
    "solve_grip",
    "solve_hertz",
    "solve_layer",
    "solve_winkler",
    "weigh",
]

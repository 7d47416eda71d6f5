# SPDX-License-Identifier: Apache-2.0
"""The effects of a scene, in the order in which they run."""

from foretouch_lab.simulation.effects import grasp, reading, view

__all__ = ["EFFECTS"]

EFFECTS = (*view.EFFECTS, *grasp.EFFECTS, *reading.EFFECTS)

# SPDX-License-Identifier: Apache-2.0
"""The effects of a scene, in the order in which they run."""

from foretouch_lab.simulation.effects import approach, contact, grasp, place, reading, view

__all__ = ["EFFECTS"]

EFFECTS = (*place.EFFECTS, *view.EFFECTS, *grasp.EFFECTS, *approach.EFFECTS, *contact.EFFECTS, *reading.EFFECTS)

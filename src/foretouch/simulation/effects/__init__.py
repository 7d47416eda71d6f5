# SPDX-License-Identifier: Apache-2.0
"""The effects of a scene, in the order in which effects that change the same key are applied."""

from foretouch.simulation.effects import campaign, contact, grasp, meeting, place, points, reading, view

__all__ = ["EFFECTS"]

EFFECTS = (
    *place.EFFECTS,
    *view.EFFECTS,
    *points.EFFECTS,
    *grasp.EFFECTS,
    *meeting.EFFECTS,
    *contact.EFFECTS,
    *campaign.EFFECTS,
    *reading.EFFECTS,
)

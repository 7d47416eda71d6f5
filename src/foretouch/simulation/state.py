# SPDX-License-Identifier: Apache-2.0
"""What is known of a sample while its effects run, key by key."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.grasp import GraspPlan
from foretouch.simulation.body import Body, Hits
from foretouch.simulation.contact import ContactFrame, ContactSolution, HeldWeight, PadWindow
from foretouch.simulation.hand import FingerFrame
from foretouch.types import Cloud, Float64, Grasp, Touch

__all__ = ["SampleState"]

Window = tuple[slice, slice]


def _key() -> Any:
    return field(init=False)


@dataclass(eq=False)
class SampleState:
    """The keys that effects read, write and modify; none is there before an effect has made it.

    Attributes:
        bodies: The object first, then the clutter.
        window: Rows and columns of the image that are rendered.
        exact_depth: (h, w) float64 along the optical axis [m], inf where there is nothing.
        labels: (h, w) int32: 0 none, 1 table, 2 the object, 3 and on the clutter.
        hits: Of each body, flat over the window; None for a body that the window does not show.
        normals: (h, w, 3) float64, outward unit normals in the world; zero where no body is.
        depth: (h, w) float64 [m], as the camera measures it; inf where it measures nothing.
        cloud: The object's points in the camera frame.
        pixels: (n,) int64, their places in the image.
        plan: What GeoGrasp found.
        grasp: The grasp that is executed, in the camera frame.
        fingers: Where thumb and middle finger close, in the world.
        targets: (2,) float64: what thumb and middle finger reach, [N] or [m] by the scene's `control`.
        axial_load_n: How much more the middle finger pushes than the thumb [N].
        weight: What the object's weight asks of the fingers.
        postures: Of each fingertip: where on its skin the hand aims with, and its axes as columns in the world, (3, 3).
        pads: Where on its skin each fingertip is touched, and the window about it.
        touches: The tangent frames there, in the world.
        relief: (2, N, N) float64 [m], the object's surface behind each tangent plane, inf where there is none.
        contacts: How thumb and middle finger touch it.
        readings: (2, 2, 25) float64 [counts]: at rest and in contact, of thumb and middle finger, PDC then electrodes;
            of an ideal fingertip, not rounded.
        times: (T,) float64 [s] of the messages; without a timeline two, for tare and touch, at one time.
        load: (T,) float64, 0 without contact and 1 in full contact.
        hold_row: The message that is the touch; the tare is the median of those before the first load.
        series: (T, 2, 25) float64 [counts], what the sensor makes of it.
        touch: What the sensor says in contact.
        tare: What it said before.
    """

    bodies: list[Body] = _key()
    window: Window = _key()
    exact_depth: Float64 = _key()
    labels: npt.NDArray[np.int32] = _key()
    hits: list[Hits | None] = _key()
    normals: Float64 = _key()
    depth: Float64 = _key()
    cloud: Cloud = _key()
    pixels: npt.NDArray[np.int64] = _key()
    plan: GraspPlan = _key()
    grasp: Grasp = _key()
    fingers: tuple[FingerFrame, FingerFrame] = _key()
    targets: Float64 = _key()
    axial_load_n: float = _key()
    weight: HeldWeight = _key()
    postures: tuple[tuple[ContactFrame, Float64], tuple[ContactFrame, Float64]] = _key()
    touches: tuple[FingerFrame, FingerFrame] = _key()
    pads: tuple[PadWindow, PadWindow] = _key()
    relief: Float64 = _key()
    contacts: tuple[ContactSolution, ContactSolution] = _key()
    readings: Float64 = _key()
    times: Float64 = _key()
    load: Float64 = _key()
    hold_row: int = _key()
    series: Float64 = _key()
    touch: Touch = _key()
    tare: Touch = _key()

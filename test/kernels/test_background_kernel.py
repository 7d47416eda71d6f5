# SPDX-License-Identifier: Apache-2.0
"""The kernel that tells background from objects, and its reference: the same reasons and outline in rooms of boxes."""

import numpy as np
import pytest
from cloud.segmentation.test_background import CAN, PACKET, room
from every_case import every_case
from kernels.references.background import BEYOND, ENTERS, FLOATS, background

from foretouch.cloud.segmentation import background as background_module
from foretouch.cloud.segmentation.segment import segment

ARM = ((0.20, -0.9, 0.12), (0.28, -0.02, 0.20))
CHAIR = ((-0.15, 0.50, -0.7), (0.10, 0.60, 0.10))
FLYING = ((-0.1, 0.1, 0.2), (0.0, 0.2, 0.25))
WALLS = ((-0.9, 0.36, -0.7), (0.9, 0.40, 0.5))


def test_kernel_and_reference_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel, given = background_module._find, []

    def keep(*arguments: object) -> None:
        kernel(*arguments)
        given.append(arguments)

    monkeypatch.setattr(background_module, "_find", keep)
    seen: set[int] = set()

    def check(boxes: tuple[object, ...], tilt: float, distance: float) -> None:
        cloud, _ = room(*boxes, tilt_deg=tilt, distance_m=distance)
        segment(cloud)
        grid, _, _, labels, n, pitch, settings, reasons, outline, found = given[-1]
        plain, hull = background(grid, labels, n, pitch, settings)
        np.testing.assert_array_equal(reasons, plain)
        corners = outline[: found[0]]
        for one, other in ((corners, hull), (hull, corners)):
            apart = np.linalg.norm(one[:, None] - other[None], axis=2).min(axis=1)
            assert apart.max() < 2.0 * pitch  # corners on a straight edge may be left out
        seen.update(reasons.tolist())

    rooms = {"bare": (CAN, PACKET), "arm": (CAN, ARM), "chair": (CAN, CHAIR), "flying": (PACKET, FLYING), "wall": (CAN, PACKET, WALLS)}  # fmt: skip
    views = ((30.0, 0.8), (50.0, 1.1))
    every_case({f"{name} {view}": (boxes, *view) for name, boxes in rooms.items() for view in views}, check)
    assert {0, ENTERS, BEYOND, FLOATS} <= seen

# SPDX-License-Identifier: Apache-2.0
"""The kernel that tells background from objects, and its reference: the same reasons and outline in rooms of boxes."""

from typing import Any

import numpy as np
import pytest
from cloud.segmentation.test_background import BIN, CAN, PACKET, room
from every_case import every_case
from kernels.references.background import BEYOND, ENTERS, FLOATS, WALL, background

from foretouch.cloud.segmentation import background as background_module
from foretouch.cloud.segmentation import segment as segment_module
from foretouch.cloud.segmentation.segment import segment
from foretouch.kernels import struct
from foretouch.types import Float64, Int64

ARM = ((0.20, -0.9, 0.12), (0.28, -0.02, 0.20))
CHAIR = ((-0.15, 0.50, -0.7), (0.10, 0.60, 0.10))
FLYING = ((-0.1, 0.1, 0.2), (0.0, 0.2, 0.25))
WALLS = ((-0.9, 0.36, -0.7), (0.9, 0.40, 0.5))


def test_kernel_and_reference_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    parts: dict[str, Any] = {}

    def keep(name: str, **fields: Any) -> Any:
        parts.update(fields)
        return struct(name, **fields)

    def find(*arguments: Any) -> tuple[Int64, Float64]:
        answers.append(background_module.find_background(*arguments))
        return answers[-1]

    answers: list[tuple[Int64, Float64]] = []
    monkeypatch.setattr(background_module, "struct", keep)
    monkeypatch.setattr(segment_module, "find_background", find)
    seen: set[int] = set()

    def check(boxes: tuple[object, ...], tilt: float, distance: float) -> None:
        cloud, _ = room(*boxes, tilt_deg=tilt, distance_m=distance)
        segment(cloud)
        plain, hull = background(**parts)
        reasons, outline = answers[-1]
        np.testing.assert_array_equal(reasons, plain)
        corners = outline[:, :2] / outline[:, 2:]
        for one, other in ((corners, hull), (hull, corners)):
            apart = np.linalg.norm(one[:, None] - other[None], axis=2).min(axis=1)
            assert apart.max() < 2.0 * parts["pitch"]  # corners on a straight edge may be left out
        seen.update(plain.tolist())

    rooms = {"bare": (CAN, PACKET), "arm": (CAN, ARM), "chair": (CAN, CHAIR), "flying": (PACKET, FLYING), "wall": (CAN, PACKET, WALLS), "bin": (CAN, PACKET, *BIN)}  # fmt: skip
    views = ((30.0, 0.8), (50.0, 1.1))
    every_case({f"{name} {view}": (boxes, *view) for name, boxes in rooms.items() for view in views}, check)
    assert {0, ENTERS, BEYOND, FLOATS, WALL} <= seen

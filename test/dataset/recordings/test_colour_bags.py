# SPDX-License-Identifier: Apache-2.0
"""Colours in recordings: found by their frame and size, matched by stamp as in a node, and none of them costs a cloud."""

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from depth_builders import FRAME, STAMP_NS, header, image, info, write_bag
from every_case import every_case
from numpy.testing import assert_array_equal
from PIL import Image
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.io.pointcloud2 import decode
from foretouch.dataset.source import open_source
from foretouch.errors import FileError
from foretouch.ros.sessions.playlist import CLOUDS, entries

DEPTH, INFO, COLOUR = "/camera/depth/image_rect_raw", "/camera/depth/camera_info", "/camera/color/image_raw"
SIZE = (48, 84)
STEP_NS, MS = 33_000_000, 1_000_000
_K = np.array([61.0, 0.0, 41.5, 0.0, 61.0, 23.5, 0.0, 0.0, 1.0])


def photograph(number: int) -> Any:
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([rows * 4, columns * 2, np.full(SIZE, 40 * number)], axis=-1).astype(np.uint8)


def coloured(number: int, form: str = "rgb8", *, late_ns: int = 0, frame: str = FRAME, **changes: Any) -> Any:
    """A colour image; `late_ns` is what its stamp is after that of the depth image."""
    head = {"header": header(frame, STAMP_NS + number * STEP_NS + late_ns)}
    pixels = photograph(number)
    if form in ("PNG", "JPEG"):
        content = io.BytesIO()
        Image.fromarray(pixels).save(content, form)
        fields = {"format": f"rgb8; {form.lower()} compressed bgr8", "data": content.getvalue()}
        return SimpleNamespace(**head, **fields, **changes)
    pixels = pixels[..., ::-1] if form == "bgr8" else pixels
    return image(np.ascontiguousarray(pixels), form, **{"step": SIZE[1] * 3, **head, **changes})


def sent(form: str = "rgb8", topic: str = COLOUR, after_ns: int = 5 * MS, **options: Any) -> list[tuple[str, int, Any]]:
    """Three depth images with their infos, each with colours that are recorded some time after it."""
    small = info(height=48, width=84, k=_K, p=np.insert(_K, [3, 6, 9], 0.0))
    made: list[tuple[str, int, Any]] = [(INFO, STAMP_NS, small)]
    for k in range(3):
        at = STAMP_NS + k * STEP_NS
        depth = np.full(SIZE, 700 + k, np.uint16)
        made.append((DEPTH, at, image(depth, "16UC1", header=header(stamp_ns=at))))
        made.append((topic, at + after_ns, coloured(k, form, **options)))
    return sorted(made, key=lambda one: one[1])


def test_colours_are_found_and_matched_in_every_form(tmp_path: Path) -> None:
    def check(number: int, form: str, topic: str, after_ns: int, late_ns: int, differs_by: int, ros1: bool) -> None:
        path = write_bag(
            tmp_path / f"{number}{'.bag' if ros1 else ''}", sent(form, topic, after_ns, late_ns=late_ns), ros1=ros1
        )
        source = open_source(path)
        assert (source.color_topic, source.converted) == (topic, False)
        for k, item in enumerate(source):
            rgb = item.cloud.rgb
            assert rgb is not None
            assert np.abs(rgb.astype(int) - photograph(k)).max() <= differs_by
        assert source.remarks == []

    packed = f"{COLOUR}/compressed"
    every_case(
        [
            (1, "rgb8", COLOUR, 5 * MS, 0, 0, False),
            (2, "bgr8", COLOUR, -5 * MS, 0, 0, False),  # recorded before its depth image
            (3, "PNG", packed, 20 * MS, 0, 0, False),
            (4, "JPEG", packed, 5 * MS, 0, 24, False),
            (5, "rgb8", COLOUR, 5 * MS, 15 * MS, 0, True),  # stamped by another clock
            (6, "rgb8", COLOUR, 5 * MS, -15 * MS, 0, False),
        ],
        check,
    )


def test_clouds_are_the_same_without_colours_and_those_that_do_not_fit_are_left_out(tmp_path: Path) -> None:
    plain = write_bag(tmp_path / "plain", [one for one in sent() if one[0] != COLOUR])
    expected = [item.cloud for item in open_source(plain)]

    def check(name: str, options: dict[str, Any]) -> None:
        source = open_source(write_bag(tmp_path / name, sent(**options)))
        clouds = [item.cloud for item in source]
        for cloud, one in zip(clouds, expected, strict=True):
            assert_array_equal(cloud.xyz, one.xyz)
        assert (source.color_topic == "") == all(cloud.rgb is None for cloud in clouds)
        assert (source.color_topic == "") == (name != "fits")

    every_case(
        [
            ("fits", {}),
            ("size", {"height": 24, "data": bytes(24 * 84 * 3)}),
            ("frame", {"frame": "camera_color_optical_frame"}),
            ("kind", {"form": "mono8", "step": 84, "data": bytes(48 * 84)}),
        ],
        check,
    )


def test_a_topic_that_is_named_is_used_and_depth_images_without_colours_are_counted(tmp_path: Path) -> None:
    messages = sent()
    messages[4][2].height = 24  # of the second
    messages[6][2].header = header(stamp_ns=STAMP_NS + 10 * STEP_NS)  # of the third
    path = write_bag(tmp_path / "bag", messages)
    source = open_source(path, camera=DepthCamera(color=COLOUR))
    assert [item.cloud.rgb is not None for item in source] == [True, False, False]
    (remark,) = source.remarks
    assert remark.startswith(f"{path}: {COLOUR}: 2 of 3 depth images have no colours: ")
    other = sent(frame="camera_color_optical_frame")
    source = open_source(write_bag(tmp_path / "other", other), camera=DepthCamera(color=COLOUR))
    assert [item.cloud.rgb for item in source] == [None] * 3
    assert (
        "'camera_color_optical_frame' is not that of the depth image, 'camera_depth_optical_frame'" in source.remarks[0]
    )
    with pytest.raises(FileError, match=r"--color '/camera/color/imageraw' is not one of /camera/color/image_raw"):
        open_source(path, camera=DepthCamera(color="/camera/color/imageraw"))


def test_clouds_that_are_played_in_place_of_depth_images_have_their_colours(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", sent())
    source = open_source(path, camera=DepthCamera(intrinsics=(60.0, 60.0, 41.5, 23.5)))
    assert (source.converted, source.color_topic) == (True, COLOUR)
    read = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
    clouds = [read(entry.data, "sensor_msgs/msg/PointCloud2") for entry in entries(source) if entry.topic == CLOUDS]
    assert len(clouds) == 3
    for k, message in enumerate(clouds):
        _, rgb = decode(message)
        assert_array_equal(rgb, photograph(k))

# SPDX-License-Identifier: Apache-2.0
"""Depth messages of drivers and of image_transport, against encoders that the tests have of their own."""

import array
import io
import re
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from depth_builders import FRAME, compressed, header, image, info, png, rvl
from every_case import every_case, every_refusal

from foretouch.cloud.io.depth_messages import CameraInfos, camera_model, decode_depth, info_topic, is_rectified
from foretouch.errors import CalibrationError, CloudError
from foretouch.types import Cloud
from foretouch.types.camera import CameraModel

K = (616.0, 615.0, 423.5, 239.5)
CAMERA = CameraModel(848, 480, *K)


@pytest.fixture
def depth(rng: np.random.Generator) -> np.ndarray:
    """Surfaces with noise, holes and the ends of the range."""
    v, u = np.indices((48, 84))
    mm = (900 + 3 * v + 2 * u + rng.integers(-3, 4, (48, 84))).astype(np.uint16)
    mm[rng.random((48, 84)) < 0.1] = 0
    mm[5, 5:8], mm[20:23] = (1, 65535, 32768), 0
    return mm


def test_every_encoding_byte_order_and_padding(depth: np.ndarray) -> None:
    metres = depth.astype(np.float32) / np.float32(1000.0)
    metres[3, 4] = np.nan
    cases = [
        (encoding, big, padding, pixels)
        for encoding, pixels in (("16UC1", depth), ("mono16", depth), ("32FC1", metres))
        for big in (False, True)
        for padding in (0, 3, 64)
    ]

    def check(encoding: str, big: bool, padding: int, pixels: np.ndarray) -> None:
        message = image(pixels, encoding, big=big, padding=padding)
        for data in (message.data, bytearray(message.data), array.array("B", message.data)):
            decoded = decode_depth(SimpleNamespace(**{**vars(message), "data": data}))
            np.testing.assert_array_equal(decoded, pixels)
        assert np.shares_memory(decoded, np.frombuffer(data, np.uint8))

    every_case(cases, check)


def test_compressed_depth_is_what_was_compressed(depth: np.ndarray) -> None:
    from PIL import Image

    written = io.BytesIO()
    Image.fromarray(depth).save(written, "PNG")
    for form, data in (
        ("16UC1; compressedDepth png", png(depth)),
        ("16UC1; compressedDepth png", written.getvalue()),  # with filters
        ("16UC1; compressedDepth", png(depth)),  # of older versions
        ("mono16; compressedDepth rvl", rvl(depth)),
        ("16UC1;compressedDepth rvl ", rvl(depth)),
    ):
        np.testing.assert_array_equal(decode_depth(compressed(data, form)), depth, err_msg=form)


def test_inverse_depth_by_hand(depth: np.ndarray) -> None:
    # Of image_transport: A = z0 (z0 + 1), B = 1 - A / zmax, with z0 = 100 and zmax = 10 m: q = A / z + B, cut to a whole number.
    a, b = 10100.0, 1.0 - 1010.0
    metres = np.where(depth[:, :40] > 500, depth[:, :40] / 1000.0, np.nan)
    metres[metres >= 10.0] = np.nan
    codes = np.where(np.isfinite(metres), np.floor(a / metres + b), 0).astype(np.uint16)
    for form, data in (("png", png(codes)), ("rvl", rvl(codes))):
        found = decode_depth(compressed(data, f"32FC1; compressedDepth {form}", a, b))
        assert found.dtype == np.float32
        np.testing.assert_array_equal(np.isnan(found), np.isnan(metres))
        sound = np.isfinite(metres)
        error = np.abs(found[sound] - metres[sound])
        assert (error <= metres[sound] ** 2 / a * 1.01).all()  # one step of q is z² / A
        assert error.max() > 1e-5  # it is lossy
    assert decode_depth(compressed(png(np.array([[1101]], np.uint16)), "32FC1; compressedDepth png", a, b))[
        0, 0
    ] == pytest.approx(10100.0 / (1101.0 + 1009.0))


def test_damaged_data_end_in_one_line(depth: np.ndarray, rng: np.random.Generator) -> None:
    for form, data in (("png", png(depth)), ("rvl", rvl(depth))):
        for cut in (0, 1, 7, 8, 30, len(data) // 2, len(data) - 40 if form == "png" else len(data) - 5):
            with pytest.raises(CloudError, match=r"^data: ") as caught:
                decode_depth(compressed(data[:cut], f"16UC1; compressedDepth {form}"))
            assert "\n" not in str(caught.value)
        for _ in range(100):
            broken = bytearray(data)
            for place in rng.integers(0, len(data), 3):
                broken[place] = rng.integers(256)
            try:
                found = decode_depth(compressed(bytes(broken), f"16UC1; compressedDepth {form}"))
            except CloudError:
                continue
            assert found.dtype == np.uint16


def test_what_is_no_depth_image_is_refused_by_name(depth: np.ndarray) -> None:
    whole = image(depth, "16UC1")

    def changed(**changes: Any) -> Any:
        return SimpleNamespace(**{**vars(whole), **changes})

    form = "16UC1; compressedDepth rvl"
    every_refusal(
        CloudError,
        [
            ("encoding: 'rgb8' is no depth image: 16UC1, mono16, 32FC1 are", changed(encoding="rgb8")),
            *((f"encoding: '{one}'", changed(encoding=one)) for one in ("mono8", "8UC1", "bgra8", "16SC1", "", "x\ny"[:1])),
            ("step: 166 bytes is less than a row of 84 x 2", changed(step=166)),
            ("data: 8064 bytes are not step 170 x height 48", changed(step=170)),
            ("data: 8063 bytes are not", changed(data=whole.data[:-1])),
            ("size: 0x48", changed(width=0)),
            ("size: 30000x30000 is not between one pixel and", changed(width=30000, height=30000, step=60000)),
            ("size: 30000x30000 is not", compressed(png(depth, size=(30000, 30000)))),
            ("size: 30000x30000 is not", compressed(struct.pack("<2I", 30000, 30000) + bytes(64), form)),
            ("size: 0x0", compressed(bytes(64), form)),
            ("PNG of 8 bits and colour type 2 is not one of 16 bits in grey", compressed(png(depth, 8, 2))),
            ("PNG is truncated or damaged", compressed(png(depth)[:-80])),
            ("data: is no PNG", compressed(rvl(depth))),
            ("truncated or damaged after 0 of 4032", compressed(struct.pack("<2I", 84, 48) + bytes(64), form)),
            ("truncated or damaged after 0 of", compressed(struct.pack("<2I", 84, 48) + b"\xff" * 64, form)),
            ("data: 12 bytes, a compressed", compressed(b"")),
            ("format: 'rgb8; jpeg compressed bgr8' is not", compressed(b"", "rgb8; jpeg compressed bgr8")),
            ("format: '16UC1; compressedDepth zstd'", compressed(b"", "16UC1; compressedDepth zstd")),
            ("encoding: 'bgr8'", compressed(png(depth), "bgr8; compressedDepth png")),
            ("quantisation A 0, B 0", compressed(png(depth), "32FC1; compressedDepth png")),
            ("quantisation A nan", compressed(png(depth), "32FC1; compressedDepth png", np.nan, 1.0)),
        ],
        decode_depth,
    )  # fmt: skip


def test_an_info_describes_the_images_that_it_belongs_to() -> None:
    assert camera_model(info()) == CAMERA
    d = np.array([0.1, -0.2, 0.001, 0.002, 0.05])
    assert camera_model(info(d=d)).distortion == tuple(d)
    assert camera_model(info(d=d), rectified=True) == CameraModel(848, 480, 610.0, 611.0, 420.0, 241.0)
    assert camera_model(info(d=d, p=np.zeros(12)), rectified=True) == CAMERA
    eight = np.array([0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6])
    assert camera_model(info(d=eight, distortion_model="rational_polynomial")).distortion == tuple(eight)
    for model in ("", "none", "brown_conrady"):
        assert camera_model(info(distortion_model=model)) == CAMERA
    roi = SimpleNamespace(x_offset=100, y_offset=40, height=400, width=600, do_rectify=False)
    part = camera_model(info(binning_x=2, binning_y=4, roi=roi))
    assert part == CameraModel(300, 100, 308.0, 153.75, 161.75, 49.875)
    noetic = vars(info())
    assert camera_model(SimpleNamespace(**{n.upper() if n in "dkrp" else n: v for n, v in noetic.items()})) == CAMERA
    every_refusal(
        CloudError,
        [
            ("camera_info: K: fx and fy are 0: the camera is not calibrated", info(k=np.zeros(9))),
            (
                "distortion_model 'equidistant' cannot be undone, only plumb_bob and",
                info(distortion_model="equidistant"),
            ),
            ("'kannala_brandt4' cannot be undone", info(d=d, distortion_model="kannala_brandt4")),
            ("camera_info: width: 0 px", info(width=0)),
            ("camera_info: K of 3 and P of 12 numbers are not 9 and 12", info(k=np.ones(3))),
            ("camera_info: distortion: .*not finite", info(d=np.array([np.nan]))),
        ],
        camera_model,
    )


def test_topics() -> None:
    realsense = "/camera/camera/depth/image_rect_raw"
    assert [is_rectified(one) for one in (realsense, f"{realsense}/compressedDepth")] == [True, True]
    assert [is_rectified(one) for one in ("depth/image", "/k4a/depth/image_raw", "/image_rect/image")] == [False] * 3
    assert info_topic(realsense) == info_topic(f"{realsense}/compressedDepth") == "/camera/camera/depth/camera_info"
    assert info_topic("depth/image") == "depth/camera_info"


def test_an_image_is_paired_by_frame_and_size() -> None:
    infos = CameraInfos()
    assert infos.add(info(), 0.0) == ""
    assert "cx, cy 423.5, 239.5 are 17% of the size off" in infos.add(info(height=720, width=1280), 0.0)
    assert infos.camera(FRAME, (480, 848), 0.1) == CAMERA
    assert infos.camera(FRAME, (720, 1280), 0.1).shape == (720, 1280)
    assert infos.camera(FRAME, (480, 848), 1e6) == CAMERA  # latched: sent once
    for frame, shape, reason, words in (
        (FRAME, (240, 424), "other_size", "is of 848x480 in frame .*, 1280x720 .* not of an image of 424x240 in frame"),
        (
            "other",
            (480, 848),
            "other_frame",
            f"is of 848x480 in frame '{FRAME}', not of an image of 848x480 in frame 'other'",
        ),
    ):
        with pytest.raises(CalibrationError, match=f"^depth/camera_info: {words}") as caught:
            infos.camera(frame, shape, 0.2)
        assert caught.value.reason == reason
    unnamed = CameraInfos()
    unnamed.add(info(header=header("")), 0.0)
    assert unnamed.camera(FRAME, (480, 848), 0.1) == CAMERA


def test_a_missing_info_is_an_error_after_three_seconds() -> None:
    infos = CameraInfos("/k4a/depth/image_raw")
    for now_s, reason, words in (
        (10.0, "awaits_camera_info", "none yet, for an image of 848x480"),
        (12.9, "awaits_camera_info", "none for 2.9 s"),
        (13.0, "no_camera_info", "none for 3.0 s"),
    ):
        with pytest.raises(CalibrationError, match=re.escape(f"/k4a/depth/camera_info: {words}")) as caught:
            infos.camera(FRAME, (480, 848), now_s)
        assert caught.value.reason == reason
    infos.add(info(), 14.0)
    assert infos.camera(FRAME, (480, 848), 14.0) == CAMERA
    infos = CameraInfos()
    assert "camera is not calibrated" in infos.add(info(k=np.zeros(9)), 0.0)
    with pytest.raises(CalibrationError, match="is not calibrated") as caught:
        infos.camera(FRAME, (480, 848), 0.0)
    assert caught.value.reason == "bad_camera_info"


def test_a_change_is_reported_once_and_two_publishers_are_refused_while_they_last() -> None:
    other = info(k=np.array([600.0, 0.0, 420.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]))
    infos = CameraInfos()
    infos.add(info(), 0.0)
    assert "changed to CameraModel(848 x 480 px, fx 600" in infos.add(other, 1.0)
    assert infos.add(other, 1.1) == ""
    assert infos.camera(FRAME, (480, 848), 1.1).fx == 600.0
    assert "changed to" in infos.add(info(), 10.0)  # back after a while: no second publisher
    assert infos.camera(FRAME, (480, 848), 10.0) == CAMERA

    notes = [infos.add((info(), other)[k % 2], 10.1 + k / 60.0) for k in range(600)]  # until 20.1
    assert sum("have two publishers?" in note for note in notes) == 1
    with pytest.raises(CalibrationError, match=r"two different infos of 848x480 .* alternate") as caught:
        infos.camera(FRAME, (480, 848), 20.1)
    assert caught.value.reason == "two_camera_infos"
    for k in range(240):  # one of them ends
        assert infos.add(info(), 20.1 + k / 60.0) in {"", *notes}
    assert infos.camera(FRAME, (480, 848), 24.1) == CAMERA


def test_the_messages_of_rosbags_and_rclpy() -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    pixels = np.full((480, 848), 900, np.uint16)
    stamp = types["builtin_interfaces/msg/Time"](sec=3, nanosec=4)
    head = types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME)
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
    plain = info()
    sent = types["sensor_msgs/msg/CameraInfo"](
        head, 480, 848, "plumb_bob", plain.d, plain.k, plain.r, plain.p, 0, 0, roi
    )
    raw = types["sensor_msgs/msg/Image"](head, 480, 848, "16UC1", 0, 1696, pixels.reshape(-1).view(np.uint8))
    expected, infos = Cloud.from_depth(pixels, CAMERA).xyz, CameraInfos()
    infos.add(info(header=header("")), 0.0)
    for message, name in ((raw, "Image"), (sent, "CameraInfo")):
        data = store.serialize_cdr(message, f"sensor_msgs/msg/{name}")
        back = store.deserialize_cdr(data, f"sensor_msgs/msg/{name}")
        if name == "Image":
            cloud = infos.cloud(back, 0.0)
            assert (cloud.stamp_ns, np.array_equal(cloud.xyz, expected)) == (3_000_000_004, True)
        else:
            assert camera_model(back) == CAMERA
    msg = pytest.importorskip("sensor_msgs.msg")
    ours = msg.Image(height=480, width=848, encoding="16UC1", step=1696, data=pixels.tobytes())
    assert np.array_equal(infos.cloud(ours, 0.0).xyz, expected)
    assert (
        camera_model(msg.CameraInfo(height=480, width=848, k=plain.k, d=[0.0] * 5, distortion_model="plumb_bob"))
        == CAMERA
    )
    assert np.array_equal(decode_depth(msg.CompressedImage(format="16UC1; compressedDepth png", data=compressed(png(pixels)).data)), pixels)  # fmt: skip


def test_the_camera_of_a_cropped_image_is_remarked_once_and_one_that_states_its_part_is_not() -> None:
    k = [500.0, 0.0, 239.5, 0.0, 500.0, 179.5, 0.0, 0.0, 1.0]
    infos, cropped = CameraInfos(), info(height=300, width=400, k=k, p=[0.0] * 12)
    report = infos.add(cropped, 0.0)
    assert "cx, cy 239.5, 179.5 are 10% of the size off the middle of 400x300" in report
    assert infos.add(cropped, 0.1) == ""
    stated = info(height=360, width=480, k=k, p=[0.0] * 12)
    stated.roi.width, stated.roi.height = 400, 300
    assert CameraInfos().add(stated, 0.0) == ""

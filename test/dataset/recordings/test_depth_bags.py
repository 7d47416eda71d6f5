# SPDX-License-Identifier: Apache-2.0
"""Recordings of depth cameras: which topic is read, and with which camera info."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_builders import FRAME, STAMP_NS, compressed, header, image, info, png, rvl, write_bag
from every_case import every_case
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionMode
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.io.depth_messages import camera_model
from foretouch.cloud.messages import decode_cloud
from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.source import open_source
from foretouch.errors import FileError
from foretouch.ros.sessions.playlist import entries
from foretouch.types import Cloud

DEPTH = "/camera/camera/depth/image_rect_raw"
INFO = "/camera/camera/depth/camera_info"
SIZE = (48, 84)
_K = np.array([61.0, 0.0, 41.5, 0.0, 61.0, 23.5, 0.0, 0.0, 1.0])


def small_info(scale: float = 1.0, **changes: Any) -> Any:
    k = _K * np.array([scale, 1, 1, 1, scale, 1, 1, 1, 1])
    return info(**{"height": 48, "width": 84, "k": k, "p": np.insert(k, [3, 6, 9], 0.0), **changes})


def pixels(number: int) -> np.ndarray:
    depth = np.full(SIZE, 700 + number, np.uint16)
    depth[number] = 0
    return depth


def frames(form: str = "raw", topic: str = DEPTH, count: int = 3) -> list[tuple[str, int, Any]]:
    made: list[tuple[str, int, Any]] = []
    for k in range(count):
        stamped = {"header": header(stamp_ns=STAMP_NS + k * 33_000_000)}
        message = {
            "raw": lambda: image(pixels(k), "16UC1", **stamped),  # noqa: B023
            "metres": lambda: image((pixels(k) / 1000.0).astype(np.float32), "32FC1", **stamped),  # noqa: B023
            "png": lambda: compressed(png(pixels(k))),  # noqa: B023
            "rvl": lambda: compressed(rvl(pixels(k)), "16UC1; compressedDepth rvl"),  # noqa: B023
        }[form]()
        message.header = stamped["header"]
        made.append(
            (topic if form in {"raw", "metres"} else f"{topic}/compressedDepth", STAMP_NS + k * 33_000_000, message)
        )
    return made


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("form", ["raw", "metres", "png", "rvl"])
def test_a_recording_with_one_depth_topic_just_works(tmp_path: Path, form: str, ros1: bool) -> None:
    colour = image(np.zeros((*SIZE, 3), np.uint8), "rgb8", step=84 * 3, width=84)
    infrared = image(np.zeros(SIZE, np.uint8), "mono8")
    sent = [
        ("/camera/camera/color/image_raw", STAMP_NS, colour),
        ("/camera/camera/infra1/image_rect_raw", STAMP_NS, infrared),
        *frames(form),
        (INFO, STAMP_NS + 20_000_000, small_info()),  # the first image comes before it
    ]
    path = write_bag(tmp_path / ("camera.bag" if ros1 else "camera"), sent, ros1=ros1)
    source = open_source(path)
    assert (source.kind, len(source)) == ("recording", 3)
    for number, item in enumerate(list(source)):  # also after the recording is closed
        cloud = item.cloud
        assert (cloud.frame_id, cloud.stamp_ns) == (FRAME, STAMP_NS + number * 33_000_000)
        expected = Cloud.from_depth(pixels(number), camera_model(small_info())).xyz
        np.testing.assert_allclose(cloud.xyz, expected, rtol=2e-7)
        assert np.isnan(cloud.xyz[number]).all()


@pytest.mark.slow
def test_depth_images_are_read_from_any_storage_also_from_a_file_that_is_cut_off(tmp_path: Path) -> None:
    expected = [Cloud.from_depth(pixels(k), camera_model(small_info())).xyz for k in range(9)]
    sent = [(INFO, STAMP_NS - 1, small_info()), *frames(count=9)]
    cases = [(plugin, mode) for plugin in StoragePlugin for mode in CompressionMode]
    cases.remove((StoragePlugin.SQLITE3, CompressionMode.STORAGE))  # SQLite has none

    def check(plugin: StoragePlugin, mode: CompressionMode) -> None:
        path = write_bag(tmp_path / f"{plugin.name} {mode.name}", sent, plugin=plugin, mode=mode)
        for read in (path, next(one for one in path.iterdir() if one.name != "metadata.yaml")):
            clouds = [item.cloud for item in open_source(read)]
            for cloud, xyz in zip(clouds, expected, strict=True):
                np.testing.assert_allclose(cloud.xyz, xyz, rtol=2e-7)

    every_case(cases, check)
    file = tmp_path / "MCAP NONE" / "MCAP NONE.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    clouds = []
    with pytest.raises(FileError, match=r"MCAP NONE\.mcap: byte \d+: cut off .*`foretouch dataset repair "):  # noqa: PT012
        for item in open_source(file.parent):
            clouds.append(item.cloud)  # noqa: PERF401  each before the error
    assert 2 <= len(clouds) <= 6
    np.testing.assert_allclose(clouds[1].xyz, expected[1], rtol=2e-7)


def test_the_image_is_preferred_to_its_compressed_form_and_several_cameras_are_named(tmp_path: Path) -> None:
    both = [*frames(), *frames("png"), (INFO, STAMP_NS, small_info())]
    assert open_source(write_bag(tmp_path / "both", both)).topic == DEPTH
    aligned = "/camera/camera/aligned_depth_to_color/image_raw"
    several = write_bag(
        tmp_path / "several",
        [*both, *frames(topic=aligned), (aligned.replace("image_raw", "camera_info"), STAMP_NS, small_info())],
    )
    with pytest.raises(
        FileError, match=f"several topics of clouds or depth images, name one with --topic: {aligned} .*{DEPTH}"
    ):
        open_source(several)
    for topic in (DEPTH, f"{DEPTH}/compressedDepth", aligned):
        source = open_source(several, topic)
        assert (source.topic, len(list(source))) == (topic, 3)
        assert next(iter(source)).cloud.camera == camera_model(small_info())


def test_rectified_images_have_the_camera_of_p(tmp_path: Path) -> None:
    bent = small_info(d=np.array([0.1, 0.0, 0.0, 0.0, 0.0]), p=np.array([70.0, 0, 41, 0, 0, 70.0, 23, 0, 0, 0, 1, 0]))
    path = write_bag(tmp_path / "rect", [*frames(), (INFO, STAMP_NS, bent)])
    found = next(iter(open_source(path))).cloud.camera
    assert found is not None
    assert (found.fx, found.cx, found.distortion) == (70.0, 41.0, ())
    raw = "/k4a/depth/image_raw"
    path = write_bag(tmp_path / "raw", [*frames(topic=raw), ("/k4a/depth/camera_info", STAMP_NS, bent)])
    found = next(iter(open_source(path))).cloud.camera
    assert found is not None
    assert (found.fx, found.distortion) == (61.0, (0.1,))


def test_each_image_has_the_last_info_before_it(tmp_path: Path) -> None:
    sent = [*frames(count=4), (INFO, STAMP_NS, small_info()), (INFO, STAMP_NS + 50_000_000, small_info(1.1))]
    items = list(open_source(write_bag(tmp_path / "zoomed", sorted(sent, key=lambda one: one[1]))))
    focal = [item.cloud.camera.fx for item in reversed(items)][::-1]  # in any order
    np.testing.assert_allclose(focal, [61.0, 61.0, 67.1, 67.1])


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    cut = compressed(png(pixels(0))[:-60])

    def check(name: str, rule: str, sent: list[tuple[str, int, Any]]) -> None:
        path = write_bag(tmp_path / name, sent)
        with pytest.raises(FileError, match=rule) as caught:
            _ = [item.cloud for item in open_source(path)]
        assert "\n" not in str(caught.value)

    sound = (INFO, STAMP_NS, small_info())
    cases = [
        ("no info", rf"no info: {DEPTH}: depth images need their camera info, and {INFO} is absent: record it too", frames()),
        ("other size", rf"{DEPTH}\[0\]: {INFO}: is of 848x480 in frame .*, not of an image of 84x48", [*frames(), (INFO, STAMP_NS, info())]),
        ("zero", "camera_info: K: fx and fy are 0", [*frames(), (INFO, STAMP_NS, small_info(k=np.zeros(9), p=np.zeros(12)))]),
        ("colour", "no messages of sensor_msgs/msg/PointCloud2, nor depth images .16UC1, mono16, 32FC1", [(DEPTH, STAMP_NS, image(np.zeros(SIZE, np.uint8), "mono8")), sound]),
        ("cut", r"compressedDepth\[0\]: data: the PNG is truncated or damaged", [(f"{DEPTH}/compressedDepth", STAMP_NS, cut), sound]),
        ("unit", r"image_rect_raw\[0\]: depth: half of the image is beyond 700 m", [(DEPTH, STAMP_NS, image(np.full(SIZE, 700.0, np.float32), "32FC1")), sound]),
    ]  # fmt: skip
    every_case(cases, check)


def test_one_damaged_image_costs_itself_alone(tmp_path: Path) -> None:
    sent = frames("rvl")
    sent[1][2].data = sent[1][2].data[:60]
    path = write_bag(tmp_path / "bag", [*sent, (INFO, STAMP_NS, small_info())])
    with Recording(path) as recording:
        outcomes = []
        for message, decode in recording.clouds(recording.cloud_topic()):
            try:
                outcomes.append(decode().organised)
            except FileError as err:
                outcomes.append(message.topic in str(err) and "RVL is truncated" in str(err))
    assert outcomes == [True, True, True]


def test_the_info_is_found_under_another_name_by_frame_and_size_or_by_its_topic(tmp_path: Path) -> None:
    aligned, colour = "/camera/aligned_depth_to_color/image_raw", "/camera/color/camera_info"
    sent = [*frames(topic=aligned), (colour, STAMP_NS, small_info()), ("/other/camera_info", STAMP_NS, info())]
    path = write_bag(tmp_path / "aligned", sent)
    expected = Cloud.from_depth(pixels(0), camera_model(small_info())).xyz
    source = open_source(path)
    assert (source.topic, source.info_topic, source.converted) == (aligned, "", True)
    np.testing.assert_allclose(next(iter(source)).cloud.xyz, expected, rtol=2e-7)
    two = write_bag(tmp_path / "two", [*sent, ("/also/info", STAMP_NS, small_info(1.1))])
    with pytest.raises(
        FileError,
        match=r"/camera/aligned_depth_to_color/camera_info is absent: .* --info-topic .there are: /also/info, /camera/color/camera_info, /other/camera_info.",
    ):
        open_source(two)
    for name, scale in ((colour, 1.0), ("/also/info", 1.1)):
        cloud = next(iter(open_source(two, camera=DepthCamera(info_topic=name)))).cloud
        assert cloud.camera == camera_model(small_info(scale))
    with pytest.raises(FileError, match=r"--info-topic '/also/inf' is not one of .*did you mean /also/info"):
        open_source(two, camera=DepthCamera(info_topic="/also/inf"))


def test_what_is_given_goes_before_what_is_recorded(tmp_path: Path) -> None:
    bent = small_info(d=np.array([0.1, 0.0, 0.0, 0.0, 0.0]), p=np.array([70.0, 0, 41, 0, 0, 70.0, 23, 0, 0, 0, 1, 0]))
    path = write_bag(tmp_path / "bag", [*frames(topic="/depth/image"), ("/depth/camera_info", STAMP_NS, bent)])
    file = tmp_path / "camera.json"
    file.write_text('{"K": [80, 80, 41.5, 23.5], "width": 84, "height": 48}')
    rect = Cloud.from_depth(pixels(0), (70.0, 70.0, 41.0, 23.0)).xyz
    cases = {
        "intrinsics": (DepthCamera(intrinsics=(90.0, 90.0, 41.5, 23.5)), Cloud.from_depth(pixels(0), (90.0, 90.0, 41.5, 23.5)).xyz),
        "camera file": (DepthCamera(info=file), Cloud.from_depth(pixels(0), (80.0, 80.0, 41.5, 23.5)).xyz),
        "rectified": (DepthCamera(rectified=True), rect),
        "scale": (DepthCamera(scale=0.0005, rectified=True), rect / 2),
        "camera file and scale": (DepthCamera(info=file, scale=0.0005), Cloud.from_depth(pixels(0), (80.0, 80.0, 41.5, 23.5)).xyz / 2),
    }  # fmt: skip

    def check(camera: DepthCamera, expected: np.ndarray) -> None:
        source = open_source(path, camera=camera)
        assert source.converted
        np.testing.assert_allclose(next(iter(source)).cloud.xyz, expected, rtol=3e-7)
        (played, *_) = [entry for entry in entries(source) if not entry.topic]
        sent = decode_cloud(deserialize(played.data))
        np.testing.assert_allclose(sent.xyz, expected, rtol=3e-7)

    every_case(cases, check)
    for given, rule in (
        (DepthCamera(info=tmp_path / "absent.yaml"), "absent.yaml: does not exist"),
        (DepthCamera(intrinsics=(900.0, 900.0, 320.0, 240.0)), "of another image size"),
    ):
        with pytest.raises(FileError, match=rule):
            _ = next(iter(open_source(path, camera=given))).cloud


def deserialize(data: bytes) -> Any:
    return get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")


def test_a_recording_of_the_realsense_viewer_is_read_in_its_unit(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    sensor = "/device_0/sensor_0"
    own = small_info(p=np.zeros(12), distortion_model="Brown Conrady", header=header(""))

    def check(unit: float) -> None:
        path = tmp_path / f"viewer{unit}.bag"
        depth = image((pixels(0) * (0.001 / unit)).round().astype(np.uint16), "mono16", header=header("0"))
        write_bag(
            path,
            [(f"{sensor}/Depth_0/image/data", STAMP_NS, depth), (f"{sensor}/Depth_0/info/camera_info", STAMP_NS, own)],
            ros1=True,
        )
        with Recording(path) as recording:
            messages = list(recording.messages())
        assert len(messages) == 2
        units = tmp_path / f"units{unit}.bag"
        with Ros1Writer(units) as writer:
            for name, kind, content in (
                (
                    f"{sensor}/option/Depth Units/value",
                    "std_msgs/msg/Float32",
                    store.types["std_msgs/msg/Float32"](data=unit),
                ),
                *((m.topic, m.type, _ros1(store, m)) for m in messages),
            ):
                writer.write(
                    writer.add_connection(name, kind, typestore=store), STAMP_NS, store.serialize_ros1(content, kind)
                )
        source = open_source(units)
        assert source.converted
        cloud = next(iter(source)).cloud
        np.testing.assert_allclose(cloud.xyz[..., 2], np.where(pixels(0) > 0, pixels(0) * 0.001, np.nan), rtol=1e-5)

    every_case([0.001, 0.0001], check)


def _ros1(store: Any, message: Any) -> Any:
    """The content of a message that was read as one of ROS 2."""
    raw = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(message.data, message.type)
    fields = {
        key.upper() if key in "dkrp" and message.type.endswith("Info") else key: value
        for key, value in vars(raw).items()
        if not key.startswith("__")
    }
    fields["header"] = store.types["std_msgs/msg/Header"](seq=0, stamp=raw.header.stamp, frame_id=raw.header.frame_id)
    return store.types[message.type](**fields)

# SPDX-License-Identifier: Apache-2.0
"""Depth files and cameras of others give the cloud of `Cloud.from_depth` to the bit; what is no depth image is named with the cure."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import yaml
from counted_work import calls_at_most
from every_case import every_case
from numpy.testing import assert_array_equal
from PIL import Image

from foretouch.cli.main import main
from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.io.files import read_cloud
from foretouch.dataset.source import open_source
from foretouch.errors import CloudError, FileError
from foretouch.types import CameraModel, Cloud

K = (60.0, 61.0, 31.5, 23.5)
MATRIX = [[60.0, 0.0, 31.5], [0.0, 61.0, 23.5], [0.0, 0.0, 1.0]]
DISTORTION = [0.1, -0.05, 0.001, 0.002, 0.01]


@pytest.fixture
def depth(rng: np.random.Generator) -> Any:
    """(48, 64) uint16 [mm], a tenth without depth."""
    image = rng.integers(500, 1500, (48, 64)).astype(np.uint16)
    image[rng.random(image.shape) < 0.1] = 0
    return image


def _image(path: Path, array: Any) -> Path:
    Image.fromarray(array).save(path)
    return path


def _npy(path: Path, array: Any) -> Path:
    np.save(path, array)
    return path


FILES: dict[str, Callable[[Path, Any], Path]] = {
    "png": lambda folder, mm: _image(folder / "a.png", mm),
    "tif of 16 bits": lambda folder, mm: _image(folder / "a.tif", mm),
    "tiff of floats": lambda folder, mm: _image(folder / "a.tiff", (mm * 1e-3).astype(np.float32)),
    "npy": lambda folder, mm: _npy(folder / "a.npy", mm),
    "npy of int32": lambda folder, mm: _npy(folder / "a.npy", mm.astype(np.int32)),
    "npy of metres": lambda folder, mm: _npy(folder / "a.npy", (mm * 1e-3).astype(np.float32)),
    "npy with a channel": lambda folder, mm: _npy(folder / "a.npy", mm[..., None]),
}


@pytest.mark.parametrize("name", FILES)
def test_a_depth_file_is_the_cloud_of_its_array_to_the_bit(tmp_path: Path, depth: Any, name: str) -> None:
    path = FILES[name](tmp_path, depth)
    array = (depth * 1e-3).astype(np.float32) if "metres" in name or "floats" in name else depth
    assert_array_equal(read_cloud(path, DepthCamera(intrinsics=K)).xyz, Cloud.from_depth(array, K).xyz)


def test_an_archive_brings_its_camera_and_its_scale(tmp_path: Path, depth: Any) -> None:
    np.savez(tmp_path / "a.npz", depth=depth, K=MATRIX, segmap=depth > 0)  # as contact_graspnet stores it
    assert_array_equal(read_cloud(tmp_path / "a.npz").xyz, Cloud.from_depth(depth, K).xyz)
    np.savez(tmp_path / "b.npz", depth=depth, K=MATRIX, factor_depth=2000)
    assert_array_equal(read_cloud(tmp_path / "b.npz").xyz, Cloud.from_depth(depth, K, scale=0.0005).xyz)
    given = DepthCamera(scale=0.002)
    assert_array_equal(read_cloud(tmp_path / "b.npz", given).xyz, Cloud.from_depth(depth, K, scale=0.002).xyz)
    np.savez(tmp_path / "c.npz", depth_mm=depth.astype(np.float64), K=MATRIX)
    assert_array_equal(read_cloud(tmp_path / "c.npz").xyz, Cloud.from_depth(depth, K).xyz)
    np.savez(tmp_path / "d.npz", depth_m=depth / 1000.0, K=MATRIX)
    np.testing.assert_allclose(read_cloud(tmp_path / "d.npz").xyz, Cloud.from_depth(depth, K).xyz, rtol=1e-6)


def _ros(path: Path) -> None:
    """As `camera_calibration` writes it."""
    facts = {
        "image_width": 64,
        "image_height": 48,
        "camera_matrix": {"rows": 3, "cols": 3, "data": np.ravel(MATRIX).tolist()},
    }
    path.write_text(
        yaml.safe_dump(facts | {"distortion_model": "plumb_bob", "distortion_coefficients": {"data": DISTORTION}})
    )


def _echo(path: Path) -> None:
    """As `ros2 topic echo` prints it, twice."""
    facts = {"header": {"frame_id": "camera"}, "height": 48, "width": 64, "distortion_model": "plumb_bob"}
    text = yaml.safe_dump(facts | {"d": DISTORTION, "k": np.ravel(MATRIX).tolist(), "binning_x": 0})
    path.write_text(f"{text}---\n{text}---\n")


def _open3d(path: Path) -> None:
    """By columns; Open3D's `PinholeCameraIntrinsic`."""
    path.write_text(
        json.dumps({"width": 64, "height": 48, "intrinsic_matrix": np.ravel(np.transpose(MATRIX)).tolist()})
    )


def _open3d_parameters(path: Path) -> None:
    matrix = np.ravel(np.transpose(MATRIX)).tolist()
    path.write_text(json.dumps({"intrinsic": {"width": 64, "height": 48, "intrinsic_matrix": matrix}, "extrinsic": []}))


def _realsense(path: Path) -> None:
    facts = dict(zip(("fx", "fy", "ppx", "ppy"), K, strict=True)) | {"width": 64, "height": 48, "depth_scale": 0.001}
    path.write_text(json.dumps(facts | {"model": "distortion.brown_conrady", "coeffs": [0.0] * 5}))


def _graspnet(path: Path) -> None:
    scipy.io.savemat(path, {"intrinsic_matrix": np.array(MATRIX), "factor_depth": np.array([[1000.0]])})


CAMERAS: dict[str, tuple[str, Callable[[Path], None], Any]] = {
    "camera_calibration": ("c.yaml", _ros, DISTORTION),
    "ros2 topic echo": ("c.yml", _echo, DISTORTION),
    "Open3D": ("c.json", _open3d, None),
    "parameters of Open3D": ("c.json", _open3d_parameters, None),
    "RealSense": ("c.json", _realsense, [0.0] * 5),
    "GraspNet": ("meta.mat", _graspnet, None),
    "text": ("cam_K.txt", lambda path: np.savetxt(path, MATRIX), None),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_camera_is_read_as_others_write_it(tmp_path: Path, depth: Any, name: str) -> None:
    file, write, distortion = CAMERAS[name]
    write(tmp_path / file)
    found = read_cloud(_image(tmp_path / "a.png", depth), DepthCamera(info=tmp_path / file))
    assert_array_equal(found.xyz, Cloud.from_depth(depth, K, distortion=distortion).xyz)


REFUSED: dict[str, tuple[Callable[[Path, Any], Path], DepthCamera, str]] = {
    "no camera": (FILES["png"], DepthCamera(), "depth: is a depth image without its camera: give --intrinsics fx,fy,cx,cy, --camera"),
    "zero": (lambda folder, mm: FILES["png"](folder, mm * 0), DepthCamera(intrinsics=K), "no pixel of 3072 has a depth"),
    "8 bits": (lambda folder, mm: FILES["png"](folder, (mm // 8).astype(np.uint8)), DepthCamera(intrinsics=K), "8 bits"),
    "colour": (
        lambda folder, mm: _image(folder / "a.png", np.stack([mm // 8] * 3, -1).astype(np.uint8)),
        DepthCamera(intrinsics=K),
        "colour image",
    ),
    "another size": (FILES["png"], DepthCamera(intrinsics=(600.0, 600.0, 320.0, 240.0)), "of another image size"),
    "scale 0": (FILES["png"], DepthCamera(intrinsics=K, scale=0.0), "scale: 0.0 is not a number of metres above 0"),
    "scale NaN": (FILES["png"], DepthCamera(intrinsics=K, scale=float("nan")), "scale: nan"),
    "millimetres as metres": (FILES["png"], DepthCamera(intrinsics=K, scale=1.0), "for millimetres pass scale=0.001"),
    "no image": (lambda folder, mm: Path((folder / "a.png").write_bytes(b"x" * 99) and folder / "a.png"), DepthCamera(intrinsics=K), "cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_depth_image_is_named(tmp_path: Path, depth: Any, name: str) -> None:
    make, camera, rule = REFUSED[name]
    with pytest.raises(FileError, match=rf"a\.png: .*{rule}"):
        read_cloud(make(tmp_path, depth), camera)


def test_a_camera_of_another_size_or_without_intrinsics_is_named(tmp_path: Path, depth: Any) -> None:
    path = _image(tmp_path / "a.png", depth[:40])
    _open3d(tmp_path / "c.json")
    with pytest.raises(FileError, match="depth: 64x40 is not the size of the camera, 64x48"):
        read_cloud(path, DepthCamera(info=tmp_path / "c.json"))
    for name, content, rule in (
        ("d.json", "{}", "holds no camera: none of K, k"),
        ("d.json", "[1", "holds no camera: "),
        ("d.yaml", "a: [", "holds no camera: "),
        ("d.yaml", "!!python/object/apply:os.system [ls]", "holds no camera: "),
        ("d.mat", "x", "holds no camera: "),
        ("d.csv", "x", "suffix: '.csv' is not one of"),
        ("d.json", '{"K": "x"}', r"a.png: could not convert .* \(of the camera in .*d.json\)"),
        (
            "d.json",
            '{"K": [60, 60, 31, 19], "model": "inverse_brown_conrady", "coeffs": [0.1, 0, 0, 0, 0]}',
            "cannot be undone",
        ),
        ("d.json", '{"K": [60, 60, 31, 19], "depth_scale": []}', "a.png: index 0 is out of bounds"),
        ("d.json", '{"intrinsic": 5}', "holds no camera: none of"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(FileError, match=rule):
            read_cloud(path, DepthCamera(info=tmp_path / name))


def test_a_pickled_dictionary_is_refused_with_the_line_that_converts_it(
    tmp_path: Path, depth: Any, monkeypatch: Any
) -> None:
    """As contact_graspnet stores its scenes."""
    np.save(tmp_path / "7.npy", {"depth": depth, "K": np.array(MATRIX)}, allow_pickle=True)
    with pytest.raises(FileError, match=r"7\.npy: holds a pickled object .*python -c ") as caught:
        read_cloud(tmp_path / "7.npy")
    line = str(caught.value).partition('python -c "')[2].rstrip('"')
    monkeypatch.chdir(tmp_path)
    exec(line, {})
    assert_array_equal(read_cloud(tmp_path / "7.npz").xyz, Cloud.from_depth(depth, K).xyz)


def test_a_folder_pairs_depth_images_with_masks_and_cameras(tmp_path: Path, depth: Any) -> None:
    names = ["scene-depth.png", "b_depth.tif", "depth_0003.png"]
    for name in names:
        _image(tmp_path / name, depth)
    _image(tmp_path / "colours.png", np.zeros((4, 4, 3), np.uint8))  # a picture beside them
    np.save(tmp_path / "b_mask.npy", depth > 900)
    _image(tmp_path / "scene-label.png", (depth > 900).astype(np.uint8))
    _realsense(tmp_path / "scene-info.json")
    _ros(tmp_path / "camera_info.yaml")  # of all others
    source = open_source(tmp_path)
    assert source.notes == (
        f"{tmp_path}: left out: colours.png; a depth image in a folder is NAME-depth or depth-NAME",
    )
    found = {Path(one.name).name: one for one in source}
    assert set(found) == set(names)
    assert {name: one.mask and one.mask.name for name, one in found.items()} == {
        "scene-depth.png": "scene-label.png", "b_depth.tif": "b_mask.npy", "depth_0003.png": None,
    }  # fmt: skip
    assert_array_equal(found["scene-depth.png"].cloud.xyz, Cloud.from_depth(depth, K, distortion=[0.0] * 5).xyz)
    assert_array_equal(found["b_depth.tif"].cloud.xyz, Cloud.from_depth(depth, K, distortion=DISTORTION).xyz)
    given = next(iter(open_source(tmp_path, camera=DepthCamera(intrinsics=(70.0, 70.0, 31.0, 23.0)))))
    assert_array_equal(given.cloud.xyz, Cloud.from_depth(depth, (70.0, 70.0, 31.0, 23.0)).xyz)


def test_commands_take_depth_files_by_options(tmp_path: Path, depth: Any, capsys: Any) -> None:
    path = str(_image(tmp_path / "a.png", depth))
    _graspnet(tmp_path / "meta.mat")
    by_numbers, by_file = ["--intrinsics", ",".join(map(str, K))], ["--camera-info", str(tmp_path / "meta.mat")]
    results = []
    for options in (by_numbers, by_file):
        main(["segment", path, *options, "--json"])
        results.append({**json.loads(capsys.readouterr().out), "ms": None})
    assert results[0] == results[1]
    assert results[0]["counts"]["received"] == depth.size
    assert main(["segment", path, *by_numbers, *by_file, "--json"]) == 1
    assert "give one of them" in capsys.readouterr().err
    for wrong in ("0", "nan", "-1"):
        with pytest.raises(SystemExit) as caught:
            main(["segment", path, *by_numbers, "--depth-scale", wrong])
        assert caught.value.code == 2


OPENCV = """%YAML:1.0
---
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 60., 0., 31.5, 0., 61., 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 1.0000000000000001e-01, -0.05, 1.0e-03, 0.002, 0.01 ]
"""


def test_cameras_of_opencv_are_read_with_and_without_its_first_line(tmp_path: Path, depth: Any) -> None:
    expected = Cloud.from_depth(depth, K, distortion=DISTORTION).xyz

    def check(text: str) -> None:
        (tmp_path / "camera.yml").write_text(text)
        found = read_cloud(_image(tmp_path / "a.png", depth), DepthCamera(info=tmp_path / "camera.yml"))
        assert_array_equal(found.xyz, expected)

    older = OPENCV.replace("camera_matrix", "Camera_Matrix").replace("distortion_c", "Distortion_C")
    every_case(
        {"opencv": OPENCV, "plain": OPENCV.partition("\n")[2], "older": older, "windows": OPENCV.replace("\n", "\r\n")},
        check,
    )
    for text, name, rule in (
        (OPENCV + "fisheye_model: 1\n", "camera.yml", "distortion_model 'fisheye' cannot be undone"),
        (
            "<opencv_storage></opencv_storage>",
            "camera.xml",
            "is XML, as of OpenCV, .*: write it as .yaml, or give --intrinsics",
        ),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(FileError, match=rule):
            read_cloud(tmp_path / "a.png", DepthCamera(info=tmp_path / name))


def _info_text(**changes: Any) -> str:
    facts = {"width": 64, "height": 48, "k": np.ravel(MATRIX).tolist(), "d": [0.0] * 5, "distortion_model": "plumb_bob"}
    p = np.insert(np.ravel(MATRIX), [3, 6, 9], 0.0).tolist()
    facts |= {
        "p": p,
        "binning_x": 0,
        "binning_y": 0,
        "roi": dict.fromkeys(("x_offset", "y_offset", "width", "height"), 0),
    }
    return yaml.safe_dump(facts | changes)


def test_a_camera_file_of_ros_counts_as_its_message_with_binning_region_and_rectified_images(
    tmp_path: Path, depth: Any
) -> None:
    """The messages of the same numbers are read by `camera_model`, which `test_depth_messages.py` compares with others."""
    file, image = tmp_path / "info.yaml", _image(tmp_path / "depth.png", depth)
    double = [*(2 * np.ravel(MATRIX)).tolist()[:8], 1.0]
    region = {"x_offset": 40, "y_offset": 30, "width": 64, "height": 48}
    other_p = [70.0, 0.0, 31.0, 0.0, 0.0, 71.0, 23.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    rectified = Cloud.from_depth(depth, (70.0, 71.0, 31.0, 23.0)).xyz
    bent = Cloud.from_depth(depth, K, distortion=DISTORTION).xyz
    cases = {
        "binning": (_info_text(width=128, height=96, k=double, p=[0.0] * 12, binning_x=2, binning_y=2), {}, Cloud.from_depth(depth, K).xyz),
        "region": (_info_text(width=200, height=120, roi=region, p=[0.0] * 12), {}, Cloud.from_depth(depth, CameraModel(64, 48, 60.0, 61.0, -8.5, -6.5)).xyz),
        "rectified": (_info_text(p=other_p, d=DISTORTION), {"rectified": True}, rectified),
        "raw": (_info_text(p=other_p, d=DISTORTION), {"rectified": False}, bent),
        "P is K": (_info_text(d=DISTORTION), {}, bent),
    }  # fmt: skip

    def check(text: str, options: dict[str, Any], expected: Any) -> None:
        file.write_text(text)
        assert_array_equal(read_cloud(image, DepthCamera(info=file, **options)).xyz, expected)

    every_case(cases, check)
    file.write_text(cases["raw"][0])
    with pytest.raises(
        FileError,
        match=r"depth.png: camera: fx is 60 px of raw images .K., 70 px of rectified ones .P.: give --rectified",
    ):
        read_cloud(image, DepthCamera(info=file))
    for name, expected in (("image_rect_raw.png", rectified), ("image_raw.png", bent)):
        assert_array_equal(read_cloud(_image(tmp_path / name, depth), DepthCamera(info=file)).xyz, expected)
    for model, undone in (
        ("Brown Conrady", True),
        ("radtan", True),
        ("Inverse Brown Conrady", False),
        ("equidistant", False),
        ("new", False),
    ):
        file.write_text(_info_text(d=DISTORTION, distortion_model=model))
        if undone:
            assert_array_equal(read_cloud(image, DepthCamera(info=file)).xyz, bent)
        else:
            with pytest.raises(FileError, match=f"distortion_model '{model}' cannot be undone"):
                read_cloud(image, DepthCamera(info=file))


def test_the_scale_of_bop_is_in_millimetres_and_the_number_of_the_image_finds_its_camera(
    tmp_path: Path, depth: Any
) -> None:
    scenes, one = tmp_path / "scene_camera.json", tmp_path / "camera.json"
    flat = np.ravel(MATRIX).tolist()
    scenes.write_text(json.dumps({"3": {"cam_K": flat, "depth_scale": 0.1}, "7": {"cam_K": flat, "depth_scale": 1.0}}))
    one.write_text(
        json.dumps(
            dict(zip(("fx", "fy", "cx", "cy"), K, strict=True)) | {"depth_scale": 0.1, "width": 64, "height": 48}
        )
    )
    tenths = Cloud.from_depth(depth * 10, K, scale=1e-4).xyz
    for image, file, expected in (
        (_image(tmp_path / "000003.png", depth * 10), scenes, tenths),
        (_image(tmp_path / "000007.png", depth), scenes, Cloud.from_depth(depth, K).xyz),
        (tmp_path / "000003.png", one, tenths),
    ):
        np.testing.assert_allclose(read_cloud(image, DepthCamera(info=file)).xyz, expected, rtol=1e-6)
    with pytest.raises(FileError, match="describes 2 images by their numbers, and 000004 is none of them"):
        read_cloud(_image(tmp_path / "000004.png", depth), DepthCamera(info=scenes))
    with pytest.raises(FileError, match=r"for millimetres pass scale=0.001 .*; for tenths of them 0.0001 \([\d.]+ m\)"):
        read_cloud(tmp_path / "000003.png", DepthCamera(intrinsics=K, scale=0.1))


def test_absurd_camera_files_are_refused_in_one_line_and_tell_no_content(tmp_path: Path, depth: Any) -> None:
    image = _image(tmp_path / "a.png", depth)
    bomb = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{y}: &{y} [{', '.join([f'*{x}'] * 9)}]\n" for x, y in zip("abcdefgh", "bcdefghi", strict=True)
    )
    texts = {
        "aliases": ("a.yaml", bomb + "K: [60, 60, 31, 23]\n"),
        "400 digits": ("a.yaml", f"K: [{'9' * 400}, 60, 31, 23]\n"),
        "400 digits in JSON": ("a.json", f'{{"K": [{"9" * 400}, 60, 31, 23]}}'),
        "a width of 400 digits": ("a.yaml", f"K: [60, 60, 31, 23]\nwidth: {'9' * 400}\nheight: 3\n"),
        "infinite": ("a.yaml", "K: [.inf, 60, 31, 23]\n"),
        "infinite size": ("a.yaml", "K: [60, 60, 31, 23]\nwidth: .inf\nheight: .inf\n"),
        "infinite unit": ("a.yaml", "K: [60, 60, 31, 23]\ndepth_scale: .inf\n"),
        "a region of words": ("a.yaml", "K: [60, 60, 31, 23]\nroi: all\n"),
        "secret": ("a.txt", "root:*:20228:0:99999:7:::"),
        "secret YAML": ("a.yaml", "root:*:20228:0:99999:7:::"),
        "deep": ("a.json", "[" * 100_000),
    }

    def check(name: str, text: str) -> None:
        (tmp_path / name).write_text(text)
        with pytest.raises(FileError) as caught, calls_at_most(100_000):
            read_cloud(image, DepthCamera(info=tmp_path / name))
        message = str(caught.value)
        assert name in message
        assert "\n" not in message
        assert "20228" not in message

    every_case(texts, check)


def test_negative_depth_is_named(depth: Any) -> None:
    with pytest.raises(CloudError, match=r"depth: is negative wherever it is not 0: .* pass -depth"):
        Cloud.from_depth(-depth.astype(np.float32) / 1000, K)

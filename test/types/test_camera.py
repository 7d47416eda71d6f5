# SPDX-License-Identifier: Apache-2.0
"""Depth images to points: by hand, against librealsense, and against an inverse by SciPy and one of 40 digits."""

import tracemalloc
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from scipy.optimize import least_squares

from foretouch.camera.device import realsense
from foretouch.camera.stream import library_camera
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.errors import CameraError, CloudError, MissingDependencyError
from foretouch.types import Cloud
from foretouch.types.camera import CameraModel, DepthImage

K = np.array([[616.0, 0.0, 423.5], [0.0, 615.0, 239.5], [0.0, 0.0, 1.0]])
D435_COLOUR = (0.1596, -0.4877, 0.0004, 0.0011, 0.4370)  # a usual plumb bob
KINECT_DEPTH = (5.27, 3.45, -1.6e-5, -5.6e-5, 0.1852, 5.605, 5.138, 0.9654)  # an Azure Kinect's rational model


@pytest.fixture(scope="module")
def rs() -> Any:
    try:
        return realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))


def _distorted(x: Any, y: Any, d: Any) -> tuple[Any, Any]:
    """OpenCV's model as its documentation writes it, in any arithmetic."""
    k1, k2, p1, p2, k3, k4, k5, k6 = [*d, *[0.0] * (8 - len(d))]
    r2 = x * x + y * y
    factor = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * factor + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)


def test_a_pixel_by_hand() -> None:
    matrix = [[10.0, 0.0, 2.0], [0.0, 5.0, 1.0], [0.0, 0.0, 1.0]]
    depth = np.zeros((3, 5), np.uint16)
    depth[2, 4] = 500
    cloud = Cloud.from_depth(depth, matrix, frame_id="camera", stamp_ns=7)
    np.testing.assert_allclose(cloud.xyz[2, 4], [0.1, 0.1, 0.5], rtol=1e-6)
    assert np.isnan(cloud.xyz).all(axis=-1).sum() == 14
    assert (cloud.frame_id, cloud.stamp_ns, cloud.camera) == ("camera", 7, CameraModel(5, 3, 10.0, 5.0, 2.0, 1.0))
    assert np.array_equal(cloud.xyz, Cloud.from_depth(depth, (10.0, 5.0, 2.0, 1.0)).xyz, equal_nan=True)
    np.testing.assert_allclose(Cloud.from_depth(depth, matrix, 1e-4).xyz[2, 4], cloud.xyz[2, 4] / 10.0, rtol=1e-6)


def test_a_cropped_image_with_the_camera_of_the_whole_is_remarked() -> None:
    depth = np.full((48, 64), 500, np.uint16)
    with pytest.warns(UserWarning, match=r"cx, cy 31.5, 23.5 are .* subtract the first column and row") as told:
        Cloud.from_depth(depth[:, 12:], (60.0, 60.0, 31.5, 23.5))
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Cloud.from_depth(depth, (60.0, 60.0, 31.5, 23.5))


def test_every_type_of_depth_gives_the_same_points() -> None:
    millimetres = np.random.default_rng(1).integers(0, 3000, (480, 848)).astype(np.uint16)
    millimetres[:40] = 0
    expected = Cloud.from_depth(millimetres, K).xyz
    z = np.where(millimetres > 0, millimetres.astype(np.float32) * np.float32(1e-3), np.float32(np.nan))
    x, y = ((np.arange(848) - K[0, 2]) / K[0, 0]), ((np.arange(480) - K[1, 2]) / K[1, 1])[:, None]
    plain = np.stack([x.astype(np.float32) * z, y.astype(np.float32) * z, z], axis=-1)
    np.testing.assert_array_equal(expected, plain)
    metres = millimetres.astype(np.float32) * np.float32(1e-3)
    metres[:10], metres[10:20], metres[20:30], metres[30:40] = np.nan, np.inf, -np.inf, -0.5
    for depth, scale in (
        (millimetres.astype(">u2"), None),
        (metres, None),
        (metres.astype(np.float64), 1.0),
        (metres.astype(">f4"), None),
        (np.asfortranarray(metres), None),
        (millimetres.astype(np.float32), 1e-3),
    ):
        assert np.array_equal(Cloud.from_depth(depth, K, scale).xyz, expected, equal_nan=True), (depth.dtype, scale)


def test_rays_are_those_of_the_library(rs: Any) -> None:
    i = rs.intrinsics()
    i.width, i.height, i.ppx, i.ppy, i.fx, i.fy = 64, 48, 31.3, 24.2, 50.1, 50.7
    i.model, i.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    for coefficients, tolerance in (([0.0] * 5, 5e-7), ([0.1, -0.05, 0.001, -0.002, 0.01], 2e-6)):
        i.coeffs = coefficients
        x, y = np.broadcast_arrays(*library_camera(i).rays)
        theirs = np.array([[rs.rs2_deproject_pixel_to_point(i, [u, v], 1.0) for u in range(64)] for v in range(48)])
        # The library computes in float32, distortion by ten iterations: coordinates are below 1.
        np.testing.assert_allclose(x, theirs[..., 0], atol=tolerance)
        np.testing.assert_allclose(y, theirs[..., 1], atol=tolerance)
    i.model = rs.distortion.inverse_brown_conrady
    with pytest.raises(CameraError, match=r"inverse_brown_conrady\): only brown_conrady can be undone"):
        library_camera(i)


@pytest.mark.parametrize("distortion", [D435_COLOUR, KINECT_DEPTH, (-0.3, 0.1), (0.0, 0.0, 0.01, -0.02)])
def test_distortion_is_undone(distortion: tuple[float, ...]) -> None:
    camera = CameraModel(320, 288, 252.3, 252.2, 161.0, 143.5, distortion)
    x, y = camera.rays
    assert x.shape == (288, 320)
    u, v = np.meshgrid((np.arange(320) - 161.0) / 252.3, (np.arange(288) - 143.5) / 252.2)
    a, b = _distorted(x.astype(np.float64), y.astype(np.float64), distortion)
    np.testing.assert_allclose(a, u, atol=3e-7)  # float32 of numbers below 1, and a slope of the distortion
    np.testing.assert_allclose(b, v, atol=3e-7)
    for row, column in ((0, 0), (287, 319), (10, 300), (143, 161), (200, 7)):
        goal = np.array([u[row, column], v[row, column]])
        found = least_squares(lambda p, goal=goal: np.subtract(_distorted(*p, distortion), goal), goal, xtol=1e-15)
        np.testing.assert_allclose([x[row, column], y[row, column]], found.x, rtol=2e-7, atol=1e-7)


def test_a_large_distorted_image_takes_the_memory_of_its_rays_and_little_more() -> None:
    camera = CameraModel(2000, 1500, 1900.0, 1900.0, 1000.0, 750.0, (0.11, -0.23, 0.001, 0.002, 0.05))
    tracemalloc.start()
    x, y = camera.rays
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < x.nbytes + y.nbytes + 20e6
    part = CameraModel(100, 75, 1900.0, 1900.0, 50.0, 37.5, camera.distortion)  # the middle of it, computed at once
    np.testing.assert_allclose(x[712:787, 950:1050], part.rays[0], atol=1e-7)


def test_points_of_a_distorted_image_are_on_its_rays() -> None:
    depth = np.random.default_rng(1).integers(0, 3000, (1, 40)).astype(np.uint16)
    for size in ((1, 40), (40, 1), (8, 5)):
        camera = CameraModel(size[1], size[0], 30.0, 31.0, size[1] / 2, size[0] / 2, (0.1, 0.0, 0.01))
        (x, y), z = camera.rays, depth.reshape(size).astype(np.float32) * np.float32(1e-3)
        assert x.shape == size
        z[z == 0.0] = np.nan
        np.testing.assert_array_equal(camera.points(depth.reshape(size)), np.stack([x * z, y * z, z], axis=-1))


def test_pixels_beyond_the_fold_of_a_lens_have_no_ray_and_a_lens_of_few_rays_is_refused() -> None:
    folded = CameraModel(640, 480, 400.0, 400.0, 319.5, 239.5, (-0.35,))  # r (1 - .35 r²) is largest at r = .976
    x, _ = folded.rays
    u, v = np.meshgrid((np.arange(640) - 319.5) / 400.0, (np.arange(480) - 239.5) / 400.0)
    radius, end = np.hypot(u, v), 2.0 / 3.0 / np.sqrt(1.05)
    clear = np.abs(radius - end) > 1e-3  # the very end of the lens is sampled
    assert np.array_equal(np.isfinite(x)[clear], (radius < end)[clear])
    xyz = Cloud.from_depth(np.full((480, 640), 1.0, np.float32), folded).xyz
    assert np.array_equal(np.isnan(xyz).all(axis=-1), np.isnan(x))
    assert np.isfinite(xyz).all(axis=-1).sum() == np.isfinite(x).sum()
    with pytest.raises(CloudError, match=r"distortion: \[-5.0\] cannot be undone for 9\d% of the pixels"):
        CameraModel(640, 480, 400.0, 400.0, 319.5, 239.5, (-5.0,)).rays  # noqa: B018


def test_what_is_no_depth_image_is_refused_in_one_line_that_names_it() -> None:
    depth = np.full((480, 848), 900, np.uint16)
    metres = np.full((480, 848), 0.9)
    nan = float("nan")

    def check(message: str, *arguments: Any) -> None:
        with pytest.raises(CloudError, match=message) as caught:
            Cloud.from_depth(*arguments)
        assert "\n" not in str(caught.value)

    half = K / 2.0
    half[2, 2] = 1.0
    cases: list[tuple[Any, ...]] = [
        ("K: fx and fy are 0: the camera is not calibrated", depth, np.zeros((3, 3))),
        ("K: fx nan is not finite", depth, (nan, 1.0, 2.0, 3.0)),
        (r"K: shape \(5,\) is neither", depth, np.ones(5)),
        ("K: is not .*0, 0, 1", depth, K + np.array([[0, 3.0, 0], [0, 0, 0], [0, 0, 0]])),
        ("K: fx -616 px is not above 0", depth, -K + np.diag([0, 0, 2.0])),
        ("K: fx 0.7 px sees 180 degrees on 848 px: is it in pixels", depth, (0.7, 1.3, 0.5, 0.5)),
        (r"K: cx, cy 211.75, 119.75 are far from the middle of 848x480: is it of another image size\?", depth, half),
        ("K: cx, cy 423.5, 239.5 are far from the middle of 640x480", depth[:, :640], K),
        ("K: cx, cy 423.5, 239.5 are far from the middle of 1280x720", np.full((720, 1280), 1.0), K),
        ("K: abc is not of numbers: texts", depth, "abc"),
        ("K: .*a number is too large", depth, [10**400] * 4),
        ("depth: 848x480 is not the size of the camera, 640x480", depth, CameraModel(640, 480, 525, 525, 320, 240)),
        ("depth: dtype uint8 .*: 8 bits hold no depth", depth.astype(np.uint8), K),
        (r"depth: a/b\.png is a path, not an array: use read_cloud\(path, camera\)", "a/b.png", K),
        (r"depth: shape \(480, 848, 3\) of a colour image is not \(H, W\)", np.zeros((480, 848, 3), np.uint8), K),
        (r"depth: dtype int64 is not uint16 .*; pass depth\.astype\(np\.uint16\)", depth.astype(np.int64), K),
        ("depth: dtype int32 is not .*: its numbers are -1 to 0, not 0 to 65535", np.full((4, 4), -1, np.int32), K),
        ("depth: dtype bool", depth > 0, K),
        ("scale: 0.0 is not", depth, K, 0),
        ("scale: 'mm' is not a number", depth, K, "mm"),
        ("depth: setting an array element with a sequence", [[1], [2, 3]], K),
        ("height: 0 px is not a whole number", depth[:0], K),
        ("scale: nan is not", depth, K, nan),
        ("scale: -0.001 is not", depth, K, -0.001),
        ("beyond 900 m .float64 with scale 1.: for millimetres pass scale=0.001", depth.astype(float), K),
        ("beyond 900 m .uint16 with scale 1.: for millimetres", depth, K, 1.0),
        ("within 0.0009 m .float64 with scale 0.001.: for metres pass scale=1", metres, K, 1e-3),
        ("within 0.001 m .uint16 with scale 0.001.: for metres", np.ones((480, 848), np.uint16), K),
        ("distortion: .* is not finite", depth, K, None, (0.1, nan)),
        ("distortion: 14 coefficients, more than the 8 of rational_polynomial", depth, K, None, np.ones(14)),
        ("distortion: is given twice", depth, CameraModel(848, 480, 616, 616, 423, 239), None, (0.1,)),
    ]
    every_case(cases, check)
    with pytest.raises(CloudError, match="rgb: shape"):
        Cloud.from_depth(depth, K, rgb=np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(CloudError, match=r"camera: \(480, 848\) is not the size of the image, \(4,\)"):
        Cloud(np.zeros((4, 3)), camera=CameraModel(848, 480, 616, 616, 423, 239))


def test_masked_pixels_are_no_depth() -> None:
    depth = np.ma.masked_less(np.arange(480 * 848, dtype=np.uint16).reshape(480, 848), 500)
    xyz = Cloud.from_depth(depth, K).xyz
    assert np.array_equal(np.isnan(xyz[..., 2]), np.ma.getmaskarray(depth) | (np.ma.getdata(depth) == 0))


@pytest.mark.parametrize("kind", [np.uint16, np.float32, np.float64])
def test_the_next_image_in_the_same_buffer_changes_no_cloud(kind: type) -> None:
    unit = 1000 if kind == np.uint16 else 1
    buffer, colours = np.full((480, 848), 0.9 * unit).astype(kind), np.full((480, 848, 3), 10, np.uint8)
    buffer[200:260, 400:460] = (0.85 * unit) if kind != np.uint16 else 850
    first = buffer.copy()
    clouds = [Cloud.from_depth(buffer, camera, rgb=colours) for camera in (K, CameraModel.of(K, 848, 480))]
    points, scene = clouds[0].xyz.copy(), segment(clouds[1], SegmentationConfig())
    labels = scene.labels.copy()
    buffer[:], colours[:] = 1.4 * unit, 0
    for cloud in (*clouds, scene.cloud):
        np.testing.assert_array_equal(cloud.xyz, points)
        assert (cloud.rgb == 10).all()
    expected = segment(Cloud.from_depth(first, K), SegmentationConfig())
    np.testing.assert_array_equal(labels, expected.labels)
    assert [one.cloud.xyz.tolist() for one in scene.objects] == [one.cloud.xyz.tolist() for one in expected.objects]


def test_a_camera_is_made_of_whole_sizes_and_numbers() -> None:
    for size in ("a", 848.5, None, 0, 20_000):
        with pytest.raises(CloudError, match=r"width: .* px is not a whole number between 1 and 16384"):
            CameraModel(size, 480, *([600.0] * 4))
    with pytest.raises(CloudError, match=r"K: cy -1e\+308 px is at no image"):
        CameraModel(848, 480, 600.0, 600.0, 424.0, -1e308)
    with pytest.raises(CloudError, match="K: None is not a number"):
        CameraModel(848, 480, None, 600.0, 424.0, 240.0)


def test_an_image_without_depth_and_a_part_of_an_image_are_no_error() -> None:
    assert np.isnan(Cloud.from_depth(np.zeros((480, 848), np.uint16), K).xyz).all()
    part = Cloud.from_depth(np.full((100, 100), 900, np.uint16), CameraModel(100, 100, 616, 615, 423.5 - 700, 239.5))
    np.testing.assert_allclose(part.xyz[0, 0], [0.9 * (700 - 423.5) / 616, -0.9 * 239.5 / 615, 0.9], rtol=1e-6)


def test_zeros_behind_the_coefficients_of_a_driver_are_no_distortion() -> None:
    camera = CameraModel.of(K, 848, 480, [0.0] * 14)
    assert camera.distortion == ()
    assert [ray.shape for ray in camera.rays] == [(1, 848), (480, 1)]
    assert camera.rays[0] is CameraModel.of((616.0, 615.0, 423.5, 239.5), 848, 480).rays[0]


@pytest.mark.real_data
def test_images_of_others_are_depth_images(real_data: Path) -> None:
    files = sorted((real_data / "real_scenes").glob("*.npz"))
    assert len(files) == 27
    for file in files:
        with np.load(file) as scene:
            depth, (fx, fy, cx, cy) = scene["depth_mm"], scene["K"]
        xyz = Cloud.from_depth(depth, (fx, fy, cx, cy)).xyz
        assert np.array_equal(np.isfinite(xyz).all(axis=-1), depth > 0), file
        seen = xyz[depth > 0].astype(np.float64)
        rows, columns = np.nonzero(depth)
        # Projected again by K, each point is at the middle of its pixel.
        np.testing.assert_allclose(fx * seen[:, 0] / seen[:, 2] + cx, columns, atol=1e-3)
        np.testing.assert_allclose(fy * seen[:, 1] / seen[:, 2] + cy, rows, atol=1e-3)
        np.testing.assert_allclose(seen[:, 2], depth[depth > 0] / 1000.0, rtol=2e-7)


@pytest.mark.parametrize("distortion", [(), (0.1, -0.2)])
@pytest.mark.parametrize("scale", [0.001, 0.00025, 1.0 / 3.0])
def test_depths_at_the_ends_of_a_range_are_counted(scale: float, distortion: tuple[float, ...]) -> None:
    rng = np.random.default_rng(0)
    depth = rng.integers(0, 90 if scale > 0.1 else 65536, (60, 80)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.2] = 0
    image = DepthImage(depth, CameraModel(80, 60, 70.0, 70.0, 40.0, 30.0, distortion), scale)
    single = DepthImage(depth.astype(np.float32), image.camera, scale)
    z = image.points()[..., 2]
    ends = z[np.isfinite(z)]
    for low, high in [(0.0, 10.0), *rng.choice(ends, (20, 2)).tolist()]:
        expected = len(ends), np.count_nonzero((ends >= np.float32(low)) & (ends <= np.float32(high)))
        assert image.count(low, high) == single.count(low, high) == expected

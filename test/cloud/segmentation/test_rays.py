# SPDX-License-Identifier: Apache-2.0
"""Points beside the ray of their pixel or out of view: dropped and counted before they decide on anything."""

import warnings
from itertools import product

import numpy as np
import numpy.typing as npt
from every_case import every_case

from benchmarks.random_scenes import random_scene
from foretouch.cloud.segmentation.plane import fit_plane
from foretouch.cloud.segmentation.rays import RayFilter
from foretouch.cloud.segmentation.segment import SegmentationConfig, _coarse, segment
from foretouch.types import Cloud
from foretouch.types.scene import Scene

Float32 = npt.NDArray[np.float32]


def _scene(seed: int = 3, n_objects: int = 3) -> Float32:
    rng = np.random.default_rng(seed)
    return random_scene(rng, n_objects=n_objects).render(rng, 0.001).cloud().xyz


def _strictly(cloud: Cloud) -> Scene:
    with warnings.catch_warnings(), np.errstate(all="raise", under="ignore", invalid="ignore"):
        warnings.simplefilter("error")
        found = segment(cloud)
    counts = found.counts
    parts = ("not_finite", "out_of_range", "off_ray", "background", "rejected", "flying", "objects")
    assert counts["received"] == cloud.size == sum(counts[name] for name in parts)
    return found


def test_a_damaged_pixel_that_the_plane_fit_samples_does_not_turn_the_table() -> None:
    xyz = _scene()
    config = SegmentationConfig()
    coarse, stride, index = _coarse(xyz, config.crop, config.grid_rows)
    sampled = index[np.linspace(0.0, len(index) - 1.0, 2048).astype(np.intp)]
    expected = _strictly(Cloud(xyz)).table

    def check(axis: int, value: float) -> None:
        for pixel in sampled[:: len(sampled) // 10]:
            row, column = (stride * int(i) for i in np.divmod(pixel, coarse.shape[1]))
            damaged = xyz.copy()
            damaged[row, column, axis] = value
            found = _strictly(Cloud(damaged))
            assert (found.status, found.counts["off_ray"]) == ("ok", 1)
            np.testing.assert_allclose(found.table.coefficients, expected.coefficients, atol=1e-3)
            points = np.ascontiguousarray(damaged[::stride, ::stride]).reshape(-1, 3)[sampled]
            with np.errstate(all="ignore"):
                unchecked, *_ = fit_plane(points, config.plane)  # the fit itself does not withstand such a point
            assert unchecked is None or abs(unchecked.normal @ expected.normal) < 0.99

    every_case(product((0, 1), (1e20, -1e30, 3e38)), check)


def test_an_image_in_millimetres_is_refused_a_rotated_one_and_pixels_on_one_line_are_on_rays() -> None:
    xyz = _scene() * np.array([1000.0, 1000.0, 1.0], np.float32)  # its lateral coordinates alone
    for cloud, reason in ((xyz, "field of view of 120"), (xyz[np.isfinite(xyz[..., 2])], "field of view of 120")):
        found = _strictly(Cloud(cloud))
        assert (found.status, reason in found.reason) == ("bad_cloud", True)
    found = _strictly(Cloud(np.ascontiguousarray(np.rot90(_scene(), axes=(0, 1)))))
    assert (found.status, found.counts["off_ray"]) == ("ok", 0)
    columns = np.arange(5)
    sample = np.stack([columns * 0.1, columns * 0.0, np.ones(5)], axis=1).astype(np.float32)
    rays = RayFilter(sample, np.zeros(5, np.intp), columns.astype(np.intp))
    assert rays.reason == ""
    assert not rays.off_sample.any()

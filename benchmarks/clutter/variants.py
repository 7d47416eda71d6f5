# SPDX-License-Identifier: Apache-2.0
"""The same image with the faults of another camera, in another size, in a mirror, or a part of it: so that fewer have to be made."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, zoom

from benchmarks.clutter.scenes import LabelledCloud
from foretouch.types import Cloud, Float32

# Of a number that is drawn for each scene from 0 to 1: up to the first it gets white noise, then up to the second a Kinect's
# faults, then up to the third those of cameras that match windows; from there on, an object alone is cut out.
WHITE, FAULTY, BLURRED = 0.1, 0.4, 0.7
NEAR, CUT = 0.25, 0.15  # shares of the scenes that are several times smaller, and of which the image shows a part
_FEWEST: Final = 300  # pixels of an object that is cut out

Rng = np.random.Generator


def variant(path: Path, number: int = 0) -> LabelledCloud:
    """The scene of a file, most of them with the faults of another camera, which the number decides."""
    rng = np.random.default_rng([*path.stem.encode(), number])
    with np.load(path) as arrays:
        scene = LabelledCloud(path.stem, str(arrays["kind"]), Cloud(arrays["xyz"]), arrays["labels"])
    scene = mirrored(scene) if rng.random() < 0.5 else scene
    scene = nearer(scene, rng) if rng.random() < NEAR else scene
    scene = cut_off(scene, rng) if scene.kind != "single" and rng.random() < CUT else scene
    share = rng.random()
    if scene.kind == "single" and share > BLURRED:
        return bare(scene, rng)
    if share < WHITE:  # noise of which each pixel has its own
        noise = 1.0 + rng.normal(0.0, rng.uniform(0.0002, 0.0008), scene.labels.shape)
        return replace(scene, cloud=Cloud((scene.cloud.xyz * noise[..., None]).astype(np.float32)))
    if share < FAULTY:
        return faulty(scene, rng)
    return blurred(scene, rng) if share < BLURRED else scene


def faulty(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The scene in another size, with noise and steps of disparity as of a Kinect."""
    z = scene.cloud.xyz[..., 2]
    noise = rng.uniform(0.001, 0.0025)
    grain = gaussian_filter(rng.normal(size=z.shape), rng.uniform(0.6, 1.2))
    step = 0.0028 * rng.uniform(0.5, 1.0)
    disparity = np.round(1.0 / (z + noise * z * z * grain / grain.std()) / step) * step
    factor = rng.uniform(0.8, 1.7) / (disparity * z)
    return replace(scene, cloud=Cloud(np.ascontiguousarray((scene.cloud.xyz * factor[..., None]).astype(np.float32))))


def blurred(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The scene in another size as cameras that match windows see it: objects grow, contacts are ramps, planes have waves and holes."""
    z = scene.cloud.xyz[..., 2]
    finite = np.isfinite(z)
    disparity = np.where(finite, 1.0 / z, 0.0).astype(np.float32)
    grown = maximum_filter(disparity, size=int(rng.integers(1, 6)))
    wide = rng.uniform(0.3, 3.0)
    smooth = gaussian_filter(np.where(finite, grown, 0.0), wide) / np.maximum(
        gaussian_filter(finite.astype(np.float32), wide), 1e-3
    )
    if rng.random() < 0.6:  # some keep steps
        smooth = np.where(np.abs(smooth - grown) > rng.uniform(0.006, 0.02) * grown**2, grown, smooth)
    for size, most in (
        (rng.uniform(0.6, 2.0), 0.002),
        (rng.uniform(3.0, 8.0), 0.0035),
        (rng.uniform(8.0, 25.0), 0.006),
    ):
        smooth += most * 10 ** rng.uniform(-1.5, 0.0) * _grain(rng, z.shape, size)
    step = 0.0028 * rng.uniform(0.05, 0.9)
    smooth = np.round(smooth / step) * step
    holes = _grain(rng, z.shape, rng.uniform(2.0, 7.0))
    seen = finite & (smooth > 0.0) & (holes < np.quantile(holes[::4, ::4], 1.0 - rng.uniform(0.0, 0.04)))
    factor = np.where(seen, rng.uniform(0.6, 1.3) / np.where(seen, smooth * z, 1.0), np.nan)
    return replace(scene, cloud=Cloud(np.ascontiguousarray((scene.cloud.xyz * factor[..., None]).astype(np.float32))))


def _grain(rng: Rng, shape: tuple[int, ...], size: float) -> Float32:
    """Noise that is even over `size` pixels, with a deviation of 1."""
    step = max(1, int(size / 2.0))
    small = rng.standard_normal([-(-side // step) + 1 for side in shape], dtype=np.float32)
    grain: Float32 = zoom(gaussian_filter(small, size / step), step, order=1)[: shape[0], : shape[1]]
    return grain / grain.std()


def bare(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The object alone, cut out and put before a table without noise: often in half the pixels, with waves, blurred edges, and holes."""
    some = (slice(None, None, int(rng.integers(1, 3))),) * 2
    xyz, labels = scene.cloud.xyz[some], scene.labels[some]
    z, finite = xyz[..., 2], np.isfinite(xyz[..., 2])
    holes = gaussian_filter(rng.normal(size=z.shape), rng.uniform(0.7, 4.0))
    seen = (labels > 0) & finite & (holes < np.quantile(holes, 1.0 - rng.uniform(0.0, 0.03)))
    if np.count_nonzero(seen) < _FEWEST:
        return scene
    disparity = gaussian_filter(np.where(finite, 1.0 / z, 1.0 / np.nanmax(z)), rng.uniform(0.0, 2.0))
    for size, least, most in ((rng.uniform(0.5, 2.0), 0.0003, 0.002), (rng.uniform(2.0, 9.0), 0.0, 0.005)):
        grain = gaussian_filter(rng.normal(size=z.shape), size)
        disparity += rng.uniform(least, most) * grain / grain.std()
    step = 0.0028 * rng.uniform(0.1, 0.7)
    depth = 1.0 / (np.round(disparity / step) * step)
    depth = np.where(seen, depth, depth[seen].max() + 0.01)
    v, u = np.nonzero(finite)
    few = rng.permutation(len(v))[:2000]
    rows, columns = np.indices(z.shape)
    ones = np.stack([np.ones(z.shape), columns, rows], axis=-1)
    slopes = (xyz[..., :2] / z[..., None])[v[few], u[few]]
    rays = np.append(ones @ np.linalg.lstsq(ones[v[few], u[few]], slopes, rcond=None)[0], ones[..., :1], axis=-1)
    points = rays * depth[..., None] * rng.uniform(0.8, 1.4)
    return replace(scene, cloud=Cloud(points.astype(np.float32)), labels=np.where(seen, labels, 0).astype(np.int32))


def nearer(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The scene several times smaller, as small parts near the camera."""
    return replace(scene, cloud=Cloud(scene.cloud.xyz * np.float32(rng.uniform(0.3, 0.8))))


def cut_off(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """A part of the image, whose border cuts objects."""
    (h, w), share = scene.labels.shape, rng.uniform(0.45, 0.8)
    rows, columns = int(h * share), int(w * share)
    v, u = int(rng.integers(h - rows + 1)), int(rng.integers(w - columns + 1))
    some = np.s_[v : v + rows, u : u + columns]
    return replace(scene, cloud=Cloud(np.ascontiguousarray(scene.cloud.xyz[some])), labels=scene.labels[some])


def mirrored(scene: LabelledCloud) -> LabelledCloud:
    """The scene with left and right exchanged."""
    xyz = np.ascontiguousarray(scene.cloud.xyz[:, ::-1]) * np.array([-1.0, 1.0, 1.0], np.float32)
    return replace(scene, cloud=Cloud(xyz), labels=np.ascontiguousarray(scene.labels[:, ::-1]))


def seen_otherwise(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """A real scene in another size, each second time in a mirror, and each third time a part of it."""
    scene = mirrored(scene) if rng.random() < 0.5 else scene
    scene = replace(scene, cloud=Cloud(scene.cloud.xyz * np.float32(rng.uniform(0.8, 1.25))))
    return cut_off(scene, rng) if rng.random() < 1.0 / 3.0 else scene

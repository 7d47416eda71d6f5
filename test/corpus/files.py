# SPDX-License-Identifier: Apache-2.0
"""Hard clouds written to every format and read back: equal to the bit, or refused by name; for `check_outcome`."""

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from bag_builders import read_bag
from corpus.clouds import object_cases, scene_cases

from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.dataset.bag_writer import write_bag
from foretouch.dataset.store import Store
from foretouch.types import Cloud, Grasp, GraspSample
from foretouch_lab.dataset.store_writer import StoreWriter


def file_cases() -> Iterator[tuple[Any, ...]]:
    """Each hard cloud in one format, in turn; clouds of few points and with colours in all of them."""
    rng = np.random.default_rng(6)
    numbers = rng.integers(0, 2**32, (9, 3), dtype=np.uint32).view(np.float32)  # any bits: denormals, NaN, both zeros
    colours = rng.integers(0, 256, (4, 5, 3)).astype(np.uint8)
    clouds = {
        **{case.name: case.cloud for case in (*object_cases(), *scene_cases())},
        "any bits": Cloud(np.concatenate([numbers, np.array([[0.0, -0.0, 1e-45]], np.float32)])),
        "colours": Cloud(rng.random((4, 5, 3), np.float32), colours),
    }
    turns = itertools.cycle(_FORMATS)
    for name, cloud in {id(cloud): (name, cloud) for name, cloud in clouds.items()}.values():  # many share one cloud
        for form in _FORMATS if cloud.size <= colours.size // 3 else [next(turns)]:
            if form == "npy" and cloud.rgb is not None:
                continue
            reason = "not finite" if form == "store" and not np.isfinite(cloud.xyz).all() else None
            yield f"files: {name} as {form}", partial(_there_and_back, form, cloud), reason


def _there_and_back(form: str, cloud: Cloud) -> None:
    with TemporaryDirectory() as folder:
        read = _FORMATS[form](Path(folder), cloud)
        assert read.xyz.tobytes() == cloud.xyz.astype("<f4").tobytes()
        assert read.xyz.shape == cloud.xyz.shape
        assert (read.rgb is None) == (cloud.rgb is None)
        assert cloud.rgb is None or np.array_equal(cloud.rgb, read.rgb)


def _file(suffix: str, folder: Path, cloud: Cloud) -> Cloud:
    write_cloud(folder / f"cloud{suffix}", cloud)
    return read_cloud(folder / f"cloud{suffix}")


def _bag(folder: Path, cloud: Cloud) -> Cloud:
    write_bag(folder / "bag", [cloud])
    (read,) = read_bag(folder / "bag")
    return Cloud(read.xyz.copy(), None if read.rgb is None else read.rgb.copy())


def _store(folder: Path, cloud: Cloud) -> Cloud:
    grasp = Grasp(np.array([0.0, 0.03, 1.0]), np.array([0.0, -0.03, 1.0]), np.eye(3))
    points = Cloud(cloud.xyz.reshape(-1, 3), None if cloud.rgb is None else cloud.rgb.reshape(-1, 3))
    with StoreWriter(folder / "store") as writer:
        writer.write(GraspSample("object/0", "object", points, grasp))
    read = Store(folder / "store")[0].cloud
    shape = cloud.xyz.shape
    return Cloud(read.xyz.reshape(shape).copy(), None if read.rgb is None else read.rgb.reshape(shape))


_FORMATS: dict[str, Callable[[Path, Cloud], Cloud]] = {
    **{suffix[1:]: partial(_file, suffix) for suffix in (".npy", ".npz", ".pcd", ".ply")},
    "bag": _bag,
    "store": _store,
}
"""Writes a cloud below a folder and reads it back."""

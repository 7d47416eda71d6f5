# SPDX-License-Identifier: Apache-2.0
"""Hard clouds written to every format and read back: equal to the bit, or refused by name."""

import itertools
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.selftest.case import HardCase
from foretouch.types import Cloud, Grasp, GraspSample, UInt8

_FEW: Final = 13  # points of the clouds that are always written in all formats
_WITHOUT_COLOURS: Final = ("npy", "PCD ascii", "PCD compressed", "PLY ascii")  # as they are written here
_MOST_IN_TEXT: Final = 5_000  # points of a file in text


def file_cases(*, every: bool = False) -> Iterator[HardCase]:
    """Each hard cloud in one format, in turn; with `every`, in all of them: over a thousand cases."""
    turns = itertools.cycle(ROUND_TRIPS)
    for name, cloud in hard_clouds():
        for form in ROUND_TRIPS if every or cloud.rgb is not None or cloud.size < _FEW else [next(turns)]:
            if ("ascii" in form and cloud.size > _MOST_IN_TEXT) or (form == "PCD compressed" and cloud.size == 0):
                continue  # text of megabytes takes seconds; Open3D cannot write an empty cloud
            reason = "not finite" if form == "store" and not np.isfinite(cloud.xyz).all() else ""
            yield HardCase(f"files: {name} as {form}", partial(_there_and_back, form, cloud), reason)


def _there_and_back(form: str, cloud: Cloud) -> None:
    if form in _WITHOUT_COLOURS:
        cloud = Cloud(cloud.xyz)
    write = ROUND_TRIPS[form]
    with tempfile.TemporaryDirectory() as folder:
        read = write(Path(folder), cloud)
        if read.xyz.shape != cloud.xyz.shape:
            raise AssertionError(f"shape {read.xyz.shape} is not {cloud.xyz.shape}")
        written, found = (one.xyz.astype("<f4").view("<u4") for one in (cloud, read))
        different = (written != found) & ~(np.isnan(cloud.xyz) & np.isnan(read.xyz))
        if different.any():
            raise AssertionError(f"{int(different.sum())} of {different.size} coordinates differ")
        ours, theirs = _colours(cloud, read)
        if (read.rgb is None) != (cloud.rgb is None) or not np.array_equal(ours, theirs):
            raise AssertionError("the colours differ")


def _colours(*clouds: Cloud) -> list[UInt8]:
    """Colours of clouds, none where there are none."""
    return [np.empty((0, 3), np.uint8) if cloud.rgb is None else cloud.rgb for cloud in clouds]


def _plain(suffix: str) -> Callable[[Path, Cloud], Cloud]:
    def write(folder: Path, cloud: Cloud) -> Cloud:
        from foretouch.cloud.io.files import read_cloud, write_cloud

        write_cloud(folder / f"cloud{suffix}", cloud)
        return read_cloud(folder / f"cloud{suffix}")

    return write


def _ascii(suffix: str) -> Callable[[Path, Cloud], Cloud]:
    def write(folder: Path, cloud: Cloud) -> Cloud:
        from foretouch.cloud.io.files import read_cloud, write_cloud

        path = folder / f"cloud{suffix}"
        write_cloud(path, Cloud(cloud.xyz))
        path.write_bytes(in_text(path.read_bytes()))
        return read_cloud(path)

    return write


def in_text(content: bytes) -> bytes:
    """The same PCD or PLY file with its coordinates in text, from a binary file without colours."""
    pcd = content.startswith(b"#")
    head, mark, body = content.partition(b"DATA binary\n" if pcd else b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(-1, 3)
    text = "".join(f"{x!s} {y!s} {z!s}\n" for x, y, z in rows).encode()
    if pcd:
        return head + b"DATA ascii\n" + text
    return head.replace(b"binary_little_endian", b"ascii") + mark + text


def _compressed(folder: Path, cloud: Cloud) -> Cloud:
    import lzf

    from foretouch.cloud.io.files import read_cloud

    columns = cloud.xyz.reshape(-1, 3).T.tobytes()  # all x, then all y, then all z
    packed = lzf.compress(columns, 2 * len(columns)) or b""
    header = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {cloud.size}\nHEIGHT 1\nPOINTS {cloud.size}\nDATA binary_compressed\n"
    )
    path = folder / "cloud.pcd"
    path.write_bytes(header.encode() + np.array([len(packed), len(columns)], "<u4").tobytes() + packed)
    return Cloud(read_cloud(path).xyz.reshape(cloud.xyz.shape))


def _bag(compression: str) -> Callable[[Path, Cloud], Cloud]:
    def write(folder: Path, cloud: Cloud) -> Cloud:
        from foretouch.dataset.bag import read_bag
        from foretouch.dataset.bag_writer import write_bag

        write_bag(folder / "bag", [cloud], compression=compression)  # type: ignore[arg-type]
        (read,) = read_bag(folder / "bag")
        return Cloud(read.xyz.copy(), None if read.rgb is None else read.rgb.copy())

    return write


def _store(folder: Path, cloud: Cloud) -> Cloud:
    from foretouch.dataset.store import Store
    from foretouch.dataset.store_writer import StoreWriter

    points = cloud.xyz.reshape(-1, 3)
    grasp = Grasp(np.array([0.0, 0.03, 1.0]), np.array([0.0, -0.03, 1.0]), np.eye(3))
    rgb = None if cloud.rgb is None else cloud.rgb.reshape(-1, 3)
    with StoreWriter(folder / "store") as writer:
        writer.write(GraspSample("object/0", "object", Cloud(points, rgb), grasp))
    read = Store(folder / "store")[0].cloud
    return Cloud(
        read.xyz.reshape(cloud.xyz.shape).copy(), None if read.rgb is None else read.rgb.reshape(cloud.xyz.shape)
    )


ROUND_TRIPS: Final[dict[str, Callable[[Path, Cloud], Cloud]]] = {
    "npy": _plain(".npy"),
    "npz": _plain(".npz"),
    "PCD binary": _plain(".pcd"),
    "PCD ascii": _ascii(".pcd"),
    "PCD compressed": _compressed,
    "PLY binary": _plain(".ply"),
    "PLY ascii": _ascii(".ply"),
    "bag": _bag("none"),
    "bag zstd": _bag("zstd"),
    "store": _store,
}
"""Writes a cloud below a folder and reads it back."""


def hard_clouds() -> Iterator[tuple[str, Cloud]]:
    """The clouds of the corpus by name, and colours at their ends."""
    from foretouch.selftest.clouds import object_cases, scene_cases

    objects = {id(case.cloud): (case.name, case.cloud) for case in reversed(list(object_cases()))}
    yield from reversed(objects.values())  # many grasps and tables share one cloud
    yield from ((case.name, case.cloud) for case in scene_cases())
    rng = np.random.default_rng(6)
    numbers = rng.integers(0, 2**32, (9, 3), dtype=np.uint32).view(np.float32)  # any bits: denormals, NaN, both zeros
    yield "any bits", Cloud(np.concatenate([numbers, np.array([[0.0, -0.0, 1e-45]], np.float32)]))
    yield "colours", Cloud(rng.random((4, 5, 3), np.float32), rng.integers(0, 256, (4, 5, 3)).astype(np.uint8))

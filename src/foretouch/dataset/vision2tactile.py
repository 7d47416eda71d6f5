# SPDX-License-Identifier: Apache-2.0
"""Reader of the public vision2tactile recordings (P1): one folder a grasp, `<object>/<unix time>/`.

A sample folder holds `cloud-object.pcd` (the segmented object, camera optical frame), `best-grasp.txt`
(g1 then g2 [m]) and `tactile.tac`: a leading comma, then for the middle finger and after it for the
thumb 24 electrodes, PAC0, PAC1, PDC, TAC and TDC [counts].

The rotation of the hand was not recorded. It follows from the contacts and the object's axis as GeoGrasp
poses the hand, with the table seen from straight above and a fingertip of 25 mm.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.cloud.io.files import read_cloud
from foretouch.errors import CloudError, DatasetError, FileError, GraspError
from foretouch.grasp.axis import object_axis
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.pose import hand_rotation
from foretouch.types import ASSUMED_TABLE, ELECTRODES, Cloud, Float64, Grasp, GraspSample, Touch

__all__ = [
    "CLOUD_FILE",
    "GRASP_FILE",
    "TOUCH_FILE",
    "folder_sha256",
    "is_sample_folder",
    "read_folder",
    "read_sample",
    "read_touch",
    "sample_folders",
]

CLOUD_FILE: Final = "cloud-object.pcd"
GRASP_FILE: Final = "best-grasp.txt"
TOUCH_FILE: Final = "tactile.tac"

_HAND: Final = GeoGraspConfig(tip_mm=25.0)
_EXTRA: Final = ("PAC0", "PAC1", "TAC", "TDC")
_FINGER_SIZE: Final = ELECTRODES + 5
_PDC: Final = ELECTRODES + 2
_NS_PER_S: Final = 1_000_000_000


def read_folder(path: str | Path) -> list[GraspSample]:
    """Read one sample folder, an object folder or the whole collection.

    Args:
        path: The folder.

    Returns:
        The samples, ordered by object and time.

    Raises:
        DatasetError: If the folder is absent or holds no sample.
        FileError: At the first file that breaks a rule; names file, field and rule.
    """
    return [read_sample(folder) for folder in sample_folders(path)]


def sample_folders(path: str | Path) -> list[Path]:
    """The sample folders at or below `path`, by object and time, without opening their files.

    Raises:
        DatasetError: If the folder is absent or holds no sample.
    """
    root = Path(path)
    if not root.is_dir():
        raise DatasetError(f"{root}: no such folder")
    if is_sample_folder(root):
        return [root]
    found = sorted(folder for pattern in ("*", "*/*") for folder in root.glob(pattern) if is_sample_folder(folder))
    if not found:
        raise DatasetError(f"{root}: holds no sample: a folder with {CLOUD_FILE}, {GRASP_FILE} and {TOUCH_FILE}")
    return found


def folder_sha256(path: str | Path) -> str:
    """One hash over names and contents of all samples' files, wherever the folder lies.

    Raises:
        DatasetError: As of `sample_folders`.
        FileError: If a file is missing.
    """
    digest = hashlib.sha256()
    for folder in sample_folders(path):
        for name in (CLOUD_FILE, GRASP_FILE, TOUCH_FILE):
            try:
                content = hashlib.sha256((folder / name).read_bytes()).hexdigest()
            except OSError as err:
                raise FileError(folder / name, err.strerror or str(err)) from err
            digest.update(f"{folder.absolute().parent.name}/{folder.name}/{name} {content}\n".encode())
    return digest.hexdigest()


def is_sample_folder(path: Path) -> bool:
    """Whether a folder is meant as a sample: it holds at least one of the three files."""
    return path.is_dir() and any((path / name).is_file() for name in (CLOUD_FILE, GRASP_FILE, TOUCH_FILE))


def read_sample(folder: str | Path) -> GraspSample:
    """Read one sample folder.

    Args:
        folder: `<object>/<unix time>`.

    Returns:
        The sample; `extra` holds PAC0, PAC1, TAC and TDC of both fingers, such as `TDC_MF` [counts].

    Raises:
        FileError: Names the file, the field and the rule that it breaks.
    """
    folder = Path(folder).absolute()
    touch, extra = read_touch(folder / TOUCH_FILE)
    cloud = read_cloud(folder / CLOUD_FILE)
    stamp_ns = _stamp(folder)
    name = folder.parent.name
    return GraspSample(
        id=f"{name}/{folder.name}",
        object=name,
        cloud=Cloud(cloud.xyz, cloud.rgb, cloud.frame_id, stamp_ns),
        grasp=_read_grasp(folder / GRASP_FILE, cloud, name),
        touch=touch,
        stamp_ns=stamp_ns,
        extra=extra,
    )


def _stamp(folder: Path) -> int:
    if not folder.name.isdecimal():
        raise FileError(folder, f"the folder's name {folder.name!r} is not a unix time in seconds", field="stamp")
    return int(folder.name) * _NS_PER_S


def _read_grasp(path: Path, cloud: Cloud, object_name: str) -> Grasp:
    numbers = _read_numbers(path, 6)
    for name, contact in (("g1", numbers[:3]), ("g2", numbers[3:])):
        if not np.isfinite(contact).all():
            raise FileError(path, f"{contact.tolist()} is not finite", field=name)
    try:
        axis, _ = object_axis(cloud, ASSUMED_TABLE, _HAND)
    except CloudError as err:
        raise FileError(path.with_name(CLOUD_FILE), str(err)) from err
    try:
        rotation = hand_rotation(numbers[:3], numbers[3:], axis)
        return Grasp(numbers[:3], numbers[3:], rotation, id=path.parent.name, object_id=object_name)
    except GraspError as err:
        raise FileError(path, str(err)) from err


def read_touch(path: Path) -> tuple[Touch, dict[str, float]]:
    """Read a `tactile.tac`.

    Returns:
        The touch, and PAC0, PAC1, TAC and TDC of both fingers by name [counts].

    Raises:
        FileError: Names the file, the field and the rule that it breaks.
    """
    numbers = _read_numbers(path, 2 * _FINGER_SIZE)
    fingers = {"MF": numbers[:_FINGER_SIZE], "TH": numbers[_FINGER_SIZE:]}
    extra: dict[str, float] = {}
    for finger, values in fingers.items():
        for i, value in enumerate(values):
            if not math.isfinite(value):
                raise FileError(path, f"{value} is not finite", field=f"{finger}[{i}]")
        others = np.delete(values[ELECTRODES:], _PDC - ELECTRODES)
        extra |= {f"{name}_{finger}": float(value) for name, value in zip(_EXTRA, others, strict=True)}
    touch = Touch(
        pdc_th=float(fingers["TH"][_PDC]),
        pdc_mf=float(fingers["MF"][_PDC]),
        e_th=fingers["TH"][:ELECTRODES],
        e_mf=fingers["MF"][:ELECTRODES],
    )
    return touch, extra


def _read_numbers(path: Path, count: int) -> Float64:
    """The file's comma-separated numbers, an empty first field aside."""
    try:
        text = path.read_text(encoding="ascii").strip()
    except FileNotFoundError as err:
        raise FileError(path, "is missing") from err
    except (OSError, UnicodeDecodeError) as err:
        raise FileError(path, f"cannot be read as text: {err}") from err
    fields = text.removeprefix(",").split(",")
    if len(fields) != count:
        raise FileError(path, f"holds {len(fields)} numbers, not {count}")
    numbers = np.empty(count)
    for i, field in enumerate(fields):
        try:
            numbers[i] = float(field)
        except ValueError:
            raise FileError(path, f"{field!r} is not a number", field=f"number {i + 1}") from None
    return numbers

# SPDX-License-Identifier: Apache-2.0
"""The format of the public vision2tactile recordings (P1): one folder a grasp, `<object>/<unix time>/`.

A folder of another name is a sample without a time.

A sample folder holds `cloud-object.pcd` (the segmented object, camera optical frame), `best-grasp.txt`
(g1 then g2 [m]) and `tactile.tac`: a leading comma, then for the middle finger and after it for the
thumb 24 electrodes, PAC0, PAC1, PDC, TAC and TDC [counts].

The rotation of the hand was not recorded. It follows from the contacts and the object's axis as GeoGrasp
computes the pose of the hand, for a table seen from straight above and a fingertip of 25 mm.
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.base.files import read_bytes, write_text
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.dataset.identity import Identity, check_id
from foretouch.dataset.samples import Each, ExportResult, SampleSet, only_finite
from foretouch.errors import CloudError, FileError, GraspError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.tactile import BIOTAC, ELECTRODES, biotac_touch
from foretouch.tactile.description import require_same
from foretouch.types import ASSUMED_TABLE, SECOND_NS, Cloud, Float64, Grasp, Sample, Touch

CLOUD_FILE: Final = "cloud-object.pcd"
GRASP_FILE: Final = "best-grasp.txt"
TOUCH_FILE: Final = "tactile.tac"
_FILES: Final = (CLOUD_FILE, GRASP_FILE, TOUCH_FILE)

_IDENTITY: Final = Identity(
    hand={"name": "Shadow Hand with BioTac SP", "source": "vision2tactile"}, camera={"source": "vision2tactile"}
)
_EXTRA: Final = ("PAC0", "PAC1", "TAC", "TDC")
_FINGER_SIZE: Final = ELECTRODES + 5
_PDC: Final = ELECTRODES + 2
_STAMP_END_NS: Final = 2**63  # where stamps of 64 bits end


def _folders_in(root: Path) -> Iterator[Path]:
    """Iterate over the folders meant as samples: they hold at least one of the three files."""
    for path in chain([root], root.glob("*"), root.glob("*/*")):
        if path.is_dir() and any((path / name).is_file() for name in _FILES):
            yield path


def folder_sha256(path: str | Path) -> str:
    """Compute one hash over names and contents of all samples' files, independent of where the folder is."""
    digest = hashlib.sha256()
    for folder in sorted(_folders_in(Path(path))):
        for name in _FILES:
            content = hashlib.sha256(read_bytes(folder / name)).hexdigest()
            digest.update(f"{folder.absolute().parent.name}/{folder.name}/{name} {content}\n".encode())
    return digest.hexdigest()


def _read_sample(folder: Path) -> Sample:
    """Return the sample in a folder `<object>/<name>`, with PAC0, PAC1, TAC and TDC of both fingers as `extra` [counts]."""
    folder = folder.absolute()
    touch, extra = read_touch(folder / TOUCH_FILE)
    cloud = read_cloud(folder / CLOUD_FILE)
    stamp_ns = _stamp_ns(folder.name)
    name = folder.parent.name
    return Sample(
        id=f"{name}/{folder.name}",
        object=name,
        cloud=Cloud(cloud.xyz, cloud.rgb, cloud.frame_id, stamp_ns),
        grasp=_read_grasp(folder / GRASP_FILE, cloud, name),
        touch=touch,
        stamp_ns=stamp_ns,
        extra=extra,
    )


def _stamp_ns(name: str) -> int:
    """Return the unix time that a folder is named by [ns]; 0 if it is none."""
    stamp_ns = int(name) * SECOND_NS if name.isascii() and name.isdecimal() and len(name) < 20 else 0
    return stamp_ns if stamp_ns < _STAMP_END_NS else 0


def _read_grasp(path: Path, cloud: Cloud, object_name: str) -> Grasp:
    numbers = _read_numbers(path, 6)
    try:
        axis, _ = object_axis(cloud, ASSUMED_TABLE, GeoGraspConfig(method="original"))
        rotation = hand_rotation(numbers[:3], numbers[3:], axis)
        return Grasp(numbers[:3], numbers[3:], rotation, id=path.parent.name, object_id=object_name)
    except CloudError as err:
        raise FileError(path.with_name(CLOUD_FILE), str(err)) from err
    except GraspError as err:
        raise FileError(path, str(err)) from err


def read_touch(path: Path) -> tuple[Touch, dict[str, float]]:
    """Return the touch in a `tactile.tac`, and PAC0, PAC1, TAC and TDC of both fingers by name [counts]."""
    numbers = _read_numbers(path, 2 * _FINGER_SIZE)
    fingers = {"MF": numbers[:_FINGER_SIZE], "TH": numbers[_FINGER_SIZE:]}
    extra: dict[str, float] = {}
    for finger, values in fingers.items():
        others = np.delete(values[ELECTRODES:], _PDC - ELECTRODES)
        extra |= {f"{name}_{finger}": float(value) for name, value in zip(_EXTRA, others, strict=True)}
    both = fingers["TH"], fingers["MF"]
    return biotac_touch(
        np.hstack([*(finger[_PDC] for finger in both), *(finger[:ELECTRODES] for finger in both)])
    ), extra


def _read_numbers(path: Path, count: int) -> Float64:
    """Return the file's comma-separated numbers, without an empty first field."""
    try:
        text = read_bytes(path, 100_000).decode("ascii").strip()  # the public files have less than 400 bytes
    except FileError as err:
        if isinstance(err.__cause__, FileNotFoundError):
            raise FileError(path, "is missing") from err
        raise
    except UnicodeDecodeError as err:
        raise FileError(path, f"cannot be read as text: {err}") from err
    fields = text.removeprefix(",").split(",")
    if len(fields) != count:
        raise FileError(path, f"holds {len(fields)} numbers, not {count}")
    try:
        numbers = np.array([float(field.replace("_", "?")) for field in fields])  # Python reads 1_0 as 10
    except ValueError as err:
        raise FileError(path, f"is not a list of numbers: {err}") from None
    for i in np.flatnonzero(~np.isfinite(numbers))[:1]:
        raise FileError(path, f"{numbers[i]} is not finite", field=f"number {i + 1}")
    return numbers


def recognise(path: Path) -> bool:
    """Return whether a folder holds samples."""
    return next(_folders_in(path), None) is not None


def open_set(path: Path, _: bool) -> SampleSet:
    """Return the samples in the folders at a path."""
    folders = sorted(_folders_in(path))
    read, name = Each(folders, _read_sample), Each(folders, str)
    return SampleSet(path, "vision2tactile", len(folders), read, name, identity=_IDENTITY)


def export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    """Write samples in this format (arguments: `export` in `foretouch.dataset.formats`)."""
    require_same(samples.sensor.channels, BIOTAC, str(samples.path))
    out.mkdir(parents=True)
    exported = {f"{name}_{finger}" for name in _EXTRA for finger in ("MF", "TH")}
    for sample in map(only_finite, samples):
        progress()
        check_id(sample.id, sample.object)
        if sample.touch is None:
            result.left_out["unlabelled"] += 1
            continue
        seconds = count(sample.stamp_ns // SECOND_NS)  # or the next free one: the format supports no other names
        folder = next(path for k in seconds if not (path := out / sample.object / str(k)).exists())
        folder.mkdir(parents=True)
        write_cloud(folder / CLOUD_FILE, sample.cloud)
        write_text(folder / GRASP_FILE, _as_text([*sample.grasp.g1, *sample.grasp.g2]))
        write_text(folder / TOUCH_FILE, "," + _as_text(_fingers(sample, sample.touch)))
        result.samples += 1
        result.lost["tare"] += sample.tare is not None
        result.lost["table"] += sample.table is not None
        result.lost["series"] += sample.series is not None
        result.lost["extra"] += bool(sample.extra.keys() - exported)
        result.lost["id"] += folder.name != sample.id.partition("/")[2]


def _fingers(sample: Sample, touch: Touch) -> list[float]:
    """List the values of the middle finger, then of the thumb: 24 electrodes, PAC0, PAC1, PDC, TAC, TDC; 0 for channels that the sample lacks."""
    values: list[float] = []
    for finger in ("MF", "TH"):
        pac0, pac1, tac, tdc = (sample.extra.get(f"{name}_{finger}", 0.0) for name in _EXTRA)
        values += [*touch[f"E_{finger}"], pac0, pac1, *touch[f"PDC_{finger}"], tac, tdc]
    return values


def _as_text(values: Sequence[float]) -> str:
    """Write numbers with as many digits as reading the same numbers back requires."""
    return ",".join(f"{int(value)}" if float(value).is_integer() else repr(float(value)) for value in values)

# SPDX-License-Identifier: Apache-2.0
"""The training store: samples in Arrow IPC shards, read at random by batches.

Layout, schema version 2 (1 lacks the tables, which are then not known)::

    store/
      manifest.json       format, schema version, counts, hashes, and facts about the samples' origin
      shard-00000.arrow   Arrow IPC files, uncompressed, so that a cloud is a view of what was read

One row is one sample; see `schema_of`. A store appears complete or not at all. Its content hash covers the samples in
order, not the files: it does not depend on how they are split into shards or on the version of Arrow.

A shard is hashed as a whole and checked when a store is opened, and refused if it has changed when a batch is read.
"""

import hashlib
import json
import os
import struct
from collections.abc import Iterable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import pyarrow as pa

from foretouch.base.files import COUNT, file_sha256, open_regular, parse_json, require_schema
from foretouch.dataset.files import read_manifest
from foretouch.dataset.identity import Identity
from foretouch.dataset.samples import SampleSet
from foretouch.errors import FileError, ForetouchError, shown
from foretouch.tactile.description import sensor_in
from foretouch.types import Cloud, Grasp, Plane, Sample, Touch
from foretouch.types.channels import Channels

FORMAT: Final = "foretouch-store"
SCHEMA_VERSION: Final = 2
MANIFEST: Final = "manifest.json"
SEAL: Final = "seal"

_COLUMNS: Final = [
    ("id", pa.string()),
    ("object", pa.string()),
    ("stamp_ns", pa.int64()),
    ("frame_id", pa.string()),
    ("xyz", pa.list_(pa.float32())),  # n points, row by row [m]
    ("rgb", pa.list_(pa.uint8())),  # the same, or null
    ("g1", pa.list_(pa.float64(), 3)),  # [m]
    ("g2", pa.list_(pa.float64(), 3)),  # [m]
    ("rotation", pa.list_(pa.float64(), 9)),  # row-major
    ("score", pa.float64()),
    ("touch", pa.list_(pa.float64(), 0)),  # D values of the sensor, null for an unlabelled sample
    ("tare", pa.list_(pa.float64(), 0)),  # the same, or null
    ("extra", pa.string()),  # JSON object of numbers
    ("table", pa.list_(pa.float64(), 4)),  # a, b, c, d in the frame of the cloud [m], or null
]

_KEPT_BATCHES: Final = 4
_STREAM: Final = 8  # offset of the first message in an Arrow file [bytes]
_ARROW_ERRORS: Final = (pa.ArrowException, ValueError, TypeError, NotImplementedError)

_POINTS: Final = ("xyz", "rgb")
_NULLABLE: Final = ("rgb", "touch", "tare", "table")
_MANIFEST_SCHEMA: Final = {
    "samples": COUNT,
    "sha256": str,
    "about?": dict,
    "sensor?": dict,
    "shards?": [{"file": str, "samples": COUNT, "sha256": str}],
    "files?": [{"file": str, "sha256": str}],
}


def schema_of(channels: Channels, version: int = SCHEMA_VERSION) -> pa.Schema:
    """Return the columns of a store of a version with readings of a sensor; a row is a sample."""
    touch = pa.list_(pa.float64(), channels.size)
    known = _COLUMNS if version > 1 else _COLUMNS[:-1]
    columns = [(name, touch if name in ("touch", "tare") else kind) for name, kind in known]
    return pa.schema(columns, metadata={"format": FORMAT, "schema_version": str(version)})


def is_store(path: str | Path) -> bool:
    """Return whether the path is a training store."""
    return (Path(path) / MANIFEST).is_file()


class _Part(NamedTuple):
    """One record batch in a verified shard: its offset there [bytes], and its number of samples."""

    path: Path
    stat: tuple[int, ...]  # of the shard when it was verified
    offset: int
    samples: int


class Store(Sequence[Sample]):
    """A training store on disk; `store[k]` reads one sample, whose cloud is a read-only view of its batch.

    Opening compares manifest, shards and attached files with their hashes before anything in them is decoded. The latest
    batches are kept in memory.

    Raises:
        FileError: If no store is there, it is of another version, or files and manifest disagree.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.manifest = _read_manifest(self.path)
        self.sensor = sensor_in(self.manifest, self.path / MANIFEST)
        self._schema = schema_of(self.sensor.channels, self.manifest["schema_version"])
        self._parts = self._verified_parts()
        self._starts = np.cumsum([0, *(part.samples for part in self._parts)])
        self._batch = lru_cache(maxsize=_KEPT_BATCHES)(partial(_read_batch, self._schema))
        if len(self) != self.manifest["samples"]:
            raise FileError(self.path, f"holds {len(self)} samples, not {self.manifest['samples']}", field="samples")

    @property
    def sha256(self) -> str:
        """Content hash as the writer computed it."""
        return str(self.manifest["sha256"])

    def __reduce__(self) -> tuple[Any, tuple[Path, str]]:
        """Let another process open the store again, if it holds the same samples then."""
        return _reopened, (self.path, self.sha256)

    def __len__(self) -> int:
        return int(self._starts[-1])

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = index + len(self) if index < 0 else index
        if not 0 <= k < len(self):
            raise IndexError(f"{self.path}: sample {index} of {len(self)}")
        b = int(np.searchsorted(self._starts, k, side="right")) - 1
        try:
            return _sample(self._batch(self._parts[b]), k - int(self._starts[b]), self.sensor.channels)
        except FileError:
            raise
        except (ForetouchError, ValueError) as err:
            raise FileError(self.path, " ".join(str(err).split()), field=f"sample {k}") from err

    def name(self, index: int) -> str:
        """Return where a sample is, for messages."""
        return f"{self.path}[{index}]"

    def _verified_parts(self) -> list[_Part]:
        for part in self.manifest["files"]:
            _require_hash(self.path / part["file"], file_sha256(self.path / part["file"]), part["sha256"])
        parts: list[_Part] = []
        for shard in self.manifest["shards"]:
            parts += _read_shard(self.path / shard["file"], shard["sha256"], shard["samples"], self._schema)
        return parts


def _reopened(path: Path, sha256: str) -> Store:
    """Open a store again; a `FileError` if it holds other samples than before."""
    store = Store(path)
    if store.sha256 != sha256:
        raise FileError(path, "was changed after it was opened: open it again")
    return store


def sample_digest(sample: Sample) -> bytes:
    """Return the SHA-256 over all values of the sample."""
    digest = hashlib.sha256()
    cloud, grasp = sample.cloud, sample.grasp
    head = [sample.id, sample.object, sample.stamp_ns, cloud.frame_id, cloud.size, dict(sorted(sample.extra.items()))]
    digest.update(json.dumps(head, separators=(",", ":")).encode())
    digest.update(np.ascontiguousarray(cloud.xyz).data)
    digest.update(b"" if cloud.rgb is None else np.ascontiguousarray(cloud.rgb).data)
    digest.update(np.concatenate([grasp.g1, grasp.g2, grasp.rotation.ravel(), [grasp.score]]).astype(np.float64).data)
    for touch in (sample.touch, sample.tare):
        digest.update(b"-" if touch is None else touch.values.data)
    if sample.table is not None:
        digest.update(sample.table.coefficients.data)
    return digest.digest()


def content_sha256(samples: Iterable[Sample]) -> str:
    """Return the SHA-256 over some samples in order, hexadecimal."""
    content = hashlib.sha256()
    for sample in samples:
        content.update(sample_digest(sample))
    return content.hexdigest()


def _read_manifest(path: Path) -> dict[str, Any]:
    file = path / MANIFEST
    manifest = read_manifest(file, FORMAT, SEAL, SCHEMA_VERSION, 1)
    require_schema(file, manifest, _MANIFEST_SCHEMA)
    for part in [*manifest.setdefault("shards", []), *manifest.setdefault("files", [])]:
        if not part["file"] or "\0" in part["file"] or Path(part["file"]).name != part["file"]:
            raise FileError(file, f"{shown(part['file'])!r} is not the name of a file in the store", field="file")
    return manifest


def _require_hash(path: Path, digest: str, wanted: str) -> None:
    if digest != wanted:
        raise FileError(path, f"sha256 is {digest}, not {shown(wanted)} as in {MANIFEST}: the file was changed")


def _read_shard(path: Path, sha256: str, samples: int, wanted: pa.Schema) -> list[_Part]:
    """Return the record batches of a shard, checked after its hash, for Arrow trusts what it is given."""
    parts = list[_Part]()
    with open_regular(path) as file:
        _require_hash(path, hashlib.file_digest(file, "sha256").hexdigest(), sha256)
        status = _stat(file)
        file.seek(_STREAM)  # behind it a file holds the messages of a stream, and then an index
        try:
            source = pa.PythonFile(file, "r")
            schema = pa.ipc.read_schema(pa.ipc.read_message(source))
            if not schema.equals(wanted):
                raise FileError(path, "has other columns than the schema", field="schema")
            offset, messages = file.tell(), pa.ipc.MessageReader.open_stream(source)
            for number, message in enumerate(messages):
                field = f"batch {number}"
                if _is_compressed(message):
                    raise FileError(path, "is compressed", field=field)
                batch = pa.ipc.read_record_batch(message, schema)
                _check_batch(path, batch, field)
                parts.append(_Part(path, status, offset, batch.num_rows))
                offset = file.tell()
        except (OSError, EOFError, struct.error, *_ARROW_ERRORS) as err:
            raise FileError(path, f"cannot be read: {' '.join(str(err).split())}") from err
    if (rows := sum(part.samples for part in parts)) != samples:
        raise FileError(path, f"holds {rows} samples, the manifest declares {samples}")
    return parts


def _stat(file: BinaryIO) -> tuple[int, ...]:
    info = os.fstat(file.fileno())
    return info.st_ino, info.st_size, info.st_mtime_ns


def _is_compressed(message: Any) -> bool:
    """Return whether a message of Arrow names a compression of its buffers; to decode it would unpack them first.

    The metadata are a flatbuffer: a `Message`, whose third field is a `RecordBatch`, whose fourth is the compression.
    """
    data = message.metadata.to_pybytes()

    def field(table: int, number: int) -> int:
        entries = table - int(struct.unpack_from("<i", data, table)[0])
        (size,) = struct.unpack_from("<H", data, entries)
        place = 4 + 2 * number
        return int(struct.unpack_from("<H", data, entries + place)[0]) if place < size else 0

    (root,) = struct.unpack_from("<I", data)
    batch = root + field(root, 2)
    return bool(field(batch + int(struct.unpack_from("<I", data, batch)[0]), 3))


def _read_batch(schema: Any, part: _Part) -> Any:
    """Return the record batch of a part, whose shard must be the one that was verified."""
    with open_regular(part.path) as file:
        if _stat(file) != part.stat:
            raise FileError(part.path, "was changed after it was opened")
        file.seek(part.offset)
        return pa.ipc.read_record_batch(pa.ipc.read_message(pa.PythonFile(file, "r")), schema)


def _check_batch(path: Path, batch: Any, field: str) -> None:
    """Check offsets, texts and lengths, so that every later view lies within its buffer."""
    try:
        batch.validate(full=True)
    except _ARROW_ERRORS as err:
        raise FileError(path, " ".join(str(err).split()), field=field) from err
    for name in batch.schema.names:
        column = batch.column(name)
        inner = column.flatten() if pa.types.is_nested(column.type) else None
        if (name not in _NULLABLE and column.null_count) or (inner is not None and inner.null_count):
            raise FileError(path, "is null in some rows", field=f"{field}: {name}")
        if name in _POINTS and any((len(cloud.values or ()) % 3) for cloud in column):
            raise FileError(path, "a cloud is not a whole number of points", field=field)


def _sample(batch: Any, row: int, channels: Channels) -> Sample:
    """Return a row of a batch; its cloud is a view, and the rest copied, so that it does not keep the bytes of the batch."""

    def vector(name: str) -> Any:
        values = batch.column(name)[row].values
        return None if values is None else values.to_numpy(zero_copy_only=False)

    def touch(name: str) -> Touch | None:
        return None if (values := vector(name)) is None else Touch(values.copy(), channels)

    names = ("id", "object", "frame_id", "extra", "stamp_ns", "score")
    plain = {name: batch.column(name)[row].as_py() for name in names}
    table = vector("table") if "table" in batch.schema.names else None
    colours = vector("rgb")
    rgb = None if colours is None else colours.reshape(-1, 3)
    g1, g2, rotation = (vector(name).copy() for name in ("g1", "g2", "rotation"))
    return Sample(
        id=plain["id"],
        object=plain["object"],
        cloud=Cloud(vector("xyz").reshape(-1, 3), rgb, plain["frame_id"], plain["stamp_ns"]),
        grasp=Grasp(g1, g2, rotation.reshape(3, 3), plain["score"], object_id=plain["object"]),
        touch=touch("touch"),
        tare=touch("tare"),
        stamp_ns=plain["stamp_ns"],
        extra=_numbers(plain["extra"]),
        table=None if table is None else Plane(table[:3].copy(), float(table[3])),
    )


def _numbers(text: str) -> dict[str, float]:
    """Return the named numbers of a sample."""
    numbers = parse_json(text)
    if not isinstance(numbers, dict) or not all(
        type(value) in (int, float) and abs(value) < 1e300 for value in numbers.values()
    ):
        raise ValueError(f"extra: {shown(text)} is not a list of named numbers that are finite")
    return numbers


recognise = is_store


def open_set(path: Path, _: bool) -> SampleSet:
    """Return the samples of a store; a `FileError` if files and manifest disagree."""
    store = Store(path)
    about = store.manifest.get("about", {})
    return SampleSet(
        path=path,
        kind="store",
        size=len(store),
        read=store.__getitem__,
        name=store.name,
        identity=Identity(hand=about.get("hand", {}), camera=about.get("camera", {})),
        sensor=store.sensor,
    )

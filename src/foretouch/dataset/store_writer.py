# SPDX-License-Identifier: Apache-2.0
"""Writes training stores; see `foretouch.dataset.store` for their layout."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa

from foretouch.dataset.store import FORMAT, MANIFEST, SCHEMA, SCHEMA_VERSION, sample_digest, seal_manifest
from foretouch.errors import DatasetError, FileError
from foretouch.types import GraspSample, Touch

__all__ = ["StoreWriter"]

_BATCH_ROWS = 64
_SHARD_ROWS = 1024


class StoreWriter:
    """Collects samples and, when its `with` block ends well, puts the store in its place.

    Until then nothing is at the path; if the block is left by an error, nothing ever is.

    Args:
        path: Where to; must not exist.
        about: Kept in the manifest: what made the samples, from what, with which seed.

    Raises:
        FileError: If the path exists or its folder cannot be written.
        DatasetError: If a number of a sample is not finite where it must be, or two samples have one id.
    """

    def __init__(self, path: str | Path, about: Mapping[str, Any] | None = None) -> None:
        self.path = Path(path)
        self.about = dict(about or {})
        self.count = 0
        self._content = hashlib.sha256()
        self._ids: set[str] = set()
        self._rows: list[dict[str, Any]] = []
        self._shards: list[dict[str, Any]] = []
        self._sink: Any = None
        self._writer: Any = None
        self._in_shard = 0
        self._files: list[dict[str, str]] = []

    def __enter__(self) -> Self:
        self._refuse_existing()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(mkdtemp(prefix=f".{self.path.name}.", dir=self.path.parent))
        except OSError as err:
            raise FileError(self.path, f"cannot be made: {err.strerror}") from err
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        try:
            self._end_shard()
            if kind is None:
                self._publish()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def sha256(self) -> str:
        """Content hash of the samples so far."""
        return self._content.hexdigest()

    def write(self, sample: GraspSample) -> None:
        """Append one sample."""
        row = _row(sample)
        if sample.id in self._ids:
            raise DatasetError(f"{sample.id}: the store {self.path} holds this id already")
        self._ids.add(sample.id)
        self._content.update(sample_digest(sample))
        self._rows.append(row)
        self.count += 1
        if len(self._rows) == _BATCH_ROWS:
            self._end_batch()
        if self._in_shard == _SHARD_ROWS:
            self._end_shard()

    def attach(self, name: str, text: str) -> None:
        """Put a file with a text beside the shards, such as splits; `Store.verify` proves it too.

        Raises:
            DatasetError: If the name is taken, or not that of a file.
        """
        if Path(name).name != name or (self._folder / name).exists() or name == MANIFEST:
            raise DatasetError(f"{self.path}: {name} is taken, or not the name of a file")
        data = text.encode()
        (self._folder / name).write_bytes(data)
        self._files.append({"file": name, "sha256": hashlib.sha256(data).hexdigest()})

    def _end_batch(self) -> None:
        if not self._rows:
            return
        if self._writer is None:
            self._sink = pa.OSFile(str(self._folder / self._shard_name()), "wb")
            self._writer = pa.ipc.new_file(self._sink, SCHEMA)
        self._writer.write_batch(_batch(self._rows))
        self._in_shard += len(self._rows)
        self._rows = []

    def _end_shard(self) -> None:
        self._end_batch()
        if self._writer is None:
            return
        self._writer.close()
        self._sink.close()
        file = self._folder / self._shard_name()
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        self._shards.append({"file": file.name, "samples": self._in_shard, "sha256": digest})
        self._writer, self._sink, self._in_shard = None, None, 0

    def _shard_name(self) -> str:
        return f"shard-{len(self._shards):05d}.arrow"

    def _publish(self) -> None:
        manifest = {
            "format": FORMAT,
            "schema_version": SCHEMA_VERSION,
            "samples": self.count,
            "sha256": self.sha256,
            "shards": self._shards,
            "about": self.about,
        }
        if self._files:
            manifest["files"] = self._files
        text = seal_manifest(manifest)
        with (self._folder / MANIFEST).open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        self._refuse_existing()
        self._folder.chmod(0o755)  # a temporary folder is private
        self._folder.rename(self.path)

    def _refuse_existing(self) -> None:
        if self.path.exists():
            raise FileError(self.path, "exists already")


def _row(sample: GraspSample) -> dict[str, Any]:
    cloud = sample.cloud
    if cloud.organised or not np.isfinite(cloud.xyz).all():
        raise DatasetError(f"{sample.id}: the cloud is organised or not finite; a store holds the object's points only")
    extra = {name: float(value) for name, value in sorted(sample.extra.items())}
    bad = [name for name, value in extra.items() if not np.isfinite(value)]
    if bad:
        raise DatasetError(f"{sample.id}: extra.{bad[0]}: {extra[bad[0]]} is not finite")
    return {
        "id": sample.id,
        "object": sample.object,
        "stamp_ns": sample.stamp_ns,
        "frame_id": cloud.frame_id,
        "xyz": cloud.xyz.ravel(),
        "rgb": None if cloud.rgb is None else cloud.rgb.ravel(),
        "g1": sample.grasp.g1,
        "g2": sample.grasp.g2,
        "rotation": sample.grasp.rotation.ravel(),
        "score": sample.grasp.score,
        "touch": _counts(sample.touch, f"{sample.id}: touch"),
        "tare": _counts(sample.tare, f"{sample.id}: tare"),
        "extra": json.dumps(extra, separators=(",", ":")),
    }


def _counts(touch: Touch | None, name: str) -> Any:
    if touch is None:
        return None
    vector = touch.vector()
    if not np.isfinite(vector).all():
        raise DatasetError(f"{name}: holds a value that is not finite")
    return vector


def _batch(rows: list[dict[str, Any]]) -> Any:
    columns = []
    for field in SCHEMA:
        values = [row[field.name] for row in rows]
        if pa.types.is_list(field.type):
            columns.append(_ragged(values, field.type))
        elif pa.types.is_fixed_size_list(field.type):
            columns.append(_fixed(values, field.type.list_size))
        else:
            columns.append(pa.array(values, field.type))
    return pa.record_batch(columns, schema=SCHEMA)


def _ragged(values: list[Any], kind: Any) -> Any:
    sizes = [0 if value is None else value.size for value in values]
    offsets = pa.array(np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32))
    present = [value for value in values if value is not None]
    flat = np.concatenate(present) if present else np.empty(0, kind.value_type.to_pandas_dtype())
    missing = pa.array([value is None for value in values])
    return pa.ListArray.from_arrays(offsets, pa.array(flat, kind.value_type), mask=missing)


def _fixed(values: list[Any], size: int) -> Any:
    empty = np.zeros(size)
    flat = np.concatenate([empty if value is None else value for value in values])
    missing = pa.array([value is None for value in values])
    return pa.FixedSizeListArray.from_arrays(pa.array(flat, pa.float64()), size, mask=missing)

# SPDX-License-Identifier: Apache-2.0
"""Writes training stores (see `foretouch.dataset.store`), and builds them from other datasets.

The content hash depends on the samples and their order alone: the same recordings give the same hash on any machine.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa

from foretouch import __version__
from foretouch.base.files import file_sha256, system_errors, write_text
from foretouch.dataset.files import new_folder, sealed
from foretouch.dataset.formats import open_samples
from foretouch.dataset.identity import id_number, numbered_id
from foretouch.dataset.samples import only_finite
from foretouch.dataset.store import FORMAT, MANIFEST, SCHEMA_VERSION, SEAL, sample_digest, schema_of
from foretouch.errors import DatasetError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import is_storable
from foretouch.tactile.description import Sensor, require_same, with_sensor
from foretouch.types import DISCARDED, Sample

_BATCH_ROWS = 64
_SHARD_ROWS = 1024


class StoreWriter:
    """Collects samples; the store appears at the path when the `with` block ends without an error.

    `about` are facts for the manifest: what made the samples, from which sources, with which seed. `sensor` is the sensor of the
    readings, by default the BioTac SP; it may be set before the first sample.

    Raises:
        FileError: If the path exists or its folder cannot be written.
        DatasetError: If a number of a sample is not finite where it must be, or two samples have one id.
        TactileError: If a reading is of another sensor.
    """

    def __init__(self, path: str | Path, about: Mapping[str, Any] | None = None, sensor: Sensor | None = None) -> None:
        self.path = Path(path)
        self.about = dict(about or {})
        self.sensor = sensor or BIOTAC_SP
        self._content = hashlib.sha256()
        self._ids: set[str] = set()
        self._rows: list[dict[str, Any]] = []
        self._shards: list[dict[str, Any]] = []
        self._files: list[dict[str, str]] = []
        self._writer: Any = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._folder = stack.enter_context(new_folder(self.path))
            stack.enter_context(system_errors(self.path, "cannot be written"))
            self._folder.mkdir()
            self._open = stack.pop_all()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        with self._open:  # removes the folder after an error
            if error is not None:
                raise error
            self._end_shard()
            self._write_manifest()

    @property
    def sha256(self) -> str:
        """Content hash of the samples so far."""
        return self._content.hexdigest()

    def write(self, sample: Sample) -> None:
        """Append one sample."""
        for name, touch in (("touch", sample.touch), ("tare", sample.tare)):
            if touch is not None:
                require_same(touch.channels, self.sensor.channels, f"{sample.id}: {name}")
        row = _row(sample)
        if sample.id in self._ids:
            raise DatasetError(f"{sample.id}: the store {self.path} holds this id already")
        self._ids.add(sample.id)
        self._content.update(sample_digest(sample))
        self._rows.append(row)
        if len(self._rows) == _BATCH_ROWS:
            self._end_batch()
            if self._shards[-1]["samples"] == _SHARD_ROWS:
                self._end_shard()

    def attach(self, name: str, text: str) -> None:
        """Add a text file beside the shards, such as splits, whose hashes `Store` checks too."""
        path = self._folder / name
        if path.name != name or path.exists() or name == MANIFEST:
            raise DatasetError(f"{self.path}: {name} is taken, or not the name of a file")
        write_text(path, text)
        self._files.append({"file": name, "sha256": file_sha256(path)})

    def _end_batch(self) -> None:
        if not self._rows:
            return
        if self._writer is None:
            name = f"shard-{len(self._shards):05d}.arrow"
            self._shards.append({"file": name, "samples": 0})
            self._sink = pa.OSFile(str(self._folder / name), "wb")
            self._schema = schema_of(self.sensor.channels)
            self._writer = pa.ipc.new_file(self._sink, self._schema)
        self._writer.write_batch(pa.RecordBatch.from_pylist(self._rows, schema=self._schema))
        self._shards[-1]["samples"] += len(self._rows)
        self._rows = []

    def _end_shard(self) -> None:
        self._end_batch()
        if self._writer is not None:
            self._writer.close()
            self._sink.close()
            self._shards[-1]["sha256"] = file_sha256(self._folder / self._shards[-1]["file"])
            self._writer = None

    def _write_manifest(self) -> None:
        manifest = {
            "format": FORMAT,
            "schema_version": SCHEMA_VERSION,
            "samples": len(self._ids),
            "sha256": self.sha256,
            "shards": self._shards,
            "about": self.about,
        }
        if self._files:
            manifest["files"] = self._files
        write_text(self._folder / MANIFEST, sealed(with_sensor(manifest, self.sensor), SEAL))


@dataclass(frozen=True)
class SampleFacts:
    """The properties of a sample that splits depend on."""

    id: str
    object: str
    stamp_ns: int
    labelled: bool


@dataclass(kw_only=True)
class BuildResult:
    """The result of a build."""

    sha256: str = ""  # content hash
    samples: list[SampleFacts] = field(default_factory=list)  # the samples in order
    left_out: Counter[str] = field(default_factory=Counter)  # counts of samples left out, by reason
    tables: int = 0  # samples that hold their table; of others the camera is taken to look straight down on it
    renumbered: int = 0  # samples whose id a source before had; both ids are in the manifest


def build_store(
    sources: Sequence[str | Path],
    out: str | Path,
    *,
    attach: Callable[[Sequence[SampleFacts]], Mapping[str, str]] = lambda _: {},
    progress: Callable[[], None] = lambda: None,
) -> BuildResult:
    """Write all samples of some datasets into one training store, without those that the operator discarded.

    A sample whose id a sample of an earlier source has gets the number after the highest so far, as in a
    recording that is continued; `about.sources` in the manifest lists the new ids by the old ones.

    Args:
        sources: Paths of datasets; of one sensor.
        out: Path of the store.
        attach: From the samples to text files that are added to the store, such as splits, by name.
        progress: Called for each sample.

    Raises:
        FileError: If `out` exists, or a source is not a dataset or damaged.
        DatasetError: If two sources hold the same sample, two of one source the same id, or a number is not finite.
    """
    result = BuildResult()
    origins: list[dict[str, Any]] = []
    about: dict[str, Any] = {"made_by": f"foretouch {__version__} dataset build", "sources": origins}
    ids = _UniqueIds(sources)
    with StoreWriter(out, about) as writer:
        for number, source in enumerate(sources):
            renumbered: dict[str, str] = {}
            samples = open_samples(source)
            if not origins:
                writer.sensor = samples.sensor
            require_same(samples.sensor.channels, writer.sensor.channels, str(source))
            identity = {"hand": dict(samples.identity.hand), "camera": dict(samples.identity.camera)}
            origins.append({"name": samples.path.name, "kind": samples.kind, "samples": len(samples), **identity})
            for sample in samples.with_discarded():
                progress()
                if DISCARDED in sample.flags:
                    result.left_out[DISCARDED] += 1
                    continue
                stored = ids.with_own_id(number, only_finite(sample), renumbered)
                writer.write(stored)
                result.tables += stored.table is not None
                result.samples.append(SampleFacts(stored.id, stored.object, stored.stamp_ns, stored.touch is not None))
            if renumbered:
                origins[-1]["renumbered"] = renumbered
                result.renumbered += len(renumbered)
        for name in ("hand", "camera"):
            if origins and all(origin[name] == origins[0][name] for origin in origins):
                about[name] = origins[0][name]
        writer.about |= about
        for name, text in attach(result.samples).items():
            writer.attach(name, text)
        result.sha256 = writer.sha256
    return result


class _UniqueIds:
    """The ids of a store that is built from several sources."""

    def __init__(self, sources: Sequence[str | Path]) -> None:
        self._sources = sources
        self._ids: dict[str, int] = {}  # number of the source of each id
        self._contents: dict[bytes, int] = {}  # and of each sample, by a hash of all but its id
        self._last = 0

    def with_own_id(self, number: int, sample: Sample, renumbered: dict[str, str]) -> Sample:
        """Return a sample of a source with its own id, which is added to `renumbered` if it is new.

        Raises a `DatasetError` if a source before holds the sample, whatever the ids.
        """
        holder = self._contents.setdefault(sample_digest(replace(sample, id="")), number)
        if holder != number:
            both = f"{self._sources[number]}: {sample.id}: is in {self._sources[holder]} too"
            raise DatasetError(f"{both}; build from one of both")
        if self._ids.setdefault(sample.id, number) != number and sample.id not in renumbered:
            new = renumbered[sample.id] = numbered_id(sample.object, self._last + 1)
            self._ids[new] = -1  # taken for all sources
            sample = replace(sample, id=new)
        self._last = max(self._last, id_number(sample.id))
        return sample


def _row(sample: Sample) -> dict[str, Any]:
    cloud = sample.cloud
    if cloud.organised or not np.isfinite(cloud.xyz).all():
        raise DatasetError(f"{sample.id}: the cloud is organised or not finite; a store holds the object's points only")
    extra = {name: float(value) for name, value in sorted(sample.extra.items())}
    for name, value in extra.items():
        if not np.isfinite(value):
            raise DatasetError(f"{sample.id}: extra.{name}: {value} is not finite")
    touches = {"touch": sample.touch, "tare": sample.tare}
    counts = {name: None if touch is None else touch.values for name, touch in touches.items()}
    for name, touch in touches.items():
        if touch is not None and not is_storable(touch.values, touch.channels):
            raise DatasetError(f"{sample.id}: {name}: holds a value that is not finite")
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
        **counts,
        "extra": json.dumps(extra, separators=(",", ":")),
        "table": None if sample.table is None else sample.table.coefficients,
    }

# SPDX-License-Identifier: Apache-2.0
"""The samples of a dataset, whatever its format; `foretouch.dataset.formats` opens and exports them."""

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, overload

import numpy as np

from foretouch.dataset.identity import Identity
from foretouch.doors import FUNCTIONS
from foretouch.errors import DatasetError, NoSuchRowError, shown
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import with_dead_taxels
from foretouch.tactile.description import Sensor
from foretouch.types import DISCARDED, AnyArray, Bool, Grasps, Index, Sample
from foretouch.types.arrays import require_types
from foretouch.types.summary import Summarised, briefly, counted, names_of
from foretouch.types.tables import LabelledTable, Tabular, Variable, labels_of

#: Bin edges of the histogram of pairing errors [ms].
PAIRING_EDGES_MS: Final = (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, float("inf"))

_SHOWN: Final = 64  # readings of a grasp by which dead taxels are found

_TYPES: Final[dict[str, tuple[Any, str]]] = {
    "path": (Path, "a path; foretouch.open(path) makes a set"),
    "kind": (str, "a text"),
    "size": ((int, np.integer), "a whole number"),
    **dict.fromkeys(("read", "name", "message_counts"), (Callable, "a function")),
    "identity": (Identity, "an Identity"),
    **dict.fromkeys(("unfinished", "edits"), (tuple, "a tuple")),
    "sensor": (Sensor, "a Sensor"),
}
"""Types of fields, and what they are in words."""


@dataclass(frozen=True)
class Each:
    """A function of each of some items, by its number: `SampleSet.read` and `name` of a list of files. It can be pickled."""

    items: Sequence[Any]
    function: Callable[[Any], Any]

    def __call__(self, number: int) -> Any:
        """Return what the function gives of an item."""
        return self.function(self.items[number])


@dataclass(frozen=True, eq=False, repr=False)
class SampleSet(Summarised, Tabular):
    """The samples of a dataset in order, read on demand and as often as needed, as they were when it was opened.

    Threads and forked processes may read one set. A pickled one opens its files again where it is unpickled, which are found by
    their absolute paths. It is a map-style dataset for the `DataLoader` of PyTorch (with `collate_fn=list`, since a sample is no
    tensor): `len(samples)` and `samples[k]` count all samples, iteration leaves out those that the operator discarded.
    """

    path: Path  # the dataset
    kind: str  # name of its format
    size: int  # number of samples, including discarded ones
    read: Callable[[int], Sample]  # reads one sample by its number; raises `FileError` with file and position
    name: Callable[[int], str]  # where a sample is stored, for messages
    identity: Identity = field(default_factory=Identity)  # hand and camera, as far as they are known
    unfinished: tuple[Path, ...] = ()  # recordings that were cut off, if those may be read
    message_counts: Callable[[], Mapping[str, Mapping[str, Any]]] = dict  # reads them by topic, in plain types
    edits: tuple[str, ...] = ()  # descriptions of later changes
    sensor: Sensor = BIOTAC_SP  # that was read

    def __post_init__(self) -> None:
        require_types(self, _TYPES, DatasetError)
        if self.size < 0:
            raise DatasetError(f"size: {self.size} is negative")

    def _summary(self) -> tuple[str, dict[str, str]]:
        return counted(self.size, "sample"), {
            "path": shown(self.path, 80),
            "format": self.kind,
            "sensor": briefly(self.sensor),
            "hand": names_of([f"{key} {value}" for key, value in self.identity.hand.items()]),
            "camera": names_of([f"{key} {value}" for key, value in self.identity.camera.items()]),
            "cut off": names_of([path.name for path in self.unfinished]),
            "changed": names_of(self.edits),
        }

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, number: int) -> Sample: ...
    @overload
    def __getitem__(self, number: slice) -> "SampleSet": ...
    def __getitem__(self, number: int | slice) -> "Sample | SampleSet":
        """Read a sample by its number, from the end if it is negative, or choose some by a slice; a `NoSuchRowError` if there is none."""
        if isinstance(number, slice):
            return self.subset(range(self.size)[number])
        if isinstance(number, bool) or not hasattr(number, "__index__") or np.ndim(number):
            rule = "is not the number of a sample; choose some by subset([0, 2]), or by filter(function)"
            raise NoSuchRowError(f"{self.path}: {shown(number, 60)} {rule}")
        number = operator.index(number)
        if not -self.size <= number < self.size:
            raise NoSuchRowError(f"{self.path}: there is no sample {number}, 0 to {self.size - 1}")
        return self.read(number % self.size)

    def __iter__(self) -> Iterator[Sample]:
        """Return the samples in order, without those that the operator discarded."""
        return (sample for sample in self.with_discarded() if DISCARDED not in sample.flags)

    def to_arrays(self) -> dict[str, AnyArray]:
        """Return all labelled samples as columns, one row for each; clouds, whose sizes differ, are left out.

        Returns:
            `id`, `object` (S,) texts; `stamp_ns` (S,) int64 [ns]; `g1`, `g2` (S, 3) and `rotation` (S, 3, 3) float64 [m] in
            the frame of the camera; `touch` and `tare` (S, D) float64 in the unit of the sensor, NaN without a tare; and
            the channels of the touch by name, such as `E` (S, F, 24) and `PDC` (S, F).

        Raises:
            DatasetError: If no sample is labelled.
        """
        samples = [sample for sample in self if sample.touch is not None]
        if not samples:
            raise DatasetError(f"{self.path}: no sample is labelled")
        channels = self.sensor.channels
        grasps = Grasps.of([sample.grasp for sample in samples])
        touch, tare = (
            np.array([
                np.full(channels.size, np.nan) if (read := getattr(sample, name)) is None else read.values for sample in samples
            ])
            for name in ("touch", "tare")
        )  # fmt: skip
        return {
            "id": np.array([sample.id for sample in samples]),
            "object": np.array([sample.object for sample in samples]),
            "stamp_ns": np.array([sample.stamp_ns for sample in samples], np.int64),
            **{name: getattr(grasps, name) for name in ("g1", "g2", "rotation")},
            "touch": touch,
            "tare": tare,
            **{channel.name: channels.part(touch, channel.name) for channel in channels.channels},
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: the sensor, and `samples`, each as `Sample.to_dict`."""
        channels = self.sensor.channels
        sensor = {"sensor": channels.sensor, "sensor_sha256": channels.sha256}
        return {**sensor, "samples": [sample.to_dict() for sample in self]}

    def _table(self) -> LabelledTable:
        columns, channels = self.to_arrays(), self.sensor.channels
        kinds = {channel.name: channel.unit for channel in channels.channels}
        variables = {name: Variable(("sample",), columns[name]) for name in ("id", "object", "stamp_ns")}
        variables |= {name: Variable(("sample", "axis"), columns[name], "m") for name in ("g1", "g2")}
        variables["rotation"] = Variable(("sample", "axis", "hand_axis"), columns["rotation"])
        for ending, values in (("", columns["touch"]), ("_tare", columns["tare"])):
            for name, unit in kinds.items() if np.isfinite(values).any() else ():
                part = channels.part(values, name)
                variables[name + ending] = Variable(("sample", "finger", "taxel")[: part.ndim], part, unit)
        return LabelledTable(
            variables, labels_of(channels), {"sensor": channels.sensor, "sensor_sha256": channels.sha256}
        )

    def split(self, kind: str = "object", seed: int = 0) -> list[tuple["SampleSet", "SampleSet"]]:
        """Split the labelled samples into parts to train and to test on; requires `foretouch[lab]`.

        Args:
            kind: `object`: each object is left out once; `time`: 5 consecutive blocks of each object's grasps; `random`: 5
                random parts, whose grasps have neighbours in the training part.
            seed: Of the random split.

        Returns:
            (train, test) of each fold.

        Raises:
            DatasetError: If there is no such split, or there are too few samples for it.
        """
        labelled = self.filter(_is_labelled)
        folds = FUNCTIONS.call("folds", "split", [*labelled], kind, seed)
        return [(labelled.subset(fold.train), labelled.subset(fold.test)) for fold in folds]

    def subset(self, numbers: Sequence[int] | Index | Bool) -> "SampleSet":
        """Return some samples by their numbers, in this order.

        Args:
            numbers: From 0, of all samples; or (S,) bool, one for each of all samples.

        Raises:
            DatasetError: If there is no sample of a number.
        """
        given = np.asarray(
            [*numbers] if isinstance(numbers, Iterable) and getattr(numbers, "ndim", None) != 0 else numbers
        )
        if given.dtype == np.bool_ and given.shape == (self.size,):
            given = np.flatnonzero(given)
        if given.ndim != 1 or (given.size and given.dtype.kind not in "iu"):
            raise DatasetError(f"{self.path}: {shown(numbers, 80)} are not the numbers of samples, such as [0, 2]")
        kept = tuple(given.astype(np.int64).tolist())
        if wrong := [k for k in kept if not 0 <= k < self.size]:
            raise DatasetError(f"{self.path}: {wrong[0]} is not the number of a sample, 0 to {self.size - 1}")
        return replace(self, size=len(kept), read=Each(kept, self.read), name=Each(kept, self.name))

    def filter(self, keep: Callable[[Sample], bool]) -> "SampleSet":
        """Return the samples for which a function is true; it is asked now, once for each sample, also for discarded ones.

        Args:
            keep: Such as `lambda sample: sample.outcome == "success"`; it is not kept.
        """
        if not callable(keep):
            raise DatasetError(f"keep: {shown(keep, 80)} is not a function of a sample")
        return self.subset([k for k, sample in enumerate(self.with_discarded()) if keep(sample)])

    def with_discarded(self) -> Iterator[Sample]:
        """Return the samples in order, also those that the operator discarded."""
        return (self.read(k) for k in range(self.size))


def _is_labelled(sample: Sample) -> bool:
    return sample.touch is not None and DISCARDED not in sample.flags


@dataclass(kw_only=True)
class ExportResult:
    """Counts of an export."""

    samples: int = 0  # that were written
    left_out: Counter[str] = field(default_factory=Counter)  # samples that the format cannot hold, by reason
    lost: Counter[str] = field(default_factory=Counter)  # samples with a field that the format cannot hold, by field


def sensor_of_samples(samples: SampleSet) -> Sensor:
    """Return the sensor of a dataset, with the taxels declared dead that all readings show to be dead."""
    rows = [series.counts[:: max(1, len(series.counts) // _SHOWN)] for sample in samples if (series := sample.readings)]
    return with_dead_taxels(samples.sensor, np.concatenate(rows).astype(np.float64)) if rows else samples.sensor


def only_finite(sample: Sample) -> Sample:
    """Return the sample with an unorganised cloud, without points that have no depth."""
    finite = np.asarray(np.isfinite(sample.cloud.xyz).all(axis=-1), np.bool_)
    return sample if not sample.cloud.organised and finite.all() else replace(sample, cloud=sample.cloud.take(finite))


def describe(samples: SampleSet) -> dict[str, Any]:
    """Read every sample once, also discarded ones, and collect counts and ranges by their keys in the JSON output.

    Raises:
        FileError: If a sample is damaged.
    """
    sensor, channels = samples.sensor, samples.sensor.channels
    objects = Counter[str]()
    outcomes = Counter[str]()
    flags = Counter[str]()
    touches = []
    sizes = []
    stamps = []
    errors = []
    tared = tables = 0
    for sample in samples.with_discarded():
        objects[sample.object] += 1
        outcomes[sample.outcome] += 1
        flags.update(sample.flags)
        tared += sample.tare is not None
        tables += sample.table is not None
        sizes.append(sample.cloud.size)
        stamps.append(sample.stamp_ns)
        if sample.pairing_error_ns is not None:
            errors.append(sample.pairing_error_ns * 1e-6)
        if sample.touch is not None:
            touches.append(sample.touch.values)
    values = {name: np.stack(touches)[:, columns] for name, columns in channels.modality_columns.items() if touches}
    return {
        "kind": samples.kind,  # name of the format
        "samples": len(sizes),
        "labelled": len(touches),
        "tared": tared,
        "tables": tables,  # samples that hold their table; of others the camera is taken to look straight down on it
        "discarded": flags[DISCARDED],
        "objects": objects,
        "outcomes": outcomes,
        "flags": flags,
        "first_ns": min(stamps, default=0),  # earliest stamp [ns]
        "last_ns": max(stamps, default=0),
        "points": (min(sizes), int(np.median(sizes)), max(sizes)) if sizes else (0, 0, 0),  # of a cloud
        "ranges": {
            name: (float(value.min()), float(value.max())) for name, value in values.items()
        },  # of each modality
        "pairing_ms": np.histogram(errors, PAIRING_EDGES_MS)[0].tolist() if errors else [],
        "sensor": f"{sensor.config.name} ({sensor.sha256[:8]})",
        "units": {name: channels.channel_of[name].unit for name in values},  # of `ranges`
        "dead": {
            finger.name: list(finger.dead) for finger in sensor.config.fingers if finger.dead
        },  # taxels that failed
        "hand": dict(samples.identity.hand),
        "camera": dict(samples.identity.camera),
        "unfinished": [file.name for file in samples.unfinished],  # recordings that were cut off and not repaired
        "accounts": samples.message_counts(),  # message counts by topic
        "edits": list(samples.edits),  # descriptions of later changes
    }

# SPDX-License-Identifier: Apache-2.0
"""The samples of a dataset, whatever its format; `foretouch.dataset.formats` opens and exports them."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.identity import Identity
from foretouch.errors import DatasetError, shown
from foretouch.laboratory import needs_laboratory
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import with_dead_taxels
from foretouch.tactile.description import Sensor
from foretouch.types import DISCARDED, AnyArray, Grasps, Sample
from foretouch.types.summary import Summarised, briefly, counted, names_of
from foretouch.types.tables import LabelledTable, Tabular, Variable, labels_of

_SHOWN: Final = 64  # readings of a grasp by which dead taxels are found


@dataclass(frozen=True, eq=False, repr=False)
class SampleSet(Summarised, Tabular):
    """The samples of a dataset in order, read on demand and as often as needed."""

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
        with needs_laboratory("split"):
            from foretouch_lab.learning.data.folds import make_folds
        labelled = [k for k in range(self.size) if _is_labelled(self.read(k))]
        folds = make_folds([self.read(k) for k in labelled], kind, seed)
        return [
            (self.subset([labelled[k] for k in fold.train]), self.subset([labelled[k] for k in fold.test]))
            for fold in folds
        ]

    def subset(self, numbers: Sequence[int]) -> "SampleSet":
        """Return some samples by their numbers, in this order.

        Args:
            numbers: From 0, of all samples.

        Raises:
            DatasetError: If there is no sample of a number.
        """
        kept = list(numbers)
        if wrong := [k for k in kept if not 0 <= k < self.size]:
            raise DatasetError(f"{self.path}: {wrong[0]} is not the number of a sample, 0 to {self.size - 1}")
        read = self.read
        name = self.name
        return replace(self, size=len(kept), read=lambda k: read(kept[k]), name=lambda k: name(kept[k]))

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

# SPDX-License-Identifier: Apache-2.0
"""A dataset: its samples, their hash, and the parts that a model is trained and tested on."""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.dataset.formats import open_samples
from foretouch.dataset.formats.vision2tactile import folder_sha256
from foretouch.dataset.samples import SampleSet, only_finite
from foretouch.dataset.store import Store, content_sha256, sample_digest
from foretouch.dataset.writing import place_fault
from foretouch.errors import DatasetError, none_of, quoted
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.dead_taxels import filled, usable, with_dead_taxels
from foretouch.tactile.description import Sensor, packaged_sensor, sensor_files
from foretouch.types import Float64, Sample, Touch
from foretouch_lab.dataset.store_writer import SampleFacts
from foretouch_lab.learning.data.folds import Fold, Indices
from foretouch_lab.learning.data.splits import SIDES, SPLITS_FILE, make_splits, parse_splits, read_splits
from foretouch_lab.learning.prequential import with_readings

_VISION2TACTILE: Final = {
    "source": "github.com/yayaneath/vision2tactile, recorded for P1",
    "licence": "none stated, so the data are not redistributed",
    "limits": [
        "One pair of fingers, one hand, one camera at 1.1 to 1.3 m seen from above: other fingers have other ranges.",
        "Recorded without a tare, each object on different days: object, day and drift cannot be separated.",
        "Skills are averages; whether they differ significantly is reported in docs/results.",
    ],
}
_ANY: Final = ObjectLimits(min_range_m=0.0, max_range_m=100.0, min_extent_m=1e-6, max_extent_m=10.0)


@dataclass(frozen=True, eq=False)
class Dataset:
    """All samples of a recorded dataset, a training store or the vision2tactile folders.

    Attributes:
        name: Name of the file or folder.
        samples: In order; without those that the operator discarded. The clouds of a store are read as they are used.
        sha256: Hash over the samples in order, equal to the hash of the training store they make.
        splits: The parts of each kind of split.
        aliases: Other hashes by which cards may name the same samples.
        omitted: By kind of split, why these samples do not have it.
        origin: `source`, `licence` and known `limits` of public and simulated data, for a card.
        shapes: By object, its shape; of simulated data alone.
        sensor: That was read; taxels that the samples show to be dead are declared so.
    """

    name: str
    samples: tuple[Sample, ...]
    sha256: str
    splits: dict[str, list[Fold]]
    aliases: tuple[str, ...] = ()
    omitted: dict[str, str] = field(default_factory=dict)
    origin: dict[str, Any] = field(default_factory=dict)
    shapes: dict[str, str] = field(default_factory=dict)
    sensor: Sensor = BIOTAC_SP

    @cached_property
    def masked(self) -> tuple[Sample, ...]:
        """The samples with NaN in touches and tares where a taxel is dead, was not read or is out of its range."""
        return self._with(lambda values: usable(values, self.sensor.channels, self.sensor.valid_values))

    @cached_property
    def filled(self) -> tuple[Sample, ...]:
        """The samples with `filled` touches and tares."""
        return self._with(lambda values: filled(values, self.sensor))

    def _with(self, change: Callable[[Float64], Float64]) -> tuple[Sample, ...]:
        samples = list(self.samples)
        for name in ("touch", "tare"):
            read = [(k, touch) for k, sample in enumerate(samples) if (touch := getattr(sample, name)) is not None]
            values = np.array([touch.values for _, touch in read]).reshape(len(read), self.sensor.channels.size)
            for (k, touch), old, new in zip(read, values, change(values), strict=True):
                if not np.array_equal(old, new):
                    samples[k] = with_readings(samples[k], **{name: Touch(new, touch.channels)})
        return tuple(samples)

    def parts(self, split: str) -> list[Fold]:
        """Return the parts of a split.

        Args:
            split: `KIND`, such as "time", or `KIND/PART`, such as "labels/T50".

        Raises:
            DatasetError: If the dataset has no such split; gives the reason, or the splits that exist.
        """
        kind, _, name = split.partition("/")
        if kind in self.omitted:
            raise DatasetError(f"{self.name}: split: {kind!r} cannot be made of these samples: {self.omitted[kind]}")
        if kind not in self.splits:
            raise DatasetError(f"{self.name}: split: {none_of(kind, self.splits)}")
        parts = [part for part in self.splits[kind] if name in ("", part.name)]
        if not parts:
            known = [f"{kind}/{part.name}" for part in self.splits[kind]]
            raise DatasetError(f"{self.name}: split: {none_of(split, known)}")
        return parts

    def hashes(self, index: Indices) -> list[str]:
        """Return `_sample_hash` of the samples with these indices."""
        return [_sample_hash(self.samples[k]) for k in index]

    def partition(self, split: str | None) -> Fold:
        """Split the samples for one training.

        Args:
            split: `KIND/PART`; None trains on all labelled samples and tests on none.

        Raises:
            DatasetError: If the dataset has no such split, the split has several parts, or no training sample is labelled.
        """
        if split is not None:
            parts = self.parts(split)
            if len(parts) != 1:
                raise DatasetError(
                    f"{self.name}: split: {split!r} has {len(parts)} parts; choose one: {split}/{parts[0].name}"
                )
            return parts[0]
        train = np.array([k for k, sample in enumerate(self.samples) if sample.touch is not None], np.intp)
        if not len(train):
            raise DatasetError(f"{self.name}: no sample to learn from is labelled")
        return Fold(train, np.empty(0, np.intp), unlabelled=np.setdiff1d(np.arange(len(self.samples)), train))


class LazySample(Sample):
    """A sample in memory but for its cloud, which is read from the store whenever it is used and is not kept.

    Clouds that are used in the order of the store cost one read of each batch. A pickle holds the path of the store.
    """

    @classmethod
    def of(cls, sample: Sample, store: Store, number: int) -> Self:
        """Return sample `number` of a store, read before."""
        stored = cls.__new__(cls)
        vars(stored).update({**vars(sample), "_place": (store, number)})
        del vars(stored)["cloud"]
        return stored

    def __getattr__(self, name: str) -> Any:
        """Return the cloud; raises `FileError` if the store was removed or changed since it was opened."""
        if name != "cloud":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        store, number = vars(self)["_place"]
        return only_finite(store[number]).cloud


def _sample_hash(sample: Sample) -> str:
    """Return what identifies a recorded grasp in any dataset, by whatever name: 16 hexadecimal digits.

    They cover the finite points, the contacts and the reading as float32, which every format keeps; not the rotation,
    whose last bits depend on the processor.
    """
    reading = np.empty(0) if sample.touch is None else sample.touch.values
    parts = (sample.cloud.finite.ravel(), sample.grasp.g1, sample.grasp.g2, reading)
    return hashlib.sha256(b"".join(np.asarray(part, np.float32).tobytes() for part in parts)).hexdigest()[:16]


def load_dataset(path: str | Path) -> Dataset:
    """Read all samples of a dataset; of a training store, which may be larger than memory, all but the clouds are kept.

    Args:
        path: A recorded dataset, a training store, or folders of vision2tactile. The splits are those stored with the
            dataset, or else are made with seed 0.

    Raises:
        FileError: If there are no samples, or a file is damaged.
        DatasetError: If two samples have the same id.
    """
    path = Path(path)
    opened = open_samples(path)
    store = Store(path) if opened.kind == "store" else None
    samples: list[Sample] = []
    content = hashlib.sha256()  # as `content_sha256`, in the same pass
    for read in opened if store is None else store:
        sample = replace(only_finite(read), series=None, candidates=())  # which nothing trains on
        content.update(sample_digest(sample))
        samples.append(sample if store is None else LazySample.of(sample, store, len(samples)))
    public = opened.kind == "vision2tactile"
    data = dataset_of(samples, path.name, opened.sensor, path, content.hexdigest())
    if store is not None:
        return replace(data, **_simulated(store))
    return replace(data, aliases=(folder_sha256(path),), origin=_VISION2TACTILE) if public else data


def dataset_of(
    samples: Sequence[Sample],
    name: str = "samples",
    sensor: Sensor | None = None,
    path: Path | None = None,
    sha256: str | None = None,
) -> Dataset:
    """Return a dataset of samples in memory.

    Args:
        samples: In order.
        name: For messages and cards.
        sensor: That was read; by default a described one with the channels of the touches.
        path: Where stored splits may be; without, splits are made with seed 0.
        sha256: Hash over the samples, if it is known.

    Raises:
        DatasetError: If there are no samples, two have the same id, or they are of a sensor that no description is known of.
    """
    if not samples:
        raise DatasetError(f"{name}: holds no sample")
    (repeated, times), *_ = Counter(sample.id for sample in samples).most_common(1)
    if times > 1:
        cure = "give each another name after the slash" if repeated else 'name each, such as "cup/1"'
        raise DatasetError(f"{path or name}: {times} samples have the id {quoted(repeated)}: {cure}")
    labels = [sample.touch for sample in samples if sample.touch is not None]
    if sensor is None:
        known = labels[0].channels.sensor if labels else BIOTAC_SP.config.name
        sensor = packaged_sensor(known) if known in sensor_files() else BIOTAC_SP
    facts = [SampleFacts(s.id, s.object, s.stamp_ns, s.touch is not None) for s in samples]
    stored = path is not None and (path / SPLITS_FILE).is_file()
    parts, omitted = read_splits(path) if stored and path else parse_splits(make_splits(facts).encode())
    places = {sample.id: k for k, sample in enumerate(samples)}
    splits = {kind: [_fold(part, places) for part in parts[kind]] for kind in parts}
    values = [touch.values for touch in labels if touch.channels == sensor.channels]
    sensor = with_dead_taxels(sensor, np.array(values)) if values else sensor
    return Dataset(name, tuple(samples), sha256 or content_sha256(samples), splits, omitted=omitted, sensor=sensor)


def dataset_from(samples: SampleSet | Sequence[Sample] | str | Path) -> Dataset:
    """Return the dataset of a path, of the samples of an opened dataset, or of samples in memory.

    Raises:
        FileError: As `load_dataset`.
        DatasetError: As `dataset_of`.
    """
    if isinstance(samples, str | Path):
        return load_dataset(samples)
    if isinstance(samples, SampleSet):
        return dataset_of(list(samples), samples.path.name, samples.sensor)
    listed: list[Any]
    try:
        listed = list(samples)
    except TypeError:  # of one thing, also of an array without axes
        listed = [samples]
    for number, sample in enumerate(listed):
        if not isinstance(sample, Sample):
            rule = "is not a Sample; pass a list of them, the path of a dataset, or what open(PATH) gives"
            raise DatasetError(f"samples: {number}: {type(sample).__name__} {rule}")
        if fault := _fault(sample):
            raise DatasetError(f"sample {number} ({sample.id}): {fault}")
    return dataset_of(listed)


def _fault(sample: Sample) -> str:
    """Return why a grasp cannot have been executed on a cloud of any size in any frame, as with millimetres; "" if it can."""
    return place_fault(sample, _ANY) if sample.grasp.is_known and len(sample.cloud.finite) else ""


def _fold(part: Mapping[str, Any], places: Mapping[str, int]) -> Fold:
    """Return a part of `splits.json`, from the place of each sample by its id."""
    if unknown := [sample_id for side in SIDES for sample_id in part.get(side, ()) if sample_id not in places]:
        raise DatasetError(f"split {part['name']}: {unknown[0]}: is not among the samples")
    train, test, unlabelled = (
        np.array([places[sample_id] for sample_id in part.get(side, ())], np.intp) for side in SIDES
    )
    return Fold(np.sort(train), test, part["name"], unlabelled)


def _simulated(store: Store) -> dict[str, Any]:
    """Return `origin` and `shapes` of a store that `foretouch simulate` wrote; nothing of another store."""
    about = store.manifest.get("about", {})
    if "scene_sha256" not in about:
        return {}
    scene, file = about.get("scene", {}), about.get("scene_file", "a scene")
    hand = scene.get("hand", "")
    touched = f"the posture of {hand} turns its pads" if hand else "its pads face each other"
    known = f"it knows no real fingertip or camera, and no other objects than {file} has."
    origin = {
        "source": f"foretouch simulate {file} -n {len(store)}",
        "scene_sha256": about["scene_sha256"],
        "limits": [f"For the simulated hand only, at whose contacts {touched}: {known}"],
    }
    return {"origin": origin, "shapes": {item["name"]: item["shape"] for item in scene.get("objects", [])}}

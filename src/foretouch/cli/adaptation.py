# SPDX-License-Identifier: Apache-2.0
"""`--tare`, `--touched` and `--history`: readings that `predict` and `view` adapt their predictions to."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foretouch.base.files import read_json, require_schema
from foretouch.cli.output import warn
from foretouch.dataset.formats import open_samples
from foretouch.errors import ConfigError, DatasetError, FileError, ForetouchError, TactileError
from foretouch.tactile import make_tare, tdc_of
from foretouch.tactile.description import require_same
from foretouch.types import Float64, Grasp, Predictions, Sample, Touch

if TYPE_CHECKING:
    from foretouch.models.calibration import Calibration
    from foretouch.models.predictor import Estimate
    from foretouch.models.touch_model import History, Readings, TouchModel
    from foretouch.pipeline import Pipeline
    from foretouch.tactile.description import Sensor
    from foretouch.types.channels import Channels
    from foretouch.types.scene import Object

_OWN = "sample"
_UNKNOWN = "unknown"  # the recorder's label of an object without a name
_TEMPERATURE = "TDC"  # of the finger


@dataclass(eq=False)
class Adaptation:
    """Readings from the command line, and the predictions adapted to them."""

    model: TouchModel
    tare: tuple[Touch, Float64] | None  # for every prediction, with its (2,) TDC; None without
    touched: Sequence[Sample]  # labelled samples of one object
    own: bool  # whether each sample's own tare is used instead
    history: Sequence[Sample] = ()  # labelled samples of any object, with stamps
    hand: History | None = None  # from the file of a hand; None without
    _estimates: dict[int, Estimate] = field(default_factory=dict)  # of readings, by the id of their sample

    def __post_init__(self) -> None:
        """Name a model that cannot adapt before the first prediction."""
        if self.touched or self.history or self.hand is not None:
            self.model.new_tracker()

    def predict(
        self, pipeline: Pipeline, target: Object, grasps: Sequence[Grasp], sample: Sample | None
    ) -> Predictions:
        """Predict K grasps on one object.

        A `DatasetError` if a sample lacks the requested tare, or is of another object than the touches.
        """
        label = next((touch.object for touch in self.touched if touch.object != _UNKNOWN), "")
        if sample is not None and label and sample.object not in (label, _UNKNOWN):
            raise DatasetError(f"{sample.id}: is of {sample.object}, the touches are of {label}")
        tare = _own_tare(sample) if self.own else self.tare
        touched = others(self.touched, sample)
        if not (touched or self.history or self.hand is not None):
            return pipeline.predict(target, grasps, tare=None if tare is None else tare[0])
        return pipeline.predict(target, grasps, history=self._history_of(touched, tare, sample))

    def _history_of(
        self, touched: Sequence[Sample], tare: tuple[Touch, Float64] | None, sample: Sample | None
    ) -> Readings:
        """Return the readings of the hand up to the time of a sample, or else until now; touches of its object in any case."""
        from foretouch.models.touch_model import History

        now_ns = sample.stamp_ns if sample is not None and sample.stamp_ns else time.time_ns()
        hand = self.hand.copy() if self.hand is not None else History(self.model)
        last = None
        for other in sorted(others(self.history, sample), key=lambda touched_sample: touched_sample.stamp_ns):
            if other.stamp_ns <= now_ns:
                self._add(hand, other, other.stamp_ns, same_object=other.object == last)
                last = other.object
        for number, touched_sample in enumerate(sorted(touched, key=lambda touched_sample: touched_sample.stamp_ns)):
            self._add(hand, touched_sample, touched_sample.stamp_ns or now_ns, same_object=number > 0)
            now_ns = max(now_ns, touched_sample.stamp_ns)
        if tare is not None:
            hand.tare(tare[0], stamp_ns=now_ns, tdc=tare[1])
        return hand.at(now_ns, same_object=bool(touched), tared=tare is not None)

    def _add(self, hand: History, sample: Sample, stamp_ns: int, *, same_object: bool) -> None:
        """Add a reading; the cloud is looked at once, however many predictions adapt to the reading."""
        assert sample.touch is not None  # noqa: S101  only labelled samples are passed
        try:
            if sample.tare is not None:
                hand.tare(sample.tare, stamp_ns=stamp_ns, tdc=tdc_of(sample.extra, sample.tare.channels, "tare_"))
            if id(sample) not in self._estimates:
                self._estimates[id(sample)] = self.model.estimate_executed(
                    sample.cloud, [sample.grasp], table=sample.table
                )
            estimate = self._estimates[id(sample)]
            hand.touched(
                sample.cloud,
                sample.grasp,
                sample.touch,
                stamp_ns=stamp_ns,
                same_object=same_object,
                estimate=estimate,
                tdc=tdc_of(sample.extra, sample.touch.channels),
            )
        except ForetouchError as err:
            raise DatasetError(f"{sample.id}: {err}") from err


def read_adaptation(arguments: argparse.Namespace, model: TouchModel) -> Adaptation:
    """Read the files of --tare, --touched and --history; a `ForetouchError` names what cannot be combined or used."""
    from foretouch.models.touch_model import History

    own = _OWN in arguments.tare
    if own and len(arguments.tare) > 1:
        raise ConfigError(f"--tare: {_OWN!r} cannot be combined with files")
    channels = model.sensor.channels
    touched = _labelled_samples("--touched", arguments.touched, channels)
    labels = sorted({sample.object for sample in touched} - {_UNKNOWN})
    if len(labels) > 1:
        raise DatasetError(f"--touched: {', '.join(labels)}: touches must be of one object")
    tare = _read_tare(arguments.tare, model.sensor, model.calibration) if arguments.tare and not own else None
    files = [path for path in arguments.history if path.endswith(".safetensors")]
    if len(files) > 1:
        raise ConfigError(f"--history: {', '.join(files)}: more than one file of a hand")
    history = _labelled_samples("--history", [path for path in arguments.history if path not in files], channels)
    for sample in history:
        if not sample.stamp_ns:
            raise DatasetError(f"--history: {sample.id}: has no stamp, so its place in time is not known")
    return Adaptation(model, tare, touched, own, history, History.load(files[0], model) if files else None)


def _read_tare(paths: Sequence[str], sensor: Sensor, calibration: Calibration | None = None) -> tuple[Touch, Float64]:
    """Return the median of all readings of a sensor in some files with its TDC; warns of each file whose readings are like those in contact."""
    from foretouch.dataset.formats.vision2tactile import read_touch

    readings: list[tuple[Touch, Float64]] = []
    for path in map(Path, paths):
        if path.suffix == ".tac":
            touch, extra = read_touch(path)
            require_same(touch.channels, sensor.channels, f"--tare: {path}")
            fresh = [(touch, tdc_of(extra, touch.channels))]
        else:
            document = read_json(path)
            fresh = [
                _reading(path, entry, sensor) for entry in (document if isinstance(document, list) else [document])
            ]
        try:
            tare = make_tare([touch for touch, _ in fresh])
        except TactileError as err:
            raise FileError(path, str(err)) from err
        if signs := calibration.contact_signs(tare) if calibration is not None else ():
            warn(f"{path}: as in contact, or of another hand; a tare is a reading at rest: {'; '.join(signs)}")
        readings += fresh
    return make_tare([touch for touch, _ in readings]), np.median([tdc for _, tdc in readings], axis=0)


def _reading(path: Path, entry: Any, sensor: Sensor) -> tuple[Touch, Float64]:
    """Return one reading and its TDC; `make_tare` checks later whether a working sensor can give it."""
    channels = sensor.channels
    sizes = {name.lower(): channel.size for name, channel in channels.channel_of.items()}
    measured = any(scalar.name == _TEMPERATURE for scalar in sensor.config.scalars)
    temperatures = [f"{_TEMPERATURE}_{finger}" for finger in channels.fingers if measured]
    optional = [name.lower() for name in temperatures]
    if not isinstance(entry, dict) or entry.keys() - {*optional} != sizes.keys():
        allowed = ", ".join(sizes) + (f", optionally {', '.join(optional)}" if measured else "")
        raise FileError(path, f"is not a reading of {channels.sensor}: it must hold {allowed} and nothing else")
    fields = {name: float if size == 1 else [float] for name, size in sizes.items()}
    require_schema(path, entry, {**fields, **{f"{name}?": float for name in optional}})
    for name, size in sizes.items():
        if size > 1 and len(entry[name]) != size:
            raise FileError(path, f"is not {size} numbers", field=name)
    tdc = tdc_of({name: float(entry.get(name.lower(), np.nan)) for name in temperatures}, channels)
    return Touch(np.hstack([entry[name] for name in sizes]), channels), tdc


def others(samples: Sequence[Sample], sample: Sample | None) -> Sequence[Sample]:
    """Return labelled samples that a prediction for one of them may use: without itself, whose reading would leak its label.

    It may come from another file, and ids alone may recur in another dataset.
    """
    if sample is None or sample.touch is None:
        return samples
    own = sample.touch.values
    return [
        other for other in samples if other.id != sample.id or other.touch is None or (other.touch.values != own).any()
    ]


def _own_tare(sample: Sample | None) -> tuple[Touch, Float64]:
    if sample is None or sample.tare is None:
        raise DatasetError(f"{'cloud' if sample is None else sample.id}: has no recorded tare")
    return sample.tare, tdc_of(sample.extra, sample.tare.channels, "tare_")


def read_samples(paths: Sequence[str], channels: Channels) -> list[Sample]:
    """Return all samples of some datasets; a `TactileError` names one that is of another sensor than a model's channels."""
    samples: list[Sample] = []
    for path in paths:
        opened = open_samples(path)
        require_same(opened.sensor.channels, channels, path)
        samples += opened
    return samples


def _labelled_samples(option: str, paths: Sequence[str], channels: Channels) -> list[Sample]:
    samples: list[Sample] = []
    for path in paths:
        try:
            labelled = [sample for sample in read_samples([path], channels) if sample.touch is not None]
        except TactileError as err:
            raise DatasetError(f"{option}: {err}") from err
        if not labelled:
            raise DatasetError(f"{path}: holds no sample with a touch")
        samples += labelled
    return samples

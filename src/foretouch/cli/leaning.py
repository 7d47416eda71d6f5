# SPDX-License-Identifier: Apache-2.0
"""What `predict` may lean on besides the cloud: a reading without contact, and touches of the same object."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.errors import ConfigError, DatasetError, FileError, TactileError

if TYPE_CHECKING:
    from foretouch.models.touch_memory import TouchMemory
    from foretouch.models.touch_model import TouchModel
    from foretouch.pipeline import FoundObject, Pipeline
    from foretouch.types import Grasp, GraspSample, Touch, TouchPrediction

__all__ = ["Leaning", "add_leaning_arguments", "read_tare", "take_in"]

_OWN = "sample"
_UNKNOWN = "unknown"  # what the recorder calls an object that nobody named
_FIELDS = ("pdc_th", "pdc_mf", "e_th", "e_mf")


def add_leaning_arguments(parser: argparse.ArgumentParser) -> None:
    """--tare and --touched."""
    parser.add_argument(
        "--tare",
        action="append",
        default=[],
        metavar="F|sample",
        help="reading without contact, taken shortly before: JSON with pdc_th, pdc_mf, e_th [24], e_mf [24], a list of such, "
        "or a vision2tactile tactile.tac; of several the median. `sample`: each sample's own, where the input is a dataset",
    )
    parser.add_argument(
        "--touched",
        action="append",
        default=[],
        metavar="PATH",
        help="grasps of the same object that were executed and read (a dataset, a training store, vision2tactile folders): "
        "each labelled one is taken in first, but for the very grasp that is asked about",
    )


class Leaning:
    """What was given, and the predictions that lean on it.

    Args:
        model: Whose memory takes the touches in.
        tare: For every prediction; None without.
        own: Whether each sample's own tare is used instead.
        touched: Labelled samples of one object.

    Attributes:
        touched: As given.
        object: Its label; "" if nobody named it.
    """

    def __init__(
        self, model: TouchModel, tare: Touch | None = None, touched: Sequence[GraspSample] = (), *, own: bool = False
    ) -> None:
        self.touched = tuple(touched)
        self.object = next((sample.object for sample in touched if sample.object != _UNKNOWN), "")
        self._model = model
        self._tare = tare
        self._own = own
        self._memory = None if own or not touched else self._remember(self.touched, tare)

    def taken_in(self, sample: GraspSample | None) -> Sequence[GraspSample]:
        """The touches that a prediction for this sample leans on: never its own reading, which it would only repeat."""
        if sample is None or sample.touch is None:
            return self.touched
        return tuple(one for one in self.touched if not _same(one, sample))

    def predict(
        self, pipeline: Pipeline, target: FoundObject, grasps: Sequence[Grasp], sample: GraspSample | None
    ) -> list[TouchPrediction]:
        """Predict K grasps on one object.

        Raises:
            DatasetError: If a sample lacks the tare that is asked for, or is of another object than the touches.
            ModelError: If the model cannot lean on what was given.
        """
        if sample is not None and self.object and sample.object not in (self.object, _UNKNOWN):
            raise DatasetError(f"{sample.id}: is of {sample.object}, the touches are of {self.object}")
        tare = _own_tare(sample) if self._own else self._tare
        touched = self.taken_in(sample)
        if not touched:
            return pipeline.predict(target, grasps, tare=tare)
        whole = self._memory if len(touched) == len(self.touched) else None
        return pipeline.predict(target, grasps, memory=whole or self._remember(touched, tare))

    def _remember(self, touched: Sequence[GraspSample], tare: Touch | None) -> TouchMemory:
        """Some touches, as sensors at this tare would have read them."""
        from foretouch.models.touch_memory import TouchMemory
        from foretouch.tactile import offsets, restore

        memory = TouchMemory(self._model, tare)
        for sample in touched:
            touch, then = sample.touch, _own_tare(sample) if self._own else sample.tare
            assert touch is not None  # noqa: S101  only labelled samples come here
            if tare is not None and then is not None:
                touch = restore(offsets(touch, then), tare)
            memory.add(sample.cloud, sample.grasp, touch)
        return memory


def take_in(arguments: argparse.Namespace, model: TouchModel) -> Leaning:
    """Read what --tare and --touched name, and let the memory take in every touch.

    Raises:
        ConfigError: If `sample` and files are both asked for.
        FileError: If a file cannot be read or is no tare, or there are no samples.
        DatasetError: If no sample is labelled, or they are of several objects.
        ModelError: If the model cannot learn from touches.
    """
    own = _OWN in arguments.tare
    if own and len(arguments.tare) > 1:
        raise ConfigError(f"--tare: {_OWN!r} stands alone: a tare is a sample's own or that of files")
    touched = _touched_samples(arguments.touched)
    labels = sorted({sample.object for sample in touched} - {_UNKNOWN})
    if len(labels) > 1:
        raise DatasetError(f"--touched: {', '.join(labels)}: touches of one object are wanted")
    return Leaning(model, read_tare(arguments.tare) if arguments.tare and not own else None, touched, own=own)


def read_tare(paths: Sequence[str]) -> Touch:
    """The median of all readings in some files.

    Args:
        paths: JSON, or vision2tactile's `tactile.tac`.

    Raises:
        FileError: Names the file, the field and the rule that it breaks.
    """
    from foretouch.tactile import make_tare

    readings: list[Touch] = []
    for path in map(Path, paths):
        fresh = _readings(path)
        try:
            make_tare(fresh)
        except TactileError as err:
            raise FileError(path, str(err)) from err
        readings += fresh
    return make_tare(readings)


def _readings(path: Path) -> list[Touch]:
    if path.suffix == ".tac":
        from foretouch.dataset.vision2tactile import read_touch

        return [read_touch(path)[0]]
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as err:
        raise FileError(path, err.strerror or str(err)) from err
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as err:
        raise FileError(path, f"is no JSON: {' '.join(str(err).split())}") from err
    entries = document if isinstance(document, list) else [document]
    return [_reading(path, entry) for entry in entries]


def _reading(path: Path, entry: Any) -> Touch:
    """One reading; whether a working sensor can have given it is asked later."""
    import numpy as np

    from foretouch.types import ELECTRODES, Touch

    if not isinstance(entry, dict) or sorted(entry) != sorted(_FIELDS):
        raise FileError(path, f"is no reading: it has to hold {', '.join(_FIELDS)} and nothing else")
    values = {}
    for name, shape in zip(_FIELDS, ((), (), (ELECTRODES,), (ELECTRODES,)), strict=True):
        numbers = entry[name] if isinstance(entry[name], list) else [entry[name]]
        if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
            raise FileError(path, "is not numbers", field=name)
        values[name] = np.array(entry[name], np.float64)
        if values[name].shape != shape:
            size = f"{ELECTRODES} numbers" if shape else "one number"
            raise FileError(path, f"is not {size}", field=name)
    return Touch(float(values["pdc_th"]), float(values["pdc_mf"]), values["e_th"], values["e_mf"])


def _same(one: GraspSample, other: GraspSample) -> bool:
    """Whether two samples are one grasp, be it read from different files; ids alone may come back in another session."""
    import numpy as np

    if one.touch is None or other.touch is None or one.id != other.id:
        return False
    return np.array_equal(one.touch.vector(), other.touch.vector())


def _own_tare(sample: GraspSample | None) -> Touch:
    if sample is None or sample.tare is None:
        raise DatasetError(f"{'cloud' if sample is None else sample.id}: holds no tare of its own")
    return sample.tare


def _touched_samples(paths: Sequence[str]) -> list[GraspSample]:
    from foretouch.dataset.samples import open_samples

    samples: list[GraspSample] = []
    for path in paths:
        with open_samples(path) as found:
            labelled = [record.sample for record in found.records() if record.sample.touch is not None]
        if not labelled:
            raise DatasetError(f"{path}: holds no sample with a touch")
        samples += labelled
    return samples

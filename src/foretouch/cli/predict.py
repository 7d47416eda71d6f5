# SPDX-License-Identifier: Apache-2.0
"""`foretouch predict`: predict the tactile readings of each grasp on each object.

`--tare`, `--touched` and `--history` adapt the predictions to a reading without contact, to touches of the same object,
and to earlier readings of the same hand. `--prequential` replays datasets in order of time instead, each sample
predicted from all readings before it.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.checked_files import read_json
from foretouch.cli import inputs
from foretouch.cli.output import print_json, print_table, warn
from foretouch.errors import ConfigError, DatasetError, FileError, ForetouchError, GraspError, TactileError
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from foretouch.dataset.source import SourceItem
    from foretouch.models.budget import LatencyBudget
    from foretouch.models.hand_history import HandHistory
    from foretouch.models.touch_model import Estimate, History, TouchModel
    from foretouch.pipeline import FoundObject, Pipeline
    from foretouch.types import Grasp, GraspSample, Touch, TouchPrediction


_OWN = "sample"
_UNKNOWN = "unknown"  # the recorder's label of an object without a name
_FIELDS = ("pdc_th", "pdc_mf", "e_th", "e_mf")


def add_adaptation_arguments(parser: argparse.ArgumentParser) -> None:
    """--tare and --touched."""
    parser.add_argument(
        "--tare",
        action="append",
        default=[],
        metavar="F|sample",
        help="reading without contact, taken shortly before: JSON with pdc_th, pdc_mf, e_th [24], e_mf [24], a list of such, "
        "or a vision2tactile tactile.tac; the median of several. `sample`: use each sample's own, for inputs that are datasets",
    )
    parser.add_argument(
        "--touched",
        action="append",
        default=[],
        metavar="PATH",
        help="executed grasps of the same object with their readings (a dataset, a training store, vision2tactile folders): "
        "adapt the predictions to all labelled ones, except the sample that is predicted",
    )
    parser.add_argument(
        "--history",
        action="append",
        default=[],
        metavar="PATH",
        help="executed grasps of any objects with their readings, earlier ones of the same hand (as --touched), or the file of a hand that "
        "the touch_predictor keeps: adapt the predictions to the state of its sensors",
    )


class Adaptation:
    """Tare and touches from the command line, and the predictions adapted to them.

    Args:
        model: The model to adapt.
        tare: For every prediction; None without.
        touched: Labelled samples of one object.
        own: Whether each sample's own tare is used instead.
        history: Labelled samples of any object, and files of a hand.

    Attributes:
        object: Label of the touched object; "" if it has no name.
    """

    def __init__(
        self,
        model: TouchModel,
        tare: Touch | None = None,
        touched: Sequence[GraspSample] = (),
        *,
        own: bool = False,
        history: ReadHistory | None = None,
    ) -> None:
        self.touched = tuple(touched)
        self.object = next((sample.object for sample in touched if sample.object != _UNKNOWN), "")
        self._model = model
        self._tare = tare
        self._own = own
        self._history = history
        self._estimates: dict[int, Estimate] = {}  # of readings, by the id of their sample
        if touched or history is not None:
            model.new_tracker()  # a model that cannot adapt is named before the first prediction

    def touches_for(self, sample: GraspSample | None) -> Sequence[GraspSample]:
        """The touches that a prediction for this sample uses: never its own reading, which would leak its label."""
        if sample is None or sample.touch is None:
            return self.touched
        return tuple(one for one in self.touched if not _same(one, sample))

    def predict(
        self,
        pipeline: Pipeline,
        target: FoundObject,
        grasps: Sequence[Grasp],
        sample: GraspSample | None,
        model: TouchModel | None = None,
    ) -> Sequence[TouchPrediction]:
        """Predict K grasps on one object, by a reduced form of the model if one is given.

        Raises:
            DatasetError: If a sample lacks the requested tare, or is of another object than the touches.
            ModelError: If the model cannot use tare or touches.
        """
        if sample is not None and self.object and sample.object not in (self.object, _UNKNOWN):
            raise DatasetError(f"{sample.id}: is of {sample.object}, the touches are of {self.object}")
        tare = _own_tare(sample) if self._own else self._tare
        touched = self.touches_for(sample)
        if self._history is None and not touched:
            return pipeline.predict(target, grasps, tare=tare, model=model)
        return pipeline.predict(target, grasps, history=self._history_of(touched, tare, sample), model=model)

    def _history_of(self, touched: Sequence[GraspSample], tare: Touch | None, sample: GraspSample | None) -> History:
        """The readings of the hand up to the time of a sample, or else until now; touches of its object in any case."""
        from foretouch.models.hand_history import HandHistory

        read = self._history or ReadHistory(())
        now_ns = sample.stamp_ns if sample is not None and sample.stamp_ns else time.time_ns()
        hand = read.hand.copy() if read.hand is not None else HandHistory(self._model)
        last = None
        for one in sorted(read.samples, key=lambda one: one.stamp_ns):
            if one.stamp_ns <= now_ns and not (sample is not None and _same(one, sample)):
                self._add(hand, one, one.stamp_ns, new_object=one.object != last)
                last = one.object
        for number, one in enumerate(sorted(touched, key=lambda one: one.stamp_ns)):
            self._add(hand, one, one.stamp_ns or now_ns, new_object=number == 0)
            now_ns = max(now_ns, one.stamp_ns)
        if tare is not None:
            hand.add_tare(now_ns, tare)
        return hand.snapshot(now_ns, same_object=bool(touched), tare=tare is not None)

    def _add(self, hand: HandHistory, sample: GraspSample, stamp_ns: int, *, new_object: bool) -> None:
        """Add a reading; the cloud is looked at once, however many predictions adapt to the reading."""
        assert sample.touch is not None  # noqa: S101  only labelled samples are passed
        try:
            if sample.tare is not None:
                hand.add_tare(stamp_ns, sample.tare)
            if id(sample) not in self._estimates:
                self._estimates[id(sample)] = self._model.estimate_executed(sample.cloud, [sample.grasp])
            estimate = self._estimates[id(sample)]
            hand.add_touch(stamp_ns, sample.cloud, sample.grasp, sample.touch, new_object=new_object, estimate=estimate)
        except ForetouchError as err:
            raise DatasetError(f"{sample.id}: {err}") from err


@dataclass(frozen=True, eq=False)
class ReadHistory:
    """Readings of a hand from --history."""

    samples: tuple[GraspSample, ...]  # labelled, with stamps
    hand: HandHistory | None = None  # from the file of a hand; None without


def _read_history(paths: Sequence[str], model: TouchModel) -> ReadHistory | None:
    """Samples of datasets, or the file of a hand.

    Raises:
        ConfigError: If there is more than one file of a hand.
        DatasetError: If a sample has no stamp.
    """
    from foretouch.models.hand_history import read_history

    if not paths:
        return None
    files = [path for path in paths if path.endswith(".safetensors")]
    if len(files) > 1:
        raise ConfigError(f"--history: {', '.join(files)}: more than one file of a hand")
    samples = _touched_samples([path for path in paths if path not in files])
    for sample in samples:
        if not sample.stamp_ns:
            raise DatasetError(f"--history: {sample.id}: has no stamp, so its place in time is not known")
    return ReadHistory(tuple(samples), read_history(Path(files[0]), model) if files else None)


def read_adaptation(arguments: argparse.Namespace, model: TouchModel) -> Adaptation:
    """Read the files of --tare, --touched and --history.

    Raises:
        ConfigError: If `sample` and files are both given.
        FileError: If a file cannot be read or is no tare, or there are no samples.
        DatasetError: If no sample is labelled, or they are of several objects.
        ModelError: If the model cannot adapt to readings.
    """
    own = _OWN in arguments.tare
    if own and len(arguments.tare) > 1:
        raise ConfigError(f"--tare: {_OWN!r} cannot be combined with files")
    touched = _touched_samples(arguments.touched)
    labels = sorted({sample.object for sample in touched} - {_UNKNOWN})
    if len(labels) > 1:
        raise DatasetError(f"--touched: {', '.join(labels)}: touches must be of one object")
    tare = read_tare(arguments.tare) if arguments.tare and not own else None
    return Adaptation(model, tare, touched, own=own, history=_read_history(arguments.history, model))


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
    document = read_json(path)
    entries = document if isinstance(document, list) else [document]
    return [_reading(path, entry) for entry in entries]


def _reading(path: Path, entry: Any) -> Touch:
    """One reading; `make_tare` checks later whether a working sensor can give it."""
    import numpy as np

    from foretouch.types import ELECTRODES, Touch

    if not isinstance(entry, dict) or sorted(entry) != sorted(_FIELDS):
        raise FileError(path, f"is no reading: it must hold {', '.join(_FIELDS)} and nothing else")
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
    """Whether two samples are the same grasp, even from different files; ids alone may recur in another dataset."""
    if one.touch is None or other.touch is None or one.id != other.id:
        return False
    return bool((one.touch.vector() == other.touch.vector()).all())


def _own_tare(sample: GraspSample | None) -> Touch:
    if sample is None or sample.tare is None:
        raise DatasetError(f"{'cloud' if sample is None else sample.id}: has no recorded tare")
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The common inputs, --grasp, --model, --tare and --touched."""
    inputs.add_input_arguments(parser)
    inputs.add_plan_arguments(parser)
    parser.add_argument(
        "--grasp",
        type=inputs.six_numbers,
        action="append",
        metavar="x1,y1,z1,x2,y2,z2",
        help="contacts [m] (default: the sample's own, or those that GeoGrasp plans)",
    )
    parser.add_argument("--model", help="name of a model, or path of its card, weights or run folder")
    add_adaptation_arguments(parser)
    parser.add_argument(
        "--budget-ms",
        type=inputs.positive_value,
        metavar="T",
        help="predict the grasps of each object within this time, by a cheaper form of the model where it is needed, which is flagged",
    )
    parser.add_argument(
        "--prequential",
        action="store_true",
        help="of inputs that are datasets, predict the samples in order of time, each from all readings before it, of any object",
    )


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cloud or a grasp was refused."""
    from foretouch.pipeline import Pipeline

    if arguments.prequential:
        return _run_prequential(arguments)
    changes = {"model": arguments.model} if arguments.model else {}
    defaults = {} if arguments.touched else {"target.mode": "all"}  # touches are of one object
    pipeline = Pipeline(inputs.pipeline_config(arguments, changes, defaults))
    model = {"name": pipeline.model.name, "sha256": pipeline.model.sha256}
    adaptation = read_adaptation(arguments, pipeline.model)
    budget = None if arguments.budget_ms is None else _make_budget(arguments.budget_ms, pipeline)

    def answer(item: SourceItem) -> Iterator[inputs.Record]:
        targets = inputs.target_objects(item, arguments, pipeline)
        if adaptation.touched and len(targets) > 1:
            raise ConfigError(
                f"--touched: the cloud holds {len(targets)} objects and the touches are of one; select it with --target"
            )
        for target in targets:
            began = time.perf_counter()
            try:
                grasps, reason = _grasps(item, target, arguments, pipeline)
            except GraspError as err:
                if len(targets) == 1:
                    raise
                grasps, reason = [], str(err)
            planned = time.perf_counter()
            predictions, level = _predict(adaptation, budget, pipeline, target, grasps, item.sample)
            ms = {"grasp": (planned - began) * 1e3, "touch": (time.perf_counter() - planned) * 1e3}
            refused = [one.reason for one in predictions if one.status != "ok"]
            yield {
                **({"sample": item.sample.id} if item.sample is not None else {}),
                "object": target.id,
                "status": "ok" if predictions and not refused else "refused",
                "reason": "; ".join(refused) or reason,
                "predictions": [prediction_record(one) for one in predictions],
                "model": model,
                **level,
                "touched": len(adaptation.touches_for(item.sample)),
                "ms": {**ms, "total": sum(ms.values())},
                "failed": not predictions or bool(refused),
            }

    return inputs.process_inputs(arguments, answer, _show)


def _make_budget(budget_ms: float, pipeline: Pipeline) -> LatencyBudget:
    """A budget for this machine, which is measured where there is no profile of it, and warmed up."""
    from foretouch.models.budget import LatencyBudget, levels_of, load_profile, profile_scene

    levels = levels_of(pipeline.model)
    budget = LatencyBudget(budget_ms / 1e3, levels, load_profile(levels, say=warn))
    cloud, grasps = profile_scene(1)
    for level in levels:
        level.model.predict(cloud, grasps)
    return budget


def _predict(
    adaptation: Adaptation,
    budget: LatencyBudget | None,
    pipeline: Pipeline,
    target: FoundObject,
    grasps: Sequence[Grasp],
    sample: GraspSample | None,
) -> tuple[Sequence[TouchPrediction], inputs.Record]:
    """Predictions, and what the budget chose for the record."""
    from foretouch.types import LATE, REDUCED

    if budget is None or not grasps:
        return adaptation.predict(pipeline, target, grasps, sample), {}
    chosen = budget.begin(len(grasps), time.monotonic())
    predictions = adaptation.predict(pipeline, target, grasps, sample, chosen.level.model)
    late = budget.end(chosen)
    if not chosen.affordable:
        warn(
            f"--budget-ms: {budget.budget_s * 1e3:g}: nothing meets it for {len(grasps)} grasps: {chosen.level.name} is used"
        )
    flags = (REDUCED,) * chosen.reduced + (LATE,) * late
    return [dataclasses.replace(one, flags=(*one.flags, *flags)) for one in predictions], {"level": chosen.level.name}


def _run_prequential(arguments: argparse.Namespace) -> int:
    """Print the prediction of each sample, in order of time."""
    import numpy as np

    from foretouch.dataset.samples import open_samples
    from foretouch.learning.evaluation.prequential import replay_model
    from foretouch.models.registry import load_model
    from foretouch.types import Reference, Touch, TouchPrediction

    for name in ("tare", "touched", "grasp", "budget_ms"):
        if getattr(arguments, name):
            raise ConfigError(f"--{name.replace('_', '-')}: cannot be combined with --prequential")

    def read(paths: Sequence[str]) -> list[GraspSample]:
        samples = []
        for path in paths:
            with open_samples(path) as found:
                samples += [record.sample for record in found.records()]
        return samples

    model = load_model(arguments.model) if arguments.model else load_model()
    done = replay_model(
        model, read(arguments.inputs), [one for one in read(arguments.history) if one.touch is not None]
    )
    for k in np.flatnonzero(done.scored):
        sample, level = done.samples[k], done.played.levels[k]
        counts, half = done.played.counts[k], done.played.half[k]
        value, lower, upper = (Touch.from_vector(end) for end in (counts, counts - half, counts + half))
        flags = ("out_of_range",) * bool(model.ranges.outside(counts).any()) + ("unfamiliar",) * (
            not done.recording.is_known(int(k))
        )
        evidence = level.evidence
        reference: Reference = "touches" if evidence.touches else "history" if evidence.readings else "none"
        predicted = TouchPrediction(sample.grasp, value, lower, upper, reference, flags, evidence=evidence)
        record = {
            "input": sample.id,
            "sample": sample.id,
            "object": sample.object,
            "status": "ok",
            "reason": "",
            "predictions": [prediction_record(predicted)],
            "model": {"name": model.name, "sha256": model.sha256},
            "touched": evidence.touches,
            "history": evidence.readings,
            "history_age_s": evidence.reading_age_s,
            "restarted": list(done.played.restarted[k]),
        }
        if arguments.json:
            print_json(record)
        else:
            _show(record)
    return 0


def prediction_record(prediction: TouchPrediction) -> inputs.Record:
    """One prediction for JSON: values and bounds in counts, bounds null without a calibration."""
    columns = {"value": prediction.value, "lower": prediction.lower, "upper": prediction.upper}
    record: inputs.Record = {"grasp": inputs.grasp_record(prediction.grasp)}
    for name in MODALITIES:
        record[name] = {key: None if touch is None else getattr(touch, name.lower()) for key, touch in columns.items()}
    return record | {
        "reference": prediction.reference,
        "evidence": dataclasses.asdict(prediction.evidence),
        "flags": list(prediction.flags),
        "status": prediction.status,
        "reason": prediction.reason,
    }


def _grasps(
    item: SourceItem, target: FoundObject, arguments: argparse.Namespace, pipeline: Pipeline
) -> tuple[list[Grasp], str]:
    """The grasps to predict, and a remark: from --grasp, else the sample's own, else planned by GeoGrasp."""
    import numpy as np

    if arguments.grasp:
        pairs = np.array(arguments.grasp, dtype=np.float64).reshape(-1, 2, 3)
        return [pipeline.grasp_between(target, g1, g2) for g1, g2 in pairs], ""
    if item.sample is not None:
        return [item.sample.grasp], ""
    plan = pipeline.plan(target)
    if not plan.grasps:
        raise GraspError(f"{plan.status}: {plan.reason}")
    return list(plan.grasps), plan.reason


def _show(record: dict[str, Any]) -> None:
    rows = [
        [
            "\n".join(" ".join(f"{v:.3f}" for v in one["grasp"][name]) for name in ("g1", "g2")),
            *(_text(one[name]) for name in MODALITIES),
            "\n".join([_reference_text(one, record["touched"]), *(flag.replace("_", " ") for flag in one["flags"])]),
        ]
        for one in record["predictions"]
    ]
    print_table(
        inputs.heading(record, f" by {record['model']['name']}"), ["g1, g2 [m]", *MODALITIES, "adapted to"], rows
    )


def _reference_text(prediction: inputs.Record, touched: int) -> str:
    if prediction["reference"] == "touches":
        return f"touches {touched}"
    if prediction["reference"] == "history":
        return f"history {prediction['evidence']['readings']}"
    return str(prediction["reference"])


def _text(modality: inputs.Record) -> str:
    """Value and half width; for 24 electrodes, the smallest and the largest value and the mean half width."""
    import numpy as np

    if modality["value"] is None:
        return "refused"
    value = np.atleast_1d(modality["value"])
    text = f"{value.min():.0f}–{value.max():.0f}" if value.size > 1 else f"{value[0]:.0f}"
    if modality["lower"] is None:
        return text
    return f"{text} ±{np.mean(np.subtract(modality['upper'], modality['lower'])) / 2.0:.0f}"  # no space: it wraps there

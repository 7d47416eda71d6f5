# SPDX-License-Identifier: Apache-2.0
"""What can be learnt from recordings of taxels without a camera? On datasets that `foretouch dataset import --map` wrote.

    hold      will it hold, from the touch alone: stable or slip, with objects left out; and with objects and a posture of the hand left out
    next      the next reading of each taxel during contact, from those before it in the same grasp
    level     the touch of the next grasp, from the grasps before it and its own tare

A dataset is asked what it can answer: `hold` needs outcomes of both kinds, `next` series, `level` stamps. Everything is fitted without
the object that is predicted; of several readings that are equal, the first counts. Where one kind of outcome was recorded before the other, whatever
drifts looks like the outcome. So the place of a grasp in its session (those on its object in its file) is a baseline of `hold`, and grasps
are also compared in the other order alone: a grasp that held with those before it in its session that did not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.other_recordings.results import summarise, tabulate
from benchmarks.other_recordings.touch_hold import electrodes, fit
from benchmarks.where_on_object import predicted, recorded
from foretouch.config import Settings, setting
from foretouch.dataset.record import HOLD, SampleRecord
from foretouch.dataset.samples import open_samples
from foretouch.dataset.store import content_sha256
from foretouch.errors import ConfigError
from foretouch.types import Bool, Float64
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.prequential import other_objects_mean
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch_lab.learning.training.tracker import fit_tracker

_RIDGE: Final = 1e-3  # of the squared deviation of a predictor
_LAGS: Final = 3
_POSTURE_FOLDS: Final = 3
HOLD_METHODS: Final = ("place in session", "electrode mean", "logistic", "boosted trees", "patterns")


@dataclass(frozen=True, kw_only=True)
class OtherSettings(Settings):
    """Settings of the experiment."""

    folds: int = setting(10, "Groups of objects that are left out together", bounds=(2, 1000))
    methods: tuple[str, ...] = setting(HOLD_METHODS, "Methods that predict whether a grasp holds", choices=HOLD_METHODS)
    trees: int = setting(200, "Number of trees", bounds=(1, 10_000))
    seed: int = setting(0, "Seed of folds and trees", minimum=0)
    bootstrap: BootstrapConfig = BootstrapConfig()


@dataclass(frozen=True, eq=False)
class Records:
    """The labelled grasps of a dataset."""

    records: list[SampleRecord]
    sha256: str

    @property
    def objects(self) -> Any:
        """(S,) names."""
        return np.array([one.sample.object for one in self.records])

    @property
    def touches(self) -> Float64:
        """(S, D)."""
        return np.array([one.sample.touch.values for one in self.records if one.sample.touch is not None])

    @property
    def postures(self) -> Any:
        """(S,) file of each grasp, without the suffix that tells the test set of its authors."""
        return np.array([one.note.partition(".")[0].removesuffix("_test") for one in self.records])

    @property
    def sessions(self) -> Any:
        """(S,) number of the session of each grasp: those on its object in its file, in the order in which they were recorded."""
        return np.unique(
            [f"{one.sample.object} {one.note.partition(',')[0]}" for one in self.records], return_inverse=True
        )[1]

    @property
    def places(self) -> Float64:
        """(S,) number of grasps before each in its session."""
        sessions = self.sessions
        return np.array([np.count_nonzero(sessions[:k] == one) for k, one in enumerate(sessions)], np.float64)


def _load(_settings: OtherSettings, path: Path) -> Records:
    records = [one for one in open_samples(path).records() if one.sample.touch is not None]
    return Records(records, content_sha256(one.sample for one in records))


def _cells(settings: OtherSettings, data: Records) -> list[Cell]:
    cells, objects = [], sorted(set(data.objects))
    if {"success", "failure"} <= {one.outcome for one in data.records}:
        cells += [Cell(f"hold+{k}", {"what": "hold", "left_out": "objects", "fold": k}) for k in range(settings.folds)]
        names = sorted(set(data.postures))
        cells += [
            Cell(f"hold+{name}+{k}", {"what": "hold", "left_out": name, "fold": k})
            for name in (names if 1 < len(names) < 10 else ())
            for k in range(_POSTURE_FOLDS)
        ]
    if all(one.series is not None for one in data.records):
        cells += [Cell(f"next+{name}", {"what": "next", "left_out": name, "fold": -1}) for name in objects]
        if any(one.sample.stamp_ns for one in data.records):
            cells += [Cell(f"level+{name}", {"what": "level", "left_out": name, "fold": -1}) for name in objects]
    if not cells:
        raise ConfigError("experiment: the dataset holds neither outcomes of both kinds nor series")
    return cells


def _run(cell: Cell, settings: OtherSettings, data: Records) -> list[Row]:
    if cell.values["what"] == "hold":
        return _hold(cell, settings, data)
    return (
        next_reading(data, cell.values["left_out"])
        if cell.values["what"] == "next"
        else level(data, cell.values["left_out"])
    )


def folds_of(objects: Any, count: int, seed: int) -> Any:
    """(S,) the fold of each grasp: objects are dealt out in a shuffled order."""
    names = np.random.default_rng(seed).permutation(np.unique(objects))
    return np.array([dict(zip(names, np.arange(len(names)) % count, strict=True))[one] for one in objects])


def _hold(cell: Cell, settings: OtherSettings, data: Records) -> list[Row]:
    known = np.array([one.outcome != "unknown" for one in data.records])
    held = np.array([one.outcome == "success" for one in data.records])
    left_out, fold = cell.values["left_out"], cell.values["fold"]
    if left_out == "objects":
        test = folds_of(data.objects, settings.folds, settings.seed) == fold
        learnt = ~test
    else:
        own, posed = folds_of(data.objects, _POSTURE_FOLDS, settings.seed) == fold, data.postures == left_out
        test, learnt = own & posed, ~own & ~posed
    test, learnt = test & known, learnt & known
    rows: list[Row] = []
    for method in settings.methods if test.any() else ():
        if (found := hold_chance(method, settings, data, learnt, held)) is not None:
            facts = {"objects": data.objects, "sessions": data.sessions, "held": held, "chance": np.round(found, 6)}
            rows.append({"method": method, **{name: values[test].tolist() for name, values in facts.items()}})
    return rows


def hold_chance(method: str, settings: OtherSettings, data: Records, learnt: Bool, held: Bool) -> Float64 | None:
    """(S,) probability that each grasp holds, by a method fitted to some grasps and whether they held; None where it does not apply."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    channels = data.records[0].sample.touch.channels  # type: ignore[union-attr]  # they are labelled
    if method == "patterns":
        readings = electrodes(data.touches, channels)
        return None if readings is None else fit(readings[learnt], held[learnt], settings.seed).chance(readings)
    features = data.touches
    if method == "place in session":
        features = data.places[:, None]
        if not features.any():  # a session for each grasp
            return None
    if method == "electrode mean":
        features = features @ channels.finger_means.mean(axis=0)[:, None]
    model: Any = make_pipeline(StandardScaler(), LogisticRegression(C=0.1, max_iter=1000))
    if method == "boosted trees":
        model = HistGradientBoostingClassifier(max_iter=settings.trees, learning_rate=0.08, random_state=settings.seed)
    found: Float64 = model.fit(features[learnt], held[learnt]).predict_proba(features)[:, 1]
    return found


def contact_readings(record: SampleRecord) -> tuple[Float64, Float64]:
    """(T, D) different readings in contact, and (D,) the rest level, 0 where there is none."""
    series, tare = record.series, record.sample.tare
    assert series is not None
    values = series.counts[series.phases == HOLD].astype(np.float64)
    changed = (
        np.concatenate([[True], (np.diff(values, axis=0) != 0.0).any(axis=1)]) if len(values) else np.zeros(0, bool)
    )
    return values[changed], np.zeros(values.shape[1]) if tare is None else tare.values


def predictors(values: Float64, rest: Float64) -> tuple[dict[str, Float64], Float64, Float64]:
    """Of (T, D) readings: predictions of the last T - 3 without learning, (T - 3, D, P) what is learnt from, and the truth."""
    past, truth = values[_LAGS - 1 : -1], values[_LAGS:]
    step, before = past - values[_LAGS - 2 : -2], values[_LAGS - 2 : -2] - values[_LAGS - 3 : -3]
    mean = np.cumsum(values, axis=0)[_LAGS - 1 : -1] / np.arange(_LAGS, len(values))[:, None]
    around = np.broadcast_to(step.mean(axis=1, keepdims=True), step.shape)
    return (
        {"last": past, "mean so far": mean, "line": past + step},
        np.stack([step, before, past - rest, past - mean, around], -1),
        truth,
    )


def next_reading(data: Records, target: str) -> list[Row]:
    """Sums of squared errors of each modality over the grasps on an object, by method."""
    channels = data.records[0].sample.touch.channels  # type: ignore[union-attr]  # they are labelled
    own: list[tuple[dict[str, Float64], Float64, Float64]] = []
    gram = {name: (np.zeros((5, 5)), np.zeros(5)) for name in channels.modalities}
    for record in data.records:
        values, rest = contact_readings(record)
        if len(values) <= _LAGS:
            continue
        made = predictors(values, rest)
        if record.sample.object == target:
            own.append(made)
            continue
        for name, columns in channels.modality_columns.items():
            inputs, change = made[1][:, columns].reshape(-1, 5), (made[2] - made[0]["last"])[:, columns].ravel()
            gram[name] = gram[name][0] + inputs.T @ inputs, gram[name][1] + inputs.T @ change
    errors: dict[tuple[str, str], float] = {}
    counts = dict.fromkeys(channels.modalities, 0)
    for found, inputs, truth in own:
        for name, columns in channels.modality_columns.items():
            square, cross = gram[name]
            weights = np.linalg.solve(square + _RIDGE * np.diag(np.diag(square)) + 1e-9 * np.eye(5), cross)
            learnt = {"autoregression": found["last"][:, columns] + inputs[:, columns] @ weights}
            for method, values in ({key: one[:, columns] for key, one in found.items()} | learnt).items():
                key = (method, name)
                errors[key] = errors.get(key, 0.0) + float(np.square(truth[:, columns] - values).sum())
            counts[name] += truth[:, columns].size
    return [
        {"method": method, "modality": name, "squares": one, "count": counts[name]}
        for (method, name), one in errors.items()
    ]


def level(data: Records, target: str) -> list[Row]:
    """Sums of squared errors of the touch of each grasp on an object, predicted from earlier grasps alone, by method."""
    records = sorted(data.records, key=lambda one: one.sample.stamp_ns)
    samples = [one.sample for one in records]
    recording, channels = recorded(samples), samples[0].touch.channels  # type: ignore[union-attr]  # they are labelled
    truth, objects = recording.readings, recording.objects
    tares = np.array([one.tare.values if one.tare is not None else np.full(channels.size, np.nan) for one in samples])
    others = recording.take(objects != target)
    expected = other_objects_mean(others)
    group = fit_group(HeldOutPredictions(expected, others.readings, others.objects, others.objects, channels), new=True)
    tracked, _ = predicted(recording, None, target, fit_tracker(others, group, group))
    rows: dict[tuple[str, str], float] = {}
    scored = [k for k in np.flatnonzero(objects == target) if k and np.isfinite(tracked[k]).all()]
    for k in scored:
        same = np.flatnonzero(objects[:k] == target)
        mean = truth[:k].mean(axis=0)
        found = {
            "mean of all": mean,
            "last grasp": truth[k - 1],
            "mean of object": truth[same].mean(axis=0) if same.size else mean,
            "tare + mean change": tares[k] + (truth[:k] - tares[:k]).mean(axis=0),
            "tracker": tracked[k],
        }
        for method, value in found.items():
            for name, columns in channels.modality_columns.items():
                error = float(np.square(truth[k] - value)[columns].sum())
                rows[method, name] = rows.get((method, name), 0.0) + error
    sizes = {name: len(scored) * len(columns) for name, columns in channels.modality_columns.items()}
    return [
        {"method": method, "modality": name, "squares": one, "count": sizes[name]}
        for (method, name), one in rows.items()
    ]


def _tabulate(settings: OtherSettings, rows: Sequence[Row]) -> list[Row]:
    return tabulate(rows, settings.bootstrap)


PRESETS: Final[Mapping[str, Mapping[str, Any]]] = {
    "full": {},
    "smoke": {"folds": 2, "methods": ["electrode mean", "logistic"], "trees": 5, "bootstrap.draws": 200},
}

EXPERIMENT = Experiment(
    name="benchmarks.other_recordings",
    question="What can be learnt from recordings of taxels without a camera?",
    module=__name__,
    settings=OtherSettings,
    presets=PRESETS,
    load=_load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise,
    resumable_settings=("bootstrap",),
)

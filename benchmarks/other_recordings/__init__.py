# SPDX-License-Identifier: Apache-2.0
"""Will it hold, from the touch alone: stable or slip, on datasets that `examples/import_*.py` wrote.

Everything is fitted without the objects that are predicted, and besides without the objects and a posture of the hand. Where one kind of outcome
was recorded before the other, whatever drifts looks like the outcome. So the place of a grasp in its session (those on its object in its file)
is a baseline, and grasps are also compared in the other order alone: a grasp that held with those before it in its session that did not.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.other_recordings.results import summarise, tabulate
from foretouch.config import Settings, setting
from foretouch.dataset.formats import open_samples
from foretouch.dataset.store import content_sha256
from foretouch.errors import ConfigError
from foretouch.models.novelty import standardisation
from foretouch.models.touch_hold import TouchHold, patterns
from foretouch.types import Bool, Float64, Sample
from foretouch.types.channels import Channels
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

_POSTURE_FOLDS: Final = 3
HOLD_METHODS: Final = ("place in session", "electrode mean", "logistic", "boosted trees", "patterns")

FINGERS: Final = ("TH", "MF", "FF")
CONFIG: Final = {"networks": 5, "units": 16, "decay": 1.0, "epochs": 60}
_USUAL: Final = (0.001, 0.999)  # quantiles of the training readings, between which a pattern is in range


@dataclass(frozen=True, kw_only=True)
class OtherSettings(Settings):
    """Settings of the experiment."""

    folds: int = setting(10, "Groups of objects that are left out together", bounds=(2, 1000))
    methods: tuple[str, ...] = setting(HOLD_METHODS, "Methods that predict whether a grasp holds", choices=HOLD_METHODS)
    trees: int = setting(200, "Number of trees", bounds=(1, 10_000))
    seed: int = setting(0, "Seed of folds and trees", minimum=0)
    bootstrap: BootstrapConfig = BootstrapConfig()


class Records:
    """The labelled grasps of a dataset, and of each (S,): object, posture of the hand, session and place in it.

    A session are the grasps on an object in a file, in the order in which they were recorded; the file names the posture, but for
    the suffix that tells the test set of its authors.
    """

    def __init__(self, samples: Sequence[Sample], sha256: str) -> None:
        self.samples, self.sha256 = samples, sha256
        self.touches = np.array([sample.touch.values for sample in samples if sample.touch is not None])  # (S, D)
        self.objects: Any = np.array([sample.object for sample in samples])
        self.postures: Any = np.array([record.note.partition(".")[0].removesuffix("_test") for record in samples])
        files = [record.note.partition(",")[0] for record in samples]
        names = [f"{object_} {file}" for object_, file in zip(self.objects, files, strict=True)]
        self.sessions: Any = np.unique(names, return_inverse=True)[1]
        earlier = [np.count_nonzero(self.sessions[:k] == session) for k, session in enumerate(self.sessions)]
        self.places = np.array(earlier, np.float64)


def _load(_settings: OtherSettings, path: Path) -> Records:
    samples = [sample for sample in open_samples(path) if sample.touch is not None]
    return Records(samples, content_sha256(samples))


def _cells(settings: OtherSettings, data: Records) -> list[Cell]:
    if not {"success", "failure"} <= {sample.outcome for sample in data.samples}:
        raise ConfigError("experiment: the dataset does not hold outcomes of both kinds")
    names = sorted(set(data.postures))
    folds = [("objects", settings.folds), *((name, _POSTURE_FOLDS) for name in (names if 1 < len(names) < 10 else ()))]
    return [Cell(f"hold+{name}+{k}", {"left_out": name, "fold": k}) for name, count in folds for k in range(count)]


def folds_of(objects: Any, count: int, seed: int) -> Any:
    """Return (S,) the fold of each grasp: objects are dealt out in a shuffled order."""
    names = np.random.default_rng(seed).permutation(np.unique(objects))
    return np.array([dict(zip(names, np.arange(len(names)) % count, strict=True))[object_] for object_ in objects])


def _run(cell: Cell, settings: OtherSettings, data: Records) -> list[Row]:
    known = np.array([record.outcome != "unknown" for record in data.samples])
    held = np.array([record.outcome == "success" for record in data.samples])
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
        if (chance := hold_chance(method, settings, data, learnt, held)) is not None:
            facts = {"objects": data.objects, "sessions": data.sessions, "held": held, "chance": np.round(chance, 6)}
            rows.append({"method": method, **{name: values[test].tolist() for name, values in facts.items()}})
    return rows


def hold_chance(method: str, settings: OtherSettings, data: Records, learnt: Bool, held: Bool) -> Float64 | None:
    """Return (S,) probability that each grasp holds, by a method fitted to some grasps and whether they held; None where it does not apply."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    channels = data.samples[0].touch.channels  # type: ignore[union-attr]  # they are labelled
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
    chance: Float64 = model.fit(features[learnt], held[learnt]).predict_proba(features)[:, 1]
    return chance


def electrodes(touches: Float64, channels: Channels) -> Float64 | None:
    """Return (S, 3, 24) electrodes of (S, D) touches by `FINGERS`; None of another sensor."""
    names = [f"E_{finger}" for finger in FINGERS]
    if not set(names) <= set(channels.modalities):
        return None
    return touches[:, channels.columns(names)].reshape(len(touches), len(FINGERS), -1)


def fit(readings: Float64, held: Bool, seed: int) -> TouchHold:
    """Return a model of (S, 3, 24) readings and whether the grasps held, not calibrated."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    inputs = patterns(readings)
    mean, deviation = standardisation(inputs)
    how = {"activation": "tanh", "alpha": CONFIG["decay"], "max_iter": CONFIG["epochs"]}
    networks = [MLPClassifier((CONFIG["units"],), random_state=seed + k, **how) for k in range(CONFIG["networks"])]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is part of the recipe
        for network in networks:
            network.fit((inputs - mean) / deviation, held)
    # The standardisation is part of the first layer.
    hidden = np.stack([network.coefs_[0] / deviation[:, None] for network in networks])
    bias = np.stack([network.intercepts_[0] for network in networks]) - np.einsum("d,kdh->kh", mean, hidden)
    out = np.stack([network.coefs_[1][:, 0] for network in networks])
    last = np.array([network.intercepts_[1][0] for network in networks])
    low, high = np.quantile(inputs, _USUAL, axis=0)
    return TouchHold(low, high, hidden, bias, out, last, np.array([1.0, 0.0]))


EXPERIMENT = Experiment(
    name="benchmarks.other_recordings",
    question="Does the touch alone tell whether a grasp will hold?",
    module=__name__,
    settings=OtherSettings,
    presets={
        "full": {},
        "smoke": {"folds": 2, "methods": ["electrode mean", "logistic"], "trees": 5, "bootstrap.draws": 200},
    },
    load=_load,
    cells=_cells,
    run=_run,
    tabulate=lambda settings, rows: tabulate(rows, settings.bootstrap),
    summarise=summarise,
    resumable_settings=("bootstrap",),
)

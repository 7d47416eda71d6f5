# SPDX-License-Identifier: Apache-2.0
"""What does it add to know where on the object its earlier touches were? Each grasp is predicted from all readings before it.

The tracker predicts a grasp from the state of the sensors, their temperature and the touches of the object, with the mean of
earlier readings in the place of vision: the geometry of the grasps is all that the camera adds. Its parameters, those of the
kernel on the geometry among them, are fitted without the object that is predicted. What stands for "where":

    level         nothing: the tracker as it was before
    where         the features of the grasp in the frame of the hand (`foretouch.models.contact.features`)
    shuffled      the same, those of the object's grasps in another order: they are as many and as wide, and say nothing
    neighbours    the same, shuffled among five grasps in succession: what would be left if geometry stood for the time
    time          the time alone, in the place of the features
    without ...   the features without those of one group

Samples without stamps, as of a simulated day, are taken object by object, a minute apart. Where the scene is known, some
grasps are executed again with everything that no camera sees redrawn: their variance is an error that no predictor avoids.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.where_on_object.results import draw_where, summarise_where, where_rows
from foretouch.config import Settings, setting
from foretouch.dataset.store import Store, is_store
from foretouch.models.contact.features import CONDITIONS, FEATURES, OBJECT_FEATURES
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.noise_ceiling import CAUSES, Repeater
from foretouch_lab.experiments.shared.scores import labelled
from foretouch_lab.experiments.shared.simulated_data import SimulatedSettings, load_simulated
from foretouch_lab.learning.data import labels_of, load_dataset
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.evaluation.prequential import other_objects_mean
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group, rest_level
from foretouch_lab.learning.training.contact import describe_samples
from foretouch_lab.learning.training.tracker import fit_places, fit_tracker
from foretouch_lab.simulation.scene import SceneConfig

LEVEL: Final = "level"
_MINUTE_NS: Final = 60 * 10**9
_NEIGHBOURS: Final = 5
_NAMES: Final = FEATURES[len(CONDITIONS) :]
_GROUPS: Final = {
    "without sizes": [name in OBJECT_FEATURES for name in _NAMES],
    "without contacts": [name.startswith(("g1_", "g2_")) for name in _NAMES],
    "without hand": [name not in OBJECT_FEATURES and not name.startswith(("g1_", "g2_")) for name in _NAMES],
}
VARIANTS: Final = (LEVEL, "where", "shuffled", "neighbours", "time", *_GROUPS)


@dataclass(frozen=True, kw_only=True)
class WhereSettings(Settings):
    """Settings of the experiment."""

    variants: tuple[str, ...] = setting(VARIANTS, "What stands for where on the object", choices=VARIANTS)
    seed: int = setting(0, "Seed of the shuffled orders", minimum=0)
    repeated: int = setting(4, "Grasps of each simulated object that are executed again", bounds=(0, 1000))
    repeats: int = setting(8, "Number of times", bounds=(2, 1000))
    bootstrap: BootstrapConfig = BootstrapConfig()


@dataclass(frozen=True, eq=False)
class Grasps:
    """Labelled grasps, and the scene of simulated ones."""

    samples: list[GraspSample]  # in order of time
    scene: SceneConfig | None
    sha256: str


def _load(_settings: WhereSettings, path: Path) -> Grasps:
    data, scene = load_dataset(path), None
    if is_store(path) and "scene" in Store(path).manifest.get("about", {}):
        scene = load_simulated(SimulatedSettings(), path).scene
    return Grasps(in_order(labelled(data)), scene, data.sha256)


def in_order(samples: Sequence[GraspSample]) -> list[GraspSample]:
    """Samples in order of time; object by object, a minute apart, where none has a stamp."""
    if any(sample.stamp_ns for sample in samples):
        return sorted(samples, key=lambda sample: sample.stamp_ns)
    samples = sorted(samples, key=lambda sample: sample.object)
    return [replace(sample, stamp_ns=(k + 1) * _MINUTE_NS) for k, sample in enumerate(samples)]


def features_of(samples: Sequence[GraspSample]) -> Float64:
    """(S, P) what is compared of the grasps: the features of `models.contact` without distance and density of the cloud."""
    return describe_samples(samples)[:, len(CONDITIONS) :]


def recorded(samples: Sequence[GraspSample]) -> TimedReadings:
    """Readings in order of time, without tares; what is expected of each is the mean of all other objects."""
    labels = labels_of(samples)
    recording = TimedReadings.of_samples(samples, labels, labels, rest_level(samples)[0])
    return replace(recording, expected=other_objects_mean(recording), tares=None, tare_tdc=None)


def variant(name: str, recording: TimedReadings, features: Float64, seed: int) -> Float64 | None:
    """(S, P) what stands for where on the object; None for nothing."""
    rng, runs = np.random.default_rng(seed), recording.runs()
    if name == LEVEL:
        return None
    if name == "time":
        return (recording.stamps_ns - recording.stamps_ns[0])[:, None] / 1e9
    if name in _GROUPS:
        return features[:, ~np.array(_GROUPS[name])]
    order = np.arange(len(runs))
    for run in np.unique(runs) if name != "where" else ():
        own = np.flatnonzero(runs == run)
        size = _NEIGHBOURS if name == "neighbours" else len(own)
        for first in range(0, len(own), size):
            order[own[first : first + size]] = rng.permutation(own[first : first + size])
    return features[order]


def predicted(
    recording: TimedReadings, where: Float64 | None, target: str, parameters: TrackerParameters
) -> tuple[Float64, Float64]:
    """(S, D) predictions of the grasps on one object and half widths, each from earlier readings alone; NaN for the others.

    What is expected is the mean of the readings before the run on other objects. Nothing is predicted of the first run.
    """
    runs = recording.runs()
    counts, half = np.full((2, *recording.readings.shape), np.nan)
    for run in np.unique(runs[(recording.objects == target) & (runs > 0)]):
        shown, last = runs <= run, runs == run
        others = (runs < run) & (recording.objects != target)
        before = replace(
            recording.take(shown),
            expected=np.tile(recording.readings[others].mean(axis=0), (shown.sum(), 1)),
            where=None if where is None else where[shown],
        )
        played = replay(SensorTracker(parameters), before)
        counts[last], half[last] = played.counts[last[shown]], played.half[last[shown]]
    return counts, half


def _cells(settings: WhereSettings, data: Grasps) -> list[Cell]:
    names = sorted({sample.object for sample in data.samples})
    cells = [Cell(f"predict+{name}", {"what": "predict", "object": name}) for name in names]
    repeated = names if data.scene is not None and settings.repeated else []
    return cells + [Cell(f"repeat+{name}", {"what": "repeat", "object": name}) for name in repeated]


def _run(cell: Cell, settings: WhereSettings, data: Grasps) -> list[Row]:
    target, recording = cell.values["object"], recorded(data.samples)
    own = recording.objects == target
    if cell.values["what"] == "repeat":
        return [{"variance": variance.tolist()} for variance in _repeated(settings, data, target)]
    others = recording.take(~own)
    others = replace(others, expected=other_objects_mean(others))
    channels = data.samples[0].touch.channels  # type: ignore[union-attr]  # they are labelled
    held_out = HeldOutPredictions(others.expected, others.readings, others.objects, others.objects, channels)
    group = fit_group(held_out, new=True)
    level, features = fit_tracker(others, group, group), features_of(data.samples)
    reference, rows = other_objects_mean(recording), []
    for name in settings.variants:
        where, parameters = variant(name, recording, features, settings.seed), level
        if where is not None:
            parameters = fit_places(level, replace(others, where=where[~own]))
        counts, half = predicted(recording, where, target, parameters)
        scored = np.isfinite(counts).all(axis=1)
        parts = {"counts": counts, "half": half, "readings": recording.readings, "reference": reference}
        rows.append(
            {
                "variant": name,
                "touches": recording.touches()[scored].tolist(),
                "ratio": parameters.where_ratio.tolist(),
                "modalities": {one: channel.size for one, channel in channels.channel_of.items()},
                **{key: values[scored].tolist() for key, values in parts.items()},
            }
        )
    return rows


def _repeated(settings: WhereSettings, data: Grasps, target: str) -> list[Float64]:
    """(D,) variances of grasps that are executed again; unbiased."""
    assert data.scene is not None
    repeater = Repeater(data.scene, frozenset(CAUSES))
    own = [sample for sample in data.samples if sample.object == target]
    chosen = np.linspace(0, len(own) - 1, min(settings.repeated, len(own))).round().astype(int)
    keys = [(int(own[k].extra["slot"]), int(own[k].extra["attempt"])) for k in chosen]
    return [repeater.repeat(*key, settings.repeats).touches.var(axis=0, ddof=1) for key in keys]


def _tabulate(settings: WhereSettings, rows: Sequence[Row]) -> list[Row]:
    return where_rows(rows, settings.bootstrap)


EXPERIMENT = Experiment(
    name="benchmarks.where_on_object",
    question="What does it add to know where on the object its earlier touches were?",
    module=__name__,
    settings=WhereSettings,
    presets={
        "full": {},
        "quick": {"variants": [LEVEL, "where", "shuffled"]},
        "smoke": {"variants": [LEVEL, "where"], "repeated": 1, "repeats": 2, "bootstrap.draws": 200},
    },
    load=_load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise_where,
    figure=draw_where,
    resumable_settings=("bootstrap",),
    data_folder="vision2tactile",
)

# SPDX-License-Identifier: Apache-2.0
"""How much must a lab record to know what vision buys? Simulated campaigns, thinned to smaller ones.

For each seed one large campaign of a scene is simulated, with other objects, another hand and other drift. Before it,
the contact model is fitted to grasps of the training objects, each with a tare; the tracker, to the first visits to them.
The readings on all others are then predicted in order of time from history, touches, temperature and tares, and
besides from

    nothing    the mean of the training labels
    contact    vision as far as the model has learnt it
    object     the mean reading of the object: the most that seeing which object it is could tell

A design keeps a part of what was recorded of them: objects, visits, grasps and tares. The half width of the 95 %
interval of the gain over `nothing`, by the paired bootstrap over objects, is how well such a campaign determines it.
The last grasp of each visit repeats the one before; half their squared difference is an error that no predictor avoids.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, load_yaml, setting
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch.types import GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.prequential.results import REGIMES
from foretouch_lab.experiments.shared.tables import grouped, listed, with_notes
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, ScoreEstimate, compare, skills
from foretouch_lab.learning.evaluation.prequential import other_objects_mean
from foretouch_lab.learning.prequential import Replayed, TimedReadings, replay
from foretouch_lab.learning.training.calibration import calibrate_on_folds, rest_level, resting_labels
from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation

_NOTHING, _CONTACT, _OBJECT, _REPEAT = "nothing", "contact", "object", "a repeat"
_DESIGN: Final = ("objects", "visits", "tares", "days")


@dataclass(frozen=True, kw_only=True)
class RecordingPlanSettings(Settings):
    """Settings of the experiment."""

    seeds: tuple[int, ...] = setting((1, 2, 3), "Seeds of the campaigns", minimum=0)
    train_objects: int = setting(60, "Number of objects that the model has learnt from before", minimum=6, maximum=1000)
    train_grasps: int = setting(20, "Number of grasps of each of them", minimum=1, maximum=1000)
    objects: tuple[int, ...] = setting((8, 16, 32, 64), "Numbers of objects", minimum=6, maximum=1000)
    visits: tuple[int, ...] = setting((1, 2, 3), "Numbers of visits to each object", minimum=1, maximum=10)
    grasps: int = setting(4, "Number of grasps of a visit, of which the last repeats the one before", minimum=4)
    contact: ContactTrainingConfig = ContactTrainingConfig(trees=20)
    bootstrap: BootstrapConfig = BootstrapConfig(draws=2000)


@dataclass(frozen=True)
class Design:
    """What is recorded."""

    objects: int
    visits: int  # to each object, on different days
    tares: str = "object"  # as in the settings of a campaign
    days: str = "few"  # with as many objects as a session has, or with fewer on `many` days


@dataclass(frozen=True)
class _Scene:
    """The scene of the campaigns as plain settings."""

    plain: Mapping[str, Any]

    @property
    def sha256(self) -> str:
        return sha256(repr(self.plain).encode()).hexdigest()

    def campaign(self, settings: RecordingPlanSettings, seed: int, objects: int) -> SceneConfig:
        """The scene with a number of objects, each with all its visits, and a tare before each grasp."""
        campaign, family = self.plain["campaign"], self.plain["families"][0]
        days = list(range(-(-objects * max(settings.visits) // campaign["objects"])))
        changes = {"days": days, "grasps": settings.grasps, "repeat_every": settings.grasps, "tares": "grasp"}
        families = [family | {"count": objects, "seed": family["seed"] + 1000 * (1 + seed)}]
        plain = {**self.plain, "seed": seed, "families": families, "campaign": campaign | changes}
        return SceneConfig.from_mapping(plain)


def _designs(settings: RecordingPlanSettings) -> list[Design]:
    """All numbers of objects and visits; and with one visit, what else can be changed."""
    others = [{"tares": "none"}, {"tares": "grasp"}, {"days": "many"}]
    found = [Design(objects, visits) for objects in settings.objects for visits in settings.visits]
    return found + [Design(objects, 1, **one) for objects in settings.objects for one in others]


def thinned(visits: Sequence[Sequence[GraspSample]], design: Design) -> list[GraspSample]:
    """What a design keeps of visits to objects, each a list of grasps with tares."""
    names = list(dict.fromkeys(visit[0].object for visit in visits))
    step = len(names) // design.objects if design.days == "many" else 1
    left = {names[k * step]: design.visits for k in range(design.objects)}
    kept = []
    for visit in visits:
        if left.get(visit[0].object):
            left[visit[0].object] -= 1
            tared = {"grasp": len(visit), "object": 1, "none": 0}[design.tares]
            kept += [*visit[:tared], *(replace(sample, tare=None) for sample in visit[tared:])]
    return kept


def _run(cell: Cell, settings: RecordingPlanSettings, data: _Scene) -> list[Row]:
    every, objects = settings.grasps, settings.train_objects + max(settings.objects)
    scene = data.campaign(settings, cell.values["seed"], objects)
    samples = list(Simulation(scene).samples(objects * max(settings.visits) * every))
    visits = [samples[k : k + every] for k in range(0, len(samples), every)]
    train = [sample for visit in visits[: settings.train_objects] for sample in visit]
    known = {sample.object for sample in train}
    tested = [visit for visit in visits if visit[0].object not in known]

    labels, (rest, _) = labels_of(train), rest_level(train)
    resting = resting_labels(train, labels, rest)
    calibration, _ = calibrate_on_folds(
        train, labels, lambda fold: np.tile(resting[fold.train].mean(axis=0), (len(fold.test), 1)), 0
    )
    before = scene.replace(campaign=None, objects=tuple(item for item in scene.objects if item.name in known))
    learnt = list(Simulation(before).samples(len(known) * settings.train_grasps))
    predictor = ContactPredictor(learnt, labels_of(learnt), settings.contact)
    everything = [sample for visit in tested for sample in visit]
    levels, names = resting_labels(everything, labels_of(everything), rest), [one.object for one in everything]
    means = {name: levels[np.array(names) == name].mean(axis=0) for name in set(names)}

    rows: list[Row] = []
    for design in _designs(settings):
        kept = thinned(tested, design)
        sources = {
            _NOTHING: (np.tile(resting.mean(axis=0), (len(kept), 1)), rest),
            _CONTACT: (predictor.predict(kept), predictor.rest),
            _OBJECT: (np.array([means[sample.object] for sample in kept]), rest),
        }
        played = {}
        for name, (expected, level) in sources.items():
            recording = TimedReadings.of_samples(kept, labels_of(kept), expected, level)
            played[name] = replay(SensorTracker(calibration.tracker_parameters), recording)
        head = asdict(design) | {"sessions": len({sample.extra["session"] for sample in kept})}
        rows += [head | row for row in _scores(recording, played, every, settings.bootstrap)]
    return rows


def _scores(
    recording: TimedReadings, played: Mapping[str, Replayed], every: int, config: BootstrapConfig
) -> Iterator[Row]:
    """In each regime, what each source gains; and the skill that a repeated grasp leaves room for."""
    objects, readings, touches = recording.objects, recording.readings, recording.touches()
    reference, again = other_objects_mean(recording), np.flatnonzero(touches % every == every - 1)
    found: dict[tuple[str, str], tuple[dict[str, ScoreEstimate], Any]] = {}
    for regime in ("never touched", "first three"):
        at = touches <= REGIMES[regime][1]
        errors = {
            name: ObjectErrors.of_predictions(objects[at], one.counts[at], readings[at], reference[at], BIOTAC)
            for name, one in played.items()
        }
        for name, one in played.items():
            without = errors[_NOTHING]
            gain = skills(without, config) if name == _NOTHING else compare(errors[name], without, config)
            found[regime, name] = gain, np.abs(readings - one.counts)[at] <= one.half[at]
    half = (readings[again] - readings[again - 1]) / np.sqrt(2.0)
    least = ObjectErrors.of_predictions(
        objects[again], readings[again] - half, readings[again], reference[again], BIOTAC
    )
    found["all", _REPEAT] = skills(least, config), None
    for (regime, name), (estimates, inside) in found.items():
        for key in MODALITIES:
            value, low, high = estimates[key].value, estimates[key].low, estimates[key].high
            width = None if low is None or high is None else (high - low) / 2.0
            covered = None if inside is None else float(inside[:, BIOTAC.columns([key])].mean())
            place = {"regime": regime, "known": name, "modality": key}
            yield place | {"value": value, "half_width": width, "coverage": covered}


def _tabulate(_settings: RecordingPlanSettings, rows: Sequence[Row]) -> list[Row]:
    """Means over the seeds, and the standard deviation of the value between them."""
    names, result = (*_DESIGN, "regime", "known", "modality"), []
    for place, own in grouped(rows, *names):
        found: Row = dict(zip(names, place, strict=True)) | {"seeds": len(own)}
        for name in ("sessions", "value", "half_width", "coverage"):
            values = [row[name] for row in own if row[name] is not None]
            found[name] = float(np.mean(values)) if values else None
        found["deviation"] = float(np.std([row["value"] for row in own], ddof=1)) if len(own) > 1 else None
        result.append(found)
    return result


def _summarise(rows: Sequence[Row]) -> list[Table]:
    tables: list[Table] = []
    head = ["objects", "visits", "tares", "days", "value", "half width", "between seeds", "coverage"]
    titles = {_NOTHING: "skill without vision", _REPEAT: "skill that no predictor exceeds, from repeated grasps"}
    for (regime, known), own in grouped(rows, "regime", "known"):
        body = []
        for (*design, _), part in grouped(own, *_DESIGN):
            numbers = [listed(part, name) for name in ("value", "half_width", "deviation", "coverage")]
            body.append([*map(str, design), f"{part[0]['sessions']:.0f}", *numbers])
        tables.append(Table(f"{regime}: {titles.get(known, f'gain of {known}')}", head, body))
    notes = [
        "PDC_TH PDC_MF E_TH E_MF, means over the seeds, all with history, touches, temperature and tares; skill: 0 is the mean of all readings of the other objects",
        "half width: of the 95 % interval by bootstrap over objects; between seeds: standard deviation of the value; coverage: of the 90 % intervals of predictions",
        "contact: vision as far as the model has learnt it from other objects; object: the mean reading of the object, as if it was recognised; days: sessions",
        "half widths fall with the square root of the number of objects",
    ]
    return with_notes(tables, notes)


EXPERIMENT = Experiment(
    name="benchmarks.recording_plan",
    question="How much must a lab record to know what vision buys?",
    module=__name__,
    settings=RecordingPlanSettings,
    presets={
        "full": {},
        "smoke": {
            "seeds": [0],
            "train_objects": 6,
            "train_grasps": 5,
            "objects": [6],
            "visits": [1],
            "contact.trees": 2,
        },
    },
    load=lambda _settings, path: _Scene(load_yaml(path)),
    cells=lambda settings, _data: [Cell(f"seed{seed}", {"seed": seed}) for seed in settings.seeds],
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    resumable_settings=("seeds",),
)

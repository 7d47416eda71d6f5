# SPDX-License-Identifier: Apache-2.0
"""Area `simulation`: level of contact, grid and effects of the simulator against the time of a sample.

digits       correct decimal digits of the drops of 24 electrodes: -log10 of the median over grasps of the error against
             the finest layer, ‖drop - finest‖ / ‖finest‖; the lower end is of the largest error
trained      skill, on the finest level and with all effects, of a contact model that is trained on the variant
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.tactile import BIOTAC
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, TradeoffSettings, Variant, make_area
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.metrics import MEAN, ObjectErrors, skills
from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.simulate import Simulation

RIGID: Final = "rigid"
SOFT: Final = "deformables"
EVERYTHING: Final = "everything"

_FOLDER: Final = Path("config/scenes")
_TIMED: Final = 16  # samples that are timed in turn
_FINEST: Final = 64  # cells a side of the finest layer
_LEVELS: Final = (("winkler", 12), ("winkler", 24), *(("layer", cells) for cells in (8, 12, 16, 24, 32)))

# Effects that are left out one by one; the first six are of the camera.
_LEFT_OUT: Final = (
    *("clutter", "flying_pixels", "depth_noise", "stereo_shadow", "holes", "depth_steps"),
    *("execution_error", "weight", "creep", "slip", "drift", "noise", "scan_hold"),
)


def _variants() -> Iterator[Variant]:
    """Iterate over the variants of each scene; the first is what the others are compared with, and is tested on."""
    for scene in (RIGID, SOFT):
        for name, cells in (("layer", _FINEST), *_LEVELS):
            text = "finest layer" if cells == _FINEST else f"{name} {cells}x{cells}"
            changes = {"fidelity": name, "fingers.pad.cells": cells}
            factor = "reference" if cells == _FINEST else name
            yield Variant(f"{scene}: {text}", factor, {"scene": scene, "changes": changes})
        yield Variant(f"{scene} as shipped", "shipped", {"scene": scene, "changes": {}})
    always = {"fingers.dead": None}  # no training accepts readings with a dead electrode
    yield Variant(f"{EVERYTHING} as shipped", "shipped", {"scene": EVERYTHING, "changes": always})
    switches = {effect.name: effect.when for effect in EFFECTS}  # setting of the scene whose absence switches it off
    for number, name in enumerate(_LEFT_OUT):
        factor = "camera" if number < 6 else "hand and sensor"
        yield Variant(f"without {name}", factor, {"scene": EVERYTHING, "changes": {**always, switches[name]: None}})


VARIANTS: Final = tuple(_variants())


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(TradeoffSettings):
    """Settings of the area."""

    compared: int = setting(60, "Grasps whose readings are compared", bounds=(2, 10_000))
    train: int = setting(
        160, "Grasps that a model is trained on, and as many that it is tested on", bounds=(10, 10_000)
    )
    trees: int = setting(30, "Trees of each of its forests", bounds=(1, 1000))


@dataclass(frozen=True, eq=False)
class Scenes:
    """The scenes of the repository by name."""

    scenes: Mapping[str, SceneConfig]

    @property
    def sha256(self) -> str:
        """Hash of all."""
        return hashlib.sha256(" ".join(scene.sha256() for scene in self.scenes.values()).encode()).hexdigest()

    def changed(self, variant: Variant) -> SceneConfig:
        """Return the scene of a variant."""
        scene, changes = self.scenes[variant.values["scene"]], variant.values["changes"]
        return scene.updated(changes) if changes else scene


def _prepare(_settings: SimulationSettings, source: Path | None, _out: Path) -> Path:
    """Return the folder of the scenes, which must be there."""
    folder = source or _FOLDER
    for name in (RIGID, SOFT, EVERYTHING):
        if not (folder / f"{name}.yaml").is_file():
            raise ConfigError(
                f"--data: {folder}: holds no {name}.yaml; give the folder config/scenes of the repository"
            )
    return folder


def _load(_settings: SimulationSettings, path: Path) -> Scenes:
    return Scenes({name: load_scene(path / f"{name}.yaml") for name in (RIGID, SOFT, EVERYTHING)})


def _accuracy(skill: str, settings: SimulationSettings, data: Scenes) -> dict[str, Row]:
    """Return all variants of the scene that the column names, against the first of them."""
    kind, _, name = skill.partition("_")
    variants = [variant for variant in VARIANTS if variant.values["scene"] == name]
    result: dict[str, Row] = {}
    if kind == "digits":
        best = _drops(data.changed(variants[0]), settings.compared)
        for variant in variants[1:]:
            mine = _drops(data.changed(variant), settings.compared)
            misses = [np.linalg.norm(mine[k] - best[k]) / np.linalg.norm(best[k]) for k in mine.keys() & best.keys()]
            digits, least = (-float(np.log10(miss)) for miss in (np.median(misses), max(misses)))
            result[variant.name] = {skill: digits, f"{skill}_low": least, f"{skill}_high": digits}
        return result
    finest = _samples(data.changed(variants[0]), 2 * settings.train)
    test, mean = finest[settings.train :], labels_of(finest[: settings.train]).mean(axis=0)
    names = [sample.id for sample in test]  # each grasp counts alone
    for variant in variants:
        train = _samples(data.changed(variant), settings.train)
        predictor = ContactPredictor(train, labels_of(train), ContactTrainingConfig(trees=settings.trees))
        errors = ObjectErrors.of_predictions(names, predictor.predict(test), labels_of(test), mean, BIOTAC)
        result[variant.name] = interval_columns(skill, skills(errors, settings.bootstrap)[MEAN])
    return result


def _drops(scene: SceneConfig, count: int) -> dict[int, Float64]:
    """Return (2, 24) drops of the electrodes of both fingers before sensor effects [counts], by slot; leave out the samples that fail."""
    drops = {}
    for key, state in Engine(scene, EFFECTS).first_tries(count):
        rest, pressed = state.readings
        drops[key.slot] = (rest - pressed)[:, 1:]
    return drops


def _samples(scene: SceneConfig, count: int) -> list[Sample]:
    return list(Simulation(scene).samples(count))


def _timed(variant: Variant, _settings: SimulationSettings, data: Scenes) -> Timed:
    """Return what simulates the first grasps that do not fail, one after the other."""
    engine = Engine(data.changed(variant), EFFECTS)
    keys = cycle([key for key, _ in engine.first_tries(2 * _TIMED)][:_TIMED])
    return lambda _: engine.run(next(keys)), 1.0


def _panels() -> Iterator[Panel]:
    for scene, objects in ((RIGID, "Rigid objects"), (SOFT, "Deformable objects")):
        pattern = f"{objects}: correct digits of the electrodes' pattern"
        yield Panel(f"digits_{scene}", 1, pattern, "correct decimal digits")
        yield Panel(f"trained_{scene}", 1, f"{objects}: skill of a model trained on it, on the finest level")
    effects = "Effects left out: skill of a model trained without, with all effects"
    yield Panel(f"trained_{EVERYTHING}", 1, effects)


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_simulation",
    question="How exact must the simulator be, and what does a sample cost?",
    module=__name__,
    settings=SimulationSettings,
    presets={
        "smoke": {"skills": [f"digits_{RIGID}"], "compared": 2, "train": 10, "trees": 2, "timing_s": 2.0},
        "small": {"compared": 16, "train": 60, "trees": 10, "timing_s": 25.0},
        "full": {"timing_s": 120.0},
    },
    prepare=_prepare,
    load=_load,
    variants=VARIANTS,
    timed=_timed,
    panels=tuple(_panels()),
)

# SPDX-License-Identifier: Apache-2.0
"""Area `simulation`: level of contact, grid and effects of the simulator against the time of a sample.

pattern      error of the drops of 24 electrodes against the finest layer, ‖drop - finest‖ / ‖finest‖, median
force        error of the forces of both fingers against those of the finest layer, median
counts       root mean square change of the readings when an effect is left out of the scene
trained      skill, on the finest level and with all effects, of a contact model that is trained on the variant
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, SimulationError
from foretouch.tactile import BIOTAC
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Row
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, Timed, TradeoffSettings, Variant, variant_cells
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.metrics import MEAN, BootstrapConfig, ObjectErrors, compare, skills
from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.simulate import Simulation
from foretouch_lab.simulation.world import SampleKey

RIGID: Final = "rigid"
SOFT: Final = "deformables"
EVERYTHING: Final = "everything"
SCENES: Final = (RIGID, SOFT, EVERYTHING)

_FOLDER: Final = Path("config/scenes")
_TIMED: Final = 16  # samples that are timed in turn
_ERRORS: Final = ("pattern_error", "pattern_error_largest", "force_error", "counts")
_BOOTSTRAP: Final = BootstrapConfig(draws=500)

_LEVELS: Final = (
    ("winkler", 12),
    ("winkler", 24),
    ("layer", 8),
    ("layer", 12),
    ("layer", 16),
    ("layer", 24),
    ("layer", 32),
)

# Effects by name, with the setting of the scene whose absence switches each off; the first six are of the camera.
_EFFECTS: Final = {
    "clutter": "clutter",
    "flying_pixels": "camera.flying_pixels",
    "depth_noise": "camera.noise",
    "stereo_shadow": "camera.stereo",
    "holes": "camera.holes",
    "depth_steps": "camera.z_step_m",
    "execution_error": "grasps.error",
    "weight": "gravity",
    "creep": "fingers.creep",
    "slip": "fingers.slip",
    "drift": "fingers.drift",
    "noise": "fingers.noise",
    "scan_hold": "fingers.scan",
}

# Changes of all variants of a scene: no training accepts readings with a dead electrode.
_ALWAYS: Final = {RIGID: {}, SOFT: {}, EVERYTHING: {"fingers.dead": None}}


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(TradeoffSettings):
    """Settings of the area."""

    compared: int = setting(60, "Grasps whose readings are compared", bounds=(2, 10_000))
    train: int = setting(
        160, "Grasps that a model is trained on, and as many that it is tested on", bounds=(10, 10_000)
    )
    trees: int = setting(30, "Trees of each of its forests", bounds=(1, 1000))
    finest_cells: int = setting(64, "Cells a side of the finest layer", bounds=(16, 256))


@dataclass(frozen=True, eq=False)
class Scenes:
    """The scenes of the repository."""

    scenes: Mapping[str, SceneConfig]

    @property
    def sha256(self) -> str:
        """Hash of all."""
        return hashlib.sha256(" ".join(one.sha256() for one in self.scenes.values()).encode()).hexdigest()

    def changed(self, values: Mapping[str, Any]) -> SceneConfig:
        """The scene of a variant."""
        scene = self.scenes[values["scene"]]
        return scene.updated(values["changes"]) if values["changes"] else scene


def _prepare(_settings: SimulationSettings, source: Path | None, _out: Path) -> Path:
    """The folder of the scenes, which must be there."""
    folder = source or _FOLDER
    for name in SCENES:
        if not (folder / f"{name}.yaml").is_file():
            raise ConfigError(
                f"--data: {folder}: holds no {name}.yaml; give the folder config/scenes of the repository"
            )
    return folder


def _load(_settings: SimulationSettings, path: Path) -> Scenes:
    return Scenes({name: load_scene(path / f"{name}.yaml") for name in SCENES})


def _shipped(scene: str) -> str:
    return f"{scene} as shipped"


def _finest(scene: str) -> str:
    """Name of the variant that simulates a scene at the finest level; scenes of effects have no other level."""
    return _shipped(scene) if scene == EVERYTHING else f"{scene}: finest layer"


def _variants(settings: SimulationSettings) -> Iterator[Variant]:
    def variant(name: str, factor: str, scene: str, changes: Mapping[str, Any]) -> Variant:
        return Variant(name, factor, {"scene": scene, "changes": {**_ALWAYS[scene], **changes}})

    for scene in (RIGID, SOFT):
        yield variant(_shipped(scene), "shipped", scene, {})
        finest = {"fidelity": "layer", "fingers.pad.cells": settings.finest_cells}
        yield variant(_finest(scene), "reference", scene, finest)
        for name, cells in _LEVELS:
            changes = {"fidelity": name, "fingers.pad.cells": cells}
            yield variant(f"{scene}: {name} {cells}x{cells}", name, scene, changes)
    yield variant(_shipped(EVERYTHING), "shipped", EVERYTHING, {})
    for number, (name, field) in enumerate(_EFFECTS.items()):
        yield variant(f"without {name}", "camera" if number < 6 else "hand and sensor", EVERYTHING, {field: None})


@lru_cache(maxsize=8)
def _touched(scene: SceneConfig, count: int) -> dict[int, tuple[Float64, Float64, Float64]]:
    """By slot, what its first try reads; those that fail are left out.

    (2, 24) drops of the electrodes of both fingers before sensor effects [counts], their (2,) forces [N], and (50,) whole
    readings [counts].
    """
    engine = Engine(scene, EFFECTS)
    found = {}
    for slot in range(count):
        try:
            state = engine.run(SampleKey(scene.seed, slot))
        except SimulationError:
            continue
        rest, pressed = state.readings
        forces = np.array([contact.force_n for contact in state.contacts])
        found[slot] = ((rest - pressed)[:, 1:], forces, state.touch.values)
    return found


def _run(cell: Cell, settings: SimulationSettings, data: Scenes) -> list[Row]:
    """The row of a variant."""
    name, scene = cell.values["scene"], data.changed(cell.values)
    best = data.changed(next(one.values for one in _variants(settings) if one.name == _finest(name)))
    mine, others = _touched(scene, settings.compared), _touched(best, settings.compared)
    both = [(mine[k], others[k]) for k in sorted(mine.keys() & others.keys())]
    row: Row = {**dict.fromkeys(_ERRORS), "refused": settings.compared - len(mine)}
    if name == EVERYTHING:
        row["counts"] = float(np.sqrt(np.mean([(one[2] - other[2]) ** 2 for one, other in both])))
    else:
        drops, forces = (
            [float(np.linalg.norm(one[k] - other[k]) / np.linalg.norm(other[k])) for one, other in both] for k in (0, 1)
        )
        row |= {
            "pattern_error": float(np.median(drops)),
            "pattern_error_largest": float(max(drops)),
            "force_error": float(np.median(forces)),
        }
    errors, best_errors = _errors(scene, best, settings), _errors(best, best, settings)
    row |= interval_columns(f"trained_{name}", skills(errors, _BOOTSTRAP)[MEAN])
    return [row | interval_columns("trained_change", compare(errors, best_errors, _BOOTSTRAP)[MEAN])]


@lru_cache(maxsize=4)
def _samples(scene: SceneConfig, count: int) -> list[GraspSample]:
    return list(Simulation(scene).samples(count))


@lru_cache(maxsize=4)
def _errors(scene: SceneConfig, best: SceneConfig, settings: SimulationSettings) -> ObjectErrors:
    """Of a model that is trained on a scene and tested on later grasps of the finest one; each grasp counts alone."""
    finest = _samples(best, 2 * settings.train)
    train = finest[: settings.train] if scene == best else _samples(scene, settings.train)
    test, mean = finest[settings.train :], labels_of(finest[: settings.train]).mean(axis=0)
    predictor = ContactPredictor(train, labels_of(train), ContactTrainingConfig(trees=settings.trees))
    return ObjectErrors.of_predictions(
        np.array([one.id for one in test]), predictor.predict(test), labels_of(test), mean, BIOTAC
    )


def _tabulate(_settings: SimulationSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant; the skill of a pattern is its number of correct decimal digits."""
    result = []
    for row in rows:
        found: Row = {"variant": row["variant"]}
        for name in (RIGID, SOFT):
            own = row["scene"] == name and row["pattern_error"]
            digits, least = (
                -float(np.log10(row[key])) if own else None for key in ("pattern_error", "pattern_error_largest")
            )
            found |= {f"digits_{name}": digits, f"digits_{name}_low": least, f"digits_{name}_high": digits}
        for name in (*(f"trained_{scene}" for scene in SCENES), "trained_change"):
            found |= {f"{name}{end}": row.get(f"{name}{end}") for end in ("", "_low", "_high")}
        result.append(found | {name: row[name] for name in (*_ERRORS, "refused")})
    return result


def _timed(variant: Variant, _settings: SimulationSettings, data: Scenes) -> Timed:
    """See `Area.timed`: simulates the first grasps that do not fail, one after the other."""
    scene = data.changed(variant.values)
    engine = Engine(scene, EFFECTS)
    kept = []
    for slot in range(2 * _TIMED):
        try:
            engine.run(SampleKey(scene.seed, slot))
        except SimulationError:
            continue
        kept.append(SampleKey(scene.seed, slot))
    keys = cycle(kept[:_TIMED])
    return lambda _: engine.run(next(keys)), 1.0


EXPERIMENT = Area(
    name="tradeoff_simulation",
    question="How exact must the simulator be, and what does a sample cost?",
    module=__name__,
    settings=SimulationSettings,
    presets={
        "small": {"compared": 16, "train": 60, "trees": 10, "finest_cells": 48, "timing_s": 25.0},
        "full": {"timing_s": 120.0},
    },
    prepare=_prepare,
    load=_load,
    cells=variant_cells(_variants),
    run=_run,
    tabulate=_tabulate,
    variants=_variants,
    timed=_timed,
    skills={
        **{f"digits_{name}": "correct decimal digits" for name in (RIGID, SOFT)},
        **{f"trained_{name}": "mean skill, 95 % interval" for name in SCENES},
    },
    panels=(
        Panel("digits_rigid", 1, "Rigid objects: correct digits of the electrodes' pattern"),
        Panel("digits_deformables", 1, "Deformable objects: correct digits of the electrodes' pattern"),
        Panel("trained_rigid", 1, "Rigid objects: skill of a model trained on it, on the finest level"),
        Panel("trained_deformables", 1, "Deformable objects: skill of a model trained on it, on the finest level"),
        Panel("trained_everything", 1, "Effects left out: skill of a model trained without, with all effects"),
    ),
)

# SPDX-License-Identifier: Apache-2.0
"""What a level of contact or an effect changes in simulated touch, and in a model that is trained on it.

pattern      error of the drops of 24 electrodes against the finest layer, ‖drop - finest‖ / ‖finest‖, median
force        error of the forces of both fingers against those of the finest layer, median
counts       root mean square change of the readings when an effect is left out of the scene
trained      skill, on the finest level and with all effects, of a contact model that is trained on the variant
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError, SimulationError
from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.learning.data import labels_of
from foretouch.learning.evaluation.metrics import MEAN, BootstrapConfig, ObjectErrors, compare, skills
from foretouch.learning.training.contact import ContactConfig, ContactPredictor
from foretouch.simulation.effects import EFFECTS
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import SceneConfig, load_scene
from foretouch.simulation.simulate import SAMPLE_KEYS, Simulation
from foretouch.simulation.world import SampleKey
from foretouch.tradeoff.area import Answer, Timed, TradeoffSettings, Variant
from foretouch.tradeoff.areas.simulation.variants import EVERYTHING, RIGID, SCENES, SOFT, finest, list_variants
from foretouch.types import Float64, GraspSample

DEFAULT_SCENES: Final = Path("config/scenes")

_SECONDS: Final = {RIGID: 0.02, SOFT: 0.03, EVERYTHING: 0.03}  # of a sample, without its contact
_FIT_S: Final = 0.03  # of a fit, for each training sample
_TIMED: Final = 16  # samples that are timed in turn


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(TradeoffSettings):
    """Settings of the area `simulation`."""

    compared: int = setting(60, "Grasps whose readings are compared", minimum=2, maximum=10_000)
    train: int = setting(160, "Grasps that a model is trained on", minimum=10, maximum=10_000)
    test: int = setting(160, "Other grasps that it is tested on", minimum=10, maximum=10_000)
    trees: int = setting(30, "Trees of each of its forests", minimum=1, maximum=1000)
    finest_cells: int = setting(64, "Cells a side of the finest layer", minimum=16, maximum=256)
    detail: str = setting("all", "few: the main levels and depth effects; all", choices=("few", "all"))


@dataclass(frozen=True, eq=False)
class Scenes:
    """The scenes of the repository."""

    scenes: Mapping[str, SceneConfig]

    @property
    def sha256(self) -> str:
        """Hash of all."""
        return hashlib.sha256(" ".join(one.sha256() for one in self.scenes.values()).encode()).hexdigest()


def prepare(settings: SimulationSettings, source: Path | None, out: Path) -> Path:
    """The folder of the scenes.

    Raises:
        ConfigError: If one of them is not there.
    """
    del settings, out
    folder = DEFAULT_SCENES if source is None else source
    for name in SCENES:
        if not (folder / f"{name}.yaml").is_file():
            raise ConfigError(
                f"--data: {folder}: holds no {name}.yaml; give the folder config/scenes of the repository"
            )
    return folder


def load(settings: SimulationSettings, path: Path) -> Scenes:
    """Read the scenes."""
    del settings
    return Scenes({name: load_scene(path / f"{name}.yaml") for name in SCENES})


def changed_scene(values: Mapping[str, Any], data: Scenes) -> SceneConfig:
    """The scene of a variant."""
    return (
        data.scenes[values["scene"]].updated(values["changes"]) if values["changes"] else data.scenes[values["scene"]]
    )


@dataclass(frozen=True, eq=False)
class Touched:
    """What the first tries of the first slots read."""

    drops: Mapping[int, Float64]  # (2, 24) by slot, of the electrodes of both fingers before sensor effects [counts]
    forces: Mapping[int, Float64]  # (2,) by slot [N]
    counts: Mapping[int, Float64]  # (50,) by slot, whole readings [counts]
    seconds: Mapping[str, float]  # of a call, by effect


@lru_cache(maxsize=8)
def touched(scene: SceneConfig, count: int) -> Touched:
    """Simulate grasps; those that fail are left out."""
    engine = Engine(scene, EFFECTS, ("readings", "contacts", "touch"))
    drops, forces, counts = {}, {}, {}
    for slot in range(count):
        try:
            state = engine.run(SampleKey(scene.seed, slot))
        except SimulationError:
            continue
        rest, pressed = state.readings
        drops[slot] = (rest - pressed)[:, 1:]
        forces[slot] = np.array([contact.force_n for contact in state.contacts])
        counts[slot] = state.touch.vector()
    seconds = {name: timing.seconds / max(timing.calls, 1) for name, timing in engine.timings.items()}
    return Touched(drops, forces, counts, seconds)


def cells(settings: SimulationSettings, data: Scenes) -> list[Cell]:
    """A cell for each variant."""
    del data
    variants = list_variants(settings.detail, settings.finest_cells)
    return [Cell(f"{number:03}", {"variant": one.name, **one.values}) for number, one in enumerate(variants)]


def run(cell: Cell, settings: SimulationSettings, data: Scenes) -> list[Row]:
    """The row of a variant."""
    name, scene = cell.values["scene"], changed_scene(cell.values, data)
    best = changed_scene(_finest_values(name, settings), data)
    row: Row = dict.fromkeys(("pattern_error", "pattern_error_largest", "force_error", "counts", "counts_largest"))
    mine, others = touched(scene, settings.compared), touched(best, settings.compared)
    both = sorted(mine.counts.keys() & others.counts.keys())
    row["refused"] = settings.compared - len(mine.counts)
    if name == EVERYTHING:
        change = np.array([mine.counts[k] - others.counts[k] for k in both])
        row |= {"counts": float(np.sqrt(np.mean(change**2))), "counts_largest": float(np.abs(change).max())}
        row["effect_ms"] = 1e3 * others.seconds[cell.values["effect"]] if cell.values["effect"] else None
    else:
        drops = [np.linalg.norm(mine.drops[k] - others.drops[k]) / np.linalg.norm(others.drops[k]) for k in both]
        forces = [np.linalg.norm(mine.forces[k] - others.forces[k]) / np.linalg.norm(others.forces[k]) for k in both]
        row |= {"pattern_error": float(np.median(drops)), "pattern_error_largest": float(max(drops))}
        row |= {"force_error": float(np.median(forces)), "effect_ms": None}
    return [row | _trained(name, scene, best, settings)]


def _finest_values(name: str, settings: SimulationSettings) -> Mapping[str, Any]:
    variants = list_variants(settings.detail, settings.finest_cells)
    return next(one.values for one in variants if one.name == finest(name))


@lru_cache(maxsize=4)
def _samples(scene: SceneConfig, count: int) -> list[GraspSample]:
    return list(Simulation(scene).samples(count))


@lru_cache(maxsize=4)
def _errors(scene: SceneConfig, best: SceneConfig, settings: SimulationSettings) -> ObjectErrors:
    """Of a model that is trained on a scene and tested on later grasps of the finest one; each grasp counts alone."""
    finest_samples = _samples(best, settings.train + settings.test)
    train = finest_samples[: settings.train] if scene == best else _samples(scene, settings.train)
    test, mean = finest_samples[settings.train :], labels_of(finest_samples[: settings.train]).mean(axis=0)
    predictor = ContactPredictor(train, labels_of(train), ContactConfig(trees=settings.trees))
    labels, predicted = labels_of(test), predictor.predict(test)
    squared, reference = (predicted - labels) ** 2, (mean - labels) ** 2
    rows = zip(test, squared, reference, strict=True)
    return ObjectErrors.total([(sample.id, 1.0, own, other) for sample, own, other in rows])


def _trained(name: str, scene: SceneConfig, best: SceneConfig, settings: SimulationSettings) -> Row:
    errors, others = _errors(scene, best, settings), _errors(best, best, settings)
    bootstrap = BootstrapConfig(draws=500)
    found = skills(errors, bootstrap)[MEAN]
    lost = compare(errors, others, bootstrap)[MEAN]
    return {
        f"trained_{name}": found.value,
        f"trained_{name}_low": found.low,
        f"trained_{name}_high": found.high,
        "trained_change": lost.value,
        "trained_change_low": lost.low,
        "trained_change_high": lost.high,
    }


def tabulate(settings: SimulationSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant; the skill of a pattern is its number of correct decimal digits."""
    del settings
    return [_row(row) for row in rows]


def _row(row: Row) -> Row:
    found: Row = {"variant": row["variant"]}
    for name in (RIGID, SOFT):
        error = row["pattern_error"] if row["scene"] == name else None
        found[f"digits_{name}"] = -float(np.log10(error)) if error else None
        largest = row["pattern_error_largest"]
        found[f"digits_{name}_low"] = -float(np.log10(largest)) if error else None
        found[f"digits_{name}_high"] = found[f"digits_{name}"]
    for name in SCENES:
        found |= {f"trained_{name}{end}": row.get(f"trained_{name}{end}") for end in ("", "_low", "_high")}
    found |= {f"trained_change{end}": row[f"trained_change{end}"] for end in ("", "_low", "_high")}
    names = (
        "pattern_error",
        "pattern_error_largest",
        "force_error",
        "counts",
        "counts_largest",
        "effect_ms",
        "refused",
    )
    found |= {name: row[name] for name in names}
    return {key: float(f"{value:.5g}") if isinstance(value, float) else value for key, value in found.items()}


def seconds(settings: SimulationSettings, data: Scenes, left: Sequence[Cell]) -> float:
    """About as long as cells took on the machine where their times were measured once."""
    del data
    total = 0.0
    for cell in left:
        layer = (cell.values["changes"].get("fingers.pad.cells", 24) / 300.0) ** 2
        simulated = settings.compared + settings.train
        total += simulated * (_SECONDS[cell.values["scene"]] + layer) + settings.train * _FIT_S
    return total + 2 * (settings.compared + settings.train + settings.test) * 0.1


def timed(variant: Variant, settings: SimulationSettings, data: Scenes) -> Timed:
    """See `Area.timed`: simulates one grasp after the other; answers are (50,) counts."""
    del settings
    scene = changed_scene(variant.values, data)
    engine = Engine(scene, EFFECTS, SAMPLE_KEYS)
    keys = _in_turn(scene, engine)

    def answer(request: int) -> Answer:
        del request
        return np.asarray(engine.run(next(keys)).touch.vector())

    return Timed(answer)


def _in_turn(scene: SceneConfig, engine: Engine) -> Iterator[SampleKey]:
    """The first grasps that do not fail, again and again."""
    kept = []
    for slot in range(2 * _TIMED):
        key = SampleKey(scene.seed, slot)
        try:
            engine.run(key)
        except SimulationError:
            continue
        kept.append(key)
        if len(kept) == _TIMED:
            break
    while True:
        yield from kept

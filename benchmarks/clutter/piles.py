# SPDX-License-Identifier: Apache-2.0
"""Piles of objects that touch, lean and stack, at rest by physics, seen by the simulated D415: labelled clouds.

The same seed gives the same piles on one machine.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.clutter.models import Model, catalogue, write_mesh
from benchmarks.clutter.physics import Pile, Placed, settle
from benchmarks.common import scene
from foretouch.types import Bool, Float32, Float64, Int32
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT
from foretouch_lab.simulation.effects.view import FRAME_EFFECTS
from foretouch_lab.simulation.engine import Effect, Engine
from foretouch_lab.simulation.solids import LYING, Body, about_z
from foretouch_lab.simulation.world import SampleKey

_ATTEMPTS: Final = 200  # at one pile
_REACH_M: Final = 0.30  # of a pile around the middle of the table
_FEWEST_PX: Final = 300  # of an object that can be seen: about 6 cm²
_DEEPEST_M: Final = 1.5e-3  # that two bodies may be within each other
_FRICTION: Final = 0.5
_ROUGH: Final = 0.8  # friction of what leans and stacks
_GAP_M: Final = 0.004  # between objects that are released
_SLENDER: Final = ("packet", "carton", "tube", "bottle", "CrackerBox", "Banana", "Scissors")  # these lean
_POSES, _VIEWS = 8, 2  # of an object alone

Rng = np.random.Generator
Models = dict[str, Model]
Shapes = dict[str, str]  # of the simulator, by name of a model


@dataclass(frozen=True, eq=False)
class Scene:
    """A labelled cloud of a pile."""

    xyz: Float32  # (H, W, 3) float32, camera frame [m], NaN where there is no depth
    labels: Int32  # (H, W) int32, 1 and up for the objects of the pile in order, 0 for everything else; exact
    kind: str  # touching, leaning, stacked, cluttered or single
    names: tuple[str, ...]  # of the objects


def _drawn(models: Models, rng: Rng, *, flat: bool = False) -> Model:
    """One of all models, or of those that others can stand on, in a random size."""
    chosen = [model for model in models.values() if model.flat or not flat]
    return chosen[rng.integers(len(chosen))].scaled(rng.uniform(0.85, 1.15))


def _standing(model: Model, place: Float64, rng: Rng, lift: float = 0.001) -> Placed:
    """Upright, turned about the vertical, its foot a little above a place (3,)."""
    middle = place + np.array([0.0, 0.0, model.size[2] / 2.0 + lift])
    return Placed(model, middle, about_z(rng.uniform(0.0, 2.0 * np.pi)))


def _round(rng: Rng, models: list[Model]) -> list[Float64]:
    """Places around the middle, so far out that the objects, turned in any way, are apart."""
    radii = [float(np.linalg.norm(model.size[:2])) / 2.0 for model in models]
    far = max(radii) if len(models) == 2 else max(radii) / np.sin(np.pi / len(models))
    angle = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(len(models)) / len(models)
    return [(far + _GAP_M) * np.array([np.cos(one), np.sin(one), 0.0]) for one in angle]


def _touching(models: Models, rng: Rng) -> Pile:
    chosen = [_drawn(models, rng) for _ in range(rng.integers(2, 5))]
    start = [_standing(model, place, rng) for model, place in zip(chosen, _round(rng, chosen), strict=True)]
    return settle(start, _FRICTION, pulled=True)


def _leaning(models: Models, rng: Rng) -> Pile:
    """A slender object falls against a stout one."""
    support = _standing(_drawn(models, rng, flat=True), np.zeros(3), rng)
    model = _drawn({name: models[name] for name in _SLENDER if name in models}, rng)
    tilt = np.radians(rng.uniform(12.0, 40.0))
    turn = about_z(rng.uniform(0.0, 2.0 * np.pi))
    sine, cosine = np.sin(tilt), np.cos(tilt)
    over = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])  # its top towards -x
    half = np.abs(over) @ model.size / 2.0
    away = float(np.linalg.norm(support.model.size[:2])) / 2.0 + half[0] + _GAP_M
    place, rotation = np.array([away, 0.0, half[2] + 0.001]), over @ about_z(np.pi / 2.0 * rng.integers(4))
    return settle([support, Placed(model, turn @ place, turn @ rotation)], _ROUGH)


def _stacked(models: Models, rng: Rng) -> Pile:
    start, top = [], 0.0
    for level in range(rng.integers(2, 4)):
        model = _drawn(models, rng, flat=True) if level == 0 or rng.random() < 0.5 else _drawn(models, rng)
        place = np.append(rng.uniform(-0.015, 0.015, 2) if level else (0.0, 0.0), top)
        start.append(_standing(model, place, rng, 0.001 * (level + 1)))
        top = start[-1].position[2] + model.size[2] / 2.0
    return settle(start, _ROUGH)


def _cluttered(models: Models, rng: Rng) -> Pile:
    start, low = [], 0.0
    for _ in range(rng.integers(5, 11)):
        model = _drawn(models, rng)
        upright = rng.random() < 0.5
        rotation = about_z(rng.uniform(0.0, 2.0 * np.pi)) @ (np.eye(3) if upright else LYING)
        reach = float(np.linalg.norm(model.size)) / 2.0
        place = np.append(rng.uniform(-0.10, 0.10, 2), low + reach)
        low += 1.2 * reach
        start.append(Placed(model, place, rotation))
    return settle(start, _FRICTION, pulled=True)


def _connected(touching: Bool, count: int) -> int:
    """The most objects that touch each other, directly or through others; the table, the last, joins none."""
    from scipy.sparse.csgraph import connected_components

    _, part = connected_components(touching[:count, :count], directed=False)
    return int(np.bincount(part).max())


def _is_touching(pile: Pile) -> bool:
    return _connected(pile.touching, len(pile.objects)) == len(pile.objects)


def _is_leaning(pile: Pile) -> bool:
    """All touch, and one is neither upright nor flat."""
    tilts = [np.degrees(np.arccos(min(1.0, np.abs(object_.rotation[2]).max()))) for object_ in pile.objects]
    return _is_touching(pile) and max(tilts) > 8.0


def _is_stacked(pile: Pile) -> bool:
    return _is_touching(pile) and not pile.touching[-1, :-1].all()


def _is_cluttered(pile: Pile) -> bool:
    return 2 * _connected(pile.touching, len(pile.objects)) >= len(pile.objects)


KINDS: Final[dict[str, tuple[Callable[[Models, Rng], Pile], Callable[[Pile], bool]]]] = {
    "touching": (_touching, _is_touching),
    "leaning": (_leaning, _is_leaning),
    "stacked": (_stacked, _is_stacked),
    "cluttered": (_cluttered, _is_cluttered),
}


def resting(models: Models, seed: int, number: int) -> Iterator[tuple[Pile, Rng, int]]:
    """Attempts at a pile whose kind is that of its number: those that come to rest, their generator and the number of the attempt."""
    build, holds = list(KINDS.values())[number % len(KINDS)]
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, number, attempt])
        pile = build(models, rng)
        if at_rest(pile) and holds(pile):
            yield pile, rng, attempt


def make(models: Models, shapes: Shapes, seed: int, number: int) -> Scene:
    """One pile; its kind is that of its number.

    Raises:
        RuntimeError: If no attempt gives one.
    """
    kind = list(KINDS)[number % len(KINDS)]
    for pile, rng, attempt in resting(models, seed, number):
        view = float(rng.uniform(25.0, 55.0)), float(rng.uniform(0.75, 1.1))
        seen = look(pile, shapes, kind, view, SampleKey(seed, number, attempt))
        if visible(seen):
            return seen
    raise RuntimeError(f"pile {number} ({kind}): none in {_ATTEMPTS} attempts")


def singles(models: Models, shapes: Shapes, seed: int) -> Iterator[Scene]:
    """Each object alone in eight poses, the even ones upright, each seen obliquely and from above.

    Raises:
        RuntimeError: If no attempt at a pose gives one.
    """
    for number, (name, pose) in enumerate(product(models, range(_POSES))):
        pile, rng = alone(models[name], seed, number, upright=pose % 2 == 0)
        for k, tilt in enumerate((float(rng.uniform(25.0, 55.0)), 0.0)):
            yield look(pile, shapes, "single", (tilt, float(rng.uniform(0.75, 1.1))), SampleKey(seed, number, k))


def alone(model: Model, seed: int, number: int, *, upright: bool) -> tuple[Pile, Rng]:
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, number, attempt])
        if upright:
            start = _standing(model, np.zeros(3), rng)
        else:
            turn = Rotation.random(random_state=rng).as_matrix()
            start = Placed(model, np.array([0.0, 0.0, float(np.linalg.norm(model.size)) / 2.0]), turn)
        pile = settle([start], _FRICTION)
        if at_rest(pile):
            return pile, rng
    raise RuntimeError(f"{model.name}: does not come to rest in {_ATTEMPTS} attempts")


def at_rest(pile: Pile) -> bool:
    """Whether nothing moves, fell away or is within something else."""
    places = np.array([object_.position for object_ in pile.objects])
    near = np.linalg.norm(places[:, :2], axis=1).max() < _REACH_M
    return bool(pile.still and near and pile.deepest_m < _DEEPEST_M)


def visible(seen: Scene) -> bool:
    """Whether enough of each object is seen, and nothing is cut off by the edge of the image."""
    depth = np.isfinite(seen.xyz[..., 2])
    inside = not seen.labels[[0, -1]].any() and not seen.labels[:, [0, -1]].any()
    sizes = np.bincount(seen.labels[depth], minlength=len(seen.names) + 1)[1:]
    return bool(inside and sizes.min() >= _FEWEST_PX)


def look(
    pile: Pile, shapes: Shapes, kind: str, view: tuple[float, float], key: SampleKey, room: Sequence[Body] = ()
) -> Scene:
    """The pile through the camera of config/scenes/rigid.yaml and its faults.

    Args:
        pile: What it sees.
        shapes: Of the simulator, by name of a model.
        kind: Of the scene.
        view: Angle between its axis and the vertical [deg], and its distance from the middle of the table [m].
        key: Decides the noise.
        room: What is in view besides, and has no label.
    """
    tilt, distance = view
    settings = scene("rigid", objects=[{"name": "pile"}], camera__tilt_deg=tilt, camera__distance_m=distance)
    bodies = [
        Body(shapes[object_.model.name], 0, object_.model.size, object_.position, object_.rotation)
        for object_ in pile.objects
    ]

    def place(_job: Any, state: Any) -> None:
        state.bodies = [*bodies, *room]

    effects = (Effect("pile", place, "objects"), *FRAME_EFFECTS)
    engine = Engine(settings, effects)
    state = engine.run(key)
    depth = np.where(np.isfinite(state.depth), state.depth, np.nan)
    xyz = (engine.world.rays * depth[..., None]) @ engine.world.view.R_world_camera
    labels = np.maximum(state.labels - (FIRST_OBJECT - 1), 0).astype(np.int32)
    labels[labels > len(bodies)] = 0
    return Scene(xyz.astype(np.float32), labels, kind, tuple(object_.model.name for object_ in pile.objects))


def save(seen: Scene, path: Path) -> None:
    """Write a scene as .npz."""
    np.savez_compressed(path, xyz=seen.xyz, labels=seen.labels, kind=seen.kind, names=np.array(seen.names))


def prepare(out: Path, data: Path | None) -> tuple[Models, Shapes]:
    """All objects, and the shapes of the simulator that show them; mesh files are written into `out/meshes`."""
    models = catalogue(None if data is None else Path(data) / "ycb")
    folder = out / "meshes"
    folder.mkdir(parents=True, exist_ok=True)
    return models, {name: write_mesh(model, folder) for name, model in models.items()}


def write_piles(out: Path, count: int, seed: int, data: Path | None) -> None:
    """Write piles."""
    models, shapes = prepare(out, data)
    for number in range(count):
        seen = make(models, shapes, seed, number)
        save(seen, out / f"{seen.kind}{number:03d}.npz")
        print(f"{number + 1} of {count}: {seen.kind}, {', '.join(seen.names)}", file=sys.stderr, flush=True)


def write_singles(out: Path, seed: int, data: Path | None) -> None:
    """Write objects alone."""
    for number, seen in enumerate(singles(*prepare(out, data), seed)):
        save(seen, out / f"{seen.names[0]}{number % (_POSES * _VIEWS):02d}.npz")

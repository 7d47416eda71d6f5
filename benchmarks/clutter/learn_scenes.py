# SPDX-License-Identifier: Apache-2.0
"""Simulated images to learn from (see `learn.py`): piles at rest, objects side by side, in contact, behind each other, and alone.

The objects are random (`shapes.py`), none of them one of the benchmark's. They stand on a table or a board, or lie in vessels and
bins, near and far.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from multiprocessing import Pool
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.clutter import shapes
from benchmarks.clutter.models import Model, write_mesh
from benchmarks.clutter.physics import Pile, Placed, settle
from benchmarks.clutter.piles import KINDS, Scene, alone, at_rest, look, make, resting, save, visible
from foretouch.errors import ForetouchError
from foretouch.types import Float64
from foretouch_lab.simulation.solids import Body, about_z
from foretouch_lab.simulation.world import SampleKey

_ATTEMPTS: Final = 50  # at a filled vessel

Rng = np.random.Generator


def in_piles(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A pile as those of the benchmark, or, every third time, three objects alone."""
    rng = np.random.default_rng([11, number, 7])
    makers = dict(shapes.FIXED)
    for k in range(8):
        one = shapes.DRAWN[rng.integers(len(shapes.DRAWN))]
        makers[f"{one.__name__}_{k}"] = one
    models = {name: replace(maker(rng), name=name) for name, maker in makers.items()}
    seen = {name: _mesh(model, f"11_{number}", folder) for name, model in models.items()}
    if number % 3 < 2:
        pile = make(models, seen, 11, number + 1000)
        yield f"{pile.kind}{number:04d}", pile
        return
    names = list(models)
    for k in range(3):
        name = names[8 + k] if rng.random() < 0.85 else names[rng.integers(8)]
        rested, _ = alone(models[name], 11, 1000 * number + k, upright=rng.random() < 0.5)
        tilt = 0.0 if rng.random() < 0.4 else float(rng.uniform(15.0, 60.0))
        yield f"single{number:04d}{k}", look(rested, seen, "single", (tilt, float(rng.uniform(0.75, 1.1))), SampleKey(11, number, k))  # fmt: skip


def arranged(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """Larger objects that stand side by side, on and before each other, and do not fall as nothing moves."""
    rng = np.random.default_rng([12, number])
    placed: list[Placed] = []
    under: list[Placed] = []
    want = rng.integers(1, 6)
    for _ in range(60):
        if len(placed) == want:
            break
        maker = shapes.STANDING[rng.integers(len(shapes.STANDING))]
        model = replace(maker(rng), name=f"o{len(placed)}_{maker.__name__}").scaled(rng.uniform(0.9, 1.7))
        if model.shape and rng.random() < 0.4 and model.shape == "box":
            model = replace(model, size=model.size[rng.permutation(3)])
        below = None
        if placed and rng.random() < 0.35:
            flat = [one for one in placed if one.model.flat and not any(one is other for other in under)]
            below = flat[rng.integers(len(flat))] if flat else None
        place = _place(model, below, placed, rng)
        if place is None:
            continue
        under += [below] if below is not None else []
        angle = rng.uniform(0.0, 2.0 * np.pi) if rng.random() < 0.7 else np.pi / 2.0 * rng.integers(4)
        placed.append(Placed(model, place, about_z(angle)))
    view = float(rng.uniform(30.0, 62.0)), float(rng.uniform(0.75, 1.2))
    yield f"arranged{number:04d}", _standing(placed, "arranged", view, SampleKey(12, number, 0), folder)


def _place(model: Model, below: Placed | None, placed: Sequence[Placed], rng: Rng) -> Float64 | None:
    """On another object, or where it is apart from those on the table; None if that fails."""
    if below is not None:
        aside = rng.uniform(-0.35, 0.35, 2) * np.minimum(below.model.size[:2], 0.1)
        place = below.position + np.append(aside, (below.model.size[2] + model.size[2]) / 2.0)
        return None if place[2] + model.size[2] / 2.0 > 0.45 else place
    place = np.array([*rng.uniform(-0.13, 0.13, 2), model.size[2] / 2.0])
    gap, radius = rng.choice([0.0, 0.01, 0.03]), float(np.linalg.norm(model.size[:2])) / 2.0
    for one in placed:
        near = radius + float(np.linalg.norm(one.model.size[:2])) / 2.0
        if np.linalg.norm((one.position - place)[:2]) < near * rng.uniform(0.75, 1.0) + gap and one.position[2] < one.model.size[2]:  # fmt: skip
            return None
    return place


def on_its_own(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """One of the objects that are concave, obliquely and from above."""
    rng = np.random.default_rng([13, number])
    maker = shapes.CONCAVE[number % len(shapes.CONCAVE)]
    model = replace(maker(rng), name=maker.__name__)
    seen = {model.name: _mesh(model, f"13_{number}", folder)}
    rested, _ = alone(model, 13, number, upright=rng.random() < 0.4)
    for k in range(2):
        view = (float(rng.uniform(20.0, 60.0)) if k else 0.0, float(rng.uniform(0.7, 1.15)))
        yield f"{model.name}{number:04d}{k}", look(rested, seen, "single", view, SampleKey(13, number, k))


def touching(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """Two or three objects in contact, on or beside each other; or one that is plain, or whose neck is stepped."""
    rng = np.random.default_rng([14, number])
    kind, placed = _in_contact(rng, number)
    tilt = 0.0 if len(placed) == 1 and rng.random() < 0.2 else float(rng.uniform(22.0, 60.0))
    view = tilt, float(rng.uniform(0.7, 1.15))
    yield f"{kind}{number:04d}", _standing(placed, kind, view, SampleKey(14, number, 0), folder)


def from_above(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """Objects in contact, seen from above as over a bin."""
    rng = np.random.default_rng([16, number])
    kind, placed = _in_contact(rng, number)
    view = _steep(rng), float(rng.uniform(0.6, 1.1))
    yield f"{kind}{number:04d}", _standing(placed, kind, view, SampleKey(16, number, 0), folder)


def heaped(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A pile at rest, of concave objects too, from four sides, near and far."""
    kind, pile = _heap(np.random.default_rng([17, number]), shapes.CONCAVE, 17, number)
    yield from _views(pile, kind, number, SampleKey(17, number, 0), folder, 4)


def contained(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """One to four small objects in a tray, box, bowl, pan or mug, from two sides; or the vessel alone."""
    rng = np.random.default_rng([18, number])
    for _ in range(_ATTEMPTS):
        start = _filled(rng)
        pile = settle(start, 0.5)
        if at_rest(pile):
            kind = "contained" if len(start) > 1 else "single"
            yield from _views(pile, kind, number, SampleKey(18, number, 0), folder, 2)
            return
    raise RuntimeError(f"vessel {number}: does not come to rest in {_ATTEMPTS} attempts")


def in_a_bin(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A pile at rest in a bin without a floor, some objects against its sides, obliquely and from above; the bin is one object."""
    rng = np.random.default_rng([19, number])
    _, pile = _heap(rng, (), 19, number)
    reach = [np.abs(one.position) + np.abs(one.rotation) @ one.model.size / 2.0 for one in pile.objects]
    half = np.max(reach, axis=0)[:2] + rng.uniform(0.002, 0.06, 2)
    sides = replace(shapes.bin_sides(*half, rng.uniform(0.05, 0.2)), name="bin")
    placed = Placed(sides, np.array([0.0, 0.0, sides.size[2] / 2.0]), np.eye(3))
    yield from _views(
        replace(pile, objects=(*pile.objects, placed)), "bin", number, SampleKey(19, number, 0), folder, 2
    )


def small(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A pile at rest of parts of 8 to 40 mm, mostly in a bin that is one object, near the camera, obliquely and from above."""
    rng = np.random.default_rng([20, number])
    _, large = _heap(rng, (shapes.stepped, shapes.can, shapes.box, shapes.union), 20, number)
    size = rng.uniform(0.3, 0.8)  # twice as large, and as far, as in the scene
    parts_ = tuple(replace(one, model=one.model.scaled(size), position=size * one.position) for one in large.objects)
    pile = replace(large, objects=parts_)
    if rng.random() < 0.7:
        reach = [np.abs(one.position) + np.abs(one.rotation) @ one.model.size / 2.0 for one in pile.objects]
        sides = replace(shapes.bin_sides(*np.max(reach, axis=0)[:2] + rng.uniform(0.0, 0.06, 2), rng.uniform(0.04, 0.24)), name="bin")  # fmt: skip
        pile = replace(
            pile, objects=(*pile.objects, Placed(sides, np.array([0.0, 0.0, sides.size[2] / 2.0]), np.eye(3)))
        )
    seen = {placed.model.name: _mesh(placed.model, f"20_{number}", folder) for placed in pile.objects}
    for k in range(2):
        view = float(rng.uniform(15.0, 55.0)) if k else _steep(rng), float(rng.uniform(0.64, 1.2))
        turned = _turned(pile, rng.uniform(0.0, 2.0 * np.pi))
        scene = look(turned, seen, "small", view, SampleKey(20, number, k))
        yield f"small{number:04d}{k}", replace(scene, xyz=scene.xyz * np.float32(0.5))


def raised(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A pile at rest on a board, with another board beside it or none, from two sides; boards are no objects."""
    rng = np.random.default_rng([21, number])
    kind, flat = _heap(rng, shapes.CONCAVE, 21, number)
    high = float(rng.uniform(0.004, 0.05))
    pile = replace(
        flat, objects=tuple(replace(one, position=one.position + np.array([0.0, 0.0, high])) for one in flat.objects)
    )
    seen = {placed.model.name: _mesh(placed.model, f"21_{number}", folder) for placed in pile.objects}
    for k in range(2):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        half = rng.uniform(0.16, 0.3, 2)
        boards = [Body("box", 0, np.array([*2.0 * half, high]), np.array([0.0, 0.0, high / 2.0]), np.eye(3))]
        if rng.random() < 0.5:
            low = float(rng.uniform(0.004, 0.04))
            beside = half[0] + rng.uniform(0.1, 0.2)
            boards.append(Body("box", 0, np.array([0.2, 0.4, low]), np.array([beside, 0.0, low / 2.0]), np.eye(3)))
        view = (_steep(rng) if k % 2 else float(rng.uniform(20.0, 60.0))), float(rng.uniform(0.6, 1.1))
        scene = look(_turned(pile, angle), seen, kind, view, SampleKey(21, number, k), boards)
        if visible(scene):
            yield f"{kind}{number:04d}{k}", scene


def _heap(rng: Rng, also: Sequence[Callable[[Rng], Model]], seed: int, number: int) -> tuple[str, Pile]:
    """A pile at rest of objects of all kinds and of `also`, and what kind of pile it is, by its number."""
    makers = (*also, *shapes.DRAWN, *shapes.FIXED.values(), *shapes.FIXED.values())
    models = {name: replace(maker(rng), name=name) for name, maker in shapes.FIXED.items()}
    models |= {f"o{k}": _one(rng, makers, f"o{k}").scaled(rng.uniform(0.75, 1.0)) for k in range(10)}
    kind = ("touching", "leaning", "cluttered", "stacked", "cluttered")[number % 5]
    pile, *_ = next(resting(models, seed, len(KINDS) * number + list(KINDS).index(kind)))
    return kind, pile


def _filled(rng: Rng) -> list[Placed]:
    """A vessel on the table, and what is released above it."""
    vessel = _one(rng, shapes.HOLDING, "vessel")
    inside = 0.35 * float(vessel.size[:2].min())
    foot = np.array([0.0, 0.0, vessel.size[2] / 2.0 + 0.001])
    start = [Placed(vessel, foot, about_z(rng.uniform(0.0, 2.0 * np.pi)))]
    height = vessel.size[2] + 0.01
    for k in range(rng.integers(5)):
        model = _one(rng, (*shapes.DRAWN, *shapes.FIXED.values()), f"o{k}")
        model = model.scaled(min(1.0, 1.3 * inside / model.size[:2].max() * rng.uniform(0.6, 1.3)))
        reach = float(np.linalg.norm(model.size)) / 2.0
        place = np.append(rng.uniform(-0.5, 0.5, 2) * inside, height + reach)
        start.append(Placed(model, place, Rotation.random(random_state=rng).as_matrix()))
        height += 2.0 * reach
    return start


def _views(pile: Pile, kind: str, number: int, key: SampleKey, folder: Path, count: int) -> Iterator[tuple[str, Scene]]:
    """A pile from several sides: each second time from above, and of four times the last two from near."""
    rng = np.random.default_rng([key.seed, number, 1])
    seen = {placed.model.name: _mesh(placed.model, f"{key.seed}_{number}", folder) for placed in pile.objects}
    for k in range(count):
        turned = _turned(pile, rng.uniform(0.0, 2.0 * np.pi))
        tilt = _steep(rng) if k % 2 else float(rng.uniform(20.0, 62.0))
        distance = float(rng.uniform(0.52, 0.8) if k >= 2 else rng.uniform(0.7, 1.1))
        scene = look(turned, seen, kind, (tilt, distance), SampleKey(key.seed, number, k))
        if visible(scene):
            yield f"{kind}{number:04d}{k}", scene


def _turned(pile: Pile, angle: float) -> Pile:
    """The pile, turned about the vertical through the middle of the table."""
    turn = about_z(angle)
    objects = (
        replace(placed, position=turn @ placed.position, rotation=turn @ placed.rotation) for placed in pile.objects
    )
    return replace(pile, objects=tuple(objects))


def _steep(rng: Rng) -> float:
    """An angle from the vertical [deg]."""
    return 0.0 if rng.random() < 0.4 else float(rng.uniform(0.0, 25.0))


def _in_contact(rng: Rng, number: int) -> tuple[str, list[Placed]]:
    """What the objects are called that touch, and where they are; the kind of scene is that of its number."""
    kind = ("stacked", "beside", "plain", "stacked", "bowls", "stepped", "beside", "balls")[number % 8]
    if kind in {"plain", "stepped"}:
        plain = (shapes.box, shapes.packet, shapes.can, shapes.tube, shapes.ball)
        makers = (shapes.stepped,) if kind == "stepped" else plain
        model = replace(makers[rng.integers(len(makers))](rng), name="o0").scaled(rng.uniform(0.9, 1.5))
        lying = model.shape == "box" and rng.random() < 0.4
        model = replace(model, size=model.size[rng.permutation(3)]) if lying else model
        placed = [Placed(model, np.array([0.0, 0.0, model.size[2] / 2.0]), about_z(rng.uniform(0.0, 2.0 * np.pi)))]
    else:
        placed = _stack(rng) if kind == "stacked" else _row(rng, kind)
    return "single" if len(placed) == 1 else kind, placed


def _one(rng: Rng, makers: Sequence[Callable[[Rng], Model]], name: str) -> Model:
    model = replace(makers[rng.integers(len(makers))](rng), name=name).scaled(rng.uniform(0.85, 1.3))
    return replace(model, size=model.size[rng.permutation(3)]) if model.shape == "box" and rng.random() < 0.3 else model


def _stack(rng: Rng) -> list[Placed]:
    placed: list[Placed] = []
    count, place, yaw, top = rng.integers(2, 4), np.zeros(2), rng.uniform(0.0, 2.0 * np.pi), 0.0
    for k in range(count):
        last = k == count - 1 and rng.random() < 0.7
        model = _one(rng, shapes.STANDING if last else (shapes.box, shapes.packet, shapes.can), f"o{k}")
        if k and rng.random() < 0.25:  # as those of a shelf
            model = replace(placed[-1].model, name=model.name)
        place = place + (rng.uniform(-0.015, 0.015, 2) if k else 0.0)
        yaw = yaw if rng.random() < 0.4 else rng.uniform(0.0, 2.0 * np.pi)
        placed.append(Placed(model, np.array([*place, top + model.size[2] / 2.0]), about_z(yaw)))
        top += model.size[2]
    return placed


def _row(rng: Rng, kind: str) -> list[Placed]:
    """Objects of which each touches the one before, in the direction of x, all turned together."""
    flat = (shapes.box, shapes.packet, shapes.can)
    makers = {"bowls": (shapes.vessel,), "balls": (shapes.ball,)}.get(kind, flat)
    models = [_one(rng, makers, "o0")]
    mixed = (*flat, shapes.vessel)
    models += [_one(rng, makers if rng.random() < 0.6 else mixed, f"o{k}") for k in range(1, rng.integers(2, 4))]
    turn, places = about_z(rng.uniform(0.0, 2.0 * np.pi)), [np.zeros(2)]
    for one, other in pairwise(models):
        aside = rng.uniform(-0.4, 0.4) * min(one.size[1], other.size[1])
        if rng.random() < 0.3:  # flush
            aside = (other.size[1] - one.size[1]) / 2.0
        far = (one.size[0] + other.size[0]) / 2.0
        if one.shape == other.shape == "ball":
            far = float(np.sqrt(one.size[0] * other.size[0]))
        if one.shape != "box" and other.shape != "box":
            aside = float(np.clip(aside, -0.8 * far, 0.8 * far))
            far = float(np.sqrt(far * far - aside * aside))
        places.append(places[-1] + (far + rng.uniform(0.0, 0.001), aside))
    middle = np.mean(places, axis=0)
    feet = [np.array([*(place - middle), model.size[2] / 2.0]) for model, place in zip(models, places, strict=True)]
    return [Placed(model, turn @ foot, turn) for model, foot in zip(models, feet, strict=True)]


def behind(number: int, folder: Path) -> Iterator[tuple[str, Scene]]:
    """A slender object before one that continues on both of its sides, or before two."""
    rng = np.random.default_rng([15, number])
    post = _one(rng, (shapes.tube, shapes.packet, shapes.bottle), "post").scaled(0.75)
    post = replace(post, size=np.sort(post.size)) if post.shape == "box" else post
    makers = (shapes.box, shapes.packet, shapes.can, shapes.tube)[: 4 if number % 2 else 2]
    models = [_one(rng, makers, f"o{k}") for k in range(1 + number % 2)]
    models = [_lying(rng, model) if len(models) == 1 or rng.random() < 0.5 else model for model in models]
    angle, x = rng.uniform(-0.4, 0.4), 0.0
    wide, placed = sum(model.size[0] for model in models), []
    for model in models:
        place = np.array(
            [x - wide / 2.0 + model.size[0] / 2.0, rng.uniform(0.0, 0.05) * bool(placed), model.size[2] / 2.0]
        )
        placed.append(Placed(model, about_z(angle) @ place, about_z(angle)))
        x += model.size[0] + rng.uniform(0.003, 0.03)
    near = max(float(np.linalg.norm(model.size[:2])) for model in models) / 2.0 + rng.uniform(0.02, 0.1)
    aside = rng.uniform(-0.25, 0.25) * wide
    placed.append(Placed(post, np.array([aside, -near, post.size[2] / 2.0]), about_z(rng.uniform(-0.5, 0.5))))
    view = float(rng.uniform(35.0, 62.0)), float(rng.uniform(0.7, 1.15))
    yield f"behind{number:04d}", _standing(placed, "behind", view, SampleKey(15, number, 0), folder)


def _lying(rng: Rng, model: Model) -> Model:
    """A box with its longest edge along x, and sometimes longer."""
    if model.shape != "box":
        return model
    return replace(model, size=np.roll(np.sort(model.size), 1) * (rng.uniform(1.0, 1.7), 1.0, 1.0))


def _standing(placed: Sequence[Placed], kind: str, view: tuple[float, float], key: SampleKey, folder: Path) -> Scene:
    """What a camera sees of objects that stay where they are placed."""
    seen = {one.model.name: _mesh(one.model, f"{key.seed}_{key.slot}", folder) for one in placed}
    return look(Pile(tuple(placed), np.zeros((1, 1), np.bool_), 0.0, True), seen, kind, view, key)


def _mesh(model: Model, prefix: str, folder: Path) -> str:
    return write_mesh(replace(model, name=f"{prefix}_{model.name}"), folder / "meshes")


SETS: Final[dict[str, tuple[Callable[[int, Path], Iterator[tuple[str, Scene]]], int]]] = {"arr": (arranged, 500), "sing": (on_its_own, 300), "touch": (touching, 308), "behind": (behind, 96), "train": (in_piles, 139), "above": (from_above, 171), "heap": (heaped, 458), "in": (contained, 458), "bin": (in_a_bin, 416), "small": (small, 300), "board": (raised, 300)}  # fmt: skip


def write_scenes(folder: Path, jobs: int, share: float = 1.0) -> None:
    """Write a share of each set that is not there yet."""
    for name, (_, all_) in SETS.items():
        count = round(share * all_)
        (folder / name / "meshes").mkdir(parents=True, exist_ok=True)
        done = folder / name / "done.txt"
        first = int(done.read_text(encoding="utf-8")) if done.is_file() else 0
        with Pool(jobs) as pool:
            for number, fault in enumerate(pool.imap(partial(_write, folder, name), range(first, count)), first):
                if fault:
                    print(f"{name} {number}: {fault}", file=sys.stderr)
                done.write_text(str(number + 1), encoding="utf-8")


def _write(folder: Path, name: str, number: int) -> str:
    try:
        for stem, scene in SETS[name][0](number, folder / name):
            save(scene, folder / name / f"{stem}.npz")
    except (ForetouchError, RuntimeError, ValueError) as err:  # it does not come to rest, or no physics takes its parts
        return str(err)
    return ""

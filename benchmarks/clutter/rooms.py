# SPDX-License-Identifier: Apache-2.0
"""Piles in a room: with a wall behind, near the table's edge, beside a second plane, with an arm over them, in a bin, in a vessel, and many.

What is in the room has no label, so what a method finds there is no object. The same seed gives the same rooms on one machine.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.clutter import piles
from benchmarks.clutter.models import BANDS, Model, centred, hollow
from benchmarks.clutter.physics import Pile, Placed, settle
from foretouch.types import Float64
from foretouch_lab.simulation.depth_scene import TABLE_M
from foretouch_lab.simulation.solids import Body, about_z
from foretouch_lab.simulation.world import SampleKey

_ATTEMPTS: Final = 200  # at one room
_FLOOR_M: Final = -0.75
_MANY: Final = (12, 17)  # objects of a full table
_SMALL: Final = ("ball", "block", "FoamBrick", "TennisBall")  # they fit into a vessel

Rng = np.random.Generator


def _box(low: tuple[float, float, float], high: tuple[float, float, float], turn_deg: float = 0.0) -> Body:
    """A box by its least and largest x, y, z [m], turned about the vertical through the middle of the table."""
    ends, turn = np.array([low, high]), about_z(np.radians(turn_deg))
    return Body("box", 0, ends[1] - ends[0], turn @ ends.mean(axis=0), turn)


def _bar(start: Float64, end: Float64, thick_m: float) -> Body:
    """A square bar from one point to another."""
    along = (end - start) / np.linalg.norm(end - start)
    aside = np.cross(along, (0.0, 0.0, 1.0) if abs(along[2]) < 0.9 else (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    turn = np.stack([np.cross(aside, along), aside, along], axis=1)
    return Body("box", 0, np.array([thick_m, thick_m, np.linalg.norm(end - start)]), (start + end) / 2.0, turn)


def _floor() -> Body:
    return _box((-3.0, -3.0, _FLOOR_M - 0.05), (3.0, 3.0, _FLOOR_M))


def _wall(rng: Rng, _: Pile) -> list[Body]:
    """A wall behind the table, up to 35 cm away."""
    behind = TABLE_M[1] / 2.0 + rng.uniform(0.02, 0.35)
    return [_floor(), _box((-2.0, behind, _FLOOR_M), (2.0, behind + 0.1, 1.5), rng.uniform(-12.0, 12.0))]


def _chair(rng: Rng, _: Pile) -> list[Body]:
    """The back and the seat of a chair beyond the far edge of the table."""
    middle, wide, away = rng.uniform(-0.3, 0.3), rng.uniform(0.2, 0.45), TABLE_M[1] / 2.0 + rng.uniform(0.05, 0.2)
    back = _box((middle - wide / 2, away, _FLOOR_M), (middle + wide / 2, away + 0.04, rng.uniform(0.05, 0.3)))
    return [_floor(), back, _box((middle - wide / 2, away, -0.32), (middle + wide / 2, away + 0.4, -0.28))]


def _shelf(rng: Rng, pile: Pile) -> list[Body]:
    """A second plane beside the pile, and higher than the table or lower and beyond its edge."""
    side, height = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.1, 0.25))
    if rng.random() < 0.5:
        near = _radius(pile) + 0.06
        return [_floor(), _box((min(side * near, side * 0.7), -0.3, 0.0), (max(side * near, side * 0.7), 0.5, height))]
    away = TABLE_M[1] / 2.0 + rng.uniform(0.02, 0.15)
    return [_floor(), _box((-0.8, away, _FLOOR_M), (0.8, away + 0.6, -height))]


def _arm(rng: Rng, pile: Pile) -> list[Body]:
    """A robot's arm of two links, with a gripper, that reaches in from the left, right or far side, beside or above the pile."""
    side = np.radians(float(rng.choice([0.0, 90.0, 180.0])) + rng.uniform(-20.0, 20.0))
    out = np.array([np.cos(side), np.sin(side), 0.0])
    top = max(object_.position[2] + np.linalg.norm(object_.model.size) / 2.0 for object_ in pile.objects)
    above = bool(rng.random() < 0.5)
    hand = out * (0.03 if above else _radius(pile) + 0.08) + (0.0, 0.0, top + 0.08 if above else rng.uniform(0.1, 0.2))
    elbow = hand + out * rng.uniform(0.2, 0.3) + (0.0, 0.0, rng.uniform(0.05, 0.2))
    wide = rng.uniform(0.06, 0.1)
    across = np.cross(out, (0.0, 0.0, 1.0)) * wide / 2.0
    fingers = [_bar(hand + k * across, hand + k * across - (0.0, 0.0, 0.05), 0.015) for k in (-0.8, 0.8)]
    return [
        _floor(),
        _bar(hand, elbow, wide),
        _bar(elbow - 0.02 * out, elbow + out + (0.0, 0.0, 0.2), wide + 0.02),
        *fingers,
    ]


def _bin(rng: Rng, pile: Pile) -> list[Body]:
    """Four walls around the pile, on the table."""
    half, height, turn = _radius(pile) + rng.uniform(0.01, 0.04), rng.uniform(0.06, 0.2), rng.uniform(0.0, 90.0)
    thick = 0.005
    walls = [(-half - thick, -half), (half, half + thick)]
    return [
        *(_box((low, -half, 0.0), (high, half, height), turn) for low, high in walls),
        *(_box((-half, low, 0.0), (half, high, height), turn) for low, high in walls),
    ]


def _nothing(_: Rng, __: Pile) -> list[Body]:
    return []


def _radius(pile: Pile) -> float:
    """Of a circle around the middle of the table that holds the pile [m]."""
    reach = [float(np.linalg.norm(object_.model.size)) / 2.0 for object_ in pile.objects]
    middle = [float(np.linalg.norm(object_.position[:2])) for object_ in pile.objects]
    return max(a + b for a, b in zip(reach, middle, strict=True))


def vessels() -> dict[str, Model]:
    """Trays, large bowls and boxes without a lid, into which other objects fit."""
    angle = np.linspace(0.0, np.pi / 2.0, 4 * BANDS + 1)
    bowl = np.stack([0.05 + 0.06 * np.sin(angle), 0.08 * (1.0 - np.cos(angle))], axis=1)
    models = [centred("large_bowl", hollow(bowl, 0.005))]
    for name, size in (("tray", (0.30, 0.22, 0.03)), ("open_box", (0.22, 0.16, 0.09))):
        models.append(centred(name, _open_box(*size)))
    return {model.name: model for model in models}


def _open_box(x: float, y: float, z: float, thick: float = 0.005) -> list[Float64]:
    a, b = x / 2.0, y / 2.0
    spans = [((-a, -b, 0.0), (a, b, thick))]
    spans += [((low, -b, thick), (low + thick, b, z)) for low in (-a, a - thick)]
    spans += [((-a + thick, low, thick), (a - thick, low + thick, z)) for low in (-b, b - thick)]
    return [
        np.array([[u, v, w] for u in (low[0], high[0]) for v in (low[1], high[1]) for w in (low[2], high[2])])
        for low, high in spans
    ]


def _within(models: piles.Models, rng: Rng) -> Pile:
    """One to three small objects in a vessel that stands on the table; the vessel alone in one of four."""
    inner = vessels()
    vessel = inner[str(rng.choice(list(inner)))].scaled(rng.uniform(0.9, 1.2))
    start = [Placed(vessel, np.array([0.0, 0.0, vessel.size[2] / 2.0 + 0.001]), about_z(rng.uniform(0.0, 2.0 * np.pi)))]
    height = vessel.size[2] + 0.01
    for _ in range(rng.integers(4)):
        model = models[str(rng.choice([name for name in _SMALL if name in models]))].scaled(rng.uniform(0.6, 0.9))
        reach = float(np.linalg.norm(model.size)) / 2.0
        place = np.append(rng.uniform(-0.04, 0.04, 2), height + reach)
        start.append(Placed(model, place, Rotation.random(random_state=rng).as_matrix()))
        height += 2.0 * reach
    return settle(start, 0.5)


def _many(models: piles.Models, rng: Rng) -> Pile:
    """Objects in rows all over the view, many of which touch."""
    start = []
    for k in range(rng.integers(*_MANY)):
        model = list(models.values())[rng.integers(len(models))].scaled(rng.uniform(0.85, 1.15))
        place = np.array([0.13 * (k % 5 - 2), 0.13 * (k // 5 - 1), model.size[2] / 2.0 + 0.001])
        place[:2] += rng.uniform(-0.02, 0.02, 2)
        start.append(Placed(model, place, about_z(rng.uniform(0.0, 2.0 * np.pi))))
    return settle(start, 0.5)


KINDS: Final[dict[str, Callable[[Rng, Pile], list[Body]]]] = {
    "wall": _wall,
    "chair": _chair,
    "shelf": _shelf,
    "arm": _arm,
    "bin": _bin,
    "vessel": _nothing,
    "full": _nothing,
}


def make(models: piles.Models, shapes: piles.Shapes, seed: int, number: int) -> piles.Scene:
    """One room; its kind is that of its number.

    Raises:
        RuntimeError: If no attempt gives one.
    """
    kind = list(KINDS)[number % len(KINDS)]
    build = {"vessel": _within, "full": _many}.get(kind, list(piles.KINDS.values())[number // len(KINDS) % 4][0])
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, 7, number, attempt])
        pile = build(models, rng)
        if not (pile.still and pile.deepest_m < 2e-3):
            continue
        least = (
            38.0 if kind in {"wall", "chair", "shelf"} else 25.0
        )  # from which on the far edge of the table is in view
        view = float(rng.uniform(least, 57.0)), float(rng.uniform(0.75, 1.1))
        seen = piles.look(pile, shapes, kind, view, SampleKey(seed, number, attempt), KINDS[kind](rng, pile))
        if piles.visible(seen):
            return seen
    raise RuntimeError(f"room {number} ({kind}): none in {_ATTEMPTS} attempts")


def write_rooms(out: Path, count: int, seed: int, data: Path | None) -> None:
    """Write rooms."""
    models, shapes = piles.prepare(out, data)
    shapes |= {name: piles.write_mesh(model, out / "meshes") for name, model in vessels().items()}
    for number in range(count):
        seen = make(models, shapes, seed, number)
        piles.save(seen, out / f"{seen.kind}{number:03d}.npz")
        print(f"{number + 1} of {count}: {seen.kind}, {', '.join(seen.names)}", file=sys.stderr, flush=True)

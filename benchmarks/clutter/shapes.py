# SPDX-License-Identifier: Apache-2.0
"""Random objects to learn from (see `learn.py`), none of them one of the benchmark's: in size, proportion and make.

Boxes, cans and balls; turned bottles, round or flattened; vessels with and without a handle; drills, hammers and jugs of convex
parts; bent ones; and unions of two or three random convex solids.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.clutter.models import BANDS, Model, centred, handle, hollow, turned
from foretouch.types import Float64

Rng = np.random.Generator
Parts = list[Float64]


def _moved(parts: Parts, axis: tuple[float, float, float], angle: float, to: tuple[float, float, float]) -> Parts:
    turn = Rotation.from_rotvec(angle * np.array(axis)).as_matrix()
    return [part @ turn.T + np.array(to) for part in parts]


def _shifted(parts: Parts, x: float, y: float, z: float) -> Parts:
    return [part + np.array([x, y, z]) for part in parts]


def _block(x: float, y: float, z: float, bevel: float = 0.15) -> Parts:
    """A box with bevelled edges about its middle."""
    half = np.array([x, y, z]) / 2.0
    cut = bevel * half.min()
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return [np.concatenate([signs * (half - cut * (1.0 - np.eye(3)[k])) for k in range(3)])]


def _rod(radius: float, length: float, top: float = 1.0) -> Parts:
    """A cone's stump about the vertical, from z = 0 on."""
    return turned([(radius, 0.0), (radius * top, length)])


def box(rng: Rng) -> Model:
    """A box of any proportion."""
    return Model("", "box", rng.uniform((0.025, 0.05, 0.03), (0.09, 0.15, 0.2)), flat=True)


def packet(rng: Rng) -> Model:
    """A slender box."""
    return Model("", "box", rng.uniform((0.02, 0.06, 0.10), (0.05, 0.13, 0.2)), flat=True)


def can(rng: Rng) -> Model:
    """A stout can."""
    wide = rng.uniform(0.05, 0.11)
    return Model("", "can", np.array([wide, wide, rng.uniform(0.03, 0.13)]), flat=True)


def tube(rng: Rng) -> Model:
    """A slender can."""
    wide = rng.uniform(0.03, 0.07)
    return Model("", "can", np.array([wide, wide, rng.uniform(2.0, 4.0) * wide]))


def ball(rng: Rng) -> Model:
    """A ball."""
    return Model("", "ball", np.full(3, rng.uniform(0.04, 0.11)))


def ellipsoid(rng: Rng) -> Model:
    """A ball, longer and mostly flattened."""
    angle = np.linspace(-1.35, 1.35, 9)
    return _squashed(rng, [(float(np.cos(a)) * 0.04, float(np.sin(a)) * rng.uniform(0.06, 0.061)) for a in angle])


def _squashed(rng: Rng, profile: list[tuple[float, float]], least: float = 0.5) -> Model:
    flatter = np.array([1.0, rng.uniform(least, 1.0) if rng.random() < 0.5 else 1.0, 1.0])
    return centred("", [part * flatter for part in turned(profile)])


def bottle(rng: Rng) -> Model:
    """A body, a shoulder, a neck and a cap."""
    r, body = rng.uniform(0.022, 0.048), rng.uniform(0.05, 0.14)
    neck, shoulder, long = r * rng.uniform(0.25, 0.65), rng.uniform(0.008, 0.05), rng.uniform(0.01, 0.06)
    waist = rng.uniform(0.85, 1.0)
    cap, tall = neck * rng.uniform(1.0, 1.35), rng.uniform(0.008, 0.025)
    top = body + shoulder
    bulge = (r + neck) / 2.0 + (r - neck) * rng.uniform(0.0, 0.35)
    end = top + long
    radii = [0.93 * r, r, waist * r, r, bulge, neck, neck * rng.uniform(0.8, 1.0), cap, cap * rng.uniform(0.8, 1.0)]
    heights = [0.0, 0.004, body / 2.0, body, body + shoulder / 2.0, top, end, end + 0.001, end + tall]
    return _squashed(rng, list(zip(radii, heights, strict=True)))


def stepped(rng: Rng) -> Model:
    """A body with a sharp step to a neck or a lid that is narrower."""
    r, body = rng.uniform((0.025, 0.05), (0.055, 0.15))
    neck, long = r * rng.uniform(0.3, 0.75), rng.uniform(0.015, 0.08)
    points = [(r, 0.0), (r, body), (neck, body + 0.001), (neck, body + long)]
    return centred("", turned(points)) if rng.random() < 0.7 else _squashed(rng, points)


def _wall(rng: Rng) -> Float64:
    if rng.random() < 0.5:
        angle = np.linspace(0.0, np.pi / 2.0, 4 * BANDS + 1)
        foot, out, tall = rng.uniform((0.02, 0.025, 0.025), (0.05, 0.055, 0.075))
        return np.stack([foot + out * np.sin(angle), tall * (1.0 - np.cos(angle))], axis=1)
    low, tall = rng.uniform((0.027, 0.05), (0.045, 0.12))
    high = low * rng.uniform(0.9, 1.5)
    return np.stack([np.linspace(low, high, BANDS + 1), np.linspace(0.0, tall, BANDS + 1)], axis=1)


def vessel(rng: Rng) -> Model:
    """A bowl, or a cup without a handle."""
    return centred("", hollow(_wall(rng), rng.uniform(0.003, 0.005)))


def bowl(rng: Rng) -> Model:
    """A bowl or dish into which other objects fit."""
    angle = np.linspace(0.0, np.pi / 2.0, 4 * BANDS + 1)
    foot, out, tall = rng.uniform((0.03, 0.03, 0.03), (0.07, 0.07, 0.09))
    wall = np.stack([foot + out * np.sin(angle), tall * (1.0 - np.cos(angle))], axis=1)
    return centred("", hollow(wall, rng.uniform(0.004, 0.006)))


def open_box(rng: Rng) -> Model:
    """A tray or a box without a lid."""
    x, y, z = rng.uniform((0.12, 0.10, 0.02), (0.30, 0.24, 0.11)) / 2.0
    thick = rng.uniform(0.003, 0.007)
    floor = _box((-x, -y, 0.0), (x, y, thick))
    return centred("", [floor, *_sides(x, y, 2.0 * z, thick)])


def bin_sides(x: float, y: float, height: float) -> Model:
    """The sides of a bin without a floor: half its inner length and width, and its height [m]."""
    return centred("", _sides(x, y, height, 0.005))


def _sides(x: float, y: float, height: float, thick: float) -> list[Float64]:
    """Four upright sheets around a rectangle of 2 x by 2 y, from 0 up."""
    ends = [_box((side - thick / 2.0, -y, 0.0), (side + thick / 2.0, y, height)) for side in (-x, x)]
    return [*ends, *(_box((-x, side - thick / 2.0, 0.0), (x, side + thick / 2.0, height)) for side in (-y, y))]


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Float64:
    """The corners of a box (8, 3)."""
    return np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T


def mug(rng: Rng) -> Model:
    """A vessel with a handle."""
    outer = _wall(rng)
    tall = outer[-1, 1]
    at = float(np.interp(tall / 2.0, outer[:, 1], outer[:, 0]))
    reach = min(rng.uniform(0.018, 0.032), 0.45 * tall)
    return centred("", [*hollow(outer, 0.004), *handle(at, tall * rng.uniform(0.45, 0.55), reach)])


def drill(rng: Rng) -> Model:
    """A barrel that lies, with a chuck before it, a grip below it, and mostly a foot below the grip."""
    r, long = rng.uniform((0.02, 0.09), (0.038, 0.17))
    chuck, out = r * rng.uniform(0.35, 0.8), rng.uniform(0.02, 0.06)
    radii = [r * rng.uniform(0.6, 1.0), r, r, chuck, chuck * rng.uniform(0.5, 1.0)]
    barrel = turned(list(zip(radii, [0.0, 0.012, long, long + 0.012, long + out], strict=True)))
    if rng.random() < 0.4:
        barrel = [*_block(2 * r, 2 * r * rng.uniform(0.8, 1.3), long), *_shifted(_rod(chuck, out), 0, 0, long / 2)]
        barrel = _shifted(barrel, 0, 0, long / 2)
    parts = _moved(barrel, (0, 1, 0), np.pi / 2, (0, 0, 0))
    wide, deep, tall = rng.uniform((0.025, 0.03, 0.07), (0.042, 0.06, 0.13))
    at, lean = rng.uniform(0.1, 0.6) * long, rng.uniform(-0.35, 0.35)
    grip = [*_block(deep, wide, tall, 0.4)]
    if rng.random() < 0.75:
        foot = _block(*rng.uniform((0.05, 0.04, 0.02), (0.1, 0.08, 0.05)), 0.2)
        grip += _shifted(foot, rng.uniform(-0.01, 0.02), 0, -tall / 2)
    return centred("", [*parts, *_moved(grip, (0, 1, 0), lean, (at, 0, -tall / 2 - 0.4 * r))])


def hammer(rng: Rng) -> Model:
    """A head across a handle."""
    r, long = rng.uniform((0.009, 0.1), (0.02, 0.24))
    if rng.random() < 0.5:
        shaft = _rod(r, long, rng.uniform(0.7, 1.2))
    else:
        shaft = _shifted(_block(2 * r, 3 * r, long), 0, 0, long / 2)
    head = _moved(_rod(1.0, 1.0), (1, 0, 0), np.pi / 2, (0, 0.5, 0)) if rng.random() < 0.5 else _block(2, 1, 2)
    size = rng.uniform((0.015, 0.06, 0.015), (0.035, 0.12, 0.035))
    return centred("", [*shaft, *[part * size + (0, rng.uniform(-0.3, 0.3) * size[1], long) for part in head]])


def jug(rng: Rng) -> Model:
    """A body with a large handle and mostly a spout."""
    r, tall = rng.uniform((0.04, 0.08), (0.065, 0.17))
    top = r * rng.uniform(0.5, 1.0)
    edge = (0.5 * top, tall + rng.uniform(0.003, 0.03))
    parts = turned([(0.9 * r, 0.0), (r, 0.01), (r, 0.5 * tall), (top, tall), edge])
    parts += handle((r + top) / 2, 0.55 * tall, min(0.4 * tall, rng.uniform(0.025, 0.055)))
    if rng.random() < 0.5:
        spout = _rod(0.013, rng.uniform(0.03, 0.07), 0.7)
        parts += _moved(spout, (0, 1, 0), rng.uniform(-1.3, -0.6), (-0.85 * r, 0, 0.5 * tall))
    return centred("", parts)


def bent(rng: Rng) -> Model:
    """An arc of round pieces: bananas, hooks, rings."""
    count, big, r = 9, rng.uniform(0.04, 0.12), rng.uniform(0.008, 0.022)
    angle = np.linspace(0.0, rng.uniform(0.8, 1.6) * min(np.pi, 0.25 / big), count)
    ring = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    thick = r * (1.0 - rng.uniform(0.0, 0.6) * np.linspace(-1, 1, count) ** 2)
    rings = [
        np.stack([(big + t * np.cos(ring)) * np.cos(a), (big + t * np.cos(ring)) * np.sin(a), t * np.sin(ring)], axis=1)
        for a, t in zip(angle, thick, strict=True)
    ]
    return centred("", [np.concatenate(pair) for pair in pairwise(rings)])


def pan(rng: Rng) -> Model:
    """A flat vessel with a straight handle."""
    radius, tall = rng.uniform((0.05, 0.02), (0.09, 0.05))
    wall = np.stack([np.linspace(radius, 1.1 * radius, BANDS + 1), np.linspace(0.0, tall, BANDS + 1)], axis=1)
    long = rng.uniform(0.06, 0.14)
    grip = _shifted(_block(long, 0.022, 0.012), 1.05 * radius + long / 2 - 0.002, 0, 0.8 * tall)
    return centred("", [*hollow(wall, 0.004), *grip])


def union(rng: Rng) -> Model:
    """Two or three convex solids, each with its middle at the surface of the one before."""
    parts: Parts = []
    place = np.zeros(3)
    for k in range(rng.integers(2, 4)):
        size = rng.uniform(0.025, 0.1, 3) * 0.8**k
        block = _block(*size, rng.uniform(0.05, 0.6))
        rod = _shifted(_rod(size[0] / 2, size[2], rng.uniform(0.4, 1.0)), 0, 0, -size[2] / 2)
        points = 0.8 * rng.normal(size=(60, 3))  # the factor keeps the trees' solids, to the bit
        round_one = [points / np.linalg.norm(points, axis=1, keepdims=True) * size / 2]
        solid = (block, rod, round_one)[rng.integers(3)]
        turn = Rotation.random(random_state=rng).as_matrix() if rng.random() < 0.4 else np.eye(3)
        solid = [part @ turn.T + place for part in solid]
        parts += solid
        every = np.concatenate(solid)
        middle, corner = every.mean(axis=0), every[rng.integers(len(every))]
        axis = np.zeros(3)
        axis[rng.integers(3)] = rng.choice([-1.0, 1.0])
        place = middle + axis * (every @ axis - middle @ axis).max() if rng.random() < 0.7 else (middle + corner) / 2
    return centred("", parts)


#: Kinds that a random catalogue always has, by the names of those that piles stand on and lean with; others are drawn.
FIXED: Final[dict[str, Callable[[Rng], Model]]] = {"carton": packet, "packet": packet, "block": box, "tin": can, "flat_tin": can, "tube": tube, "bottle": bottle, "box": box}  # fmt: skip
DRAWN: Final[tuple[Callable[[Rng], Model], ...]] = (ball, ellipsoid, bottle, vessel, mug, drill, hammer, jug, bent, pan, union, vessel, drill, union)  # fmt: skip
#: Kinds that stand by themselves.
STANDING: Final = (packet, box, can, tube, bottle, vessel, mug, jug, box, vessel, packet, can, bottle, drill)
#: Kinds that are concave.
CONCAVE: Final = (drill, bottle, drill, vessel, mug, bottle, union, jug, hammer, pan, bent, drill)
#: Kinds that hold other objects.
HOLDING: Final = (open_box, open_box, bowl, bowl, pan, mug, vessel)

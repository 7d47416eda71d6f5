# SPDX-License-Identifier: Apache-2.0
"""Learn which fragments of clusters are one object: `python -m benchmarks.clutter.learn` writes `same_object.safetensors` and its card.

The scenes are of random objects (`shapes.py`), none of which is one of the benchmark's: piles at rest, objects placed side by
side, in contact, behind each other, and alone. In each, segmentation joins fragments by the trees of the round before and keeps the
pairs that it rated; whether both are of one object is known from the labels. Boosted trees learn that, in further rounds also
from the pairs that their own joining makes.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import import_module
from itertools import pairwise
from multiprocessing import Pool
from pathlib import Path
from string import ascii_letters
from typing import Any, Final

import numpy as np
from safetensors.numpy import save_file
from scipy.ndimage import gaussian_filter, maximum_filter, zoom
from scipy.spatial.transform import Rotation
from sklearn.ensemble import HistGradientBoostingClassifier

from benchmarks.clutter import shapes
from benchmarks.clutter.metrics import SceneScore, score, summary
from benchmarks.clutter.models import Model, write_mesh
from benchmarks.clutter.physics import Pile, Placed, settle
from benchmarks.clutter.piles import KINDS, Scene, alone, at_rest, look, make, resting, save, visible
from benchmarks.clutter.scenes import LabelledCloud, cache_folder
from foretouch.cloud.segmentation import parts
from foretouch.cloud.segmentation.clusters import Clusters
from foretouch.cloud.segmentation.segment import segment
from foretouch.errors import ForetouchError
from foretouch.types import Cloud, Float32, Float64, Int32
from foretouch_lab.simulation.solids import about_z
from foretouch_lab.simulation.world import SampleKey

# Of a number that is drawn for each scene from 0 to 1: up to the first it gets white noise, then up to the second a Kinect's
# faults, then up to the third those of cameras that match windows; from there on, an object alone is cut out.
WHITE, FAULTY, BLURRED = 0.1, 0.4, 0.7
TWICE: Final = ("arr", "behind")  # sets whose pairs count twice: large objects beside and before each other are few
HELD_OUT: Final = 10  # every so many piles, with all their views, are not learned from
DEPTH, RATE = 5, 0.15
ROUNDS: Final = (200, 300, 400)  # trees
FEATURES: Final = 62  # of a pair of fragments, see `describe` of kernels/split.c
LESS, MORE = (0,), (2, 6, 7)  # concave borders tell against one object; convex ones, and surfaces that agree, for it
# Of the first round: joined across borders that bend by less than 26 degrees.
FIRST: Final = np.array([[0, np.radians(26.0), 1, -1]], np.float32)
_ATTEMPTS: Final = 50  # at a filled vessel
_FEWEST: Final = 300  # pixels of an object that is cut out
_ROWS: Final = 8000  # of a scene at most

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


SETS: Final[dict[str, tuple[Callable[[int, Path], Iterator[tuple[str, Scene]]], int]]] = {"arr": (arranged, 500), "sing": (on_its_own, 300), "touch": (touching, 308), "behind": (behind, 96), "train": (in_piles, 139), "above": (from_above, 171), "heap": (heaped, 458), "in": (contained, 458), "bin": (in_a_bin, 416)}  # fmt: skip


def write_scenes(folder: Path, jobs: int) -> None:
    """Write all that are not there yet."""
    for name, (_, count) in SETS.items():
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


def faulty(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The scene in another size, with noise and steps of disparity as of a Kinect."""
    z = scene.cloud.xyz[..., 2]
    noise = rng.uniform(0.001, 0.0025)
    grain = gaussian_filter(rng.normal(size=z.shape), rng.uniform(0.6, 1.2))
    step = 0.0028 * rng.uniform(0.5, 1.0)
    disparity = np.round(1.0 / (z + noise * z * z * grain / grain.std()) / step) * step
    factor = rng.uniform(0.8, 1.7) / (disparity * z)
    return replace(scene, cloud=Cloud(np.ascontiguousarray((scene.cloud.xyz * factor[..., None]).astype(np.float32))))


def blurred(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The scene in another size as cameras that match windows see it: objects grow, contacts are ramps, planes have waves and holes."""
    z = scene.cloud.xyz[..., 2]
    finite = np.isfinite(z)
    disparity = np.where(finite, 1.0 / z, 0.0).astype(np.float32)
    grown = maximum_filter(disparity, size=int(rng.integers(1, 6)))
    wide = rng.uniform(0.3, 3.0)
    smooth = gaussian_filter(np.where(finite, grown, 0.0), wide) / np.maximum(
        gaussian_filter(finite.astype(np.float32), wide), 1e-3
    )
    if rng.random() < 0.6:  # some keep steps
        smooth = np.where(np.abs(smooth - grown) > rng.uniform(0.006, 0.02) * grown**2, grown, smooth)
    for size, most in (
        (rng.uniform(0.6, 2.0), 0.002),
        (rng.uniform(3.0, 8.0), 0.0035),
        (rng.uniform(8.0, 25.0), 0.006),
    ):
        smooth += most * 10 ** rng.uniform(-1.5, 0.0) * _grain(rng, z.shape, size)
    step = 0.0028 * rng.uniform(0.05, 0.9)
    smooth = np.round(smooth / step) * step
    holes = _grain(rng, z.shape, rng.uniform(2.0, 7.0))
    seen = finite & (smooth > 0.0) & (holes < np.quantile(holes[::4, ::4], 1.0 - rng.uniform(0.0, 0.04)))
    factor = np.where(seen, rng.uniform(0.6, 1.3) / np.where(seen, smooth * z, 1.0), np.nan)
    return replace(scene, cloud=Cloud(np.ascontiguousarray((scene.cloud.xyz * factor[..., None]).astype(np.float32))))


def _grain(rng: Rng, shape: tuple[int, ...], size: float) -> Float32:
    """Noise that is even over `size` pixels, with a deviation of 1."""
    step = max(1, int(size / 2.0))
    small = rng.standard_normal([-(-side // step) + 1 for side in shape], dtype=np.float32)
    grain: Float32 = zoom(gaussian_filter(small, size / step), step, order=1)[: shape[0], : shape[1]]
    return grain / grain.std()


def bare(scene: LabelledCloud, rng: Rng) -> LabelledCloud:
    """The object alone, cut out and put before a table without noise: often in half the pixels, with waves, blurred edges, and holes."""
    some = (slice(None, None, int(rng.integers(1, 3))),) * 2
    xyz, labels = scene.cloud.xyz[some], scene.labels[some]
    z, finite = xyz[..., 2], np.isfinite(xyz[..., 2])
    holes = gaussian_filter(rng.normal(size=z.shape), rng.uniform(0.7, 4.0))
    seen = (labels > 0) & finite & (holes < np.quantile(holes, 1.0 - rng.uniform(0.0, 0.03)))
    if np.count_nonzero(seen) < _FEWEST:
        return scene
    disparity = gaussian_filter(np.where(finite, 1.0 / z, 1.0 / np.nanmax(z)), rng.uniform(0.0, 2.0))
    for size, least, most in ((rng.uniform(0.5, 2.0), 0.0003, 0.002), (rng.uniform(2.0, 9.0), 0.0, 0.005)):
        grain = gaussian_filter(rng.normal(size=z.shape), size)
        disparity += rng.uniform(least, most) * grain / grain.std()
    step = 0.0028 * rng.uniform(0.1, 0.7)
    depth = 1.0 / (np.round(disparity / step) * step)
    depth = np.where(seen, depth, depth[seen].max() + 0.01)
    v, u = np.nonzero(finite)
    few = rng.permutation(len(v))[:2000]
    rows, columns = np.indices(z.shape)
    ones = np.stack([np.ones(z.shape), columns, rows], axis=-1)
    slopes = (xyz[..., :2] / z[..., None])[v[few], u[few]]
    rays = np.append(ones @ np.linalg.lstsq(ones[v[few], u[few]], slopes, rcond=None)[0], ones[..., :1], axis=-1)
    points = rays * depth[..., None] * rng.uniform(0.8, 1.4)
    return replace(scene, cloud=Cloud(points.astype(np.float32)), labels=np.where(seen, labels, 0).astype(np.int32))


class Recorder:
    """Splitting, called by segmentation, with the trees it rates with and the pairs that it rates."""

    def __init__(self) -> None:
        self._split, self._rows = parts.split_window, np.zeros((_ROWS, FEATURES + 2))
        self._at: tuple[Clusters, int, int] | None = None
        parts.split_window = self  # type: ignore[assignment]

    def use(self, trees: Float32) -> None:
        """Rate with these trees from now on."""
        parts._trees = lambda: trees  # type: ignore[assignment]  # noqa: SLF001

    def __call__(
        self, xyz: Float32, window: Clusters, cell: int, settings: Float64
    ) -> tuple[Int32, list[int], Float64]:
        """Split a window, and keep what is rated."""
        labels, counts, joins = self._split(xyz, window, cell, settings, self._rows)
        self._at = window, cell, min(counts[-1], _ROWS)
        return labels, counts, joins

    def pairs(self, scene: LabelledCloud) -> tuple[Float64, Float64]:
        """Features (n, FEATURES) of what is rated in a scene, and whether both are one object (n,)."""
        self._at = None
        segment(scene.cloud)
        if self._at is None:
            return np.zeros((0, FEATURES)), np.zeros(0)
        window, k, count = self._at
        (h, w), rows = scene.labels.shape, self._rows[:count]
        v, u = np.divmod(rows[:, :2].astype(np.int64), -(-window.labels.shape[1] // k) * k)
        of = scene.labels[np.minimum(v + window.rows, h - 1), np.minimum(u + window.columns, w - 1)]
        known = of.any(axis=1)
        return rows[known, 2:].copy(), ((of[:, 0] == of[:, 1]) & (of[:, 0] > 0))[known].astype(np.float64)


def variant(path: Path, number: int = 0) -> LabelledCloud:
    """The scene of a file, most of them with the faults of another camera, which the number decides."""
    rng = np.random.default_rng([*path.stem.encode(), number])
    with np.load(path) as arrays:
        scene = LabelledCloud(path.stem, str(arrays["kind"]), Cloud(arrays["xyz"]), arrays["labels"])
    share = rng.random()
    if scene.kind == "single" and share > BLURRED:
        return bare(scene, rng)
    if share < WHITE:  # noise of which each pixel has its own
        noise = 1.0 + rng.normal(0.0, rng.uniform(0.0002, 0.0008), scene.labels.shape)
        return replace(scene, cloud=Cloud((scene.cloud.xyz * noise[..., None]).astype(np.float32)))
    if share < FAULTY:
        return faulty(scene, rng)
    return blurred(scene, rng) if share < BLURRED else scene


def pairs_of(trees: Float32, number: int, path: Path) -> tuple[Float64, Float64]:
    """Of one file: features, and whether both are one object."""
    scene = variant(path, number)
    _the_recorder().use(trees)
    return _the_recorder().pairs(scene)


def score_of(trees: Float32, path: Path) -> SceneScore:
    """Of segmentation with trees in one file."""
    scene = variant(path)
    _the_recorder().use(trees)
    return score(segment(scene.cloud).labels, scene.labels)


@cache
def _the_recorder() -> Recorder:
    return Recorder()


def learned(rows: Sequence[Float64], same: Sequence[Float64], count: int) -> Float32:
    """Trees (T, 3 * 2**DEPTH - 2): nodes of (feature, threshold) and leaves in the order of a heap."""
    x, y = np.concatenate(rows), np.concatenate(same)
    signs = [MORE.count(k) - LESS.count(k) for k in range(FEATURES)]
    model = HistGradientBoostingClassifier(
        max_iter=count, max_depth=DEPTH, learning_rate=RATE, max_leaf_nodes=None, min_samples_leaf=40, l2_regularization=1.0,
        early_stopping=False, random_state=0, monotonic_cst=signs,
    ).fit(x, y)  # fmt: skip
    inner = 2**DEPTH - 1
    trees = np.zeros((count, 3 * inner + 1), np.float32)
    trees[:, 1 : 2 * inner : 2] = np.inf  # to the left
    for tree, (predictor,) in zip(trees, model._predictors, strict=True):  # noqa: SLF001  scikit-learn exports them as pickles only
        _fill(tree, predictor.nodes, 0, 0)
    trees[0, 2 * inner :] += float(np.ravel(model._baseline_prediction)[0])  # noqa: SLF001
    return trees


def _fill(tree: Float32, nodes: Any, node: int, at: int) -> None:
    inner, one = len(tree) // 3, nodes[node]
    if at >= inner:
        tree[at + inner] = one["value"]
    elif one["is_leaf"]:
        _fill(tree, nodes, node, 2 * at + 1)
    else:
        tree[2 * at], tree[2 * at + 1] = one["feature_idx"], one["num_threshold"]
        _fill(tree, nodes, one["left"], 2 * at + 1)
        _fill(tree, nodes, one["right"], 2 * at + 2)


def main() -> None:
    """Make scenes, learn in rounds from nine tenths of them, and write the trees with their scores on the others."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, default=cache_folder() / "learn", help="folder of the scenes, made where they are not there")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=2, help="processes; the result does not depend on them")
    options = parser.parse_args()
    write_scenes(options.scenes, options.jobs)
    files = sorted(path for name in SETS for path in (options.scenes / name).glob("*.npz"))
    new = [path for path in files if _number_of(path) % HELD_OUT == 0]
    known = [path for path in files if _number_of(path) % HELD_OUT]
    trees, rows, same = FIRST, [], []
    with Pool(options.jobs) as pool:
        for number, count in enumerate(ROUNDS):
            pairs = pool.imap(partial(pairs_of, trees, number), known, chunksize=8)
            for path, (x, y) in zip(known, pairs, strict=True):
                times = 2 if path.parent.name in TWICE else 1
                rows += times * [x]
                same += times * [y]
            trees = learned(rows, same, count)
            means = summary(pool.imap(partial(score_of, trees), new, chunksize=8))
            scores = {name: round(value, 3) for name, value in means.items()}
            print(f"{sum(map(len, same))} pairs: {scores}", flush=True)
    write(trees, scores, len(known), sum(map(len, same)))


def _number_of(path: Path) -> int:
    """The number of the pile in the name of a file: its kind, four digits, and at most one for the view."""
    return int(path.stem.lstrip(ascii_letters + "_")[:4])


def write(trees: Float32, scores: dict[str, float], scenes: int, pairs: int) -> None:
    """The trees, and the card beside them."""
    save_file({"trees": trees}, parts.TREES)
    card = {
        "what": "log odds that two fragments of a cluster are one object, from the features of `describe` in kernels/split.c",
        "made_by": "python -m benchmarks.clutter.learn",
        "versions": {name: import_module(name).__version__ for name in ("numpy", "scipy", "sklearn", "mujoco")},
        "learned_from": f"{pairs} pairs of fragments in {scenes} simulated scenes of random objects, a third each as of a Kinect and of cameras that match windows; of one object, a third as points cut out",
        "not_learned_from": "any object or scene of benchmarks/clutter, OSD, YCB, or a recording",
        "model": f"{len(trees)} boosted trees of depth {DEPTH}, learning rate {RATE}, in {len(ROUNDS)} rounds; seeds 11 to 19 of the scenes, 0 of the trees",
        "held_out_scenes": scores,
        "sha256": hashlib.sha256(parts.TREES.read_bytes()).hexdigest(),
    }
    parts.TREES.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""Learn which fragments of clusters are one object: `python -m benchmarks.clutter.learn` writes `same_object.safetensors` and its card.

Simulated images (`learn_scenes.py`) show random objects, none of which is one of the benchmark's; those of real cameras are labelled by
people. In each, segmentation joins fragments by the trees of the round before and keeps the pairs that it rated; whether both are of one
object is known from the labels. Boosted trees learn that. The first rounds learn from simulated images alone, so that in the last one
each source of real images can be left out (`left_out.py`).
"""

import argparse
import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from multiprocessing import Pool
from multiprocessing.pool import Pool as Workers
from pathlib import Path
from string import ascii_letters
from typing import Any, Final, Self

import numpy as np
from safetensors.numpy import load_file, save_file
from sklearn.ensemble import HistGradientBoostingClassifier

from benchmarks.clutter.learn_scenes import SETS, write_scenes
from benchmarks.clutter.metrics import SceneScore, score, summary
from benchmarks.clutter.scenes import LabelledCloud, real_sources
from benchmarks.clutter.variants import seen_otherwise, variant
from benchmarks.common import add_data
from foretouch.base.files import cache_folder
from foretouch.cloud.segmentation import parts
from foretouch.cloud.segmentation.clusters import Clusters
from foretouch.cloud.segmentation.segment import segment
from foretouch.types import Bool, Float32, Float64, Int32, Int64

TWICE: Final = ("arr", "behind")  # sets whose pairs count twice: large objects beside and before each other are few
HELD_OUT: Final = 10  # every so many piles, with all their views, are not learned from
DEPTH, RATE = 5, 0.15
ROUNDS: Final = (150, 250)  # trees that learn from simulated images alone
LAST: Final = 400  # trees that learn from real images too
OTHER_VARIANTS: Final = 4  # of each simulated image, in the last round
REAL_VARIANTS: Final = 6  # of each real image, half as many where a source has many
MANY: Final = 20  # images of a source
REAL_SHARE: Final = 0.35  # of the weight of simulated pairs; of each source by the root of its number
NONE_SHARE: Final = 0.25  # of the weight of other pairs, that pairs of what is no object have
TRUST: Final = (
    0.75  # weight of earlier trees, in images that they know: whose pairs they rate with a mean log loss below
)
KNOWN: Final = 0.5
LEAST: Final = 0.02  # weight of a pair that counts
FEATURES: Final = 64  # of a pair of fragments, see `describe` of kernels/split.c
LESS, MORE = (0,), (2, 6, 7)  # concave borders tell against one object; convex ones, and surfaces that agree, for it
# Of the first round: joined across borders that bend by less than 26 degrees.
FIRST: Final = np.array([[0, np.radians(26.0), 1, -1]], np.float32)
_ROWS: Final = 8000  # of a scene at most


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of fragments that were rated."""

    features: Float32  # (n, FEATURES)
    same: Float64  # (n,) 1 where both are of one object
    weight: Float64  # (n,)
    image: Int64  # (n,) number of the image

    @classmethod
    def of(cls, found: Sequence[tuple[Float64, Float64]], weights: Sequence[float]) -> Self:
        """Those of several images, each with a weight."""
        counts = [len(same) for _, same in found]
        features, same = (np.concatenate(part) for part in zip(*found, strict=True))
        return cls(
            features.astype(np.float32), same, np.repeat(weights, counts), np.repeat(np.arange(len(counts)), counts)
        )

    def only(self, kept: Bool) -> "Pairs":
        """Some of them."""
        return Pairs(self.features[kept], self.same[kept], self.weight[kept], self.image[kept])

    def times(self, factor: float) -> "Pairs":
        """The same with other weights."""
        return replace(self, weight=factor * self.weight)


class Recorder:
    """Splitting, called by segmentation, with the trees it rates with and the pairs that it rates."""

    def __init__(self) -> None:
        self._split, self._rows = parts.split_window, np.zeros((_ROWS, FEATURES + 2))
        self._at: tuple[Clusters, int, int] | None = None
        parts.split_window = self  # type: ignore[assignment]

    def use(self, trees: Float32) -> None:
        """Rate with these trees from now on."""
        prepared = parts.Trees.of(trees)
        parts._trees = lambda: prepared  # type: ignore[assignment]  # noqa: SLF001

    def __call__(
        self, xyz: Float32, window: Clusters, cell: int, settings: Float64
    ) -> tuple[Int32, list[int], Float64]:
        """Split a window, and keep what is rated."""
        labels, counts, joins = self._split(xyz, window, cell, settings, self._rows)
        self._at = window, cell, min(counts[-1], _ROWS)
        return labels, counts, joins

    def pairs(self, scene: LabelledCloud) -> tuple[Float64, Float64]:
        """Features (n, FEATURES) of what is rated in a scene, and whether both are one object (n,): 1, 0, and 2 where neither is one.

        Pairs of which one is not scored are left out.
        """
        self._at = None
        segment(scene.cloud)
        if self._at is None:
            return np.zeros((0, FEATURES)), np.zeros(0)
        window, k, count = self._at
        (h, w), rows = scene.labels.shape, self._rows[:count]
        v, u = np.divmod(rows[:, :2].astype(np.int64), -(-window.labels.shape[1] // k) * k)
        of = scene.labels[np.minimum(v + window.rows, h - 1), np.minimum(u + window.columns, w - 1)]
        known = (of >= 0).all(axis=1)
        same = np.where(of.any(axis=1), of[:, 0] == of[:, 1], 2.0)
        return rows[known, 2:].copy(), same[known]


@cache
def _the_recorder() -> Recorder:
    return Recorder()


def pairs_of(trees: Float32, number: int, path: Path) -> tuple[Float64, Float64]:
    """Of one simulated image: features, and whether both are one object."""
    scene = variant(path, number)
    _the_recorder().use(trees)
    return _the_recorder().pairs(scene)


def _real_pairs(trees: Float32, data: Path, job: tuple[str, int, int]) -> tuple[Float64, Float64]:
    """Of one variant of an image of a source; 0 is the image as it is."""
    source, place, number = job
    scene = _real(data)[source][place]
    _the_recorder().use(trees)
    return _the_recorder().pairs(seen_otherwise(scene, np.random.default_rng([place, number])) if number else scene)


@cache
def _real(data: Path) -> dict[str, list[LabelledCloud]]:
    return real_sources(data)


def real_pairs(workers: Workers, trees: Float32, data: Path) -> dict[str, Pairs]:
    """Pairs of all real images by source. What is no object, as a wall, stays in one piece; it counts less."""
    found = {}
    for source, scenes in _real(data).items():
        variants = REAL_VARIANTS if len(scenes) < MANY else REAL_VARIANTS // 2
        jobs = [(source, place, number) for place in range(len(scenes)) for number in range(variants)]
        pairs = Pairs.of(workers.map(partial(_real_pairs, trees, data), jobs), [1.0] * len(jobs))
        found[source] = pairs
    return found


def weighted(simulated: Pairs, real: dict[str, Pairs]) -> list[Pairs]:
    """All pairs, with the weights by which the trees learn from them."""
    total, weighed = float(simulated.weight.sum()), [simulated]
    for none in (False, True):
        some = {name: one.only(one.same == 2.0 if none else one.same < 2.0) for name, one in real.items()}
        shares = {name: float(np.sqrt(len(one.same))) for name, one in some.items() if len(one.same)}
        for name, share in shares.items():
            part = REAL_SHARE * (NONE_SHARE if none else 1.0) * share / sum(shares.values())
            weighed.append(some[name].times(part * total / len(some[name].same)))
    return weighed


def probabilities(trees: Float32, features: Float32) -> Float64:
    """The probability (n,) by trees that both fragments of pairs are one object."""
    inner, rows, odds = trees.shape[1] // 3, np.arange(len(features)), np.zeros(len(features))
    for tree in trees:
        at = np.zeros(len(features), np.int64)
        feature, threshold, leaves = tree[: 2 * inner : 2].astype(np.int64), tree[1 : 2 * inner : 2], tree[2 * inner :]
        for _ in range((inner + 1).bit_length() - 1):
            at = 2 * at + 1 + (features[rows, feature[at]] > threshold[at])
        odds += leaves[at - inner]
    probability: Float64 = 1.0 / (1.0 + np.exp(-odds))
    return probability


def taught(pairs: Pairs, teacher: Float32) -> Pairs:
    """Pairs that count as one object and as two, by what is true and by how earlier trees rate them, where those know such images."""
    says = probabilities(teacher, pairs.features)
    loss = -np.log(np.maximum(np.where(pairs.same > 0.5, says, 1.0 - says), 1e-3))
    known = (np.bincount(pairs.image, loss) / np.maximum(np.bincount(pairs.image), 1) < KNOWN)[pairs.image]
    both = np.where(known, (1.0 - TRUST) * pairs.same + TRUST * says, pairs.same)
    one, two = both > LEAST, 1.0 - both > LEAST
    return Pairs(
        np.concatenate([pairs.features[one], pairs.features[two]]),
        np.repeat([1.0, 0.0], [one.sum(), two.sum()]),
        np.concatenate([(pairs.weight * both)[one], (pairs.weight * (1.0 - both))[two]]),
        np.concatenate([pairs.image[one], pairs.image[two]]),
    )


def score_of(trees: Float32, path: Path) -> SceneScore:
    """Of segmentation with trees in one simulated image."""
    scene = variant(path)
    _the_recorder().use(trees)
    return score(segment(scene.cloud).labels, scene.labels)


def learned(pairs: Sequence[Pairs], count: int) -> Float32:
    """Trees (T, 3 * 2**DEPTH - 2): nodes of (feature, threshold) and leaves in the order of a heap."""
    x, y, weight = (np.concatenate([getattr(one, name) for one in pairs]) for name in ("features", "same", "weight"))
    signs = [MORE.count(k) - LESS.count(k) for k in range(FEATURES)]
    model = HistGradientBoostingClassifier(
        max_iter=count, max_depth=DEPTH, learning_rate=RATE, max_leaf_nodes=None, min_samples_leaf=40, l2_regularization=1.0,
        early_stopping=False, random_state=0, monotonic_cst=signs,
    ).fit(x, y > 0.5, weight)  # fmt: skip
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


def simulated_pairs(workers: Workers, files: Sequence[Path]) -> tuple[Pairs, Float32]:
    """Pairs of simulated images in all rounds, and the trees that learned from the rounds before the last."""
    trees, found, weights = FIRST, [], []
    for number in range(len(ROUNDS) + OTHER_VARIANTS):
        found += workers.map(partial(pairs_of, trees, number), files, chunksize=8)
        weights += [2.0 if path.parent.name in TWICE else 1.0 for path in files]
        if number < len(ROUNDS):
            pairs = Pairs.of(found, weights)
            trees = learned([pairs.only(pairs.same < 2.0)], ROUNDS[number])
        print(f"{sum(len(same) for _, same in found)} pairs", flush=True)
    pairs = Pairs.of(found, weights)
    return pairs.only(pairs.same < 2.0), trees


def main() -> None:
    """Make scenes, learn from nine tenths of them and from real images, and write the trees with their scores on the others."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, default=cache_folder("benchmarks") / "learn", help="folder of the scenes, made where they are not there")  # fmt: skip
    parser.add_argument("--share", type=float, default=1.0, help="share of the simulated images that are made")
    parser.add_argument("--jobs", type=int, default=2, help="processes; the result does not depend on them")
    parser.add_argument(
        "--teacher",
        type=Path,
        help="earlier trees (.safetensors) that rate simulated pairs as well, so that fewer images do",
    )
    add_data(parser)
    options = parser.parse_args()
    write_scenes(options.scenes, options.jobs, options.share)
    files = sorted(path for name in SETS for path in (options.scenes / name).glob("*.npz"))
    new, known = ([path for path in files if (_number_of(path) % HELD_OUT == 0) == held] for held in (True, False))
    with Pool(options.jobs) as workers:
        simulated, before = simulated_pairs(workers, known)
        real = {} if options.data is None else real_pairs(workers, before, Path(options.data))
        teacher = options.teacher and load_file(options.teacher)["trees"]
        simulated = simulated if teacher is None else taught(simulated, teacher)
        keep(options.scenes, simulated, real)
        trees = learned(weighted(simulated, real), LAST)
        means = summary(workers.imap(partial(score_of, trees), new, chunksize=8))
    scores = {name: round(value, 3) for name, value in means.items()}
    print(scores)
    teaches = "" if options.teacher is None else hashlib.sha256(options.teacher.read_bytes()).hexdigest()
    write(trees, scores | {"images": len(new)}, (len(known), len(simulated.same), teaches), {name: len(one.same) for name, one in real.items()})  # fmt: skip


def _number_of(path: Path) -> int:
    """The number of the pile in the name of a file: its kind, four digits, and at most one for the view."""
    return int(path.stem.lstrip(ascii_letters + "_")[:4])


def keep(folder: Path, simulated: Pairs, real: dict[str, Pairs]) -> None:
    """Keep the pairs for `left_out.py`: `pairs-SOURCE.npz`, and those of simulated images without a source."""
    for name, pairs in (("", simulated), *real.items()):
        np.savez(
            folder / f"pairs-{name}.npz",
            features=pairs.features,
            same=pairs.same,
            weight=pairs.weight,
            image=pairs.image,
        )


def kept(folder: Path) -> Iterator[tuple[str, Pairs]]:
    """The pairs that `keep` wrote, by source."""
    for path in sorted(folder.glob("pairs-*.npz")):
        with np.load(path) as arrays:
            yield (
                path.stem.removeprefix("pairs-"),
                Pairs(*(arrays[name] for name in ("features", "same", "weight", "image"))),
            )


def write(trees: Float32, scores: dict[str, float], simulated: tuple[int, int, str], real: dict[str, int]) -> None:
    """The trees, and the card beside them; `simulated` are the number of images and pairs, and the checksum of earlier trees or ""."""
    images, pairs, teacher = simulated
    save_file({"trees": trees}, parts.TREES)
    card = {
        "what": "log odds that two fragments of a cluster are one object, from the features of `describe` in kernels/split.c",
        "made_by": "the code of python -m benchmarks.clutter.learn",
        "versions": {name: import_module(name).__version__ for name in ("numpy", "scipy", "sklearn", "mujoco")},
        "learned_from": f"{pairs} pairs of fragments in {images} simulated images of random objects, each in several variants: as of a Kinect and of cameras that match windows, nearer, cut off",
        "earlier_trees": {"sha256": teacher, "weight": TRUST} if teacher else {},
        "learned_from_real_images": {"weight": REAL_SHARE, "pairs": real},
        "not_learned_from": "any object or scene of piles and rooms of benchmarks/clutter, YCB, or a recorded grasp",
        "model": f"{len(trees)} boosted trees of depth {DEPTH}, learning rate {RATE}; two rounds before learn from simulated images alone; seeds 11 to 21 of the scenes, 0 of the trees",
        "held_out_simulated_images": scores,
        "sha256": hashlib.sha256(parts.TREES.read_bytes()).hexdigest(),
    }
    parts.TREES.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

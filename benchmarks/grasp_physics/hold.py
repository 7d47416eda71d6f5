# SPDX-License-Identifier: Apache-2.0
"""Will a grasp hold? Tests probabilities from what the planner has on objects left out. See HOLD.md."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from sklearn.base import ClassifierMixin
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmarks.common import add_data, print_rows, read_csv, write_csv
from benchmarks.grasp_physics.camera import VIEWS, see
from benchmarks.grasp_physics.measure import Conditions
from benchmarks.grasp_physics.methods import Proposal, find
from benchmarks.grasp_physics.objects import Item, Placed, read_items
from foretouch.camera.device import ensure_libusb
from foretouch.grasp import geograsp
from foretouch.grasp.completed import ClosingLines
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.types import Bool, Float64, Grasp

FEATURES: Final = (
    "score", "rank", "width", "level", "top", "offset", "slope_1", "slope_2", "across", "unseen_1", "unseen_2",
    "narrowest", "widest", "height", "volume", "elevation", "free", "completed",
)  # fmt: skip
SCORE_ALONE: Final = ("score",)
WITH_MASS: Final = (*FEATURES, "mass")  # which no planner has
_BINS = 15  # of the calibration error


def main() -> None:
    """Close the grasps of all objects and write rows, or compare probabilities from such files."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--count", type=int, default=8, help="grasps of each plan")
    parser.add_argument("--poses", type=int, default=8, help="of each object")
    parser.add_argument("--cache", type=Path, help="folder where images are kept")
    parser.add_argument("--rows", type=Path, help="write one row for each grasp to this CSV, and end")
    parser.add_argument("--from", dest="files", type=Path, nargs="+", help="compare with rows of these files")
    options = parser.parse_args()
    if options.files:
        compare(options.files)
        return
    if options.rows is None:
        parser.error("one of --rows and --from is required")
    ensure_libusb()
    items = read_items(options.objects or Path(options.data or "") / "ycb")
    rows = [row for item in items for row in rows_of(item, options.count, options.poses, options.cache)]
    write_csv(options.rows, rows)


def rows_of(item: Item, count: int, poses: int, cache: Path | None) -> Iterator[dict[str, Any]]:
    """One row for each grasp of each image of an object: its features, and whether it held."""
    pipeline = Pipeline(PipelineConfig().updated({"grasp.count": count}))
    for pose in range(poses):
        for view in VIEWS:
            seen = see(item, pose, view, cache)
            surface, target = Placed(item, seen.pose), find(seen, pipeline)
            for grasp, features in [] if target is None else planned(pipeline, target):
                proposal = Proposal(seen.camera.to_world(np.stack([grasp.g1, grasp.g2])), "", "ok")
                held = Conditions().close(item, seen.pose, surface, proposal).verdict.held
                first = {"object": item.name, "pose": pose, "view": view, "held": int(held), "mass": item.mass_kg}
                yield {**first, **features}


def planned(pipeline: Pipeline, target: FoundObject) -> list[tuple[Grasp, dict[str, float]]]:
    """The grasps of a plan, each with its features."""
    kept: list[tuple[ClosingLines, list[tuple[int, int]]]] = []
    planner: Any = geograsp
    chosen_by = planner.best_lines

    def noted(completed: Any, lines: ClosingLines, count: int) -> list[tuple[int, int]]:
        kept.append((lines, chosen_by(completed, lines, count)))
        return kept[-1][1]

    planner.best_lines = noted
    try:
        plan = pipeline.plan(target)
    finally:
        planner.best_lines = chosen_by
    if not plan.grasps:
        return []
    lines, chosen = kept[0]
    points = target.cloud.xyz.reshape(-1, 3)
    xyz = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    shared = _of_object(plan.counts, lines, xyz, target)
    pairs = enumerate(zip(plan.grasps, chosen, strict=True))
    return [(grasp, {**_of_grasp(k, grasp, lines, *one, xyz), **shared}) for k, (grasp, one) in pairs]


def _of_object(counts: dict[str, int], lines: ClosingLines, xyz: Float64, target: FoundObject) -> dict[str, float]:
    widths = (lines.high - lines.low)[:, lines.low.shape[1] // 2]
    height = float(np.quantile(np.abs(xyz @ target.plane.normal + target.plane.offset), 0.98))
    centre = xyz.mean(axis=0)
    return {
        "narrowest": float(np.nanmin(widths, initial=1.0)),
        "widest": float(np.nanmax(widths, initial=0.0)),
        "height": height,
        "volume": height * float(np.nansum(widths**2)) * np.pi / 4.0 / len(widths),
        "elevation": float(abs(centre @ target.plane.normal) / np.linalg.norm(centre)),
        "free": counts["n_free"] / counts["n_lines"],
        "completed": counts["n_completed"] / counts["n_filtered"],
    }


def _of_grasp(rank: int, grasp: Grasp, lines: ClosingLines, angle: int, line: int, xyz: Float64) -> dict[str, float]:
    unseen = [float(np.linalg.norm(xyz - end, axis=1).min()) for end in (grasp.g1, grasp.g2)]
    middle = lines.low.shape[1] // 2
    near = slice(max(line - 2, 0), line + 3)
    slopes = [float(np.nanstd(side[angle, near])) if near.stop else 0.0 for side in (lines.low, lines.high)]
    across = abs(np.cos(np.pi * angle / lines.low.shape[0]))
    return {
        "score": grasp.score, "rank": rank, "width": float(lines.high[angle, line] - lines.low[angle, line]),
        "level": float(lines.height[angle, line]), "top": float(lines.top[angle, line]), "offset": abs(line - middle),
        "slope_1": max(slopes), "slope_2": min(slopes), "across": across,
        "unseen_1": max(unseen), "unseen_2": min(unseen),
    }  # fmt: skip


def compare(files: list[Path]) -> None:
    """Print AUC and calibration error of each model: objects left out by folds, and whole files left out."""
    tables = [read_csv(path) for path in files]
    rows = [row for table in tables for row in table]
    held = np.array([row["held"] == "1" for row in rows], np.bool_)
    objects = np.array([row["object"] for row in rows])
    sets = np.repeat(np.arange(len(files)), [len(table) for table in tables])
    print(f"{len(rows)} grasps, {len(np.unique(objects))} objects, {held.mean():.3f} held")
    found = []
    for name, model, features in _models():
        x = np.array([[float(row[key]) for key in features] for row in rows])
        folds = [*GroupKFold(min(10, len(np.unique(objects)))).split(x, held, objects)]
        line: dict[str, Any] = {"model": name, **_scores("", held, _left_out(model, x, held, folds))}
        if len(files) > 1:
            ends = [(np.flatnonzero(sets != k), np.flatnonzero(sets == k)) for k in range(len(files))]
            p = _left_out(model, x, held, ends)
            for k, path in enumerate(files):
                line |= _scores(f"{path.stem} ", held[sets == k], p[sets == k])
        found.append(line)
    print_rows(found)


def _models() -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    for name, features in (("score", SCORE_ALONE), ("all", FEATURES), ("all and the true mass", WITH_MASS)):
        yield f"logistic, {name}", make_pipeline(StandardScaler(), LogisticRegression(C=0.1)), features
        trees = ExtraTreesClassifier(300, min_samples_leaf=20, max_features=0.5, random_state=0, n_jobs=1)
        yield f"trees, {name}", trees, features


def _left_out(model: ClassifierMixin, x: Float64, held: Bool, folds: list[tuple[Any, Any]]) -> Float64:
    probability = np.empty(len(x))
    for train, test in folds:
        probability[test] = cast("Any", model).fit(x[train], held[train]).predict_proba(x[test])[:, 1]
    return probability


def _scores(prefix: str, held: Bool, probability: Float64) -> dict[str, float]:
    bins = np.minimum((probability * _BINS).astype(int), _BINS - 1)
    gaps = [abs(float((held[bins == k] - probability[bins == k]).sum())) for k in np.unique(bins)]
    return {f"{prefix}AUC": float(roc_auc_score(held, probability)), f"{prefix}ECE": sum(gaps) / len(held)}


if __name__ == "__main__":
    main()

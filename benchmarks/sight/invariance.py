# SPDX-License-Identifier: Apache-2.0
"""How far do predictions of a known object move when only the recording changes: place, density, roll of the camera?"""

import argparse
import csv
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from foretouch.learning.data import load_dataset
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.types import Cloud, Float64, Grasp, GraspSample

Change = Callable[[Float64, np.random.Generator], tuple[Float64, Float64, Float64]]
"""Points to points, and the rotation and the shift that carry the grasp along."""

_NOWHERE = np.zeros(3)
_STILL = np.eye(3)
COLUMNS = ("model", "change", "grasps", "median", "p95", "largest", "unfamiliar", "newly_unfamiliar", "familiar_p95")


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("FORETOUCH_DATA"), help="folder of the recordings")
    parser.add_argument("--models", nargs="+", default=["contact-v2", "touchnet-v1"], help="names or cards")
    parser.add_argument("--every", type=int, default=1, help="use each k-th recorded grasp")
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent / "results.csv")
    arguments = parser.parse_args()
    samples = load_dataset(Path(arguments.data) / "vision2tactile").samples[:: arguments.every]
    rows = [row for name in arguments.models for row in measure(load_model(name), samples)]
    with arguments.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)


def measure(model: TouchModel, samples: Sequence[GraspSample]) -> Iterator[dict[str, object]]:
    """A row for each change: of each grasp, the largest move of its 50 values in half widths of their intervals."""
    before = [_predict(model, sample.cloud.xyz.reshape(-1, 3), sample.grasp) for sample in samples]
    known = np.array([familiar for _, _, familiar in before])
    for name, change in CHANGES.items():
        rng = np.random.default_rng(0)
        moves, familiar = [], []
        for sample, (counts, half, _) in zip(samples, before, strict=True):
            points = sample.cloud.xyz.reshape(-1, 3).astype(np.float64)
            points, turn, shift = change(points[np.isfinite(points).all(axis=1)], rng)
            grasp = sample.grasp
            carried = Grasp(turn @ grasp.g1 + shift, turn @ grasp.g2 + shift, turn @ grasp.rotation)
            after, _, inside = _predict(model, points, carried)
            moves.append(float((np.abs(after - counts) / half).max()))
            familiar.append(inside)
        flags = np.array(familiar)
        both = np.array(moves)[known & flags]
        row = {
            "model": model.name,
            "change": name,
            "grasps": len(samples),
            "median": round(float(np.median(moves)), 3),
            "p95": round(float(np.quantile(moves, 0.95)), 3),
            "largest": round(max(moves), 3),
            "unfamiliar": round(float((~flags).mean()), 4),
            "newly_unfamiliar": round(float((known & ~flags).mean()), 4),
            "familiar_p95": round(float(np.quantile(both, 0.95)), 3) if len(both) else "",
        }
        print(row, flush=True)
        yield row


def _predict(model: TouchModel, points: Float64, grasp: Grasp) -> tuple[Float64, Float64, bool]:
    (one,) = model.predict(Cloud(points.astype(np.float32)), [grasp])
    if one.value is None or one.upper is None:
        raise SystemExit(f"{model.name}: {one.reason or 'has no calibration'}")
    counts = one.value.vector()
    return counts, one.upper.vector() - counts, "unfamiliar" not in one.flags


def _none(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    del rng
    return points, _STILL, _NOWHERE


def _to_one_metre(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    del rng
    shift = np.array([0.0, 0.0, 1.0 - points[:, 2].mean()])
    return points + shift, _STILL, shift


def _aside(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    del rng
    shift = np.array([0.1, 0.1, 0.0])
    return points + shift, _STILL, shift


def _thinned(share: float) -> Change:
    def change(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
        return points[rng.random(len(points)) < share], _STILL, _NOWHERE

    return change


def _repeated(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    del rng
    return np.concatenate([points, points]), _STILL, _NOWHERE


def _doubled(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    return np.concatenate([points, points + rng.normal(0.0, 0.0005, points.shape)]), _STILL, _NOWHERE


def _turned(degrees: float, axis: int) -> Change:
    def change(points: Float64, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
        del rng
        angle = np.radians(degrees)
        turn = np.eye(3)
        i, j = [k for k in range(3) if k != axis]
        turn[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        centre = points.mean(axis=0) if axis != 2 else _NOWHERE  # a roll is about the optical axis
        return (points - centre) @ turn.T + centre, turn, centre - turn @ centre

    return change


CHANGES: dict[str, Change] = {
    "none": _none,
    "shifted to 1 m": _to_one_metre,
    "shifted aside by 0.14 m": _aside,
    "thinned to 50 %": _thinned(0.5),
    "thinned to 10 %": _thinned(0.1),
    "every point twice": _repeated,
    "doubled with 0.5 mm of noise": _doubled,
    "camera rolled by 90 deg": _turned(90.0, 2),
    "camera rolled by 180 deg": _turned(180.0, 2),
    "camera tilted by 45 deg": _turned(45.0, 0),
}


if __name__ == "__main__":
    main()

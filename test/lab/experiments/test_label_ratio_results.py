# SPDX-License-Identifier: Apache-2.0
"""Differences of the models by hand, the coverage of their intervals, and the figure of the label ratios."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foretouch.errors import DatasetError
from foretouch.tactile import P2_RANGES
from foretouch_lab.experiments.label_ratio.results import TREES, compare_models, draw_models, summarise_models


def row(model: str, seed: int, squared: dict[str, list[float]], **more: Any) -> dict[str, Any]:
    objects = {name: {"squared": values, "reference": [200.0] * len(values)} for name, values in squared.items()}
    facts = {"ratio": 90, "modality": "PDC_TH", "trial": "a", "labelled": 320, "updates": 640}
    return {**facts, "model": model, "seed": seed, "objects": objects, **more}


def test_means_and_deviations_by_hand() -> None:
    errors = (("pointnet", 0, 81.0), ("pointnet", 1, 121.0), ("srgan", 0, 64.0), ("srgan", 1, 100.0))
    rows = [row(model, seed, {"a": [one, one], "b": [one]}) for model, seed, one in errors]
    rows.append(row("srgan", 2, {"a": [1.0, 2.0], "b": [3.0]}))  # a run without its partner is left out
    (told,) = compare_models(rows, P2_RANGES.ranges, draws=200)
    assert (told["pointnet_rmse"], told["srgan_rmse"], told["change"]) == (10.0, 9.0, -10.0)
    assert told["pointnet_sd"] == pytest.approx(np.sqrt(2.0), abs=1e-4)
    assert told["pointnet_percent"] == pytest.approx(100.0 * 10.0 / 900.0, abs=1e-4)
    # Both runs and all samples agree on -1: nothing is left to chance.
    assert (told["change_low"], told["change_high"], told["verdict"]) == (-10.0, -10.0, "better")
    assert (told["runs"], told["samples"], told["p2_change"]) == (2, 3, -6.2)


def test_a_single_run_is_no_verdict_and_trees_and_mean_stand_beside_on_the_same_samples() -> None:
    networks = [row("pointnet", 0, {"a": [4.0]}), row("srgan", 0, {"a": [9.0]})]
    (told,) = compare_models(networks, P2_RANGES.ranges, draws=200)
    assert told["change"] == pytest.approx(50.0)
    assert told["verdict"] is told["change_low"] is told["srgan_sd"] is None
    errors, changes = summarise_models([{"srgan": "chosen", **told}, {"srgan": "other", **told}])
    assert [line[:2] for line in errors.rows] == [
        ["T90 mean of the labels", "14.1"],
        ["T90 trees on geometry", "–"],
        ["T90 PointNet", "2.0"],
        ["T90 SR-GAN chosen", "3.0"],
        ["T90 SR-GAN other", "3.0"],
    ]
    assert [line[:2] for line in changes.rows] == [["T90 chosen", "+50.0"], ["T90 other", "+50.0"]]
    (told,) = compare_models([row(TREES, 0, {"a": [2.25]}), *networks], P2_RANGES.ranges, draws=200)
    assert (told["mean_rmse"], told["trees_rmse"], told["runs"]) == (pytest.approx(200.0**0.5, abs=1e-4), 1.5, 1)
    others = [row("pointnet", 0, {"a": [1.0, 2.0]}), row("srgan", 0, {"a": [1.0], "b": [2.0]})]
    for rows in ([row(TREES, 0, {"b": [2.25]}), *networks], others):
        with pytest.raises(DatasetError, match="not tested on the same samples"):
            compare_models(rows, P2_RANGES.ranges, draws=200)


def cell(ratio: int, high: float | None, verdict: str | None, **more: Any) -> dict[str, Any]:
    found = {"pointnet_rmse": 80.0, "srgan_rmse": 76.0, "pointnet_percent": 2.3, "srgan_percent": 2.2}
    found |= {"mean_rmse": 90.0, "trees_rmse": None, "pointnet_sd": None, "srgan_sd": 1.0, "p2_change": None}
    change = {"change": -5.0, "change_low": None if high is None else -7.0, "change_high": high, "verdict": verdict}
    return {"modality": "E_TH", "ratio": ratio, "srgan": "chosen", **found, **change, **more}


def test_the_figure_is_drawn_of_all_modalities(tmp_path: Path) -> None:
    other = cell(90, None, None, modality="E_MF", change=24.8)
    rows = [cell(90, -3.0, "better"), cell(10, 2.0, "tie"), cell(10, 2.0, "tie", srgan="srgan"), other]
    (path,) = draw_models(rows, tmp_path)
    assert path.stat().st_size > 5000

# SPDX-License-Identifier: Apache-2.0
"""The ceiling on numbers whose answer is known: touches m + noise, of which m can be told."""

from typing import Any

import numpy as np
import pytest

from foretouch.experiments.noise_ceiling import ceiling_rows

GRASPS, SIGMA_M, SIGMA = 4000, 3.0, 4.0  # so 9 / 25 of the variance can be told
TRUE_CEILING = SIGMA_M**2 / (SIGMA_M**2 + SIGMA**2)


def rows(repeats: int, predictors: dict[str, Any]) -> list[dict[str, Any]]:
    """As the cells of `noise_ceiling` make them; a predictor is given the (S, 50) true means."""
    rng = np.random.default_rng(0)
    true = rng.normal(0.0, SIGMA_M, (GRASPS, 50))
    made = true[:, None] + rng.normal(0.0, SIGMA, (GRASPS, repeats, 50))
    mean, spread = made.mean(axis=1), made.var(axis=1, ddof=1)
    share = 1.0 - 1.0 / repeats
    told = [
        {
            "what": "repeats",
            "name": "all",
            "id": str(k),
            "mean": mean[k],
            "rest": share * spread[k],
            "within": spread[k],
            "within_change": spread[k],
            "reference": mean[k] ** 2 + share * spread[k],
        }
        for k in range(GRASPS)
    ]
    for name, predict in predictors.items():
        said = predict(true)
        told += [{"what": "predictor", "name": name, "id": str(k), "predicted": said[k]} for k in range(GRASPS)]
    return told


@pytest.mark.parametrize("repeats", [2, 20])
def test_the_ceiling_does_not_depend_on_the_number_of_repeats(repeats: int) -> None:
    told = {row["modality"]: row for row in ceiling_rows(rows(repeats, {}), 100) if row["name"] == "ceiling"}
    for modality in ("PDC_TH", "E_MF"):
        assert told[modality]["skill"] == pytest.approx(TRUE_CEILING, abs=0.03)
        assert told[modality]["skill_low"] < told[modality]["skill"] < told[modality]["skill_high"]
    assert told["E_TH"]["skill"] == pytest.approx(TRUE_CEILING, abs=0.01)
    assert told["E_TH"]["rmse"] == pytest.approx(SIGMA, rel=0.01)


def test_shares_of_predictors_that_know_all_half_and_nothing() -> None:
    """Half of m leaves a quarter of its variance: 3/4 of the ceiling."""
    knowing = {"all": lambda m: m, "half": lambda m: 0.5 * m, "nothing": np.zeros_like}
    told = {row["name"]: row for row in ceiling_rows(rows(3, knowing), 100) if row["modality"] == "E_TH"}
    assert told["all"]["share"] == pytest.approx(1.0, abs=0.01)
    assert told["half"]["share"] == pytest.approx(0.75, abs=0.01)
    assert told["nothing"]["share"] == pytest.approx(0.0, abs=1e-9)
    assert told["nothing"]["skill"] == pytest.approx(0.0, abs=1e-9)


def test_a_predictor_without_rows_is_left_out() -> None:
    assert {row["name"] for row in ceiling_rows(rows(2, {}), 100)} == {"ceiling", "ceiling, change from the tare"}
    assert ceiling_rows([], 100) == []

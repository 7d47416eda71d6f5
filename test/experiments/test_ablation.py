# SPDX-License-Identifier: Apache-2.0
"""The combined components equal the released model, and variants differ from it in what they leave out."""

from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from every_case import every_case
from experiment_samples import make_samples

from foretouch.experiments import find_experiment
from foretouch.experiments.ablation import BLIND, FEATURE_SETS, FULL, fit_variants
from foretouch.learning.data import labels_of
from foretouch.learning.training.contact import ContactPredictor, describe_samples
from foretouch.models.contact.estimator import by_modality
from foretouch.models.contact.features import CHECKED, CONDITIONS, FEATURES, SLOPE_FEATURES

NONE, TOUCHED, ASKED = np.arange(0), np.arange(3), np.arange(3, 10)


def test_variants_are_the_released_model_without_what_they_leave_out() -> None:
    samples = with_tares(make_samples(5, 10), 30.0)
    train, held = samples[:40], samples[40:]
    models = fit_variants(train, held, FEW_TREES, calibrated=True)
    released = ContactPredictor(train, labels_of(train), FEW_TREES)
    expected = {name: model.recording.expected for name, model in models.items()}

    def check(tare: bool, touched: np.ndarray) -> None:
        wanted = released.predict_after([held[k] for k in touched], held[3:], tare=tare)
        np.testing.assert_allclose(models[FULL].predict(ASKED, touched, tare=tare), wanted, atol=1e-9)

    every_case([(tare, touched) for tare in (False, True) for touched in (NONE, TOUCHED)], check)
    estimator, features = released.estimator, describe_samples(held)
    kernel = estimator.kernel.predict(features[:, len(CONDITIONS) :]) * by_modality(estimator.generalisation_gain)
    np.testing.assert_allclose(expected["kernel alone"], kernel * estimator.deviation + estimator.mean)
    half = (expected["forests alone"] + expected["kernel alone"]) / 2.0
    np.testing.assert_allclose(expected["no gate, half of each"], half)
    assert np.abs(expected["joint forest only"] - expected[FULL]).max() > 1e-3
    for name in ("no shrinkage", "diagonal B"):  # they differ after touches only
        np.testing.assert_array_equal(expected[name], expected[FULL])
        after = models[name].predict(ASKED, TOUCHED, tare=False)
        assert np.abs(after - models[FULL].predict(ASKED, TOUCHED, tare=False)).max() > 1e-3
    mean = models[BLIND]
    np.testing.assert_allclose(mean.predict(ASKED, NONE, tare=False), np.tile(mean.recording.expected[0], (7, 1)))
    assert np.abs(mean.predict(ASKED, TOUCHED, tare=True) - mean.recording.expected[ASKED]).max() > 1e-3
    whole, diagonal = (models[name].calibration.tracker for name in (FULL, "diagonal B"))
    for part in ("slow", "fast", "object", "noise", "tare_noise"):
        wanted = getattr(whole, part) @ (whole.basis**2).T
        np.testing.assert_allclose(getattr(diagonal, part) @ (diagonal.basis**2).T, wanted)
    rows = {name: describe(held) for name, describe in FEATURE_SETS.items()}
    for one in rows.values():  # they begin with what novelty is detected by
        np.testing.assert_array_equal(one[:, : len(CHECKED)], features[:, : len(CHECKED)])
    assert rows["without slopes"].shape[1] == len(FEATURES) - len(SLOPE_FEATURES)


def _row(table: str, name: str, who: str, squared: float) -> dict:
    errors = {"squared": [squared] * 50, "reference": [10.0] * 50}
    return {"table": table, "part": "0", "seed": 0, "predictor": name, "object": who, "count": 5, **errors}


def test_differences_are_from_the_full_model_or_from_no_adaptation(tmp_path: Path) -> None:
    cases = (("parts", FULL, 5.0), ("parts", "less", 6.0), ("lean", "nothing", 8.0), ("lean", "tare", 4.0))
    rows = [_row(table, name, f"o{k}", squared) for table, name, squared in cases for k in range(8)]
    experiment = find_experiment("ablation")
    table = experiment.tabulate(experiment.resolve("smoke", {}), rows)
    by_name = {(row["table"], row["predictor"]): row for row in table if row["modality"] == "E_TH"}
    assert by_name["parts", "less"]["difference"] == pytest.approx(-0.1)
    assert by_name["parts", "less"]["difference_verdict"] == "worse"
    assert by_name["lean", "tare"]["difference"] == pytest.approx(0.4)
    found, parts, lean = experiment.summarise(table)
    assert found.notes == ["parts: mean skill of full .50, less .40▼", "lean: mean skill of nothing .20, tare .60▲"]
    assert [one.title.rpartition(" ")[2] for one in (parts, lean)] == ["`full`", "`nothing`"]
    assert parts.rows[1][1].startswith("0.400 (-0.100 ▼")
    (figure,) = experiment.draw(table, tmp_path)
    assert figure.stat().st_size > 5000


@pytest.mark.slow
@pytest.mark.real_data
def test_sweep(swept, real_data: Path) -> None:
    rows = swept("ablation", real_data / "vision2tactile", samples=10, **{"contact.trees": 2})
    assert {row["predictor"] for row in rows} >= {FULL, BLIND, "kernel alone", "without slopes"}

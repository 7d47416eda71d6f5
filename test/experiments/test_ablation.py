# SPDX-License-Identifier: Apache-2.0
"""The combined components equal the released model, and variants differ from it in what they leave out."""

from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import FEW_TREES, with_tares
from experiment_samples import make_samples

from foretouch.experiments import find_experiment, run_sweep
from foretouch.experiments.ablation.variants import FEATURE_SETS, FULL, ModelVariant, fit_variants
from foretouch.learning.data import labels_of
from foretouch.learning.training.contact import ContactPredictor, describe_samples
from foretouch.models.contact.estimator import by_modality
from foretouch.models.contact.features import CHECKED, CONDITIONS, FEATURES, SLOPE_FEATURES

NONE, TOUCHED, ASKED = np.arange(0), np.arange(3), np.arange(3, 10)


@pytest.fixture(scope="module")
def sides() -> tuple[list, list]:
    samples = with_tares(make_samples(5, 10), 30.0)
    return samples[:40], samples[40:]


@pytest.fixture(scope="module")
def models(sides) -> dict[str, ModelVariant]:
    return fit_variants(*sides, FEW_TREES, calibrated=True)


@pytest.fixture(scope="module")
def released(sides) -> ContactPredictor:
    return ContactPredictor(sides[0], labels_of(sides[0]), FEW_TREES)


@pytest.mark.parametrize("tare", [False, True])
@pytest.mark.parametrize("touched", [NONE, TOUCHED])
def test_the_full_model_is_the_released_one(models, released, sides, tare: bool, touched: np.ndarray) -> None:
    held = sides[1]
    expected = released.predict_after([held[k] for k in touched], held[3:], tare=tare)
    np.testing.assert_allclose(models[FULL].predict(ASKED, touched, tare=tare), expected, atol=1e-9)


def test_combinations(models, released, sides) -> None:
    """The kernel by itself, and half of each as the mean of both."""
    estimator = released.estimator
    inputs = describe_samples(sides[1])[:, len(CONDITIONS) :]
    kernel = (
        estimator.kernel.predict(inputs) * by_modality(estimator.generalisation_gain) * estimator.deviation
        + estimator.mean
    )
    np.testing.assert_allclose(models["kernel alone"].recording.expected, kernel)
    half = (models["forests alone"].recording.expected + models["kernel alone"].recording.expected) / 2.0
    np.testing.assert_allclose(models["no gate, half of each"].recording.expected, half)
    assert np.abs(models["joint forest only"].recording.expected - models[FULL].recording.expected).max() > 1e-3


def test_variants_that_differ_only_after_touches(models) -> None:
    for name in ("no shrinkage", "diagonal B"):
        np.testing.assert_array_equal(models[name].recording.expected, models[FULL].recording.expected)
        after = models[name].predict(ASKED, TOUCHED, tare=False)
        assert np.abs(after - models[FULL].predict(ASKED, TOUCHED, tare=False)).max() > 1e-3
    whole, diagonal = (models[name].calibration.tracker for name in (FULL, "diagonal B"))
    for part in ("slow", "fast", "object", "noise", "tare_noise"):
        wanted = getattr(whole, part) @ (whole.basis**2).T
        np.testing.assert_allclose(getattr(diagonal, part) @ (diagonal.basis**2).T, wanted)


def test_feature_sets_begin_with_what_novelty_is_detected_by(sides) -> None:
    rows = {name: describe(sides[1]) for name, describe in FEATURE_SETS.items()}
    objects = describe_samples(sides[1])[:, : len(CHECKED)]
    for one in rows.values():
        np.testing.assert_array_equal(one[:, : len(CHECKED)], objects)
    assert rows["without slopes"].shape[1] == len(FEATURES) - len(SLOPE_FEATURES)


def _row(table: str, name: str, who: str, squared: float) -> dict:
    errors = {"squared": [squared] * 50, "reference": [10.0] * 50}
    return {"table": table, "part": "0", "seed": 0, "predictor": name, "object": who, "count": 5, **errors}


def test_differences_are_from_the_full_model_or_from_no_adaptation(tmp_path: Path) -> None:
    objects = [f"o{k}" for k in range(8)]
    rows = [_row("parts", FULL, one, 5.0) for one in objects] + [_row("parts", "less", one, 6.0) for one in objects]
    rows += [_row("lean", "nothing", one, 8.0) for one in objects] + [_row("lean", "tare", one, 4.0) for one in objects]
    experiment = find_experiment("ablation")
    table = experiment.tabulate(experiment.resolve("smoke", {}), rows)
    by_name = {(row["table"], row["predictor"]): row for row in table if row["modality"] == "E_TH"}
    assert by_name["parts", "less"]["difference"] == pytest.approx(-0.1)
    assert by_name["parts", "less"]["difference_verdict"] == "worse"
    assert by_name["lean", "tare"]["difference"] == pytest.approx(0.4)
    tables = experiment.summarise(table)
    assert tables[0].notes == ["parts: mean skill of full .50, less .40▼", "lean: mean skill of nothing .20, tare .60▲"]
    assert [one.title.rpartition(" ")[2] for one in tables[1:]] == ["`full`", "`nothing`"]
    assert tables[1].rows[1][1].startswith("0.400 (-0.100 ▼")
    (figure,) = experiment.draw(table, tmp_path)
    assert figure.stat().st_size > 5000


@pytest.mark.real_data
@pytest.mark.usefixtures("in_this_process")
def test_sweep(tmp_path: Path, real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    experiment = find_experiment("ablation")
    settings = experiment.resolve("smoke", {"samples": 10, "contact.trees": 2})
    result = run_sweep(experiment, settings, tmp_path / "out", source=real_data / "vision2tactile")
    assert result.failures == {}
    assert {row["predictor"] for row in result.rows} >= {FULL, "kernel alone", "without slopes"}
    assert experiment.summarise(result.rows)

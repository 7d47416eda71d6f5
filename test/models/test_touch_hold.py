# SPDX-License-Identifier: Apache-2.0
"""Whether a grasp will hold: what the model sees, its arithmetic against plain loops, and its files."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import ModelError
from foretouch.models.registry import available_models, load_model
from foretouch.models.touch_hold import TouchHold, load_touch_hold, patterns

RNG = np.random.default_rng(0)


def test_a_pattern_is_what_is_left_without_level_and_spread_of_each_finger() -> None:
    readings = RNG.uniform(100.0, 4000.0, (5, 3, 24))
    moved = readings * RNG.uniform(0.5, 2.0, (5, 3, 1)) + RNG.uniform(-500.0, 500.0, (5, 3, 1))
    assert_allclose(patterns(moved), patterns(readings), atol=1e-9)
    assert_allclose(patterns(readings).reshape(5, 3, 24).std(axis=-1), 1.0)
    assert_allclose(patterns(np.full((1, 3, 24), 7.0)), 0.0)  # not NaN, where a finger reads one number


def test_the_released_model_computes_what_its_file_says() -> None:
    model, card = load_touch_hold()
    readings = RNG.uniform(1000.0, 3500.0, (3, 3, 24))
    for reading, chance in zip(readings, model.chance(readings), strict=True):
        row, logits = patterns(reading[None])[0], []
        for k in range(len(model.out_bias)):
            units = [math.tanh(row @ model.hidden[k, :, h] + model.hidden_bias[k, h]) for h in range(len(model.out[k]))]
            logits.append(
                sum(unit * weight for unit, weight in zip(units, model.out[k], strict=True)) + model.out_bias[k]
            )
        slope, offset = model.calibration
        assert chance == pytest.approx(1.0 / (1.0 + math.exp(-slope * np.mean(logits) - offset)), rel=1e-9)
    seen = patterns(readings)
    assert_allclose(model.outside(readings), ((seen < model.low) | (seen > model.high)).mean(axis=1))
    assert card["data"]["licence"] == "MIT"
    assert card["skill"]["objects"]["hold"]["auc_low"] >= 0.85  # below, it is not to be published
    assert card["limits"]


def test_files_that_are_not_of_this_model_are_refused(tmp_path: Path) -> None:
    assert "touch-hold" not in available_models()
    card = Path(__file__).parents[2] / "src/foretouch/models/weights/hold/touch-hold.json"
    with pytest.raises(ModelError, match="predicts whether a grasp holds, and no touch"):
        load_model(card)
    with pytest.raises(ModelError, match="kind: contact is not hold"):
        load_touch_hold(card.parents[1] / "contact-v3.json")
    facts = json.loads(card.read_text())
    (tmp_path / "touch-hold.json").write_text(json.dumps(facts))
    weights = tmp_path / "touch-hold.safetensors"
    weights.write_bytes(card.with_suffix(".safetensors").read_bytes())
    (tmp_path / "five.json").write_text(json.dumps(facts | {"config": {"fingers": list("abcde")}}))
    with pytest.raises(ModelError, match=r"config\.fingers: are not those of 72 numbers"):
        load_touch_hold(tmp_path / "five.json")
    weights.write_bytes(b"other")
    with pytest.raises(ModelError, match="damaged or replaced"):
        load_touch_hold(tmp_path / "touch-hold.json")
    tensors = load_touch_hold()[0].to_tensors()
    with pytest.raises(ModelError, match="out: shape"):
        TouchHold.from_tensors({**tensors, "out": tensors["out"][:, :-1]})
    with pytest.raises(ModelError, match=r"low: .* not within"):
        TouchHold.from_tensors({**tensors, "low": np.full(72, np.nan)})

# SPDX-License-Identifier: Apache-2.0
"""Files of a contact model and of calibrations: exact round trip, every damage reported by file and field."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated_models import FACTS, make_calibration
from contact_model_builders import edit_card, small_estimator
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_array_equal

from foretouch.errors import FileError, ModelError
from foretouch.models.calibration import Calibration
from foretouch.models.card import load_calibration, read_card
from foretouch.models.contact.estimator import save_contact
from foretouch.models.files import packed, read_tensors
from foretouch.models.novelty import Fallback, object_sizes
from foretouch.models.registry import load_model
from foretouch.models.touch_model import History, TouchModel
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch_lab.learning.network.networks import save_network

SAMPLES = make_samples(5, 10)
TARE = biotac_touch(make_calibration().rest + 12.0)


@pytest.fixture
def card(tmp_path: Path) -> Path:
    facts = {"summary": "a toy", "limits": ["none"]}
    return save_contact(tmp_path, "toy", small_estimator(), facts, (make_calibration(), FACTS))


def rewrite(card: Path, name: str, value: Any, *, calibration: bool = False) -> None:
    """Change a tensor and make the card's hash fit, so that only the deeper check can find it."""
    facts = json.loads(card.read_text())
    mine = facts["calibration"] if calibration else facts
    path, tensors = read_tensors(card, mine)
    tensors = {key: array for key, array in ({**tensors, name: value}).items() if array is not None}
    content, mine["sha256"] = packed(tensors)
    path.write_bytes(content)
    card.write_text(json.dumps(facts))


def everything(model: TouchModel) -> np.ndarray:
    """Values and bounds without adaptation, with a tare, and with touches."""
    history = History(model)
    for sample in SAMPLES[:3]:
        history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=True)
    found = []
    for adapted in ({}, {"tare": TARE}, {"history": history.at(SAMPLES[3].stamp_ns, same_object=True)}):
        for sample in SAMPLES[5::8]:
            (one,) = model.predict(sample.cloud, [sample.grasp], **adapted)
            found += [one.value.values, one.lower.values, one.upper.values]
    return np.array(found)


def test_a_loaded_model_predicts_as_the_saved_one_to_the_bit_and_a_full_disk_leaves_it(card: Path, full_disk) -> None:
    saved = TouchModel(small_estimator(), {"name": "toy", "sha256": ""}, make_calibration())
    assert_array_equal(everything(load_model(card)), everything(saved))
    assert_array_equal(everything(load_model(card.with_suffix(".safetensors"))), everything(saved))
    facts = read_card(card)
    assert (facts["kind"], facts["name"], facts["summary"], facts["limits"]) == ("contact", "toy", "a toy", ["none"])
    assert [facts["calibration"][name] for name in ("level", "weights")] == [FACTS["level"], "toy.trust.safetensors"]
    assert {path.name for path in card.parent.iterdir()} == {"toy.json", "toy.safetensors", "toy.trust.safetensors"}
    assert (load_model(card).name, load_model(card).sha256) == ("toy", facts["sha256"])
    before = {path.name: path.read_bytes() for path in card.parent.iterdir()}
    with full_disk("toy.json"), pytest.raises(FileError, match=r"toy.json: cannot be written, the one before is kept"):
        save_contact(card.parent, "toy", small_estimator(), {}, (make_calibration(seed=1), FACTS))
    assert {path.name: path.read_bytes() for path in card.parent.iterdir()} == before


def test_a_model_without_calibration_has_no_bounds_and_a_networks_brings_its_fallback(tmp_path: Path, make_net) -> None:
    card = save_contact(tmp_path, "bare", small_estimator(), {})
    assert load_calibration(card, read_card(card), BIOTAC) == (None, None)
    (prediction,) = load_model(card).predict(SAMPLES[0].cloud, [SAMPLES[0].grasp])
    assert not prediction.calibrated
    sizes = np.array([object_sizes(sample.cloud.xyz) for sample in SAMPLES])
    fallback = Fallback.fit(BIOTAC, sizes, np.tile(np.linspace(1000.0, 3000.0, 50), (len(SAMPLES), 1)))
    card = save_network(tmp_path, "net", make_net(), {}, (make_calibration(), FACTS), fallback)
    calibration, found = load_calibration(card, read_card(card), BIOTAC)
    assert isinstance(calibration, Calibration)
    for name, array in fallback.to_tensors().items():
        assert_array_equal(found.to_tensors()[name], array)
    sample = SAMPLES[0]
    (prediction,) = load_model(card).predict(sample.cloud, [sample.grasp])
    inside = fallback.score(sizes[0]) >= 0.5
    assert ("unfamiliar" in prediction.flags) is not inside


def test_absent_replaced_and_unfit_files_are_named_with_file_and_field(card: Path) -> None:
    for which in ("toy.safetensors", "toy.trust.safetensors"):
        path = card.with_name(which)
        original = path.read_bytes()
        path.write_bytes(original[:-1] + bytes([original[-1] ^ 1]))
        with pytest.raises(ModelError, match=rf"{which}: sha256: .* of toy.json; damaged or replaced"):
            load_model(card)
        path.unlink()
        with pytest.raises(ModelError, match=rf"{which}: no such weights; toy.json names them"):
            load_model(card)
        path.write_bytes(original)
    files = {path: path.read_bytes() for path in card.parent.iterdir()}

    def check(rule: str, name: str, value: Any) -> None:
        for path, content in files.items():
            path.write_bytes(content)
        rewrite(card, name, value, calibration=".trust." in rule)
        with pytest.raises(ModelError, match=rule):
            load_model(card)

    cases = [
        ("toy.safetensors: mean: is missing", "mean", None),
        ("toy.safetensors: forest_E_MF/leaf: shape", "forest_E_MF/leaf", np.zeros(3, np.int32)),
        ("toy.trust.safetensors: rest: is missing", "rest", None),
    ]
    every_case(cases, check)


def test_a_card_that_cannot_be_right_is_refused_by_field(card: Path) -> None:
    original = card.read_text()

    def check(rule: str, changes: dict[str, Any]) -> None:
        card.write_text(original)
        edit_card(card, **changes)
        with pytest.raises(ModelError, match=rule):
            load_model(card)

    cases = [
        ("toy.json: weights: is missing", {"weights": ...}),
        ("toy.json: calibration: 'yes' is not a mapping or null", {"calibration": "yes"}),
        ("toy.json: calibration.sha256: is missing", {"calibration": {"weights": "x.safetensors"}}),
        ("toy.json: ranges: .*e_th", {"ranges": {"e_th": [9.0, 1.0]}}),
        ("toy.json: ranges: e_xx: unknown", {"ranges": {"e_xx": [1.0, 9.0]}}),
        ("toy.json: ranges: 5 is not a mapping", {"ranges": 5}),
    ]
    every_case(cases, check)
    card.write_text(original)
    edit_card(card, weights="../../elsewhere/toy.safetensors")  # weights are looked for beside the card only
    assert load_model(card).name == "toy"

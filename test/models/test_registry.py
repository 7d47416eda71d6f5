# SPDX-License-Identifier: Apache-2.0
"""Finding models by name and path (damage: `test_checkpoint.py` and `test_contact_checkpoint.py`)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import small_estimator
from experiment_samples import make_samples

from foretouch.errors import ModelError
from foretouch.models.contact.checkpoint import save_contact
from foretouch.models.network.checkpoint import save_ensemble, save_network
from foretouch.models.registry import DEFAULT_MODEL, available_models, find_card, load_model
from foretouch.tactile.modalities import MODALITIES

SAMPLE = make_samples(1, 1)[0]


@pytest.fixture
def contact(tmp_path: Path) -> Path:
    return save_contact(tmp_path, "toy", small_estimator(), {})


def test_names_cards_and_weights_lead_to_the_card(contact: Path) -> None:
    assert find_card(contact) == find_card(contact.with_suffix(".safetensors")) == contact
    assert find_card("default") == find_card(DEFAULT_MODEL)
    for name in available_models():
        assert find_card(name).stem == name


def test_what_is_no_model_is_refused_with_the_names_that_are(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=f"touchnet: is no card .* and none of {DEFAULT_MODEL}"):
        find_card("touchnet")
    with pytest.raises(ModelError, match=r"absent.json: no such model card"):
        load_model(tmp_path / "absent.safetensors")


def test_each_kind_loads_and_predicts(contact: Path, make_net, small, tmp_path: Path) -> None:
    network = save_network(tmp_path, "net", make_net(), {})
    parts = [save_network(tmp_path, name, make_net(small.replace(outputs=(name,))), {}) for name in MODALITIES]
    ensemble = save_ensemble(tmp_path, "all", parts)
    for card in (contact, network, ensemble):
        model = load_model(card)
        (prediction,) = model.predict(SAMPLE.cloud, [SAMPLE.grasp])
        assert (model.name, prediction.status, prediction.lower) == (card.stem, "ok", None)
        assert np.isfinite(prediction.value.vector()).all()


def test_a_contact_model_is_no_part_of_an_ensemble_of_networks(contact: Path, make_net, small, tmp_path: Path) -> None:
    network = save_network(tmp_path, "net", make_net(), {})
    card = save_ensemble(tmp_path, "all", [network])
    card.write_text(card.read_text().replace("net.json", "toy.json"))
    with pytest.raises(ModelError, match=r"toy.json: kind"):
        load_model(card)


def test_a_contact_model_is_loaded_and_asked_without_torch(contact: Path) -> None:
    code = f"""
import sys, numpy as np
from foretouch.models.registry import load_model
from foretouch.types import Cloud, Grasp
cloud = Cloud(np.random.default_rng(0).normal(size=(99, 3)).astype(np.float32))
load_model({str(contact)!r}).predict(cloud, [Grasp(np.zeros(3), np.ones(3), np.eye(3))])
sys.exit(any(name in sys.modules for name in ("torch", "sklearn")))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

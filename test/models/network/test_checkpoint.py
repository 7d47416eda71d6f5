# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: exact roundtrip, and a refusal that names file and field for everything that can be wrong."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from contact_model_builders import edit_card
from every_case import every_case
from safetensors.torch import load_file, save_file

from foretouch.base.files import file_sha256
from foretouch.errors import ModelError
from foretouch.models.network.checkpoint import load_network
from foretouch.models.network.folding import tensor_shapes
from foretouch.models.registry import load_model
from foretouch_lab.learning.network.networks import TouchNet, save_network


@pytest.fixture
def card(tmp_path: Path, make_net) -> Path:
    return save_network(tmp_path, "tiny", make_net(), {"limits": ["a toy"]})


def refused(card: Path, rule: str) -> None:
    with pytest.raises(ModelError, match=rule):
        load_model(card)


def test_roundtrip_is_exact_and_can_be_trained_on(card: Path, make_net) -> None:
    state = torch.random.get_rng_state()
    config, tensors, facts = load_network(card)
    net = TouchNet.of(config, tensors)
    assert torch.equal(torch.random.get_rng_state(), state)
    for key, value in make_net().state_dict().items():
        assert torch.equal(net.state_dict()[key], value), key
    assert {key: tuple(value.shape) for key, value in tensors.items()} == tensor_shapes(config)
    assert not net.training
    assert (facts["limits"], facts["calibration"]) == (["a toy"], None)
    assert facts["sha256"] == file_sha256(card.with_suffix(".safetensors"))
    assert load_model(card.with_suffix(".safetensors")).name == "tiny"
    net.train()(torch.randn(4, 64, 3), torch.randn(4, 15)).sum().backward()
    assert all(parameter.grad is not None for parameter in net.parameters())


def test_wrong_weights_are_named(card: Path) -> None:
    """With a hash that fits, so that only the deeper check can find them."""
    weights = card.with_suffix(".safetensors")
    original = weights.read_bytes()

    def check(rule: str, change: Callable[[dict[str, Any]], Any]) -> None:
        weights.write_bytes(original)
        tensors = load_file(weights)
        change(tensors)
        save_file(tensors, weights)
        edit_card(card, sha256=file_sha256(weights))
        refused(card, rule)

    cases = [
        (r"output.bias: .* \(24,\) is not .* \(50,\)", lambda t: t.update({"output.bias": torch.zeros(24)})),
        ("output.bias: float16", lambda t: t.update({"output.bias": torch.zeros(50).half()})),
        ("output.bias: is missing; the card describes another", lambda t: t.pop("output.bias")),
        ("extra: is not part of the card's architecture", lambda t: t.update({"extra": torch.zeros(1)})),
        ("output.bias: holds a value that is not finite", lambda t: t["output.bias"].fill_(float("nan"))),
    ]
    every_case(cases, check)


def test_wrong_cards_and_what_is_none_are_named(card: Path, make_net, small, tmp_path: Path) -> None:
    original = card.read_text()

    def check(rule: str, changes: dict[str, Any]) -> None:
        card.write_text(original)
        edit_card(card, **changes)
        refused(card, rule)

    config = json.loads(original)["config"]
    cases = [
        ("tiny.json: format: is not a foretouch-model card", {"format": "other"}),
        ("format_version: 1 is not 2", {"format_version": 1}),
        ("kind: 'tree' is not one of network, networks, contact", {"kind": "tree"}),
        ("skill: is missing", {"skill": ...}),
        ("config: widht: unknown setting; known: n_points", {"config": {"widht": 3}}),
        (r"head.1.linear.bias: .*\(8,\) is not .*\(9,\)", {"config": {**config, "head_widths": [16, 9]}}),
        ("gone.safetensors: no such weights", {"weights": "gone.safetensors"}),
        ("familiar: must give", {"familiar": {"range_m": [0, 1]}}),
        ("calibration.weights: is missing", {"calibration": {}}),
    ]
    every_case(cases, check)
    part = save_network(tmp_path, "one", make_net(small.replace(outputs=("PDC_TH", "E_TH"))), {})
    refused(part, "one.json: outputs: PDC_MF, E_MF: not predicted by this network")
    (tmp_path / "x.json").write_text("{")
    refused(tmp_path / "x.json", r"x\.json: not JSON")

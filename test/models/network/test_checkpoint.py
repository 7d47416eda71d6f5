# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: exact roundtrip, and a refusal that names file and field for everything that can be wrong."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from foretouch.checked_files import file_sha256
from foretouch.errors import FileError, ModelError
from foretouch.models.network.checkpoint import load_network, save_ensemble, save_network
from foretouch.models.registry import load_model


@pytest.fixture
def card(tmp_path: Path, make_net) -> Path:
    return save_network(tmp_path, "tiny", make_net(), {"limits": ["a toy"]})


def edit(card: Path, **changes) -> None:
    document = json.loads(card.read_text())
    for key, value in changes.items():
        if value is ...:
            del document[key]
        else:
            document[key] = value
    card.write_text(json.dumps(document))


def rewrite(card: Path, change) -> None:
    """Change the weights and make the card's hash fit, so that only the deeper check can find it."""
    weights = card.with_suffix(".safetensors")
    tensors = load_file(weights)
    change(tensors)
    save_file(tensors, weights)
    edit(card, sha256=file_sha256(weights))


def test_roundtrip_is_exact(card: Path, make_net) -> None:
    net, facts = load_network(card)
    for key, value in make_net().state_dict().items():
        assert torch.equal(net.state_dict()[key], value), key
    assert not net.training
    assert facts["limits"] == ["a toy"]
    assert facts["calibration"] is None
    assert facts["sha256"] == file_sha256(card.with_suffix(".safetensors"))


@pytest.mark.parametrize("full", ["tiny.safetensors", "tiny.json"])
def test_a_full_disk_leaves_the_checkpoint_before(card: Path, make_net, full: str) -> None:
    before = {path.name: path.read_bytes() for path in card.parent.iterdir()}
    card.with_name(f"{full}.part").symlink_to("/dev/full")
    with pytest.raises(FileError, match=rf"{full}: cannot be written, the one before is kept: No space left"):
        save_network(card.parent, "tiny", make_net(seed=5), {"limits": ["another"]})
    assert {path.name: path.read_bytes() for path in card.parent.iterdir()} == before
    load_network(card)


def test_one_flipped_byte_is_refused(card: Path) -> None:
    weights = card.with_suffix(".safetensors")
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ModelError, match=r"tiny.safetensors: sha256: .* damaged or replaced"):
        load_model(card)


def test_truncated_weights_are_refused(card: Path) -> None:
    weights = card.with_suffix(".safetensors")
    weights.write_bytes(weights.read_bytes()[:100])
    edit(card, sha256=file_sha256(weights))
    with pytest.raises(ModelError, match=r"tiny.safetensors: damaged"):
        load_model(card)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update({"output.bias": torch.zeros(24)}), r"output.bias: .* \(24,\) is not .* \(50,\)"),
        (lambda t: t.update({"output.bias": torch.zeros(50).half()}), r"output.bias: torch.float16"),
        (lambda t: t.pop("output.bias"), r"output.bias: is missing; the card describes another architecture"),
        (lambda t: t.update({"extra": torch.zeros(1)}), r"extra: is not part of the card's architecture"),
        (lambda t: t["output.bias"].fill_(float("nan")), r"output.bias: holds a value that is not finite"),
    ],
)
def test_wrong_weights_are_named(card: Path, change, message: str) -> None:
    rewrite(card, change)
    with pytest.raises(ModelError, match=message):
        load_model(card)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "tiny.json: format: is no foretouch-model card"),
        ({"format_version": 2}, "format_version: 2 is not 1"),
        ({"kind": "tree"}, "kind: 'tree' is none of network, contact, ensemble"),
        ({"skill": ...}, "skill: is missing"),
        ({"data": 3}, "data: 3 is of type int"),
        ({"config": {"widht": 3}}, "config: widht: unknown setting; known: n_points"),
        ({"config": {"n_points": "many"}}, "n_points: 'many' is not a whole number"),
        ({"weights": "gone.safetensors"}, "gone.safetensors: no such weights"),
        ({"familiar": {"range_m": [0, 1]}}, "familiar: must give"),
        ({"calibration": {}}, "calibration.weights: is missing"),
    ],
)
def test_wrong_cards_are_named(card: Path, changes, message: str) -> None:
    edit(card, **changes)
    with pytest.raises(ModelError, match=message):
        load_model(card)


def test_card_of_another_architecture(card: Path) -> None:
    document = json.loads(card.read_text())
    document["config"]["head_widths"] = [16, 9]
    card.write_text(json.dumps(document))
    with pytest.raises(ModelError, match=r"head.1.linear.bias: .*\(8,\) is not .*\(9,\)"):
        load_model(card)


def test_not_json_and_absent(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(ModelError, match=r"x\.json: not JSON"):
        load_model(tmp_path / "x.json")
    with pytest.raises(ModelError, match=r"y\.json: no such model card"):
        load_model(tmp_path / "y.json")
    with pytest.raises(ModelError, match="nonsense: is no run folder, no card"):
        load_model("nonsense")


def test_weights_path_finds_its_card(card: Path) -> None:
    assert load_model(card.with_suffix(".safetensors")).name == "tiny"


def test_a_model_of_one_modality_is_refused_alone(tmp_path: Path, small, make_net) -> None:
    card = save_network(tmp_path, "one", make_net(small.replace(outputs=("PDC_TH",))), {})
    with pytest.raises(ModelError, match="one: outputs: PDC_MF is predicted by 0 networks"):
        load_model(card)


def test_an_ensemble_notices_a_replaced_member(tmp_path: Path, small, make_net) -> None:
    cards = [
        save_network(tmp_path, name.lower(), make_net(small.replace(outputs=(name,)), seed=k), {})
        for k, name in enumerate(("PDC_TH", "PDC_MF", "E_TH", "E_MF"))
    ]
    ensemble = save_ensemble(tmp_path, "papers", cards)
    assert load_model(ensemble).name == "papers"
    save_network(tmp_path, "pdc_th", make_net(small.replace(outputs=("PDC_TH",)), seed=9), {})
    with pytest.raises(ModelError, match=r"papers.json: sha256: .* one was replaced"):
        load_model(ensemble)


def test_loading_leaves_the_global_generator(card: Path) -> None:
    state = torch.random.get_rng_state()
    load_network(card)
    assert torch.equal(torch.random.get_rng_state(), state)


def test_a_loaded_network_can_be_trained_on(card: Path) -> None:
    net, _ = load_network(card)
    net.train()(torch.randn(4, 64, 3), torch.randn(4, 15)).sum().backward()
    assert all(parameter.grad is not None for parameter in net.parameters())

# SPDX-License-Identifier: Apache-2.0
"""Finding models by name, path and model folder (damaged files: `*/test_checkpoint.py`)."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from calibrated_models import save_small_network
from contact_model_builders import can_with_grasps, small_estimator

from foretouch.errors import ModelError
from foretouch.models.contact.estimator import save_contact
from foretouch.models.registry import DEFAULT_MODEL, available_models, find_card, load_model
from foretouch_lab.learning.network.networks import save_network


@pytest.fixture
def contact(tmp_path: Path) -> Path:
    return save_contact(tmp_path, "toy", small_estimator(), {})


def test_names_cards_and_weights_lead_to_the_card(contact: Path) -> None:
    assert find_card(contact) == find_card(contact.with_suffix(".safetensors")) == contact
    assert find_card("default") == find_card(DEFAULT_MODEL)
    assert [find_card(name).stem for name in available_models()] == list(available_models())


def test_what_is_no_model_and_a_folder_without_one_are_refused(tmp_path: Path) -> None:
    for name in ("touchnet", "contact-v1"):
        with pytest.raises(ModelError, match=f"{name}: is not a model folder, .* and none of contact-v3, simulated"):
            find_card(name)
    with pytest.raises(ModelError, match=r"absent.json: no such model card"):
        load_model(tmp_path / "absent.safetensors")
    folder = tmp_path / "none"
    folder.mkdir()
    (folder / "notes.json").write_text("[1]")
    with pytest.raises(ModelError, match=rf"^{folder}: holds no model card \(<name>.json\)"):
        load_model(folder)


def test_a_run_folder_leads_to_its_only_card_and_an_unfinished_one_is_refused(contact: Path, tmp_path: Path) -> None:
    assert find_card(contact.parent) == find_card(str(contact.parent)) == contact
    assert load_model(contact.parent).sha256 == load_model(contact).sha256
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "state.safetensors").write_bytes(b"")
    with pytest.raises(ModelError, match=rf"^{folder}: is an unfinished run without a model card; .*--resume"):
        load_model(folder)


def test_a_folder_with_several_models_or_a_damaged_card_is_refused_by_name(contact: Path, make_net) -> None:
    save_network(contact.parent, "net", make_net(), {})
    with pytest.raises(ModelError, match=rf"^{contact.parent}: holds several models, net.json, toy.json: name the"):
        find_card(contact.parent)
    (contact.parent / "net.json").unlink()
    contact.write_text("{")
    with pytest.raises(ModelError, match=r"toy.json: not JSON"):
        load_model(contact.parent)


def test_a_network_predicts_where_torch_is_not_installed(tmp_path: Path) -> None:
    model_card = save_small_network(tmp_path, "small", np.linspace(1700.0, 3300.0, 50))
    cloud, (grasp,) = can_with_grasps(1)
    np.save(tmp_path / "can.npy", cloud.xyz)
    code = f"""
import sys, numpy as np
sys.modules["torch"] = None
from foretouch import Cloud, Grasp, load_model
xyz = np.load({str(tmp_path / "can.npy")!r})
grasp = Grasp(np.array([0.0, 0.034, 1.148]), np.array([0.0, -0.034, 1.148]), np.array({grasp.rotation.tolist()!r}))
sys.exit(not load_model({str(model_card)!r}).predict(Cloud(xyz), [grasp]).ok.all())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

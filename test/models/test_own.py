# SPDX-License-Identifier: Apache-2.0
"""Predictors of the user: how they are found, and what a bad one gives."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from contact_model_builders import can_with_grasps
from experiment_samples import make_samples
from own_predictors import MEAN, Bad, Constant, Familiar, Memory, NoTable, Widths

from foretouch.errors import ModelError
from foretouch.models.own import find_predictor, save_own
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.types import Cloud, Grasps

CAN, GRASPS = can_with_grasps(3)
CARD = {"kind": "own", "name": "bad", "sha256": ""}


def test_a_predictor_is_an_object_a_class_or_a_name() -> None:
    predictor = Constant()
    assert find_predictor(predictor) is predictor
    for named in (Constant, "own_predictors:Constant", lambda: predictor):
        assert isinstance(find_predictor(named), Constant)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("own_predictors:Nothing", "own_predictors:Nothing: AttributeError: module 'own_predictors' has no attribute"),
        ("no_such_module:Mine", "no_such_module:Mine: ModuleNotFoundError: No module named"),
        ("mine", r"mine \(which is no module:attribute\): is no entry point of the group foretouch.models"),
        (object(), r"builtins:object has no estimate\(cloud, grasps, table=None\)"),
        (NoTable, r"own_predictors:NoTable.estimate must take \(cloud, grasps, table=None\): too many positional"),
    ],
)
def test_what_is_no_predictor_is_refused_in_one_line(named, message: str) -> None:
    with pytest.raises(ModelError, match=f"^predictor: {message}"):
        find_predictor(named)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("shape", r"estimate: returned counts of shape \(3, 7\); 3 grasps and 50 values need \(3, 50\)"),
        ("error", r"bad: estimate: ZeroDivisionError: division by zero \(own_predictors.py:\d+\)"),
        ("text", r"estimate: returned counts: 2800 is not of numbers: texts"),
        ("texts", r"estimate: returned counts: .* is not of numbers: texts"),
        ("complex", r"estimate: returned counts: .* is not of numbers: complex numbers"),
        ("object", r"estimate: returned counts: .* is not of numbers"),
        ("rows", r"returned counts of shape \(2, 50\); 3 grasps and 50 values need \(3, 50\)"),
        ("familiar", r"returned familiar of shape \(4,\) and type bool; 3 grasps need \(3,\) of bool"),
        ("where", r"returned where of shape \(3,\); 3 grasps need \(3, P\)"),
        (
            "reasons",
            r"returned reasons\['other_shape'\] of shape \(2,\) and type float64; 3 grasps need \(3,\) of bool",
        ),
        ("exit", r"bad: estimate: SystemExit: 3 \(own_predictors.py:\d+\)"),
    ],
)
def test_a_predictor_that_fails_is_named_in_one_line(fault: str, message: str) -> None:
    predictor = Bad()
    predictor.fault = fault
    with pytest.raises(ModelError, match=message) as caught:
        TouchModel(predictor, CARD).predict(CAN, GRASPS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((Constant(), {}), r"^card: {} holds no name and sha256; load_model\(…\) reads a card, and calibrate"),
        ((Constant(), None), "^card: None holds no name"),
        ((None, CARD), "^predictor: None has no estimate"),
        ((Constant(), CARD, 5), "^calibration: int is not a Calibration"),
        ((Constant(), CARD | {"sensor": 5}), "^bad: sensor: is not a description of a sensor"),
    ],
)
def test_what_is_no_model_is_refused_in_one_line(arguments, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        TouchModel(*arguments)


def test_a_predictor_that_writes_into_its_arguments_changes_nothing_of_the_callers() -> None:
    class Writing(Constant):
        def estimate(self, cloud, grasps, table=None):
            cloud.xyz[:] += 0.01
            grasps.g1[:] += 0.01
            return super().estimate(cloud, grasps, table)

    cloud, grasps = can_with_grasps(3)
    predictions = TouchModel(Writing(), CARD).predict(cloud, grasps)
    assert predictions.ok.all()
    np.testing.assert_array_equal(cloud.xyz, CAN.xyz)
    np.testing.assert_array_equal(predictions.grasps.g1, Grasps.of(GRASPS).g1)


def test_rows_that_are_not_finite_are_refused_and_the_others_stay() -> None:
    predictor = Bad()
    predictor.fault = "nan"
    predictions = TouchModel(predictor, CARD).predict(CAN, GRASPS)
    assert predictions.status.tolist() == ["refused", "ok", "ok"]
    assert predictions.reason[0] == "the model gives a value that is not finite"
    with pytest.raises(ModelError, match="bad: the model gives a value that is not finite"):
        TouchModel(predictor, CARD).estimate_executed(CAN, GRASPS)


def test_a_predictor_flags_what_it_says_is_unfamiliar_and_nothing_if_it_does_not() -> None:
    thin = Cloud(CAN.xyz * [1.0, 0.3, 1.0])
    for predictor, cloud, flags in ((Familiar(), CAN, ()), (Familiar(), thin, ("unfamiliar",)), (Constant(), thin, ())):
        predictions = TouchModel(predictor, CARD).predict(cloud, GRASPS)
        assert [tuple(flag for flag in row if flag == "unfamiliar") for row in predictions.flags] == [flags] * 3
        assert np.array_equal(predictions.value.reshape(3, -1), np.tile(MEAN, (3, 1))) or predictions.ok.all()


def test_what_was_learned_is_saved_and_another_predictor_is_refused(tmp_path) -> None:
    memory = Memory(np.array([grasp.g1 for grasp in GRASPS]), MEAN + 20.0 * np.arange(3)[:, None])
    card = save_own(tmp_path / "mine" / "memory.json", memory, {})
    again = load_model(tmp_path / "mine", "own_predictors:Memory")
    assert np.array_equal(again.estimate(CAN, GRASPS).counts, MEAN + 20.0 * np.arange(3)[:, None])
    with pytest.raises(
        ModelError, match="own_predictors:Constant answers other numbers than the predictor of this model"
    ):
        load_model(card, Constant)
    with pytest.raises(ModelError, match="kind: contact has a predictor already"):
        load_model("contact-v3", Constant)


def test_arrays_among_the_attributes_are_saved_and_set_again(tmp_path) -> None:
    widths = Widths()
    widths.fit(make_samples(2, 6))
    card = save_own(tmp_path / "widths.json", widths, {})
    again = load_model(card, "own_predictors:Widths")
    assert np.array_equal(again.estimate(CAN, GRASPS).counts, widths.estimate(CAN, Grasps.of(GRASPS)))
    with pytest.raises(ModelError, match=r"widths: estimate: AttributeError: 'Widths' object has no attribute 'width'"):
        load_model(card, Widths())  # which was not fitted


def test_a_card_makes_nothing_import(tmp_path, monkeypatch) -> None:
    card = save_own(tmp_path / "mine.json", Constant(), {})
    (tmp_path / "planted.py").write_text("class Constant: pass\n")
    card.write_text(json.dumps(json.loads(card.read_text()) | {"predictor": "planted:Constant"}))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelError, match=r"is made of planted:Constant, and no card makes foretouch import code"):
        load_model(card)
    assert "planted" not in sys.modules
    assert load_model(card, "own_predictors:Constant").name == "mine"


@pytest.mark.slow
def test_an_installed_package_names_its_predictors(tmp_path) -> None:
    """In a fresh process whose path has the folder that pip installed it to."""
    project, prefix = tmp_path / "project", tmp_path / "prefix"
    project.mkdir()
    (project / "lab_touch.py").write_text(
        "import numpy as np\n\n\nclass Widths:\n    def estimate(self, cloud, grasps, table=None):\n"
        "        return np.full((len(grasps), 50), 2500.0)\n"
    )
    (project / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n\n[project]\nname = "lab-touch"\n'
        'version = "1.0"\n\n[project.entry-points."foretouch.models"]\nlab-widths = "lab_touch:Widths"\n'
    )
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, str(prefix), str(project)], check=True, timeout=120)
    card = save_own(tmp_path / "mine.json", Constant(), {})
    script = (
        "import sys, foretouch as ft\nfrom foretouch.models.own import find_predictor\n"
        "print(type(find_predictor('lab-widths')).__name__)\n"
        "for name in ('lab-width', 'lab-widths'):\n"
        "    try:\n        ft.load_model(sys.argv[1], name)\n    except ft.ForetouchError as err:\n        print(err)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(prefix)}
    call = [sys.executable, "-c", script, str(card)]
    done = subprocess.run(call, env=environment, capture_output=True, text=True, timeout=120, check=True)
    found, misspelt, other = done.stdout.splitlines()
    assert found == "Widths"
    assert misspelt.endswith("of which lab-widths are known; did you mean lab-widths?")
    assert "lab_touch:Widths answers other numbers than the predictor of this model, own_predictors:Constant" in other

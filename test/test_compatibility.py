# SPDX-License-Identifier: Apache-2.0
"""What version 0.1.0 wrote is read by this one, with the same numbers: recording, store, models and runs.

`data/from_0_1_0/README.md` describes how each was made. Everything goes through the command line, as for a user; its output is
compared with that of 0.1.0 (`expected/`). Keys may be added, but none may be missing and no value may differ.
Never regenerate `expected` to make a test pass: users with such files would meet the same difference.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_answer import Answer

from foretouch.cli.main import main

OLD = Path(__file__).parent / "data" / "from_0_1_0"
SESSION = "session-0002.mcap"
MODELS = ("toy-network", "toy-contact", "toy-ensemble")
CHANGING = {"ms", "seconds", "version", "out", "reason"}
"""Keys whose values change from run to run, or may be reworded."""

COMPUTED = 1e-5
"""Relative tolerance of what floating point gives: another processor sums in another order."""

TRAINED = 1e-3
"""The same after a few epochs."""


Call = Callable[..., Answer]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    def run(*words: object) -> Answer:
        capsys.readouterr()
        status = main([str(word) for word in words])
        captured = capsys.readouterr()
        return Answer(status, captured.out, captured.err)

    return run


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A copy of everything, that may be written to."""
    return Path(shutil.copytree(OLD, tmp_path / "old"))


def told(call: Call, *words: object, status: int = 0) -> list[dict[str, Any]]:
    """The JSON lines of a command that has to end with this status."""
    answer = call(*words, "--json")
    assert answer.status == status, answer.err
    assert answer.records, "nothing was told"
    return answer.records


def require(name: str, found: Any, *, rel: float = 0.0) -> None:
    """Compare with `expected/<name>.json`.

    Args:
        name: Of the file.
        found: Plain JSON (see `plain`).
        rel: Tolerance of numbers that are no whole ones; 0 for equality to the bit.
    """
    expected = json.loads((OLD / "expected" / f"{name}.json").read_text(encoding="utf-8"))
    differences = list(_differences(expected, json.loads(json.dumps(found)), rel))
    assert not differences, f"{name}: {len(differences)} differences:\n" + "\n".join(differences[:10])


def _differences(old: Any, new: Any, rel: float, where: str = "") -> list[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        gone = [f"{where}.{key}: is gone" for key in old if key not in new]
        return gone + [
            text for key in old if key in new for text in _differences(old[key], new[key], rel, f"{where}.{key}")
        ]
    if isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            return [f"{where}: {len(new)} entries, not {len(old)}"]
        pairs = enumerate(zip(old, new, strict=True))
        return [text for k, (a, b) in pairs for text in _differences(a, b, rel, f"{where}[{k}]")]
    if isinstance(old, float) and isinstance(new, int | float) and not isinstance(new, bool):
        same = old == pytest.approx(new, rel=rel, abs=rel) if rel else old == new
    else:
        same = type(old) is type(new) and old == new
    return [] if same else [f"{where}: {new!r}, not {old!r}"]


def plain(value: Any, *folders: Path) -> Any:
    """JSON without what changes, and without the places where the files happen to lie."""
    if isinstance(value, dict):
        return {key: plain(item, *folders) for key, item in value.items() if key not in CHANGING}
    if isinstance(value, list):
        return [plain(item, *folders) for item in value]
    if isinstance(value, str):
        for folder in folders:
            value = value.replace(f"{folder}/", "")
    return value


# Recordings.


@pytest.mark.parametrize("what", ["recording", "store"])
def test_counts_identities_edits_and_accounts_are_told_as_before(call: Call, what: str) -> None:
    require(f"{what}_info", plain(told(call, "dataset", "info", OLD / what), OLD))


@pytest.mark.parametrize("what", ["recording", "store"])
def test_every_byte_is_still_proved(call: Call, what: str) -> None:
    records = told(call, "dataset", "verify", OLD / what)
    assert all(record["status"] == "ok" for record in records)
    require(f"{what}_verify", plain(records, OLD))


@pytest.mark.parametrize("name", ["recording/session-0001.mcap", "store/shard-00000.arrow", "store/splits.json"])
def test_a_flipped_byte_is_still_found(call: Call, old: Path, name: str) -> None:
    path = old / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    records = told(call, "dataset", "verify", path.parent, status=1)
    assert any(record["status"] == "damaged" and record["faults"] for record in records)


def test_a_contact_sheet_is_drawn(call: Call, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    require("recording_show", plain(told(call, "dataset", "show", OLD / "recording", "-o", sheet, "-n", 3)))
    assert sheet.stat().st_size > 10_000


@pytest.mark.parametrize("what", ["recording", "store"])
def test_every_value_of_every_sample_is_as_before(call: Call, tmp_path: Path, what: str) -> None:
    require(
        f"{what}_export", plain(told(call, "dataset", "export", OLD / what, "-o", tmp_path / "npz", "--format", "npz"))
    )
    found = {}
    for path in sorted((tmp_path / "npz").rglob("*.npz")):
        with np.load(path, allow_pickle=False) as arrays:
            found[path.name] = {name: _summary(arrays[name]) for name in arrays.files}
    require(f"{what}_values", found)


def _summary(array: np.ndarray) -> list[Any]:
    return [str(array.dtype), list(array.shape), hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:16]]


@pytest.mark.parametrize("what", ["recording", "store"])
def test_it_becomes_the_same_training_store(call: Call, tmp_path: Path, what: str) -> None:
    """Content hash and splits: so results that name a hash can be made again."""
    require(f"{what}_build", plain(told(call, "dataset", "build", OLD / what, "-o", tmp_path / "store", "--seed", 3)))
    require(f"{what}_splits", json.loads((tmp_path / "store/splits.json").read_text(encoding="utf-8")))


def test_edits_are_known_and_can_be_undone(call: Call, old: Path) -> None:
    steps = [told(call, "dataset", "edit", old / "recording")]
    steps += [told(call, "dataset", "edit", old / "recording", "--undo") for _ in range(2)]
    steps += [told(call, "dataset", "edit", old / "recording", "--relabel", "jar", "--id", "box/000007")]
    require("recording_edits", plain(steps))
    require("recording_info_edited", plain(told(call, "dataset", "info", old / "recording"), old))


def test_what_was_cut_off_is_repaired(call: Call, old: Path) -> None:
    """As after a kill: the file ends in the middle of a chunk."""
    path = old / "recording" / SESSION
    path.write_bytes(path.read_bytes()[:120_000])
    require("recording_repair", plain(told(call, "dataset", "repair", old / "recording"), old))
    require("recording_info_repaired", plain(told(call, "dataset", "info", old / "recording"), old))
    told(call, "dataset", "verify", old / "recording")


def test_a_recording_goes_on(call: Call, old: Path, tmp_path: Path) -> None:
    """Samples of the same hand and camera are added to it as another session."""
    _simulate(call, tmp_path, 2)
    (info,) = told(call, "dataset", "info", old / "recording")
    identity = [f"--{what}={name}={value}" for what in ("hand", "camera") for name, value in info[what].items()]
    told(call, "dataset", "import", tmp_path / "more", "-o", old / "recording", *identity)
    (grown,) = told(call, "dataset", "info", old / "recording")
    assert grown["samples"] == info["samples"] + 2
    assert grown["objects"] == info["objects"] | {"jar": 2}
    told(call, "dataset", "verify", old / "recording")


def test_raw_clouds_are_read_and_planned_on(call: Call) -> None:
    words = (OLD / "recording" / SESSION, "--topic", "/foretouch/object_cloud")
    require("recording_grasps", plain(told(call, "grasp", *words), OLD), rel=COMPUTED)


# Models.


@pytest.mark.parametrize("name", [*MODELS, "../run-whole/toy-whole"])
def test_files_and_card_are_told_as_before(call: Call, name: str) -> None:
    path = OLD / "model" / f"{name}.json"
    (record,) = told(call, "models", path)
    assert record["status"] == "ok"
    require(f"model_{path.stem}", plain(record, OLD))
    assert call("models", path).status == 0  # the table for people


@pytest.mark.parametrize("name", [*MODELS, "../run-whole/toy-whole"])
def test_predictions_are_as_before(call: Call, name: str) -> None:
    path = OLD / "model" / f"{name}.json"
    records = told(call, "predict", OLD / "recording" / SESSION, "--model", path)
    require(f"predict_{path.stem}", plain(records, OLD), rel=COMPUTED)


@pytest.mark.parametrize("name", ["toy-network", "toy-contact"])
def test_predictions_lean_on_touch_as_before(call: Call, name: str) -> None:
    session = OLD / "recording" / SESSION
    words = ("predict", session, "--model", OLD / "model" / f"{name}.safetensors")
    leaning = told(call, *words, "--tare", "sample", "--touched", session, status=1)
    require(f"lean_{name}", plain(leaning, OLD), rel=COMPUTED)


@pytest.mark.parametrize("name", MODELS)
def test_replaced_weights_are_still_refused(call: Call, old: Path, name: str) -> None:
    weights = old / "model" / f"{'toy-pdc' if name == 'toy-ensemble' else name}.safetensors"
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    (record,) = told(call, "models", old / "model" / f"{name}.json", status=1)
    assert record["status"] == "damaged"


@pytest.mark.parametrize("name", ["model/toy-contact", "model/toy-ensemble", "run-whole/toy-whole"])
def test_scores_are_as_before(call: Call, name: str) -> None:
    (record,) = told(call, "evaluate", OLD / f"{name}.json", OLD / "store", "--split", "object/tin")
    record["baselines"] = {"training_mean": record["baselines"]["training_mean"]}  # trees are scikit-learn's affair
    require(f"evaluate_{Path(name).name}", plain(record, OLD), rel=COMPUTED)


# Runs.


@pytest.mark.parametrize(("run", "config"), [("run", "run"), ("run-srgan", "srgan")])
def test_an_interrupted_run_goes_on(call: Call, old: Path, run: str, config: str) -> None:
    """Two of four epochs are done; weights, optimisers and random numbers are those of the state."""
    words = ("train", OLD / "configs" / f"{config}.yaml", f"data={OLD / 'store'}", "-o", old / run)
    refused = call(*words)
    assert (refused.status, "--resume" in refused.err) == (1, True)
    records = told(call, *words, "--resume")
    assert [record["epoch"] for record in records[:-1]] == [2, 3]
    _drop_trees(records[-1])
    require(f"resumed_{config}", plain(records, old), rel=TRAINED)
    require(f"log_{config}_kept", _log(old / run)[:2])
    require(f"log_{config}", _log(old / run), rel=TRAINED)
    (card,) = (old / run).glob("toy-*.json")
    if run == "run":  # the other predicts one modality, of which no whole prediction can be made
        _same_weights(card.with_suffix(".safetensors"), OLD / "run-whole/toy-whole.safetensors")
        predicted = told(call, "predict", OLD / "recording" / SESSION, "--model", card)
        assert all(record["status"] == "ok" for record in predicted)


def _same_weights(one: Path, other: Path) -> None:
    """Resumed or not, training gives one network."""
    from safetensors.numpy import load_file

    resumed, whole = load_file(one), load_file(other)
    assert list(resumed) == list(whole)
    for name, tensor in whole.items():
        np.testing.assert_allclose(resumed[name], tensor, rtol=TRAINED, atol=TRAINED, err_msg=name)


def _drop_trees(result: dict[str, Any]) -> None:
    for name in ("object_time_trees", "geometry_trees"):
        result["scores"].pop(name, None)


def test_a_run_that_is_over_tells_its_result_again(call: Call, old: Path) -> None:
    words = ("train", OLD / "configs/run.yaml", f"data={OLD / 'store'}", "name=toy-whole", "-o", old / "run-whole")
    (result,) = told(call, *words, "--resume")
    _drop_trees(result)
    require("resumed_whole", plain(result, old), rel=COMPUTED)
    weights = "run-whole/toy-whole.safetensors"
    assert (old / weights).read_bytes() == (OLD / weights).read_bytes()
    require("log_whole", _log(old / "run-whole"))


def _log(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "log.jsonl").read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize("change", ["train.batch_size=5", "model.head_widths=[14]", "validation=0.2"])
def test_another_configuration_is_not_taken_for_the_same_run(call: Call, old: Path, change: str) -> None:
    answer = call("train", OLD / "configs/run.yaml", f"data={OLD / 'store'}", change, "-o", old / "run", "--resume")
    assert answer.status == 1
    assert change.partition("=")[0].rpartition(".")[2] in answer.err


def test_other_data_are_not_taken_for_the_same_run(call: Call, old: Path, tmp_path: Path) -> None:
    _simulate(call, tmp_path, 12)
    answer = call("train", OLD / "configs/run.yaml", f"data={tmp_path / 'more'}", "-o", old / "run", "--resume")
    assert answer.status == 1
    assert "data_sha256" in answer.err


def _simulate(call: Call, folder: Path, count: int) -> None:
    """A store of grasps on a jar, `folder/more`."""
    scene = folder / "scene.yaml"
    scene.write_text("objects: [{name: jar, shape: can, size_m: [0.07, 0.07, 0.1]}]\n", encoding="utf-8")
    told(call, "simulate", scene, "-n", count, "-o", folder / "more", "--no-sheet", "--workers", 1)

# SPDX-License-Identifier: Apache-2.0
"""`predict` with a tare and with touches: equal to the model's predictions, and mistakes reported by name."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated_models import REST, make_tracked_calibration, save_calibrated_contact, save_calibrated_network
from command_answer import run_python
from every_case import every_case
from recording_builders import IDENTITY, QUICK, record, write_dataset
from sim_builders import CAN, made, scene

from foretouch.cli.adaptation import _read_tare
from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.writing import write
from foretouch.errors import FileError
from foretouch.models import load_model
from foretouch.models.history_keeper import HistoryFile
from foretouch.models.touch_model import History, TouchModel
from foretouch.tactile import biotac_touch
from foretouch.tactile.description import packaged_sensor
from foretouch.types import Prediction, Sample
from foretouch.types.scene import Object
from foretouch_lab.learning.prequential import replay_model


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> str:
    return save_calibrated_network(tmp_path_factory.mktemp("model"))


@pytest.fixture(scope="module")
def tracked(tmp_path_factory) -> str:
    """A model whose calibration has a tracker."""
    return save_calibrated_network(tmp_path_factory.mktemp("tracked"), make_tracked_calibration())


def write_touches(path: Path, levels: Sequence[float], drift: float | None, **label: Any) -> Path:
    """Grasps of one object, with touches of some levels beside rest, and tares that drift [counts]."""
    with RecordingWriter(path, IDENTITY, QUICK) as writer:
        for number, level in enumerate(levels):
            one = record(label.get("first", 0) + number, points=300)
            tare = None if drift is None else biotac_touch(REST + drift * number)
            stamp_ns = one.stamp_ns - label.get("before_ns", 0)
            changes = {"object": label.get("object", one.object), "stamp_ns": stamp_ns}
            writer.append(replace(one, touch=biotac_touch(REST + level), tare=tare, **changes))
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """Five grasps of one object, each with touch and tare; the sensors drift."""
    return write_touches(tmp_path_factory.mktemp("session") / "ball", [3.0 * k - 50.0 for k in range(5)], 3.0)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory) -> Path:
    """Three grasps of another object an hour before those of the session."""
    path = tmp_path_factory.mktemp("earlier") / "box"
    return write_touches(path, [-80.0, -79.0, -78.0], None, object="box", before_ns=3600 * 10**9)


def samples_of(path: Path) -> list[Sample]:
    return sorted(open_samples(path), key=lambda sample: sample.stamp_ns)


def hand_after(model: TouchModel, path: Path) -> History:
    """The history of a hand that has touched the object of a dataset."""
    hand = History(model)
    for number, one in enumerate(samples_of(path)):
        hand.touched(one.cloud, one.grasp, one.touch, stamp_ns=one.stamp_ns, same_object=number > 0)
    return hand


def reading(number: Any, rest: Any = REST) -> dict[str, Any]:
    touch = biotac_touch(rest + number)
    return {
        "pdc_th": touch["PDC_TH"][0],
        "pdc_mf": touch["PDC_MF"][0],
        "e_th": touch["E_TH"].tolist(),
        "e_mf": touch["E_MF"].tolist(),
    }


def flat(one: dict[str, Any], key: str) -> list[float]:
    return [one["PDC_TH"][key], one["PDC_MF"][key], *one["E_TH"][key], *one["E_MF"][key]]


def assert_reported(one: dict[str, Any], wanted: Prediction) -> None:
    for key in ("value", "lower", "upper"):
        np.testing.assert_array_equal(flat(one, key), getattr(wanted, key).values)
    assert one["reference"] == wanted.reference


def test_a_tare_shifts_the_prediction_as_the_model_does(call, model, session, tmp_path) -> None:
    (tmp_path / "t.json").write_text(json.dumps([reading(k) for k in (30, 10, 20)]))
    answer = call("predict", session, "--model", model, "--tare", tmp_path / "t.json", "--json")
    core, tare = load_model(model), biotac_touch(REST + 20)
    for result, sample in zip(answer.records, samples_of(session), strict=True):
        (wanted,) = core.predict(sample.cloud, [sample.grasp], tare=tare)
        assert_reported(result["predictions"][0], wanted)
        assert (wanted.reference, result["touched"]) == ("tare", 0)
    assert "contact" not in answer.err


def test_a_tare_that_is_like_a_reading_in_contact_is_warned_of_by_file_and_channel(call, session, tmp_path) -> None:
    rest = load_model("contact-v3").calibration.rest
    for name, change in (("rest", 30.0), ("held", np.r_[400.0, 0.0, np.zeros(24), np.full(24, -700.0)])):
        (tmp_path / f"{name}.json").write_text(json.dumps(reading(change, rest)))
    words = ("predict", session, "--model", "contact-v3", "--json")
    answer = call(*words, "--tare", tmp_path / "rest.json", "--tare", tmp_path / "held.json")
    (line,) = [one for one in answer.err.splitlines() if "contact" in one]
    assert line.startswith(f"foretouch: {tmp_path / 'held.json'}: as in contact, or of another hand; a tare is")
    assert "PDC_TH: 3119 is far above the rest level, 2719 ± " in line
    assert line.endswith("E_MF: 24 values are far below their rest level")


def test_touches_and_own_tares_adapt_it_in_order_of_time(call, model, session) -> None:
    answer = call("predict", session, "--model", model, "--tare", "sample", "--touched", session, "--json")
    core = load_model(model)
    samples = samples_of(session)
    results = {result["sample"]: result for result in answer.records}
    for sample in samples:
        hand, others = History(core), [one for one in samples if one.id != sample.id]  # never its own reading
        for other in others:
            hand.tare(other.tare, stamp_ns=other.stamp_ns)
            hand.touched(other.cloud, other.grasp, other.touch, stamp_ns=other.stamp_ns, same_object=True)
        now_ns = max(sample.stamp_ns, others[-1].stamp_ns)
        hand.tare(sample.tare, stamp_ns=now_ns)
        read = hand.at(now_ns, same_object=True, tared=True)
        (wanted,) = core.predict(sample.cloud, [sample.grasp], history=read)
        assert_reported(results[sample.id]["predictions"][0], wanted)
        assert (wanted.reference, results[sample.id]["touched"]) == ("touches", 4)
    assert "4 touches" in call("predict", session, "--model", model, "--touched", session).out


def test_a_sample_is_predicted_and_compared_on_the_table_that_it_holds(call, tmp_path) -> None:
    tilted = made(scene(CAN, camera={"tilt_deg": 40.0}), 4)
    samples = [replace(sample, id="", stamp_ns=(1 + k) * 10**9) for k, sample in enumerate(tilted)]
    core, answers = load_model("contact-v3"), []
    for name, tables in (("known", [sample.table for sample in samples]), ("unknown", [None] * 4)):
        stored = [replace(sample, table=table) for sample, table in zip(samples, tables, strict=True)]
        write(tmp_path / name, stored)
        answer = call("predict", tmp_path / name, "--touched", tmp_path / name, "--json")
        answers.append([one["predictions"][0] for one in answer.records])
    assert all("assumed_table" not in one["flags"] for one in answers[0])
    assert all("assumed_table" in one["flags"] for one in answers[1])
    for k, sample in enumerate(samples):
        hand = History(core)
        for number, other in enumerate(samples[:k] + samples[k + 1 :]):
            if other.tare is not None:
                hand.tare(other.tare, stamp_ns=other.stamp_ns)
            seen = Object.of("1", other.cloud, other.table)
            hand.touched(seen, other.grasp, other.touch, stamp_ns=other.stamp_ns, same_object=number > 0)
        read = hand.at(4 * 10**9, same_object=True)
        (wanted,) = core.predict(Object.of("1", sample.cloud, sample.table), [sample.grasp], history=read)
        assert_reported(answers[0][k], wanted)
        assert flat(answers[1][k], "value") != flat(answers[0][k], "value")


def test_a_file_that_is_no_tare_is_named_with_the_rule(tmp_path) -> None:
    path, good = tmp_path / "t.json", reading(0)

    def check(content: Any, rule: str) -> None:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        with pytest.raises(FileError, match=f"t.json: .*{rule}"):
            _read_tare([str(path)], packaged_sensor("biotac_sp"))

    cases = [
        ("{", "is not JSON"),
        ([], "no reading"),
        ({"pdc_th": 1}, "it must hold pdc_th, pdc_mf, e_th, e_mf"),
        (good | {"e_mf": [1.0] * 23}, "e_mf: is not 24 numbers"),
        (good | {"pdc_th": "high"}, "pdc_th.*: .high. is not a number"),
        (good | {"pdc_th": -22072.0}, "absent or dead sensor"),
    ]
    every_case(cases, check)


def test_what_cannot_be_adapted_to_is_refused_in_one_line(call, model, session, files, tmp_path) -> None:
    other = write_dataset(tmp_path / "cup", 2, name="cup", points=300)
    sample, scene, cloud = ("--tare", "sample"), files / "scene.npz", files / "object.pcd"

    def check(words: tuple[Any, ...], line: str) -> None:
        answer = call("predict", *words, "--model", model)
        assert answer.status == 1
        assert all(line in one for one in answer.err.splitlines()), answer.err

    cases = [
        ((session, "--tare", session / "none.json"), "none.json"),
        ((session, "--touched", session / "none.json"), "none.json"),
        ((session, "--touched", session, "--touched", other), "ball, cup: touches must be of one object"),
        ((other, "--touched", session), "is of cup, the touches are of ball"),
        ((cloud, *sample), "has no recorded tare"),
        ((cloud, *sample, "--tare", "x.json"), "cannot be combined with files"),
        ((scene, "--touched", session, "--target", "all"), "the cloud holds 2 objects"),
        ((session, "--prequential", *sample), "--tare: cannot be combined with --prequential"),
        ((session, "--prequential", "--hand", "two_tips"), "--hand: cannot be combined with --prequential"),
        ((session, "--grasp", "0,0,1,0.05,0,1", "--hand", "two_tips"), "--grasp, --hand: a hand is for planned grasps"),
    ]
    every_case(cases, check)
    (result,) = call("predict", scene, "--model", model, "--touched", session, "--target", "nearest", "--json").records
    assert result["predictions"][0]["reference"] == "touches"


def test_the_contact_model_needs_no_torch(files, session, tmp_path) -> None:
    card = save_calibrated_contact(tmp_path)
    words = ["predict", str(files / "object.pcd"), "--model", card, "--touched", str(session), "--json"]
    code = f"import sys\nfrom foretouch.cli.main import main\nstatus = main({words!r})\nsys.exit(status + 2 * bool({{'torch', 'sklearn'}} & set(sys.modules)))"
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["predictions"][0]["reference"] == "touches"


def test_a_history_is_read_from_a_dataset_or_a_file_in_order_of_time(call, tracked, session, earlier, tmp_path) -> None:
    words = ("predict", session, "--model", tracked, "--json", "--history", earlier)
    one = load_model(tracked)
    hand, records = hand_after(one, earlier), call(*words).records
    for result, sample in zip(records, samples_of(session), strict=True):
        (found,) = result["predictions"]
        (wanted,) = one.predict(sample.cloud, [sample.grasp], history=hand.at(sample.stamp_ns, same_object=False))
        assert_reported(found, wanted)
        assert (found["reference"], found["evidence"]["readings"]) == ("history", 3)
        assert found["evidence"]["reading_age_s"] > 3000.0
    file = HistoryFile(tmp_path / "right.safetensors", "right")
    file.write(hand)
    file.close()
    words = (*words[:-1], file.path)
    assert [one["predictions"] for one in call(*words).records] == [one["predictions"] for one in records]
    file.path.write_bytes(file.path.read_bytes()[:-1])
    assert "right.safetensors: damaged" in call(*words).err


def test_no_reading_of_the_future_is_used_and_never_its_own(call, model, tracked, session, tmp_path) -> None:
    words = ("predict", session, "--model", tracked, "--json")
    alone, adapted = (call(*words, *more).records for more in ((), ("--history", session)))
    readings = [result["predictions"][0]["evidence"]["readings"] for result in adapted]
    assert readings == [2 * k for k in range(5)] or readings == [k + 1 if k else 0 for k in range(5)]
    assert flat(alone[0]["predictions"][0], "value") == flat(adapted[0]["predictions"][0], "value")
    with RecordingWriter(tmp_path / "one", IDENTITY, QUICK) as writer:
        writer.append(next(iter(open_samples(session))))
    words = ("predict", tmp_path / "one", "--model", model, "--json")
    (alone,), (adapted,) = (call(*words, *more).records for more in ((), ("--touched", tmp_path / "one")))
    assert adapted["predictions"] == alone["predictions"]
    assert (adapted["touched"], adapted["predictions"][0]["reference"]) == (0, "none")


def test_in_order_of_time_each_sample_is_predicted_from_the_readings_before(call, model, session) -> None:
    answer = call("predict", session, "--model", model, "--prequential", "--json")
    assert answer.status == 0
    assert [one["touched"] for one in answer.records] == [0, 1, 2, 3, 4]
    found = samples_of(session)
    done = replay_model(load_model(model), found)
    for k, one in enumerate(answer.records):
        assert one["sample"] == found[k].id
        np.testing.assert_array_equal(flat(one["predictions"][0], "value"), done.played.counts[k])
        np.testing.assert_array_equal(flat(one["predictions"][0], "upper"), done.played.counts[k] + done.played.half[k])
    references = [one["predictions"][0]["reference"] for one in answer.records]
    assert references[1:] == ["touches"] * 4
    assert references[0] in ("none", "history")  # a tare is read before the first touch
    same = call("predict", session, "--model", model, "--prequential", "--json", "--history", session)
    assert same.out == answer.out, "readings of the samples themselves are no history"

# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor` on a good machine, and what it says of a broken one."""

import json
import re
from importlib import metadata

import numpy as np
import pytest
from every_case import every_case
from packaging.requirements import Requirement

from foretouch.cli import doctor, selftest
from foretouch.errors import ModelError
from foretouch.models import available_models, load_model
from foretouch.ros.runtime import environment
from foretouch.types import Cloud


@pytest.mark.slow
def test_this_environment_has_no_problem(call) -> None:
    answer = call("doctor", "--json", "--self-test")
    records = {record["name"]: record for record in answer.records if record["name"] != "large clouds"}
    assert [name for name, record in records.items() if record["state"] not in {"ok", "optional"}] == []
    (rclpy_loads,) = (record for name, record in records.items() if name.startswith("rclpy loads"))
    assert rclpy_loads["found"] == "rmw_fastrtps_cpp"
    (clouds,) = (record["found"] for record in answer.records if record["name"] == "large clouds")
    assert re.match(r"rmw_fastrtps_cpp: \d+ of \d+ MB of /dev/shm are free", clouds)
    assert {"Python", "torch", "open3d loads", "model contact-v3", "a node answers over DDS"} <= set(records)


def test_an_absent_package_and_another_version_are_named_with_the_fix(monkeypatch) -> None:
    lines = ["no-such-package", *(f"other-package>=2; extra == '{extra}'" for extra in ("sim", "lab")), "numpy>=1.26"]
    monkeypatch.setattr(metadata, "requires", lambda _: lines)
    shown = {found.name: (found.state, found.found, found.fix) for found in doctor._requirements()}
    assert shown["no-such-package"] == ("missing", "absent", "pip install 'no-such-package'")
    assert shown["extra lab"] == ("optional", "absent: other-package", "pip install 'foretouch[lab]'")
    assert set(shown) == {"Python", "numpy", "no-such-package", "extra sim", "extra lab"}
    monkeypatch.setattr(metadata, "version", lambda _: "0.1")
    found = doctor._requirement(Requirement("numpy>=1.26"))
    assert (found.state, found.found, found.fix) == ("mismatch", "0.1 is not >=1.26", "pip install 'numpy>=1.26'")


def test_a_machine_without_ros_has_nothing_to_fix(monkeypatch) -> None:
    monkeypatch.setattr(doctor, "_LIBRARIES", ())
    monkeypatch.setattr(doctor.importlib.util, "find_spec", lambda _: None)
    (found,) = doctor._libraries()
    assert (found.name, found.state, found.fix) == (
        "ROS 2",
        "optional",
        "pip install 'foretouch[ros]' ./foretouch_msgs",
    )


@pytest.mark.ros
def test_variables_with_which_ros_ends_a_process_are_named_first(monkeypatch, call) -> None:
    monkeypatch.setattr(doctor, "_LIBRARIES", ())
    for name, value, rule in (
        ("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "'rmw_cyclonedds_cpp' is not installed; ROS 2 from PyPI has"),
        ("ROS_DOMAIN_ID", "233", "'233' is not a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "x", "'x' is not a whole number from 0 to 232"),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            patch.setattr(environment, "wheels_of_ros", lambda: "jazzy")
            (found,) = doctor._libraries()
            assert (found.state, found.found.startswith(f"{name}: {rule}"), found.fix) == (
                "broken",
                True,
                f"unset {name}",
            )
            for command in (["run", "--source", "camera"], ["forget", "touches"]):
                call(*command).check_refused(f"{name}: {rule}")


def test_a_check_whose_process_crashes_or_hangs_is_broken(monkeypatch) -> None:
    monkeypatch.setattr(doctor, "_PATIENCE_S", 0.5)
    for code, reason in (
        ("import os; os.abort()", "its process ended by SIGABRT"),
        ("import sys; print('words'); sys.exit('first\\nlast')", "last"),
        ("import time; time.sleep(60)", "takes more than 0.5 s"),
    ):
        found = doctor._tried("it loads", code, "fix it")
        assert (found.state, found.found, found.fix) == ("broken", reason, "fix it")


@pytest.mark.committed_numbers
def test_models_are_as_stored_and_what_is_not_is_named(monkeypatch, tmp_path) -> None:
    selftest.check_models()
    stored = json.loads(selftest._EXPECTED.read_text())
    monkeypatch.setattr(selftest, "_EXPECTED", tmp_path / "expected.json")
    counts = [[one + 1.0 for one in row] for row in stored["contact-v3"]["counts"]]
    for name, changed, message in (
        ("gone", {}, "model gone: is not both installed and stored"),
        ("contact-v3", {**stored["contact-v3"], "sha256": "0" * 64}, f"sha256: .* is not {'0' * 64} of this version"),
        ("contact-v3", {**stored["contact-v3"], "counts": counts}, "model contact-v3: answers differ by 1 counts"),
    ):
        selftest._EXPECTED.write_text(json.dumps({**stored, name: changed}))
        with pytest.raises(ModelError, match=message):
            selftest.check_models()


def test_one_bit_in_each_coordinate_moves_answers_far_less_than_the_tolerance(rng) -> None:
    def check(name: str) -> None:
        model, xyz = load_model(name), selftest.exact_cloud().xyz
        moved = np.nextafter(xyz, np.where(rng.random(xyz.shape) < 0.5, np.float32(-9), np.float32(9)))
        one, other = (model.predict(Cloud(points), [selftest.exact_grasp()]) for points in (xyz, moved))
        for a, b in zip(one, other, strict=True):
            assert np.abs(a.value.values - b.value.values).max() <= selftest._TOLERANCE_COUNTS / 10

    every_case(sorted(available_models()), check)

# SPDX-License-Identifier: Apache-2.0
import re
from importlib import metadata

import pytest
from packaging.requirements import Requirement

from foretouch.cli import doctor


@pytest.mark.slow
def test_this_environment_has_no_problem(call) -> None:
    answer = call("doctor", "--json", "--self-test")
    records = {one["name"]: one for one in answer.records if one["name"] != "large clouds"}
    assert [name for name, one in records.items() if one["state"] not in {"ok", "optional"}] == []
    assert all(one["mend"] == one["fix"] for one in answer.records)  # the old key stays
    (rclpy_loads,) = (one for name, one in records.items() if name.startswith("rclpy loads"))
    assert rclpy_loads["found"] == "rmw_fastrtps_cpp"
    (clouds,) = (one["found"] for one in answer.records if one["name"] == "large clouds")
    assert re.match(r"rmw_fastrtps_cpp: \d+ of \d+ MB of /dev/shm are free", clouds)
    assert {
        "Python",
        "torch",
        "open3d loads",
        "foretouch_msgs loads",
        "default model",
        "a node answers over DDS",
    } <= set(records)


def test_another_version_an_absent_package_and_a_library_that_crashes_are_named(monkeypatch) -> None:
    for needed in (None, "ros"):
        assert doctor._requirement(Requirement("no-such-package"), needed).state == "missing"
    for extra in ("camera", "sweep"):
        assert doctor._requirement(Requirement("no-such-package"), extra).state == "optional"
    monkeypatch.setattr(metadata, "version", lambda _: "0.1")
    found = doctor._requirement(Requirement("numpy>=1.26"), None)
    assert (found.state, found.found, found.fix) == ("mismatch", "0.1 is not >=1.26", "pip install 'numpy>=1.26'")


def test_a_check_whose_process_crashes_or_hangs_is_broken(monkeypatch) -> None:
    monkeypatch.setattr(doctor, "_PATIENCE_S", 0.5)
    for code, reason in (
        ("import os; os.abort()", "its process ended by SIGABRT"),
        ("import sys; print('words'); sys.exit('first\\nlast')", "last"),
        ("import time; time.sleep(60)", "takes more than 0.5 s"),
    ):
        found = doctor._tried("it loads", code, "fix it")
        assert (found.state, found.found, found.fix) == ("broken", reason, "fix it")

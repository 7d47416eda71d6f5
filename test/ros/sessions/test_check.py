# SPDX-License-Identifier: Apache-2.0
"""Each fault of hand, camera and table is named with a fix, and nothing else."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from pair_builders import REST, level

from foretouch.errors import FileError
from foretouch.ros.runtime.subscription import SerializedMessage
from foretouch.ros.sessions.check import CHECKS, CheckFeed, CheckFinding, SessionCheck, store_check
from foretouch.ros.sessions.subscriptions import RecordedTopic
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileConfig, TactileReader, TactileReading
from foretouch.tactile.readings import to_celsius
from foretouch.types import Plane
from foretouch_msgs.msg import BiotacAll

MS = 1_000_000
READ: Any = None  # the readings are given as decoded
TABLE = Plane(np.array([0.0, 0.0, -1.0]), 1.0)  # 1 m before the camera
FLOOR = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 81), np.linspace(-0.3, 0.3, 61), [1.0]), -1).reshape(-1, 3)
BOX = np.random.default_rng(0).uniform((-0.03, -0.03, 0.9), (0.03, 0.03, 0.96), (2000, 3))
ARM = np.random.default_rng(1).uniform((0.1, -0.02, 0.6), (0.4, 0.02, 0.9), (3000, 3))


class Sensor:
    """Readings of both fingers at 100 Hz, given to a check as received when they were stamped."""

    def __init__(self, check: SessionCheck, rng: np.random.Generator) -> None:
        self.check, self.rng, self.now = check, rng, 10**18

    def feel(self, counts: Any, readings: int, *, skew_ms: int = 0, every_ms: int = 10, tdc: float = 2400.0) -> None:
        for _ in range(readings):
            noisy = counts + self.rng.normal(0, 1, 50) * np.r_[0.3, 0.3, np.full(48, 4.0)]
            noisy = np.where(np.isin(counts, (0.0, 7.0)), counts, noisy)  # of channels that never change
            others = np.array([tdc, tdc], np.float32)
            stamp = self.now + skew_ms * MS
            self.check.add_reading(TactileReading(stamp, noisy.astype(np.float32), others), self.now + 2 * MS)
            self.now += every_ms * MS


def look(check: SessionCheck, rate_hz: float = 30.0, delay_ms: int = 50, *others: Any) -> None:
    for number in range(round(3.0 * rate_hz)):  # as long as the sensor sends
        received = 10**18 + round(number * 1e9 / rate_hz)
        check.add_message("camera", received, received - delay_ms * MS)
    check.table = TABLE
    check.scene = np.concatenate([FLOOR, BOX, *others]).astype(np.float32)
    check.targets = (BOX.astype(np.float32),)


def faults(findings: list[CheckFinding]) -> dict[str, str]:
    return {finding.name: f"{finding.found}; {finding.fix}" for finding in findings if finding.fix}


def test_a_setup_without_a_fault_has_none_and_each_fault_is_named_alone(rng) -> None:
    def setup(**changes: Any) -> dict[str, str]:
        check = SessionCheck(("TH", "MF"), TactileReader(READ, ("TDC_TH", "TDC_MF")))
        sensor = Sensor(check, rng)
        rate_hz, delay_ms = changes.pop("rate_hz", 30.0), changes.pop("delay_ms", 50)
        look(check, rate_hz, delay_ms, *changes.pop("others", ()))
        counts = changes.pop("counts", (REST,))
        for part in counts:
            sensor.feel(part, 3000 // changes.get("every_ms", 10) // len(counts), **changes)
        return faults(check.at_rest())

    assert setup() == {}
    one_still = REST.copy()
    one_still[2 + 4] = 7.0
    absent = REST.copy()
    absent[26:] = 0.0
    cases: dict[str, tuple[dict[str, Any], str, str]] = {
        "clock": ({"skew_ms": 200}, "hand clock", "0.20 s ahead of this computer; synchronise the clocks"),
        "late": ({"skew_ms": -300}, "hand clock", "0.30 s behind this computer"),
        "slow hand": ({"every_ms": 50}, "hand rate", " Hz, at least 50 are needed"),
        "slow camera": ({"rate_hz": 5.0}, "camera rate", " Hz, at least 10 are needed"),
        "late camera": ({"delay_ms": 800}, "camera clock", "0.80 s behind"),
        "hot": ({"tdc": 3300.0}, "thumb temperature", "°C; 10 to 60 are plausible"),
        "electrode": ({"counts": (one_still,)}, "thumb", "taxels 4 (the first is 0) never change"),
        "absent": ({"counts": (absent,)}, "middle finger", "e_mf: all 24 values"),
        "touched": ({"counts": (REST, level(3))}, "thumb", "is touched: no tare; keep the fingers open and still"),
        "hand": ({"others": (ARM,)}, "hand in view", "something stands 1"),
    }

    def check(changes: dict[str, Any], name: str, words: str) -> None:
        found = setup(**dict(changes))
        assert words in found[name], found
        both = {"thumb temperature": {"middle finger temperature"}, "thumb": {"middle finger"}}
        assert set(found) <= {name} | both.get(name, set()), found

    every_case(cases, check)
    nothing = faults(SessionCheck(("TH", "MF"), TactileReader(READ)).at_rest())
    assert {"hand rate", "camera rate", "thumb", "middle finger", "table", "hand in view"} == set(nothing)
    silent = SessionCheck(("TH", "MF"), TactileReader(READ, ("TDC_TH", "TDC_MF")))
    assert next(one.found for one in silent.at_rest() if one.name == "thumb") == "no readings"
    assert to_celsius(2048.0) == pytest.approx(49.3, abs=0.05)  # 4025 / ln(131900 / 0.5001) - 273.15


def test_the_pressed_finger_must_answer_and_alone(rng) -> None:
    both, thumb, middle = level(3), REST.copy(), REST.copy()
    own = np.r_[0, 2:26]
    thumb[own] = both[own]
    middle = np.where(np.isin(np.arange(50), own), REST, both)

    def press(*felt: Any) -> dict[str, str]:
        check = SessionCheck(("TH", "MF"), TactileReader(READ))
        sensor = Sensor(check, rng)
        sensor.feel(REST, 200)
        for finger, counts in zip(("TH", "MF"), felt, strict=True):
            check.pressed.clear()
            sensor.feel(counts, 60)
            sensor.feel(REST, 150)
            check.end_press(finger)
        return faults(check.presses())

    assert press(thumb, middle) == {}
    swapped = "fingers are swapped: --thumb MF --middle TH"
    assert press(middle, thumb) == {
        "press thumb": f"MF answered; {swapped}",
        "press middle finger": f"TH answered; {swapped}",
    }
    assert press(REST, middle) == {"press thumb": "no finger answered; check its cable"}
    assert list(press(thumb, both)) == ["press middle finger"]


def test_reports_are_lines_in_the_dataset(tmp_path: Path) -> None:
    store_check(tmp_path, [CheckFinding("table", "none", "look")], 5)
    store_check(tmp_path, [CheckFinding("table", "found")], 6)
    lines = [json.loads(line) for line in (tmp_path / CHECKS).read_text().splitlines()]
    assert [line["stamp_ns"] for line in lines] == [5, 6]
    assert lines[0]["findings"] == [{"name": "table", "fault": True, "found": "none", "fix": "look"}]
    (tmp_path / CHECKS).unlink()
    (tmp_path / CHECKS).mkdir()
    with pytest.raises(FileError, match=r"checks\.jsonl"):
        store_check(tmp_path, [], 7)


pytestmark = pytest.mark.ros

TACTILE = "/rh/tactile"


def test_messages_that_cannot_be_decoded_are_counted_and_named() -> None:
    reader = make_reader(TactileConfig())
    check = SessionCheck(("TH", "MF"), reader)
    queues = []
    topics = {TACTILE: RecordedTopic(TACTILE, BiotacAll, role="tactile")}
    inputs = SimpleNamespace(topics=topics, open=queues.append, close=lambda: None)
    feed = CheckFeed(check, inputs, reader)
    for number in range(7):
        queues[0].put(SerializedMessage(TACTILE, b"\0\1\0\0 not a message", number, number, None))
    feed.receive(0.1)
    feed.close()
    (finding,) = [finding for finding in check.at_rest() if finding.name == "messages"]
    assert finding.found.startswith("cannot be decoded: 7 of tactile: BiotacAll: 18 bytes cannot be deserialized")
    assert finding.fix == "do the types and the sensor's description fit?"

# SPDX-License-Identifier: Apache-2.0
"""The contact detector on grasps whose onset is known, on noise, and on steady touches of a real sensor."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from sim_builders import CAN, SPONGE, run, scene

from foretouch.tactile import contact_detector
from foretouch.tactile.contact_detector import ContactDetector, FingerContact, contact_scores, find_contact
from foretouch_lab.simulation.execution import GraspTimingConfig, SimulatedHand

PERIOD = 10_000_000
NOISE = np.r_[0.4, np.full(24, 4.4)]
REST, TOUCH = np.r_[2779.0, np.full(24, 3200.0)], np.r_[2900.0, np.full(24, 3100.0)]


def vectors(counts: np.ndarray) -> np.ndarray:
    """(T, 2, 25) as a hand sends them to (T, 50)."""
    thumb, middle = counts[:, 0].astype(float), counts[:, 1].astype(float)
    return np.concatenate([thumb[:, :1], middle[:, :1], thumb[:, 1:], middle[:, 1:]], axis=1)


def test_onsets_of_simulated_grasps_are_found_within_50_ms_live_and_afterwards() -> None:
    every_case([(f"{item['name']} {slot}", item, slot) for item in (CAN, SPONGE) for slot in range(3)], _check_onsets)


def _check_onsets(_: str, item: dict[str, Any], slot: int) -> None:
    config = scene(item, fingers={"timeline": {}, "noise": {}, "scan": {}, "drift": {}})
    course = SimulatedHand(config, GraspTimingConfig(rest_s=1.0)).execute(run(config, "grasp", slot=slot).grasp, slot)
    series = vectors(course.counts)
    stamps = np.arange(len(series)) * PERIOD
    for contact in find_contact(stamps, series, course.start):
        assert contact.onset is not None
        assert 0 <= contact.onset - course.onset <= 5
        assert (contact.several, contact.drifted) == (False, False)
    detector, changes = ContactDetector(), []
    for stamp, reading in zip(stamps, series, strict=True):
        changes += detector.update(int(stamp), reading)
        if course.contact <= stamp // PERIOD < course.release:
            assert detector.holding
    assert [(c.finger, c.kind) for c in sorted(changes, key=lambda c: (c.finger, c.stamp_ns))] == [
        ("MF", "onset"), ("MF", "release"), ("TH", "onset"), ("TH", "release"),
    ]  # fmt: skip
    for change in changes:
        if change.kind == "onset":
            assert 0 <= change.stamp_ns // PERIOD - course.onset <= 5
        else:
            assert change.stamp_ns // PERIOD >= course.release
    assert not detector.holding


def test_noise_and_the_drift_of_a_sensor_at_rest_are_no_contact(rng: np.random.Generator) -> None:
    finger, drift = FingerContact("TH"), np.r_[0.5, rng.uniform(-4, 4, 24)]  # counts a second
    for k in range(6000):
        reading = REST + rng.normal(0, NOISE) + drift * k / 100.0
        assert finger.update(k * PERIOD, reading) is None
    assert finger.touching is False
    assert finger.score < 1.0


@pytest.mark.real_data
def test_a_steady_touch_gives_no_false_alarm(real_data: Path) -> None:
    """22 recordings, 45 s after the reference is there; electrodes with a constant PDC, which was not recorded."""
    files = sorted((real_data / "biotac_steady_100hz").glob("*.csv"))
    assert len(files) == 22
    judged = 0
    for file in files:
        finger = FingerContact(file.stem)
        for k, row in enumerate(np.loadtxt(file, delimiter=",", skiprows=1)):
            assert finger.update(k * PERIOD, np.r_[2779.0, row]) is None
            judged += finger.touching is not None
    assert judged > 4000


def test_one_reading_is_no_contact_and_a_moment_below_no_release(monkeypatch) -> None:
    finger = FingerContact("TH")
    script = [REST] * 100 + [TOUCH, TOUCH] + [REST] * 3 + [TOUCH] * 10 + [REST, REST] + [TOUCH] * 5 + [REST] * 10
    changes = [(k, c.kind, c.stamp_ns // PERIOD) for k, r in enumerate(script) if (c := finger.update(k * PERIOD, r))]
    assert changes == [(107, "onset", 105), (124, "release", 122)]
    monkeypatch.setattr(contact_detector, "LONGEST_S", 1.0)
    finger = FingerContact("TH")  # a contact without end is drift
    kinds = [c.kind for k in range(400) if (c := finger.update(k * PERIOD, REST if k < 100 else TOUCH))]
    assert kinds == ["onset", "release"]
    assert finger.touching is False


def test_one_electrode_or_a_little_of_all_is_enough_and_pdc_alone_too() -> None:
    rest = np.tile(np.r_[2779.0, 1676.0, np.full(48, 3200.0)], (20, 1))

    def score(**changes: float) -> np.ndarray:
        changed = rest[:1].copy()
        for name, by in changes.items():
            changed[0, slice(2, 26) if name == "all" else {"pdc": 0, "one": 7}[name]] += by
        return contact_scores(changed, rest)[0]

    np.testing.assert_array_equal(score(), [0.0, 0.0])
    # Hand-worked: rms / 4.4 / 3 with one of 24 changed by x is x / sqrt(24) / 13.2; PDC by x is x / 0.4 / 12.
    np.testing.assert_allclose(score(one=-66.0), [66.0 / np.sqrt(24) / 13.2, 0.0])
    np.testing.assert_allclose(score(all=-13.2), [1.0, 0.0])
    np.testing.assert_allclose(score(pdc=4.8), [1.0, 0.0])

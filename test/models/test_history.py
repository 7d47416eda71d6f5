# SPDX-License-Identifier: Apache-2.0
"""The history of a hand: which object it is of, what a prediction is adapted to, and the file that keeps it."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from calibrated_models import REST, make_tracked_calibration
from contact_model_builders import scaled, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_array_equal
from safetensors.numpy import load, save

from foretouch.errors import CloudError, FileError, TactileError
from foretouch.models.history_keeper import HistoryFile, HistoryKeeper
from foretouch.models.registry import load_model
from foretouch.models.touch_model import History, TouchModel
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Prediction, Sample, Touch

CARD = {"name": "small", "sha256": "0" * 64}
SAMPLES = make_samples(3, 6)
FIRST, SECOND = SAMPLES[:6], SAMPLES[6:12]
S, DAY = 10**9, 86400 * 10**9


@pytest.fixture(scope="module")
def model() -> TouchModel:
    return TouchModel(small_estimator(), CARD, make_tracked_calibration())


def read(history: History, samples: list[Sample], *, tare: Touch | None = None) -> History:
    for number, sample in enumerate(samples):
        if tare is not None:
            history.tare(tare, stamp_ns=sample.stamp_ns)
        history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=number > 0)
    return history


def predict(history: History, sample: Sample, stamp_ns: int = 0, *, same: bool = False) -> Prediction:
    at = history.at(stamp_ns or sample.stamp_ns, same_object=same)
    (found,) = history.model.predict(sample.cloud, [sample.grasp], history=at)
    return found


def test_readings_of_another_object_move_predictions_and_narrow_them(model: TouchModel) -> None:
    sample = SECOND[0]
    (unread,) = model.predict(sample.cloud, [sample.grasp])
    history = read(History(model), FIRST)
    after = predict(history, sample)
    assert (unread.reference, after.reference) == ("none", "history")
    assert (after.evidence.touches, after.evidence.readings) == (0, 6)
    assert after.evidence.reading_age_s == pytest.approx((sample.stamp_ns - FIRST[-1].stamp_ns) / S)
    assert (half(after) < half(unread)).all()
    assert not np.allclose(after.value.values, unread.value.values)
    own = predict(read(History(model), FIRST), FIRST[0], FIRST[-1].stamp_ns, same=True)
    assert (own.reference, own.evidence.touches, own.evidence.touch_age_s) == ("touches", 6, 0.0)


def half(prediction: Prediction) -> np.ndarray:
    return prediction.upper.values - prediction.lower.values


def test_a_tare_observes_the_sensors_and_is_named(model: TouchModel) -> None:
    sample, tare = SECOND[0], biotac_touch(REST + 40.0)
    (unread,), (tared,) = (model.predict(sample.cloud, [sample.grasp], tare=one) for one in (None, tare))
    assert tared.reference == "tare"
    shift = tared.value.values - unread.value.values
    assert (shift > 0.0).all()
    assert 10.0 < shift.mean() < 40.0  # part of its way from rest
    assert (half(tared) < half(unread)).mean() > 0.9
    history = History(model)
    history.tare(tare, stamp_ns=sample.stamp_ns)
    history.tare(biotac_touch(REST - 40.0), stamp_ns=sample.stamp_ns + 30 * S)  # within a minute of the last one
    at = history.at(sample.stamp_ns, same_object=False, tared=True)
    (found,) = model.predict(sample.cloud, [sample.grasp], history=at)
    assert_array_equal(found.value.values, tared.value.values)


def test_an_object_is_recognised_by_place_and_size(model: TouchModel) -> None:
    history = read(History(model), FIRST)
    cloud = FIRST[-1].cloud
    squares_overflow = cloud.xyz.copy()
    squares_overflow[:2, 1] = 3e38
    others = {
        "elsewhere": Cloud(cloud.xyz + np.float32(0.05)),
        "in another frame": Cloud(cloud.xyz.copy(), None, "other"),
        "larger": scaled(cloud, 2.0),
        "without a point": Cloud(np.full((4, 3), np.nan, np.float32)),
        "with a point whose square no float32 holds": Cloud(squares_overflow),
    }
    assert history.is_current(cloud, 0.02)
    assert history.is_current(Cloud(cloud.xyz + np.float32(0.015)), 0.02)
    assert [name for name, other in others.items() if history.is_current(other, 0.02)] == []
    history.start_object()
    assert not history.is_current(cloud, 0.02)
    assert history.touches == 0
    assert predict(history, FIRST[0], FIRST[-1].stamp_ns).reference == "history"


def test_a_refused_reading_changes_nothing(model: TouchModel) -> None:
    history = read(History(model), FIRST[:2])
    before = history.to_tensors()
    dead = biotac_touch(np.zeros(50))
    one = FIRST[2]
    with pytest.raises(TactileError, match="touched: pdc_th: 0 is not between"):
        history.touched(one.cloud, one.grasp, dead, stamp_ns=one.stamp_ns, same_object=True)
    with pytest.raises(CloudError, match="fewer than 8"):
        history.touched(
            Cloud(np.zeros((3, 3), np.float32)), one.grasp, one.touch, stamp_ns=one.stamp_ns, same_object=True
        )
    with pytest.raises(TactileError, match="tare"):
        history.tare(dead, stamp_ns=one.stamp_ns)
    for name, value in history.to_tensors().items():
        assert_array_equal(value, before[name], err_msg=name)


def test_a_restart_in_the_middle_changes_no_bit(model: TouchModel, tmp_path: Path) -> None:
    tare = biotac_touch(REST + 15.0)
    whole = read(History(model), FIRST, tare=tare)
    file = HistoryFile(tmp_path / "right.safetensors", "right")
    assert file.read(model) is None
    half_way = read(History(model), FIRST[:3], tare=tare)
    file.write(half_way)
    file.close()
    again = HistoryFile(tmp_path / "right.safetensors", "right").read(model)
    assert again.is_current(FIRST[3].cloud, 0.02)
    for one in FIRST[3:]:
        again.tare(tare, stamp_ns=one.stamp_ns)
        again.touched(one.cloud, one.grasp, one.touch, stamp_ns=one.stamp_ns, same_object=True)
    for name, value in whole.to_tensors().items():
        assert_array_equal(again.to_tensors()[name], value, err_msg=name)


@pytest.mark.parametrize("away", [30.0, 100.0, 400.0, 1500.0])
def test_what_was_saved_is_loaded_for_a_hand_however_far_it_is_from_the_model(tmp_path: Path, away: float) -> None:
    model = load_model()
    rng = np.random.default_rng(int(away))
    history = History(model)
    for number, sample in enumerate(SAMPLES):
        side = away * rng.choice([-1.0, 1.0], 50)
        history.tare(biotac_touch(np.clip(REST + side, 1.0, 4094.0)), stamp_ns=sample.stamp_ns)
        reading = biotac_touch(np.clip(sample.touch.values + side, 1.0, 4094.0))
        history.touched(sample.cloud, sample.grasp, reading, stamp_ns=sample.stamp_ns, same_object=number % 3 > 0)
        history.save(tmp_path / "hand", "right")
        again = History.load(tmp_path / "hand", model, "right")
        for name, value in history.to_tensors().items():
            assert_array_equal(again.to_tensors()[name], value, err_msg=name)
    assert np.isfinite(predict(again, SAMPLES[0]).value.values).all()
    assert away == 30.0 or sum(history.restarts.values())  # the jumps were seen


def test_several_that_save_one_history_and_load_it_do_not_disturb_each_other(model: TouchModel, tmp_path: Path) -> None:
    path = tmp_path / "hand"
    histories = [read(History(model), FIRST[: k + 1]) for k in range(3)]
    histories[0].save(path)

    def save_and_load(history: History) -> set[int]:
        loaded = set()
        for _ in range(20):
            history.save(path)
            loaded.add(History.load(path, model).touches)
        return loaded

    with ThreadPoolExecutor(3) as threads:
        assert set.union(*threads.map(save_and_load, histories)) <= {1, 2, 3}
    assert [*tmp_path.iterdir()] == [path]


@pytest.fixture
def path(model: TouchModel, tmp_path: Path) -> Path:
    file = HistoryFile(tmp_path / "right.safetensors", "right")
    file.write(read(History(model), FIRST))
    file.close()
    return file.path


def test_a_file_of_another_hand_model_or_version_is_refused(model: TouchModel, path: Path) -> None:
    assert History.load(path, model).touches == 6
    with pytest.raises(FileError, match=r"right.safetensors: hand: is of 'right', not of 'left'"):
        History.load(path, model, "left")
    other = TouchModel(small_estimator(), {**CARD, "name": "other"}, make_tracked_calibration())
    with pytest.raises(FileError, match="model: is of 'small', not of 'other'"):
        History.load(path, other)
    retrained = TouchModel(small_estimator(), CARD, make_tracked_calibration())
    History.load(path, retrained)  # of equal parameters
    with pytest.raises(FileError, match="No such file"):
        History.load(path.with_name("none"), model)


def test_every_damage_and_impossible_values_though_sealed_are_refused(model: TouchModel, path: Path) -> None:
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(damaged))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"right\.safetensors"):
            History.load(path, model, "right")
    for size in (0, 7, 100, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(FileError):
            History.load(path, model, "right")
    tensors = load(content)  # sealed again, with impossible values
    tensors.pop("sha256")
    for name, value in (
        ("tracker/mean", np.inf),
        ("version", 7),
        ("signature", None),
        ("tracker/counts", -1),
        ("tracker/covariance", -1.0),
        ("tracker/covariance", 1e30),
    ):
        changed = {key: array.copy() for key, array in tensors.items()}
        if value is None:
            changed[name] = changed[name][:3]
        else:
            changed[name].flat[0] = value
        sha256 = np.frombuffer(hashlib.sha256(save(changed)).digest(), np.uint8)
        path.write_bytes(save({**changed, "sha256": sha256}))
        with pytest.raises(FileError, match=name.removeprefix("tracker/")):
            History.load(path, model, "right")


def test_one_process_at_a_time_uses_a_file(path: Path) -> None:
    file = HistoryFile(path, "right")
    code = f"from pathlib import Path; from foretouch.models.history_keeper import HistoryFile as F; F(Path({str(path)!r}), 'right')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "right.safetensors: is used by another process" in done.stderr
    file.close()
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_keeper_sets_the_file_of_another_model_aside(tmp_path: Path) -> None:
    for name in "AB":
        model = TouchModel(small_estimator(), {**CARD, "name": name}, make_tracked_calibration())
        keeper = HistoryKeeper(model, "right", str(tmp_path), info=lambda _: None, warn=lambda _: None)
        read(keeper.history, FIRST[:1])
        keeper.changed()
        keeper.close()
    (kept,) = tmp_path.glob("*.unused*")
    assert History.load(tmp_path / "right.safetensors", model).tracker.evidence(0).readings == 1
    with pytest.raises(FileError, match="model: is of 'A', not of 'B'"):
        History.load(kept, model)


def test_readings_ahead_of_a_clock_that_was_set_back_count_as_taken_now(model: TouchModel) -> None:
    history = read(History(model), FIRST)
    now, touches = FIRST[-1].stamp_ns, history.touches
    assert not history.keep_to_clock(now - 50 * S)  # of jitter
    assert not history.keep_to_clock(0)  # before `/clock`
    assert history.keep_to_clock(now - DAY)
    assert history.tracker.evidence(now - DAY + 5 * S).reading_age_s == 5.0
    assert history.touches == touches
    history.tare(biotac_touch(REST), stamp_ns=now - DAY + 61 * S)
    assert history.tracker.evidence(now - DAY + 61 * S).reading_age_s == 0.0


def test_the_keeper_tells_any_error_and_writes_again_after_it(
    model: TouchModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    warned: list[str] = []
    keeper = HistoryKeeper(model, "right", str(tmp_path), info=lambda _: None, warn=warned.append)
    write = HistoryFile.write
    failed = threading.Event()

    def fail(*_: object) -> None:
        failed.set()
        raise ValueError("odd")

    monkeypatch.setattr(HistoryFile, "write", fail)
    read(keeper.history, FIRST[:1])
    keeper.changed()
    assert failed.wait(5.0)
    monkeypatch.setattr(HistoryFile, "write", write)
    keeper.close()
    assert len(warned) == 1
    assert "odd" in warned[0]
    assert History.load(tmp_path / "right.safetensors", model).tracker.evidence(0).readings == 1

# SPDX-License-Identifier: Apache-2.0
"""Replay in order of time: nothing later enters a prediction."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated_models import REST, make_calibration
from numpy.testing import assert_array_equal

from foretouch.errors import DatasetError
from foretouch.models.tracker import SensorTracker
from foretouch_lab.learning.prequential import TimedReadings, other_objects_mean, replay

S = 10**9
CALIBRATION = make_calibration()


def recording(rng: np.random.Generator, names: str = "aabbba", tares: bool = False) -> TimedReadings:
    count = len(names)
    readings, expected = REST + rng.normal(0.0, 30.0, (2, count, 50))
    offsets = rng.normal(0.0, 10.0, (count, 50)) if tares else None
    stamps = 1_700_000_000 * S + np.arange(count) * 3600 * S
    order = rng.permutation(count)
    made = TimedReadings(
        stamps[order], np.array(list(names))[order], readings[order], expected[order], offsets
    ).ordered()
    assert "".join(made.objects) == names
    assert_array_equal(made.readings, readings)
    return made


def tracker() -> SensorTracker:
    patient = replace(CALIBRATION.tracker_parameters, alarm=np.full((2, 2), 1e6))  # never restarts a finger
    return SensorTracker(patient)


def test_an_object_that_returns_begins_again(rng) -> None:
    assert recording(rng).touches().tolist() == [0, 1, 0, 1, 2, 0]
    assert recording(rng).runs().tolist() == [0, 0, 1, 1, 1, 2]


@pytest.mark.parametrize("tares", [False, True])
def test_a_prediction_does_not_depend_on_its_own_reading_or_later_ones(tares: bool, rng) -> None:
    made = recording(rng, "aaabbbaab", tares)
    whole = replay(tracker(), made)
    for k in range(9):
        changed = made.readings.copy()
        changed[k:] += 50.0
        other = replay(tracker(), replace(made, readings=changed))
        assert_array_equal(other.counts[: k + 1], whole.counts[: k + 1])
        assert_array_equal(other.half[: k + 1], whole.half[: k + 1])
        if k < 8 and made.objects[k] == made.objects[k + 1]:
            assert (other.counts[k + 1] != whole.counts[k + 1]).all()


def test_an_unlabelled_grasp_is_predicted_and_not_remembered(rng) -> None:
    made = recording(rng)
    readings = made.readings.copy()
    readings[1] = np.nan
    played = replay(tracker(), replace(made, readings=readings))
    assert np.isfinite(played.counts).all()
    assert [level.evidence.readings for level in played.levels] == [0, 1, 1, 2, 3, 4]


def test_recordings_without_stamps_or_with_one_object_are_refused(rng) -> None:
    with pytest.raises(DatasetError, match="has no stamp"):
        TimedReadings(np.array([0, 5]), np.array(["a", "b"]), *np.zeros((2, 2, 50))).ordered()
    with pytest.raises(DatasetError, match="all readings are of a"):
        other_objects_mean(recording(rng, "aaa"))

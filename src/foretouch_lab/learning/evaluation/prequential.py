# SPDX-License-Identifier: Apache-2.0
"""Scores of predictions in order of time: each grasp from vision and all earlier readings [Dawid 1984]."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from foretouch.errors import DatasetError
from foretouch.models.touch_model import TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.types import Float64, GraspSample
from foretouch_lab.learning.evaluation.metrics import score
from foretouch_lab.learning.prequential import TimedReadings, replay, replay_model

BINS: Final[Mapping[str, tuple[int, int]]] = {
    "none": (0, 0),
    "1 touch": (1, 1),
    "2 touches": (2, 2),
    "first 3": (0, 2),
    "3-9": (3, 9),
    "10+": (10, 10**9),
    "all": (0, 10**9),
}
"""Ranges of the number of touches of the object before a grasp, both ends included, by name."""

CLOCK_S: Final = 86400.0
"""Time constant of the weights of the baselines that know the time only [s]."""


def baselines(recording: TimedReadings, reference: Float64) -> dict[str, Float64]:
    """(S, D) predictions by name that know labels and times only [counts].

    Args:
        recording: Its predictions by vision are not used.
        reference: (S, D) prediction where nothing was read before [counts].

    Returns:
        `running mean` of all earlier readings; mean of the `last run` of another object; `object mean` of the earlier
        touches of the object; `clock`: mean of all earlier readings, with weights that fall by e in a day; `clock both
        ways`: the same over all readings of other runs, earlier and later.
    """
    readings, runs, touches = recording.readings, recording.runs(), recording.touches()
    seconds = (recording.stamps_ns - recording.stamps_ns[0]) / 1e9
    found = {name: reference.copy() for name in ("running mean", "last run", "object mean", "clock", "clock both ways")}
    for k in range(len(readings)):
        weights = np.exp(-np.abs(seconds - seconds[k]) / CLOCK_S) + 1e-12
        others = runs != runs[k]
        if others.any():
            found["clock both ways"][k] = np.average(readings[others], axis=0, weights=weights[others])
        if k:
            found["running mean"][k] = readings[:k].mean(axis=0)
            found["clock"][k] = np.average(readings[:k], axis=0, weights=weights[:k])
        if runs[k]:
            found["last run"][k] = readings[runs == runs[k] - 1].mean(axis=0)
        if touches[k]:
            found["object mean"][k] = readings[k - touches[k] : k].mean(axis=0)
    return found


def other_objects_mean(recording: TimedReadings) -> Float64:
    """(S, D) mean of all readings of other objects, earlier and later: the reference of the skill [counts].

    Raises:
        DatasetError: If all readings are of one object.
    """
    names = np.unique(recording.objects)
    if len(names) < 2:
        raise DatasetError(f"prequential: all readings are of {names[0]}; skills require another object")
    result = np.empty_like(recording.readings)
    for name in names:
        own = recording.objects == name
        result[own] = recording.readings[~own].mean(axis=0)
    return result


def evaluate_prequential(
    model: TouchModel, samples: Sequence[GraspSample], history: Sequence[GraspSample] = ()
) -> dict[str, Any]:
    """Scores over touches of the object: tracker, memory that ends with the object, vision alone, baselines without a cloud.

    Args:
        model: With a calibration.
        samples: Labelled, of at least two objects.
        history: As of `replay_model`, labelled.

    Returns:
        `touches`: by name from `BINS` (those without a grasp are left out), `grasps` and by method and modality `rmse`,
        `skill` against the mean of the other objects, and `coverage90` and `half_width` (None without intervals).
        `samples`; `history`; `restarted`: ids of samples whose reading restarted a finger, with its name; `not_scored`: indices of
        the taxels that are dead in the training data or were not always read, by finger.

    Raises:
        DatasetError: As `replay_model`, or if all samples are of one object.
    """
    done = replay_model(model, samples, history)
    assert model.calibration is not None  # noqa: S101  checked by replay_model
    readings = done.recording.readings
    valid = model.sensor.valid_values & ~np.isnan(readings).any(axis=0)
    readings = np.nan_to_num(readings)  # of taxels that are not scored
    recording = replace(done.recording, readings=readings)
    reference = other_objects_mean(recording)
    forgetful = SensorTracker(replace(model.calibration, tracker=None).tracker_parameters)
    memory = replay(forgetful, done.recording, keep_sensors=False)
    counts = {"tracker": done.played.counts, "memory": memory.counts, "sight": done.recording.expected}
    counts |= baselines(recording, reference)
    half = {"tracker": done.played.half, "memory": memory.half}
    touches = recording.touches()
    found: dict[str, Any] = {}
    for name, (low, high) in BINS.items():
        chosen = done.scored & (touches >= low) & (touches <= high)
        if not chosen.any():
            continue
        scores: dict[str, Any] = {}
        for method, values in counts.items():
            scored = score(values[chosen], readings[chosen], reference[chosen], model.ranges, valid=valid)
            scores[method] = {
                key: {"rmse": one.rmse, "skill": one.skill, "coverage90": None, "half_width": None}
                for key, one in scored.items()
            }
            for key in model.sensor.channels.modalities if method in half else ():
                columns = model.sensor.channels.columns([key])
                own = np.ix_(chosen, columns[valid[columns]])
                width = half[method][own]
                inside = np.abs(readings[own] - values[own]) <= width
                scores[method][key] |= {"coverage90": float(inside.mean()), "half_width": float(width.mean())}
        found[name] = {"grasps": int(chosen.sum()), "scores": scores}
    pairs = zip(done.samples, done.played.restarted, strict=True)
    restarted = {sample.id: list(names) for sample, names in pairs if names}
    count = int(done.scored.sum())
    facts = {"samples": count, "history": len(done.samples) - count, "restarted": restarted}
    return {"touches": found, **facts, "not_scored": model.sensor.taxels_of(~valid)}

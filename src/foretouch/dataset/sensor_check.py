# SPDX-License-Identifier: Apache-2.0
"""Compares the description of a sensor with what was recorded of it."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.dataset.record import REST, readings
from foretouch.dataset.samples import open_samples
from foretouch.errors import TactileError
from foretouch.tactile.description import Sensor
from foretouch.types import SECOND_NS, Float64

_STILL: Final = 20  # readings without change, through which a working taxel shows its noise
_SATURATED: Final = 0.01  # of a taxel's readings at an end of its range


def compare_sensor(sensor: Sensor, path: Path) -> dict[str, Any]:
    """Ranges, noise, drift, rate and failed taxels of a dataset, beside those of a description, in plain types.

    Dead taxels never changed, stuck ones not through at least one grasp. Noise is the standard deviation at rest, drift the change of the
    rest level from a grasp to the next (medians over taxels). `corrections` lists setting, stated and recorded value.

    Raises:
        FileError: If there is no dataset.
        TactileError: If its readings have another number of values, or it holds none.
    """
    channels, size = sensor.channels, sensor.channels.size
    low, high, still, ends = np.full(size, np.inf), np.full(size, -np.inf), np.zeros(size, int), np.zeros(size, int)
    count, outside, grasps, repeated = 0, np.zeros(size, int), 0, 0
    noise, rests, steps = list[Float64](), list[Float64](), list[Float64]()
    edge = [one.saturation or one.limits for one, size in sensor.predicted for _ in channels.fingers for _ in range(size)]
    bottom, top = np.array(edge).T
    for record in open_samples(path).records():
        if (series := readings(record)) is None:
            continue
        values = series.counts.astype(np.float64)
        if values.shape[1] != size:
            raise TactileError(f"{path}: {values.shape[1]} values in a reading, and {size} of {channels.sensor}")
        grasps, count = grasps + 1, count + len(values)
        low, high = np.minimum(low, values.min(axis=0)), np.maximum(high, values.max(axis=0))
        outside += ((values < channels.low) | (values > channels.high)).sum(axis=0)
        ends += ((values <= bottom) | (values >= top)).sum(axis=0)
        still += (np.ptp(values, axis=0) == 0.0) & (len(values) >= _STILL)
        repeated += int((np.diff(values, axis=0) == 0.0).all(axis=1).sum())
        steps.append(np.diff(series.stamps_ns) / SECOND_NS)
        if (rest := values[series.phases == REST]).shape[0] > 1:
            noise.append(rest.std(axis=0, ddof=1))
            rests.append(np.median(rest, axis=0))
    if not grasps:
        raise TactileError(f"{path}: holds no readings")
    step = float(np.median(np.concatenate(steps))) if any(map(len, steps)) else 0.0
    calm = np.sort(np.square(noise), axis=0)[: max(1, int(0.9 * len(noise)))] if noise else np.full((1, size), np.nan)
    level = np.sqrt(calm.mean(axis=0))  # without the tenth of the grasps that were least at rest
    drift = np.median(np.abs(np.diff(rests, axis=0)), axis=0) if len(rests) > 1 else np.full(size, np.nan)
    dead, modalities = (low == high) & (count >= _STILL), dict[str, Any]()
    for name, columns in channels.modality_columns.items():
        modalities[name] = {
            "range": [float(low[columns].min()), float(high[columns].max())],
            "outside": int(outside[columns].sum()),
            "noise": _number(level[columns]),
            "drift": _number(drift[columns]),
            "saturated": np.flatnonzero(ends[columns] > _SATURATED * count).tolist(),
            "dead": np.flatnonzero(dead[columns]).tolist(),
            "stuck": np.flatnonzero(~dead[columns] & (still[columns] > 0)).tolist(),
        }
    found = {"grasps": grasps, "readings": count, "rate_hz": 1.0 / step if step else None}
    found["repeated"] = repeated / max(1, count - grasps)
    return {**found, "modalities": modalities, "corrections": _corrections(sensor, found["rate_hz"], modalities)}


def _corrections(sensor: Sensor, rate_hz: float | None, modalities: dict[str, Any]) -> list[list[str]]:
    rows, config = [], sensor.config
    if rate_hz is not None and abs(rate_hz / config.update_rate - 1.0) > 0.05:
        rows.append(["update_rate", f"{config.update_rate:g}", f"{rate_hz:.3g}"])
    for one, _ in sensor.predicted:
        parts = [modalities[f"{one.name}_{finger}"] for finger in sensor.channels.fingers]
        if any(part["outside"] for part in parts):
            ends = [min(part["range"][0] for part in parts), max(part["range"][1] for part in parts)]
            rows.append([f"{one.name}: range", str(list(one.limits)), str(ends)])
        noises = [part["noise"] for part in parts if part["noise"] is not None]
        if noises and not (one.noise and 0.5 < np.median(noises) / one.noise < 2.0):
            rows.append([f"{one.name}: noise", "none" if one.noise is None else f"{one.noise:g}", f"{np.median(noises):.3g}"])
    for finger in config.chosen_fingers():
        own = [modalities[f"{one.name}_{finger.name}"]["dead"] for one, size in sensor.predicted if size == sensor.size]
        if (dead := sorted(set.intersection(*map(set, own)))) != sorted(finger.dead):
            rows.append([f"{finger.name}: dead", str(list(finger.dead)), str(dead)])
    return rows


def _number(values: Float64) -> float | None:
    return None if np.isnan(values).all() else float(f"{np.nanmedian(values):.3g}")

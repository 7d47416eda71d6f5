# SPDX-License-Identifier: Apache-2.0
"""How do the levels of the sensors drift in the public recordings? The variances behind `campaign` in config/scenes/campaign.yaml.

Reading = mean + slow drift + fast drift + object + grasp, by restricted maximum likelihood on blocks of three successive grasps of
an object. Both drifts are Ornstein-Uhlenbeck processes in time, whatever the object. Prints aggregated figures only.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from foretouch.dataset.samples import open_samples

Array = npt.NDArray[np.float64]

SLOW_DAYS, FAST_DAYS = 10.0, 0.05
_BLOCK = 3  # grasps
_PAUSE_S = 3600.0  # begins another visit of the same object
_DAY_S = 86400.0


@dataclass(frozen=True)
class Blocks:
    """Successive grasps of one object, averaged."""

    values: Array  # (n, 50): PDC_TH, PDC_MF, E_TH, E_MF [counts]
    days: Array  # (n,) mean time
    sizes: Array  # (n,) grasps
    same_object: Array  # (n, n): 1 or 0


def blocks(path: str) -> Blocks:
    """Read the grasps of a dataset in order of time."""
    with open_samples(path) as samples:
        kept = [r.sample for r in samples.records() if r.sample.touch is not None]
    kept.sort(key=lambda sample: sample.stamp_ns)
    values = np.array([sample.touch.vector() for sample in kept if sample.touch is not None])
    seconds = np.array([sample.stamp_ns * 1e-9 for sample in kept])
    objects = np.array([sample.object for sample in kept])
    new = (np.diff(seconds) > _PAUSE_S) | (objects[1:] != objects[:-1])
    visits = np.split(np.arange(len(kept)), np.flatnonzero(new) + 1)
    parts = [part for visit in visits for part in np.array_split(visit, max(1, len(visit) // _BLOCK))]
    labels = np.array([objects[part[0]] for part in parts])
    return Blocks(
        np.array([values[part].mean(axis=0) for part in parts]),
        np.array([seconds[part].mean() for part in parts]) / _DAY_S,
        np.array([float(len(part)) for part in parts]),
        (labels[:, None] == labels).astype(np.float64),
    )


def fit(data: Blocks, values: Array, slow_days: float, fast_days: float) -> tuple[Array, float]:
    """Standard deviations (slow, fast, object, grasp) that all columns share, and the log likelihood."""
    apart = np.abs(data.days[:, None] - data.days)
    parts = [np.exp(-apart / slow_days), np.exp(-apart / fast_days), data.same_object, np.diag(1.0 / data.sizes)]
    scale = float(values.var())

    def loss(logs: Array) -> float:
        factor = cho_factor(sum(math.exp(log) * part for log, part in zip(logs, parts, strict=True)), lower=True)
        ones = cho_solve(factor, np.ones(len(values)))
        rest = values - (ones @ values) / ones.sum()
        determinant = 2.0 * float(np.log(np.diag(factor[0])).sum()) + math.log(ones.sum())
        return 0.5 * (values.shape[1] * determinant + float((rest * cho_solve(factor, rest)).sum()))

    limits = [(math.log(scale * 1e-4), math.log(scale * 30.0))] * 4
    found = minimize(loss, np.log([0.4 * scale, 0.4 * scale, 0.4 * scale, scale]), method="L-BFGS-B", bounds=limits)
    return np.exp(found.x / 2.0), -float(found.fun)


def kinds(data: Blocks) -> Iterator[tuple[str, Array]]:
    """What is fitted, each of uncorrelated columns: what both fingers share, what differs between them, and what is left."""
    thumb, middle = data.values[:, 2:26], data.values[:, 26:]
    means = [finger.mean(axis=1, keepdims=True) for finger in (thumb, middle)]
    yield "electrodes, mean of both fingers", (means[0] + means[1]) / 2.0
    yield "electrodes, half the difference of the fingers", (means[0] - means[1]) / 2.0
    for name, finger, mean in zip(("TH", "MF"), (thumb, middle), means, strict=True):
        yield f"E_{name}, each from the mean of its finger", (finger - mean) * math.sqrt(24.0 / 23.0)
    yield "PDC_TH", data.values[:, :1]
    yield "PDC_MF", data.values[:, 1:2]


def settings(found: dict[str, Array]) -> Iterator[tuple[str, float, float]]:
    """The settings of a drift term in a scene: name, slow and fast."""
    mean, difference = list(found.values())[:2]
    finger = math.sqrt(2.0) * difference[:2]
    hand = np.sqrt(np.maximum(mean[:2] ** 2 - finger**2 / 2.0, 0.0))
    yield "hand_counts", hand[0], hand[1]
    yield "finger_counts", finger[0], finger[1]
    for name, ends in (("electrode_counts", slice(2, 4)), ("pdc_counts", slice(4, 6))):
        slow, fast = np.sqrt(np.mean(np.array(list(found.values())[ends]) ** 2, axis=0))[:2]
        yield name, float(slow), float(fast)


def warm_up(data: Blocks, warming_s: float) -> Iterator[tuple[str, float, float]]:
    """Rise with 1 - exp(-t / warming) after the first grasp of a session, whatever the object: counts and standard error.

    The mean of each visit is free; visits are the unit of the standard error.
    """
    pause = np.diff(data.days) * _DAY_S > _PAUSE_S
    starts = np.concatenate([[0], np.flatnonzero(pause) + 1])
    since = (
        data.days - data.days[starts[np.searchsorted(starts, np.arange(len(data.days)), side="right") - 1]]
    ) * _DAY_S
    new = pause | (data.same_object.diagonal(1) == 0.0)
    visit = np.concatenate([[0], np.cumsum(new)])
    rise = -np.expm1(-since / warming_s)
    weights = data.sizes

    def without_visits(column: Array) -> Array:
        sums = np.bincount(visit, weights * column) / np.bincount(visit, weights)
        return np.asarray(column - sums[visit])

    x = without_visits(rise)
    names = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")
    columns = (
        data.values[:, 0],
        data.values[:, 1],
        data.values[:, 2:26].mean(axis=1),
        data.values[:, 26:].mean(axis=1),
    )
    for name, column in zip(names, columns, strict=True):
        y = without_visits(column)
        slope = (weights * x) @ y / ((weights * x) @ x)
        scores = np.bincount(visit, weights * x * (y - slope * x))
        yield name, float(slope), float(np.sqrt(scores @ scores) / ((weights * x) @ x))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", help="dataset with stamps: the public recordings, or a simulated campaign")
    parser.add_argument(
        "-o", "--out", type=Path, help="CSV file of the fits; results/drift.csv is that of the recordings"
    )
    arguments = parser.parse_args()
    data = blocks(arguments.data)
    rows: list[list[object]] = []
    found = {}
    for name, values in kinds(data):
        found[name], likelihood = fit(data, values, SLOW_DAYS, FAST_DAYS)
        rows.append([name, SLOW_DAYS, FAST_DAYS, *(f"{value:.1f}" for value in found[name]), f"{likelihood:.1f}"])
    name, values = next(kinds(data))
    for slow, fast in ((5.0, 0.05), (20.0, 0.05), (40.0, 0.05), (10.0, 0.02), (10.0, 0.1), (10.0, 0.2)):
        sds, likelihood = fit(data, values, slow, fast)
        rows.append([name, slow, fast, *(f"{value:.1f}" for value in sds), f"{likelihood:.1f}"])
    header = ["what", "slow [days]", "fast [days]", "sd slow", "sd fast", "sd object", "sd grasp", "log likelihood"]
    if arguments.out is not None:
        with arguments.out.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])
    for row in [header, ["---"] * len(header), *rows]:
        print(f"| {' | '.join(map(str, row))} |")
    print("\nsettings of a drift term, slow and fast:")
    for setting_name, slow, fast in settings(found):
        print(f"  {setting_name}: {slow:.1f}, {fast:.1f}")
    print("\nwarm-up over 600 s, counts and standard error:")
    for name, rise, error in warm_up(data, 600.0):
        print(f"  {name}: {rise:.0f} ± {error:.0f}")


if __name__ == "__main__":
    main()

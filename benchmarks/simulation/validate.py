# SPDX-License-Identifier: Apache-2.0
"""Is the simulated world like the measured one?

Prints one table: what was found in the scenes of this repository, and what it must be. The bounds were measured on
real recordings: 400 grasps of rigid objects, 22 steady touches, and the clouds of the first paper.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.common import print_rows, scene
from foretouch.types import Sample
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.simulate import Simulation

Array = npt.NDArray[np.float64]
Row = tuple[str, float, float, float]  # what, found, least, most

# Of each finger its electrodes and its pressure among the readings, and the bounds of the drops of an electrode [counts].
_TH_MF = (("TH", slice(2, 26), 0, (78, 176), (657, 1479)), ("MF", slice(26, 50), 1, (48, 108), (461, 1037)))

_FEWEST = 100  # the first 4 components of 12 grasps explain .9 of any variance


@dataclass(frozen=True)
class SteadyNoise:
    """Noise of electrodes in steady touch."""

    sd: float  # of the white part [counts]: root mean square of the steps that move, over √2; a slow change hardly enters
    repeated: float  # share of values equal to the one before
    lag1: float  # autocorrelation at one row about each channel's straight line, median of the channels that depart from it


def steady_noise(series: Sequence[npt.ArrayLike]) -> SteadyNoise:
    """Estimate the noise of series of (T, C) counts at a steady rate; T and C may differ."""
    rows = [np.asarray(hold, np.float64) for hold in series]
    steps = np.concatenate([np.diff(counts, axis=0).ravel() for counts in rows])
    moves = steps[steps != 0.0]
    lags = np.concatenate([_lag1(counts) for counts in rows])
    return SteadyNoise(math.sqrt(np.mean(moves**2) / 2.0), 1.0 - moves.size / steps.size, float(np.median(lags)))


def _lag1(counts: Array) -> Array:
    time = np.arange(len(counts)) - (len(counts) - 1) / 2.0
    rest = counts - counts.mean(axis=0)
    rest -= np.outer(time, time @ rest / (time @ time))
    squares = (rest**2).sum(axis=0)
    moving = squares > 0.0
    return np.asarray((rest[1:] * rest[:-1]).sum(axis=0)[moving] / squares[moving])


def camera() -> Iterator[Row]:
    """Measure the noise of planes in 10 mm patches of a flat box, and the step of depth."""
    config = scene("rigid", camera__holes=None, camera__flying_pixels=None, objects=[_FLAT])
    rng = np.random.default_rng(0)
    tries = Engine(config, EFFECTS).first_tries(10)
    clouds = [state.cloud.xyz.astype(np.float64) for _, state in tries]
    rms = [value for cloud in clouds for value in _plane_rms(cloud, rng)]
    yield "plane-fit RMS of 10 mm patches at 1.2 m, median [mm]", 1e3 * float(np.median(rms)), 0.64, 1.05
    steps = np.unique(np.diff(np.unique(np.round(1e6 * clouds[0][:, 2]))))
    yield "step of z [mm]", 1e-3 * float(steps[steps > 1].min()), 0.999, 1.001


_FLAT = {"name": "flat", "shape": "box", "size_m": [0.12, 0.16, 0.05], "pose": {"yaw_deg": [0, 0]}}


def _plane_rms(cloud: Array, rng: np.random.Generator) -> Iterator[float]:
    for centre in cloud[rng.integers(0, len(cloud), 60)]:
        patch = cloud[(np.abs(cloud[:, :2] - centre[:2]) < 0.005).all(axis=1)]
        if len(patch) >= 16:
            design = np.column_stack([patch[:, :2], np.ones(len(patch))])
            yield float(np.std(patch[:, 2] - design @ np.linalg.lstsq(design, patch[:, 2], rcond=None)[0]))


def sensor() -> Iterator[Row]:
    """Measure the noise of electrodes in a steady hold at 100 Hz."""
    fingers = {"timeline": {"hold_s": 3.0}, "noise": {}, "scan": {}}
    config = scene("clean", fingers=fingers)
    holds = []
    for _, state in Engine(config, EFFECTS).first_tries(8):
        holds += [np.rint(state.series[state.load == 1.0][1:, finger, 1:]) for finger in range(2)]
    noise = steady_noise(holds)
    yield "electrode noise, sd [counts]", noise.sd, 3.9, 4.9
    yield "electrode noise, repeated share", noise.repeated, 0.30, 0.40
    yield "electrode noise, lag-1 correlation", noise.lag1, 0.30, 0.46


def counts(samples: list[Sample]) -> Iterator[Row]:
    """Measure the spread of the counts over grasps of rigid objects."""
    touches = np.array([s.touch.values for s in samples if s.touch is not None])
    for name, columns, pdc, median, most in _TH_MF:
        electrodes = touches[:, columns]
        drop = np.percentile(electrodes, 95, axis=0) - electrodes
        variances = np.linalg.svd(electrodes - electrodes.mean(axis=0), compute_uv=False) ** 2
        yield f"rigid {name}: drop of an electrode, median [counts]", float(np.median(drop)), *median
        yield f"rigid {name}: drop, 99 % [counts]", float(np.percentile(drop, 99)), *most
        share = float(variances[:4].sum() / variances.sum())
        yield f"rigid {name}: share of the first 4 components", share, 0.65, 0.85
        correlation = float(np.corrcoef(touches[:, pdc], electrodes.mean(axis=1))[0, 1])
        yield f"rigid {name}: corr(PDC, mean electrode)", correlation, -0.4, 0.4


def forces(name: str, count: int) -> Iterator[Row]:
    """Measure the balance of the fingers, and the sum of pressure against the commanded force."""
    config = scene(name, grasps__control="force")
    balance, sums = [], []
    for _, state in Engine(config, EFFECTS).first_tries(count):
        thumb, middle = (
            c.pressure.sum() * (p.x[0, 1] - p.x[0, 0]) ** 2 for c, p in zip(state.contacts, state.pads, strict=True)
        )
        balance.append(abs(thumb - middle) / thumb)
        sums.append(abs(thumb - state.target) / state.target)
    yield f"{name}: imbalance of the two fingers, largest", max(balance), 0.0, 1e-3
    yield f"{name}: Σ p·A against the command, largest", max(sums), 0.0, 1e-3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=400, help="grasps of rigid objects")
    arguments = parser.parse_args()
    if arguments.n < _FEWEST:
        parser.error(f"-n: {arguments.n} is below {_FEWEST}, the fewest grasps that show a spread")
    rigid = Simulation(scene("rigid"))
    samples = list(rigid.samples(arguments.n))
    rows = [*camera(), *sensor(), *counts(samples)]
    rows += [*forces("rigid", 60), *forces("deformables", 60)]
    lines = [
        {"what": what, "found": f"{value:.3g}", "must": f"{least:g} to {most:g}", "": "ok" if least <= value <= most else "no"}
        for what, value, least, most in rows
    ]  # fmt: skip
    print_rows(lines)
    print(f"Failed tries in {arguments.n} rigid grasps: {rigid.failures_by_reason or 'none'}")
    sys.exit(any(line[""] == "no" for line in lines))


if __name__ == "__main__":
    main()

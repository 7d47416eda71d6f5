# SPDX-License-Identifier: Apache-2.0
"""Does the simulated fingertip spread its counts as real ones do?

Prints one row a finger and seed: simulated grasps of rigid objects against the bounds set by 400 real ones.
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt
from contacts import random_contacts

from foretouch.simulation.contact import Command, PadConfig, solve_contact
from foretouch.simulation.disturbances import NoiseConfig
from foretouch.simulation.fingertip import FingerConfig, ThumbConfig, draw_finger, quantise, read_contact

Array = npt.NDArray[np.float64]


def grasps(kind: FingerConfig, n: int, seed: int) -> tuple[Array, Array]:
    """PDC (n,) and electrodes (n, 24) of one finger, in whole counts with white noise."""
    pad, noise = PadConfig(), NoiseConfig()
    deviation = np.array([noise.pdc_counts, *[noise.electrode_counts] * 24])
    rng = np.random.default_rng([seed, 1])
    finger = draw_finger(kind, rng)
    readings = [
        read_contact(pad, finger, window, solve_contact(problem, Command(force_n=force)))
        + deviation * rng.standard_normal(25)
        for window, problem, force in random_contacts(n, seed, pad)
    ]
    counts = quantise(np.array(readings)).astype(np.float64)
    return counts[:, 0], counts[:, 1:]


def spread(pdc: Array, electrodes: Array) -> dict[str, float]:
    """The statistics that real grasps are told by."""
    top = np.percentile(electrodes, 95, axis=0)
    drop = top - electrodes
    variances = np.linalg.eigvalsh(np.cov(electrodes.T))[::-1]
    return {
        "drop_median": float(np.median(drop)),
        "drop_99": float(np.percentile(drop, 99)),
        "share_of_4": float(variances[:4].sum() / variances.sum()),
        "corr_pdc_mean_e": float(np.corrcoef(pdc, electrodes.mean(axis=1))[0, 1]),
        "pdc_5": float(np.percentile(pdc, 5)),
        "pdc_95": float(np.percentile(pdc, 95)),
        "e_min": float(electrodes.min()),
        "e_95": float(np.median(top)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=400, help="grasps a finger")
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    rows = [
        (name, seed, spread(*grasps(kind, arguments.n, seed)))
        for name, kind in (("MF", FingerConfig()), ("TH", ThumbConfig()))
        for seed in range(arguments.seeds)
    ]
    print("| finger | seed | " + " | ".join(rows[0][2]) + " |\n" + "|---" * (2 + len(rows[0][2])) + "|")
    for name, seed, values in rows:
        print(
            f"| {name} | {seed} | "
            + " | ".join(f"{v:.3g}" if abs(v) < 10 else f"{v:.0f}" for v in values.values())
            + " |"
        )


if __name__ == "__main__":
    main()

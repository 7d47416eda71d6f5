# SPDX-License-Identifier: Apache-2.0
"""A stream of tactile readings in which every grasp can be told from every other by its counts."""

from dataclasses import dataclass

import numpy as np

from foretouch.dataset.labelling.cut import Interval
from foretouch.tactile.messages.table import TactileReading
from foretouch_lab.simulation.message_faults import FaultConfig, MessageFaults

SECOND = 1_000_000_000
PERIOD = SECOND // 100
T0 = 1_700_000_000 * SECOND
REST = np.concatenate([[2779.0, 1676.0], np.linspace(3000, 3300, 24), np.linspace(3100, 3500, 24)]).astype(np.float32)
NONE = np.empty(0, np.float32)


@dataclass(frozen=True)
class Named:
    """A grasp with the only field that the matcher uses."""

    id: str


def level(number: int) -> np.ndarray:
    """(50,) counts while grasp `number` holds: PDC rises by 100 + 20 n, electrodes fall by 60 + 10 n."""
    counts = REST.copy()
    counts[:2] += 100 + 20 * number
    counts[2:] -= 60 + 10 * number
    return counts


def interval(number: int, period_s: float = 3.0) -> Interval:
    """Grasp `number` closes at 1 s of its period, holds from 1.5 s to 2.2 s."""
    begin = T0 + round(number * period_s * SECOND)
    return Interval(start=begin + SECOND, contact=begin + 3 * SECOND // 2, release=begin + 11 * SECOND // 5)


def true_counts(stamp_ns: int, grasps: int, period_s: float = 3.0) -> np.ndarray:
    """Noise-free counts at a true time: ramps of 0.2 s to and from the hold."""
    number = min(grasps - 1, int((stamp_ns - T0) // round(period_s * SECOND)))
    one = interval(number, period_s)
    ramp = 0.2 * SECOND
    share = min(1.0, max(0.0, 1.0 - (one.contact - stamp_ns) / ramp), max(0.0, 1.0 - (stamp_ns - one.release) / ramp))
    return (REST + np.float32(share) * (level(number) - REST)).astype(np.float32)


def stream(
    grasps: int, faults: FaultConfig | None = None, seed: int = 0, period_s: float = 3.0
) -> list[TactileReading]:
    """What the sensor sends during so many grasps, in the order of arrival; arrival is on time."""
    rng = np.random.default_rng(seed)
    spoil = MessageFaults(faults or FaultConfig(), seed)
    readings = []
    for true_ns in range(T0, T0 + round(grasps * period_s * SECOND), PERIOD):
        stamp = spoil.stamp(true_ns)
        if stamp is None:
            continue
        noise = rng.normal(0.0, np.concatenate([[0.3, 0.3], np.full(48, 4.4)]))
        counts = np.round(true_counts(true_ns, grasps, period_s) + noise).astype(np.float32)
        readings.append(TactileReading(stamp, counts, NONE, true_ns))
    return readings

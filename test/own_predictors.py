# SPDX-License-Identifier: Apache-2.0
"""Predictors as a user writes them, good and bad: this module is also imported by its name."""

import threading
import time

import numpy as np

import foretouch as ft

MEAN = np.concatenate([[2820.0, 1780.0], 3000.0 + 25.0 * np.linspace(1.0, 5.0, 24), np.full(24, 3200.0)])


class Constant:
    """Returns one reading for every grasp."""

    def estimate(self, cloud, grasps, table=None):
        return np.tile(MEAN, (len(grasps), 1))


class Memory:
    """Knows by heart what it was fitted to, and returns the mean for what it was not."""

    def __init__(self, keys=None, values=None):
        self.keys, self.values = keys, values

    def fit(self, samples):
        self.keys = np.array([sample.grasp.g1 for sample in samples])
        self.values = np.array([sample.touch.values for sample in samples])

    def estimate(self, cloud, grasps, table=None):
        return np.array([self._of(g1) for g1 in grasps.g1])

    def _of(self, g1):
        same = (self.keys == g1).all(axis=1)
        return self.values[same][0] if same.any() else self.values.mean(axis=0)

    def to_tensors(self):
        return {"keys": self.keys, "values": self.values}

    @classmethod
    def from_tensors(cls, tensors):
        return cls(tensors["keys"], tensors["values"])


class Familiar(Constant):
    """Says that grasps on thick objects resemble its training."""

    def estimate(self, cloud, grasps, table=None):
        return ft.Estimate(
            super().estimate(cloud, grasps), familiar=np.ptp(cloud.finite[:, 1]) > 0.05 + 0.0 * grasps.g1[:, 0]
        )


class Bad(Constant):
    """Is right until it is told how to fail."""

    fault = ""
    end = threading.Event()

    def estimate(self, cloud, grasps, table=None):
        counts = super().estimate(cloud, grasps)
        return getattr(self, f"_{self.fault}", lambda counts: counts)(counts)

    def _shape(self, counts):
        return counts[:, :7]

    def _rows(self, counts):
        return counts[:-1]

    def _nan(self, counts):
        return np.where(np.arange(len(counts))[:, None] == 0, np.nan, counts)

    def _error(self, _):
        return 1 / 0

    def _exit(self, _):
        raise SystemExit(3)

    def _text(self, _):
        return "2800"

    def _texts(self, counts):
        return [["2800"] * counts.shape[1]] * len(counts)

    def _complex(self, counts):
        return counts + 1j

    def _object(self, _):
        return self

    def _familiar(self, counts):
        return ft.Estimate(counts, familiar=np.ones(len(counts) + 1, bool))

    def _where(self, counts):
        return ft.Estimate(counts, where=np.zeros(len(counts)))

    def _reasons(self, counts):
        return ft.Estimate(counts, np.ones(len(counts), bool), reasons={"other_shape": np.zeros(2)})

    def _slow(self, counts):
        time.sleep(1.5)
        return counts

    def _minutes(self, counts):
        self.end.wait(300.0)
        return counts


class NoTable:
    def estimate(self, cloud, grasps):
        return np.tile(MEAN, (len(grasps), 1))


class Widths:
    """Returns the mean of the ten grasps with the nearest width."""

    def fit(self, samples):
        self.width = np.array([sample.grasp.width_m for sample in samples])
        self.touch = np.array([sample.touch.values for sample in samples])

    def estimate(self, cloud, grasps, table=None):
        width = np.linalg.norm(grasps.g1 - grasps.g2, axis=1)
        near = abs(width[:, None] - self.width).argsort(axis=1)[:, :10]
        return self.touch[near].mean(axis=1)

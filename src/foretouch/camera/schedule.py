# SPDX-License-Identifier: Apache-2.0
"""A scene over time: which of its samples is on the table at a given stamp.

Camera and hand are separate nodes, perhaps in separate processes; the stamp is all that they share about a cloud.
So the sample is a function of the stamp, and the hand touches the very object that the camera saw.
"""

from dataclasses import dataclass

from foretouch.config import Settings, setting

_MS_NS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class ScheduleConfig(Settings, read_only=True):
    """A scene whose samples follow each other in time; camera and hand are given the same."""

    path: str = setting("", "Path of the scene file (YAML)")
    dwell_s: float = setting(3.0, "Time that each sample stays on the table", bounds=(0.05, 86400.0))
    samples: int = setting(1000, "Number of samples that are shown before the first comes again", minimum=1)
    origin_ns: int = setting(0, "Time when the first sample is laid on the table, since 1970", minimum=0)

    def slot(self, stamp_ns: int) -> int:
        """The sample on the table at a time, such as a cloud's stamp [ns]; before the first, the first."""
        return max(0, stamp_ns - self.origin_ns) // (round(self.dwell_s * 1e3) * _MS_NS) % self.samples

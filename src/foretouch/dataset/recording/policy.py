# SPDX-License-Identifier: Apache-2.0
"""How safe a recording is, and what that may cost."""

from __future__ import annotations

from dataclasses import dataclass

from foretouch.config import Settings, setting

__all__ = ["RecordingConfig"]


@dataclass(frozen=True, kw_only=True)
class RecordingConfig(Settings):
    """How safe, and how often."""

    fsync_samples: int = setting(
        1, "Samples between two waits for the disk; 0 leaves it to the system: a power cut then costs up to half a minute",
        minimum=0,
    )  # fmt: skip
    fsync_s: float = setting(
        5.0, "Longest time between two waits for the disk while messages come; 0 never waits", unit="s", minimum=0.0
    )
    chunk_s: float = setting(
        0.5, "Longest time that messages are collected before they are written", unit="s", minimum=0.0
    )
    chunk_bytes: int = setting(4_000_000, "Most that is collected before it is written", unit="bytes", minimum=1)
    min_free_mb: float = setting(500.0, "Space on the disk at which a session ends", unit="MB", minimum=0.0)
    accounts_s: float = setting(5.0, "Time between accounts in the file", unit="s", minimum=0.1)

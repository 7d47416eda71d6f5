# SPDX-License-Identifier: Apache-2.0
"""Clouds for recordings, and recordings read back."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from foretouch.dataset.recordings.bag import Recording
from foretouch.types import Cloud


def make_clouds(rng: np.random.Generator, count: int = 6, shape: tuple[int, ...] = (12, 16)) -> list[Cloud]:
    """Coloured clouds, each with a point that is NaN, 33 ms apart."""
    clouds = []
    for number in range(count):
        xyz = rng.normal(size=(*shape, 3)).astype(np.float32)
        xyz.reshape(-1, 3)[number % 5] = np.nan
        rgb = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
        clouds.append(Cloud(xyz, rgb, "camera", 1_700_000_000_123_456_789 + number * 33_333_333))
    return clouds


def read_bag(path: str | Path, topic: str | None = None) -> Iterator[Cloud]:
    """The clouds of one topic of a recording."""
    with Recording(path) as recording:
        for message in recording.messages([recording.cloud_topic(topic)]):
            yield recording.decode_cloud(message)

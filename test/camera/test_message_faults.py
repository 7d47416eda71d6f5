# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from foretouch.camera.message_faults import FaultConfig, MessageFaults

TRUE = 1_763_000_000_000_000_000 + 10_000_000 * np.arange(20_000)


def stamped(**settings) -> tuple[MessageFaults, list[int | None]]:
    faults = MessageFaults(FaultConfig(**settings))
    return faults, [faults.stamp(int(t)) for t in TRUE]


def test_every_message_is_counted_once_and_the_asked_share_is_lost() -> None:
    faults, stamps = stamped()
    assert stamps == TRUE.tolist()
    assert (faults.passed, faults.dropped, faults.moved) == (len(TRUE), 0, 0)
    faults, stamps = stamped(drop_share=0.05)
    assert faults.passed + faults.dropped == len(TRUE)
    assert faults.dropped == stamps.count(None)
    assert faults.dropped / len(TRUE) == pytest.approx(0.05, abs=5 * np.sqrt(0.05 * 0.95 / len(TRUE)))


def test_jitter_stays_within_its_bounds_around_the_skew_and_is_not_moved_by_losses() -> None:
    faults, stamps = stamped(jitter_s=0.02, skew_s=0.05)
    errors = np.array(stamps) - TRUE
    assert 30_000_000 <= errors.min() <= errors.max() <= 70_000_000
    assert errors.mean() == pytest.approx(50e6, abs=5 * 20e6 / np.sqrt(3 * len(TRUE)))
    assert (np.diff(stamps) < 0).any(), "20 ms of jitter put messages of 100 Hz out of order"
    assert faults.moved == len(TRUE)
    _, both = stamped(jitter_s=0.02, skew_s=0.05, drop_share=0.3)
    assert all(b is None or a == b for a, b in zip(stamps, both, strict=True))

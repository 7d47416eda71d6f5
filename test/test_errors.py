# SPDX-License-Identifier: Apache-2.0
"""Messages of known failures: one line, whatever names they repeat."""

import pytest

from foretouch.dataset.pairing.cut import PairingError
from foretouch.errors import ConfigError, ForetouchError, SimulationError


@pytest.mark.parametrize(
    "err",
    [
        ForetouchError("a\nb\0"),
        ConfigError("x" * 100_000),
        SimulationError("a\nb"),
        PairingError("why", "\x1b[2J" * 9999),
    ],
)
def test_a_failure_is_one_short_line(err: ForetouchError) -> None:
    assert str(err)
    assert str(err).isprintable()
    assert len(str(err)) <= 20_000


def test_an_ordinary_message_is_unchanged() -> None:
    assert str(ConfigError("scene.yaml: camera.range_m: 12.0 exceeds 10.0 … ±")) == (
        "scene.yaml: camera.range_m: 12.0 exceeds 10.0 … ±"
    )

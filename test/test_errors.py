# SPDX-License-Identifier: Apache-2.0
"""Messages of known failures: one line, whatever names they repeat."""

from every_case import every_case

from foretouch.dataset.pairing.cut import PairingError
from foretouch.errors import ConfigError, ForetouchError, SimulationError


def test_a_failure_is_one_short_line() -> None:
    def check(err: ForetouchError) -> None:
        assert str(err).isprintable()
        assert 0 < len(str(err)) <= 20_000

    long = {"one name": ConfigError("x" * 100_000), "codes": PairingError("why", "\x1b[2J" * 9999)}
    every_case({"lines": ForetouchError("a\nb\0"), "simulation": SimulationError("a\nb"), **long}, check)
    ordinary = "scene.yaml: camera.range_m: 12.0 exceeds 10.0 … ±"
    assert str(ConfigError(ordinary)) == ordinary

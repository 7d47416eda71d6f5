# SPDX-License-Identifier: Apache-2.0
"""Tasks on a cluster: a node of another version is named."""

from foretouch import __version__
from foretouch_lab.ray_cluster import outcome


def test_a_node_with_another_version_makes_nothing_and_is_named() -> None:
    result, error = outcome(abs, -3, "0.0.1")
    assert result is None
    assert error.endswith(f" has foretouch {__version__}, not 0.0.1")
    assert outcome(abs, -3, __version__) == (3, "")

# SPDX-License-Identifier: Apache-2.0
"""The widths of the papers and the rules across fields."""

import pytest

from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig


def test_p2_widths() -> None:
    config = ModelConfig(outputs=("PDC_TH",))
    assert (config.feature_size, config.head_size, config.output_size) == (1024, 1039, 1)
    assert config.head_widths == (1024, 512, 256)
    assert ModelConfig(outputs=("E_MF",)).output_size == 24
    assert ModelConfig().output_size == 50
    assert ModelConfig(n_points=500, use_grasp=False, outputs=("E_TH",)).head_size == 1024  # P1 feeds features only
    assert ModelConfig(metric_inputs=True).head_size == 1041
    assert [ModelConfig(channels=c).channel_count for c in ("xyz", "xyz+rgb", "xyz+normals")] == [3, 6, 6]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"outputs": ()}, "outputs: .* at least one modality"),
        ({"outputs": ("E_TH", "E_TH")}, "each once"),
        ({"outputs": ("PAC",)}, "'PAC' is none of PDC_TH"),
        ({"channels": "rgb"}, "'rgb' is none of"),
        ({"tnet_widths": (8, 8)}, "exactly five"),
        ({"use_grasp": False, "metric_inputs": True}, "needs use_grasp"),
        ({"n_points": 0}, "n_points: 0 is below 8"),
    ],
)
def test_rules(changes, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ModelConfig(**changes)

# SPDX-License-Identifier: Apache-2.0
"""The widths of the papers and the rules across fields."""

from every_case import every_refusal

from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig


def test_p2_widths_and_the_rules_across_fields() -> None:
    config = ModelConfig(outputs=("PDC_TH",))
    assert (config.feature_size, config.head_size, config.output_size) == (1024, 1039, 1)
    assert config.head_widths == (1024, 512, 256)
    assert ModelConfig(outputs=("E_MF",)).output_size == 24
    assert ModelConfig().output_size == 50
    assert ModelConfig(n_points=500, use_grasp=False, outputs=("E_TH",)).head_size == 1024  # P1 feeds features only
    assert ModelConfig(metric_inputs=True).head_size == 1041
    assert [ModelConfig(channels=c).channel_count for c in ("xyz", "xyz+rgb", "xyz+normals")] == [3, 6, 6]
    cases = (
        ("outputs: .* at least one modality", {"outputs": ()}),
        ("each once", {"outputs": ("E_TH", "E_TH")}),
        ("'PAC' is not one of PDC_TH", {"outputs": ("PAC",)}),
        ("'rgb' is not one of", {"channels": "rgb"}),
        ("exactly five", {"tnet_widths": (8, 8)}),
        ("needs use_grasp", {"use_grasp": False, "metric_inputs": True}),
    )
    every_refusal(ConfigError, cases, lambda changes: ModelConfig(**changes))

# SPDX-License-Identifier: Apache-2.0
"""The architecture and inputs of every network of this package: P1's, P2's and the shared one."""

from dataclasses import dataclass
from typing import Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.tactile import BIOTAC, MODALITIES, TactileRanges

GRASP_SIZE: Final = 15
"""g1, g2 (3 + 3) and R (9), as in P2."""

EACH: Final = "each"
"""As the only output: one network for each modality, as in P1 and P2."""

_CHANNELS: Final = {"xyz": 3, "xyz+rgb": 6, "xyz+normals": 6}


@dataclass(frozen=True, kw_only=True)
class ModelConfig(Settings):
    """Architecture, inputs and outputs of a network; the defaults are P2's, with all four modalities at once.

    P2 does not specify its six channels; the public clouds hold x, y, z and colour, so three choices exist. P2 trains
    one network for each modality (`outputs: [PDC_TH]`, or `each` for all of them); several outputs share the features and the
    head.

    Raises:
        ConfigError: If a setting is out of its bounds, or outputs are repeated or empty.
    """

    n_points: int = setting(750, "Points of a cloud as input: 750 in P2, 500 in P1", bounds=(8, 8192))
    channels: str = setting("xyz", "Values of each point", choices=tuple(_CHANNELS))
    outputs: tuple[str, ...] = setting(
        MODALITIES,
        "Modalities to predict by one network; each: one network for each modality",
        choices=(*MODALITIES, EACH),
    )
    use_grasp: bool = setting(True, "Use g1, g2 and R as inputs of the head, as in P2 but not in P1")
    metric_inputs: bool = setting(
        False,
        "Use the radius of the cloud and the width of the grasp as inputs of the head as well [dm]: "
        "not in the papers, whose unit sphere loses the size of the object",
    )
    tnet: bool = setting(True, "Transform the points by a learned 3 x 3 matrix first (the T-Net of PointNet)")
    trunk_widths: tuple[int, ...] = setting((64, 128, 1024), "Shared layers over the points", bounds=(1, 8192))
    trunk_relu: bool = setting(
        True, "Apply ReLU to the features before the maximum over the points; P1's public code does not"
    )
    tnet_widths: tuple[int, ...] = setting(
        (64, 128, 1024, 512, 256), "Layers of the T-Net: three over the points, then two", bounds=(1, 8192)
    )
    head_widths: tuple[int, ...] = setting((1024, 512, 256), "Layers of the head", bounds=(1, 8192))
    head_norm: bool = setting(False, "Batch norm in the head")
    head_dropout: float = setting(0.0, "Dropout before the last layer, in training", bounds=(0.0, 0.9))
    ranges: TactileRanges = TactileRanges()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.outputs or len(set(self.outputs)) != len(self.outputs):
            raise ConfigError(f"outputs: {list(self.outputs)} must name at least one modality, each once")
        if EACH in self.outputs and len(self.outputs) > 1:
            raise ConfigError(f"outputs: {list(self.outputs)} names modalities beside {EACH}, which is all of them")
        if not self.trunk_widths or len(self.tnet_widths) != 5:
            raise ConfigError(
                f"trunk_widths, tnet_widths: {list(self.trunk_widths)}, {list(self.tnet_widths)} "
                "must hold at least one and exactly five layers"
            )
        if self.metric_inputs and not self.use_grasp:
            raise ConfigError("metric_inputs: true needs use_grasp, because the width is the grasp's")

    def networks(self) -> "list[ModelConfig]":
        """Return the configuration of each network: of one, or of one for each modality."""
        return [self.replace(outputs=(name,)) for name in MODALITIES] if self.outputs == (EACH,) else [self]

    @property
    def channel_count(self) -> int:
        """Values of each point: 3 or 6."""
        return _CHANNELS[self.channels]

    @property
    def feature_size(self) -> int:
        """Width of the feature vector of a cloud: 1024 in the papers."""
        return self.trunk_widths[-1]

    @property
    def grasp_size(self) -> int:
        """Grasp inputs of the head: 0, 15 or 17."""
        return (GRASP_SIZE if self.use_grasp else 0) + (2 if self.metric_inputs else 0)

    @property
    def head_size(self) -> int:
        """Input width of the head: 1039 in P2, 1024 in P1."""
        return self.feature_size + self.grasp_size

    @property
    def output_size(self) -> int:
        """Number of values predicted: 1, 24 or up to 50."""
        return sum(len(BIOTAC.columns([name])) for name in self.outputs)

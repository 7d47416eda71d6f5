# SPDX-License-Identifier: Apache-2.0
"""Time the shared-feature network against four eager networks of P2, after proving equal answers; then the shipped models.

`--quick` leaves out the networks of P2.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from foretouch.learning.data import SPLITS
from foretouch.models.network.checkpoint import NetworkEstimator
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import fold
from foretouch.models.network.networks import TouchNet
from foretouch.models.network.pointnet import Layer
from foretouch.models.registry import available_models, load_model
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import MODALITIES
from foretouch.types import Cloud, Grasp

REPEATS = 40
GRASPS = 100
COUNTS = (1, 10, 100, 1000)
SECONDS = 1.0  # of CPU time for one median, or three calls
TOLERANCE_COUNTS = 0.01


def make_net(config: ModelConfig, seed: int) -> TouchNet:
    """Random weights, batch norms that have seen data, outputs in counts."""
    torch.manual_seed(seed)
    net = TouchNet(config)
    net.set_scaling(torch.full((config.output_size,), 2500.0), torch.full((config.output_size,), 300.0))
    with torch.no_grad():
        for _ in range(3):
            net(torch.randn(8, config.n_points, config.channel_count) * 0.4, torch.randn(8, config.grasp_size))
    return net.eval()


class ChannelsFirst(nn.Module):
    """The same weights as 1-D convolutions over (B, C, N)."""

    def __init__(self, net: TouchNet) -> None:
        super().__init__()
        self.net = net
        transform = net.features.transform
        self.shared = self._convolutions(transform.points)
        self.trunk = self._convolutions(net.features.layers)

    @staticmethod
    def _convolutions(layers: nn.Sequential) -> nn.Sequential:
        modules: list[nn.Module] = []
        for layer in layers:
            assert isinstance(layer, Layer)
            convolution = nn.Conv1d(layer.linear.in_features, layer.linear.out_features, 1)
            convolution.weight.data = layer.linear.weight.data[:, :, None].clone()
            convolution.bias.data = layer.linear.bias.data.clone()
            modules += [convolution, layer.norm, nn.ReLU()]
        return nn.Sequential(*modules)

    def forward(self, points: Tensor, grasp: Tensor) -> Tensor:
        """(B, N, C) and (B, G) to counts."""
        x = points.transpose(1, 2)
        transform = self.net.features.transform
        matrix = transform.matrix(transform.cloud(self.shared(x).amax(dim=2))).view(-1, 3, 3)
        turned = torch.cat([points[..., :3] @ matrix, points[..., 3:]], dim=-1).transpose(1, 2)
        return self.net.to_counts(self.net.regress(self.trunk(turned).amax(dim=2), grasp))


def median_ms(call: Callable[[], object]) -> float:
    """Median CPU time of this thread [ms]."""
    times: list[float] = []
    for k in range(5 + REPEATS):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
        if k >= 5 and sum(times) > SECONDS:
            break
    return float(np.median(times[3:])) * 1e3


def prove_equal(name: str, difference: Tensor) -> None:
    """Stop unless two answers agree."""
    worst = float(difference.abs().max())
    print(f"equal answers: {name}: largest difference {worst:.1e} counts of {TOLERANCE_COUNTS}")
    if not worst <= TOLERANCE_COUNTS:
        raise SystemExit(f"{name}: answers differ, nothing is timed")


def scene(rng: np.random.Generator) -> tuple[Cloud, list[Grasp]]:
    """A cloud of 3000 points and 1000 grasps on it."""
    xyz = rng.uniform([-0.05, -0.05, 1.15], [0.05, 0.05, 1.25], (3000, 3)).astype(np.float32)
    pairs = rng.choice(3000, (max(COUNTS), 2), replace=False).astype(np.int64)
    return Cloud(xyz), [Grasp(xyz[a].astype(float), xyz[b].astype(float), np.eye(3)) for a, b in pairs]


@torch.inference_mode()
def networks(cloud: Cloud, candidates: list[Grasp]) -> None:
    """P2's four networks, and one with shared features."""
    shared = make_net(ModelConfig(), 0)
    four = [make_net(ModelConfig(outputs=(name,)), k) for k, name in enumerate(MODALITIES)]
    first = [ChannelsFirst(net).eval() for net in four]
    folded, half = fold(shared), fold(shared, "bfloat16")
    points, grasps = torch.randn(1, 750, 3) * 0.4, torch.randn(GRASPS, 15)
    eager = shared.to_counts(shared.regress(shared.features(points).expand(GRASPS, -1), grasps))
    prove_equal("folded shared network and eager one", folded.regress(folded.features(points[0]), grasps) - eager)
    for net, convolved in zip(four, first, strict=True):
        prove_equal(
            f"{net.config.outputs[0]}, rows and channels first",
            net.counts(points, grasps[:1]) - convolved(points, grasps[:1]),
        )
    rounded = (half.regress(half.features(points[0]), grasps) - eager).abs()
    print(f"shared layers in bfloat16: largest difference {float(rounded.max()):.1e} counts, with random weights")

    plain, fast = (
        TouchModel(NetworkEstimator(ModelConfig(), net), {"name": "full width", "sha256": ""}) for net in (folded, half)
    )
    rows: list[tuple[str, Callable[[int], object]]] = [
        ("four eager networks, channels first", lambda k: [net(points.expand(k, -1, -1), grasps[:k]) for net in first]),
        ("four eager networks, rows", lambda k: [net.counts(points.expand(k, -1, -1), grasps[:k]) for net in four]),
        ("shared, folded: network", lambda k: folded.regress(folded.features(points[0]), grasps[:k])),
        ("shared, folded: TouchModel.predict", lambda k: plain.predict(cloud, candidates[:k])),
        ("shared, folded, bfloat16: network", lambda k: half.regress(half.features(points[0]), grasps[:k])),
        ("shared, folded, bfloat16: TouchModel.predict", lambda k: fast.predict(cloud, candidates[:k])),
    ]
    print(f"\n| median CPU time [ms], one thread | 1 grasp | times as fast | {GRASPS} grasps |\n|---|---|---|---|")
    peer = 0.0
    for name, call in rows:
        one = median_ms(lambda call=call: call(1))
        peer = peer or one
        many = "not run" if "eager" in name else f"{median_ms(lambda call=call: call(GRASPS)):.1f}"
        print(f"| {name} | {one:.1f} | {peer / one:.1f} | {many} |")


def _times(model: TouchModel, cloud: Cloud, candidates: list[Grasp]) -> list[float]:
    return [median_ms(lambda k=k: model.predict(cloud, candidates[:k])) for k in COUNTS]


def shipped(cloud: Cloud, candidates: list[Grasp]) -> None:
    """The models of the package."""
    print(f"\n| shipped model | skill: {', '.join(SPLITS)} | {' | '.join(map(str, COUNTS))} grasps [ms] |")
    print(f"|---|---|{'---|' * len(COUNTS)}")
    for model in map(load_model, available_models()):
        skills = (np.mean([row["skill"] for row in model.card["skill"][split].values()]) for split in SPLITS)
        cells = " | ".join(f"{one:.2f}" for one in _times(model, cloud, candidates))
        print(f"| {model.name} | {', '.join(f'{skill:.2f}' for skill in skills)} | {cells} |")


def main() -> None:
    torch.set_num_threads(1)
    cloud, candidates = scene(np.random.default_rng(0))
    if "--quick" not in sys.argv:
        networks(cloud, candidates)
    shipped(cloud, candidates)


if __name__ == "__main__":
    main()

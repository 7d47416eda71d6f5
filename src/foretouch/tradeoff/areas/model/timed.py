# SPDX-License-Identifier: Apache-2.0
"""Make each model ready to be timed: it predicts the touch of K grasps on the cloud of one real grasp."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from foretouch.experiments.shared.real_grasps import labelled
from foretouch.learning.data import Dataset
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.registry import load_model
from foretouch.tactile import MODALITIES
from foretouch.tradeoff.area import Answer, Timed, Variant
from foretouch.tradeoff.areas.model.skill import ModelSettings, contact_variant
from foretouch.tradeoff.areas.model.variants import SHIPPED
from foretouch.types import Cloud, Grasp


def timed(variant: Variant, settings: ModelSettings, data: Dataset) -> Timed:
    """See `Area.timed`: answers are (K, 50) counts."""
    cloud, grasps = scene(data, max(settings.requests))
    kind = variant.values["kind"]
    if kind == "papers":
        return Timed(_papers(cloud, grasps))
    fitted = load_model(SHIPPED).estimator
    assert isinstance(fitted, ContactEstimator)  # noqa: S101  the shipped model is one
    if kind == "mean":
        return Timed(lambda count: np.tile(fitted.mean, (count, 1)))
    estimator = contact_variant(variant, fitted)
    return Timed(lambda count: estimator.estimate(cloud, grasps[:count]).counts)


@lru_cache(maxsize=1)
def scene(data: Dataset, count: int) -> tuple[Cloud, list[Grasp]]:
    """A real cloud of median size, and grasps between random points of it, whose hand is that of its own grasp."""
    samples = labelled(data)
    sample = sorted(samples, key=lambda one: one.cloud.size)[len(samples) // 2]
    xyz = sample.cloud.xyz.reshape(-1, 3)
    xyz = xyz[np.isfinite(xyz).all(axis=1)].astype(np.float64)
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, len(xyz), (4 * count, 2))
    near = [(a, b) for a, b in pairs if 0.02 < np.linalg.norm(xyz[a] - xyz[b]) < 0.1][: count - 1]
    return sample.cloud, [sample.grasp, *(Grasp(xyz[a], xyz[b], sample.grasp.rotation) for a, b in near)]


def _papers(cloud: Cloud, grasps: Sequence[Grasp]) -> Any:
    """Four eager networks of P2 on 750 points, one for each modality, of random weights: for their time alone."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.networks import TouchNet
    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps

    torch.manual_seed(0)
    configs = [ModelConfig(outputs=(name,)) for name in MODALITIES]
    nets = [TouchNet(config).eval() for config in configs]

    @torch.inference_mode()
    def answer(count: int) -> Answer:
        prepared = prepare_cloud(cloud, configs[0])
        points = torch.from_numpy(prepared.points)[None].expand(count, -1, -1)
        inputs = torch.from_numpy(prepare_grasps(grasps[:count], prepared.frame, configs[0]))
        return torch.cat([net.counts(points, inputs) for net in nets], dim=1).numpy()

    return answer

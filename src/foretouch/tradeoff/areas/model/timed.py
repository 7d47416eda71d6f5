# SPDX-License-Identifier: Apache-2.0
"""Make each model ready to be timed: it predicts the touch of K grasps on the cloud of one real grasp."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from foretouch.experiments.shared.scores import labelled
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.files import packed
from foretouch.models.registry import find_card, load_model
from foretouch.models.touch_model import Estimator
from foretouch.tactile import MODALITIES
from foretouch.tradeoff.area import Answer, Timed, Variant
from foretouch.tradeoff.areas.model.contact import Described, FittedContact, cut, thin
from foretouch.tradeoff.areas.model.skill import ModelData, ModelSettings
from foretouch.tradeoff.areas.model.variants import NETWORK, SHIPPED
from foretouch.types import TOUCH_SIZE, Cloud, Grasp, GraspSample


def timed(variant: Variant, settings: ModelSettings, data: ModelData) -> Timed:
    """See `Area.timed`: answers are (K, 50) counts."""
    cloud, grasps = scene(data, max(settings.requests))
    values, kind = variant.values, variant.values["kind"]
    if kind == "papers":
        return Timed(_papers(cloud, grasps))
    if kind == "mean":
        mean = _shipped().mean
        return Timed(lambda count: np.tile(mean, (count, 1)), 8.0 * TOUCH_SIZE / 1e6)
    estimator: Estimator
    if kind == "network":
        from foretouch.tradeoff.areas.model.networks import timed_estimator

        estimator = timed_estimator(values)
        own = set(values) == {"kind"}
        return Timed(lambda count: estimator.estimate(cloud, grasps[:count]).counts, _file_mb(NETWORK) if own else None)
    fitted = _refitted(data).variant(values)[0] if "refit" in values else cut(_shipped(), values)
    size = len(packed(fitted.to_tensors())[0]) / 1e6
    if "points" in values:
        return Timed(lambda count: fitted.estimate(thin(cloud, values["points"]), grasps[:count]).counts, size)
    return Timed(lambda count: fitted.estimate(cloud, grasps[:count]).counts, size)


def _file_mb(name: str) -> float:
    return find_card(name).with_suffix(".safetensors").stat().st_size / 1e6


@lru_cache(maxsize=1)
def _shipped() -> ContactEstimator:
    found = load_model(SHIPPED).estimator
    assert isinstance(found, ContactEstimator)  # noqa: S101  the shipped model is one
    return found


@lru_cache(maxsize=1)
def _refitted(data: ModelData) -> FittedContact:
    described = Described(labelled(data.real))
    return FittedContact(described, np.arange(len(described.samples)), 0)


@lru_cache(maxsize=1)
def scene(data: ModelData, count: int) -> tuple[Cloud, list[Grasp]]:
    """A real cloud of median size, and grasps between random points of it, whose hand is that of its own grasp."""
    samples = sorted(labelled(data.real), key=lambda one: one.cloud.size)
    return grasps_on(samples[len(samples) // 2], count)


def grasps_on(sample: GraspSample, count: int) -> tuple[Cloud, list[Grasp]]:
    """The cloud of a sample, its grasp, and others between random points of it, up to a number."""
    xyz = sample.cloud.xyz.reshape(-1, 3)
    xyz = xyz[np.isfinite(xyz).all(axis=1)].astype(np.float64)
    pairs = np.random.default_rng(0).integers(0, len(xyz), (50 * count, 2))
    width = np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1)
    near = pairs[(width > 0.02) & (width < 0.1)][: count - 1]
    return sample.cloud, [sample.grasp, *(Grasp(xyz[a], xyz[b], sample.grasp.rotation) for a, b in near)]


def _papers(cloud: Cloud, grasps: Sequence[Grasp]) -> Callable[[int], Answer]:
    """Four eager networks of P2 on 750 points, one for each modality, of random weights: for their time alone."""
    import torch

    from foretouch.models.network.config import ModelConfig
    from foretouch.models.network.networks import TouchNet
    from foretouch.models.network.preparation import prepare_cloud, prepare_grasps

    torch.manual_seed(0)
    configs = [ModelConfig(outputs=(name,)) for name in MODALITIES]
    nets = [TouchNet(config).eval() for config in configs]

    def answer(count: int) -> Answer:
        with torch.inference_mode():
            prepared = prepare_cloud(cloud, configs[0])
            points = torch.from_numpy(prepared.points)[None].expand(count, -1, -1)
            inputs = torch.from_numpy(prepare_grasps(grasps[:count], prepared.frame, configs[0]))
            return torch.cat([net.counts(points, inputs) for net in nets], dim=1).numpy()

    return answer

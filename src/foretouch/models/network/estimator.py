# SPDX-License-Identifier: Apache-2.0
"""What a network falls back to on objects unlike those that it was trained on: the mean of its training labels.

A network has no notion of what it does not know: on the public recordings it is far worse than that mean on an object that was left
out. The contact model needs none of this, for its kernel fades by itself.

Touch from sight by one network with 50 outputs, or by several that share the modalities out.

cloud ─ sample, unit sphere ─ features (once) ─┐
K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► faded to the mean on new objects
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ModelError
from foretouch.models.contact.features import ContactScene
from foretouch.models.estimator import Estimate
from foretouch.models.familiarity import Familiarity, describe
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import PreparedCloud, prepare_cloud, prepare_grasps
from foretouch.models.novelty import FAMILIAR, Novelty
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.tactile.ranges import TactileRanges
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp

if TYPE_CHECKING:
    from foretouch.models.network.folding import FoldedNetwork

__all__ = ["Fallback", "Member", "NetworkEstimator"]


@dataclass(frozen=True, eq=False)
class Fallback:
    """Where predictions fade to, and how fast.

    Attributes:
        novelty: Of the training objects.
        mean: (50,) float64 of the training labels [counts].
    """

    novelty: Novelty
    mean: Float64

    @classmethod
    def fit(cls, objects: Float64, labels: Float64) -> Fallback:
        """From (S, len(OBJECT_FEATURES)) descriptions of the training clouds and their (S, 50) labels [counts]."""
        return cls(Novelty.fit(objects), labels.mean(axis=0))

    def fade(self, counts: Float64, objects: Float64) -> tuple[Float64, npt.NDArray[np.bool_]]:
        """Predictions, nearer to the mean the less familiar the object is.

        Args:
            counts: (K, 50) of the network [counts].
            objects: (K, len(OBJECT_FEATURES)) of the clouds that they were made from, or (1, …) of the one of all.

        Returns:
            (K, 50) [counts], and (K,) whether the object is familiar.
        """
        familiarity = np.array([self.novelty.familiarity(row) for row in objects])
        weight = familiarity[:, None]
        known = np.broadcast_to(familiarity >= FAMILIAR, len(counts))
        return weight * counts + (1.0 - weight) * self.mean, known

    def to_tensors(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays by name, for a file."""
        return {**self.novelty.to_tensors(), "mean": self.mean}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]]) -> Fallback:
        """From `to_tensors`.

        Raises:
            ModelError: If an array is missing or damaged.
        """
        mean = tensors.get("mean")
        if mean is None or mean.shape != (TOUCH_SIZE,) or not np.isfinite(mean).all():
            raise ModelError("mean: is missing, of another shape, or not finite")
        return cls(Novelty.from_tensors(tensors), np.asarray(mean, np.float64))


@dataclass(frozen=True, eq=False)
class Member:
    """One network of a model.

    Attributes:
        config: What it is fed and what it predicts.
        network: Its folded weights.
        familiar: Spans of its training samples; None if its card holds none.
    """

    config: ModelConfig
    network: FoldedNetwork
    familiar: Familiarity | None = None


class NetworkEstimator:
    """Networks that together predict all four modalities; immutable, so threads may share it.

    Args:
        members: One network with all outputs, or several that share them out.
        fallback: On objects unlike those that they were trained on; None if these were not kept.

    Attributes:
        ranges: Of each modality, those of the network that predicts it.

    Raises:
        ModelError: If a modality is predicted by no member, or by two.
    """

    def __init__(self, members: Sequence[Member], fallback: Fallback | None = None) -> None:
        self._members = tuple(members)
        self._fallback = fallback
        limits = {}
        for modality in MODALITIES:
            mine = [member for member in members if modality in member.config.outputs]
            if len(mine) != 1:
                raise ModelError(f"outputs: {modality} is predicted by {len(mine)} networks, not by one")
            limits[modality.lower()] = mine[0].config.ranges.of(modality)
        self.ranges = TactileRanges(**limits)

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """As of `Estimator`; unfamiliar where a length leaves its span or the object's sizes are new."""
        counts = np.zeros((len(grasps), TOUCH_SIZE))
        familiar = np.ones(len(grasps), np.bool_)
        for member in self._members:
            prepared = prepare_cloud(cloud, member.config)
            counts[:, columns(member.config.outputs)] = _run(member, prepared, grasps)
            if member.familiar is not None:
                faults = member.familiar.unfamiliar(describe(prepared, grasps))
                familiar &= np.array([not fault for fault in faults], np.bool_)
        if self._fallback is not None:
            counts, known = self._fallback.fade(counts, ContactScene(cloud.xyz).object_features[None])
            familiar &= known
        return Estimate(counts, familiar)


def _run(member: Member, prepared: PreparedCloud, grasps: Sequence[Grasp]) -> Float64:
    """(K, M) predictions of one network [counts]."""
    import torch

    features = member.network.features(torch.from_numpy(prepared.points))
    fed = prepare_grasps(grasps, prepared.frame, member.config)
    return member.network.regress(features, torch.from_numpy(fed)).numpy().astype(np.float64)

# SPDX-License-Identifier: Apache-2.0
"""Touch from the cloud and the grasp by one network with 50 outputs, or by several that predict a part of them each.

cloud ─ sample, unit sphere ─ features (once) ─┐
K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► fallback on novel objects
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.contact.features import ContactScene
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import PreparedCloud, prepare_cloud, prepare_grasps
from foretouch.models.novelty import Fallback, LengthRangeCheck, grasp_lengths
from foretouch.models.touch_model import Estimate
from foretouch.tactile import MODALITIES, TactileRanges, columns
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp

if TYPE_CHECKING:
    from foretouch.models.network.folding import FoldedNetwork

__all__ = ["Member", "NetworkEstimator"]
__all__ += ["Fallback"]  # alias until merge


@dataclass(frozen=True, eq=False)
class Member:
    """One network of a model.

    Attributes:
        config: Its inputs and outputs.
        network: Its folded weights.
        lengths: Ranges over its training samples; None if its card holds none.
    """

    config: ModelConfig
    network: FoldedNetwork
    lengths: LengthRangeCheck | None = None


class NetworkEstimator:
    """Networks that together predict all four modalities; immutable, so threads may share it.

    Args:
        members: One network with all outputs, or several with a part of them each.
        fallback: For objects unlike those of training; None if it was not stored.

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
            predictors = [member for member in members if modality in member.config.outputs]
            if len(predictors) != 1:
                raise ModelError(f"outputs: {modality} is predicted by {len(predictors)} networks, not by one")
            limits[modality.lower()] = predictors[0].config.ranges.of(modality)
        self.ranges = TactileRanges(**limits)

    def estimate(self, cloud: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        """See `Estimator.estimate`; out of distribution where a length leaves its range or the object's sizes are novel."""
        counts, in_distribution = np.zeros((len(grasps), TOUCH_SIZE)), np.ones(len(grasps), np.bool_)
        for member in self._members:
            prepared = prepare_cloud(cloud, member.config)
            counts[:, columns(member.config.outputs)] = _run(member, prepared, grasps)
            if member.lengths is not None:
                in_distribution &= member.lengths.within(grasp_lengths(prepared, grasps))
        if self._fallback is not None:
            counts, inside = self._fallback.fade(counts, ContactScene(cloud.xyz).object_features[None])
            in_distribution &= inside
        return Estimate(counts, in_distribution)


def _run(member: Member, prepared: PreparedCloud, grasps: Sequence[Grasp]) -> Float64:
    """(K, M) predictions of one network [counts]."""
    import torch

    features = member.network.features(torch.from_numpy(prepared.points))
    inputs = prepare_grasps(grasps, prepared.frame, member.config)
    return member.network.regress(features, torch.from_numpy(inputs)).numpy().astype(np.float64)

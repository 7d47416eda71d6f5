# SPDX-License-Identifier: Apache-2.0
"""Touch from sight by one network with 50 outputs, or by several that share the modalities out.

cloud ─ sample, unit sphere ─ features (once) ─┐
K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► faded to the mean on new objects
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.contact_features import ContactScene
from foretouch.models.estimator import Estimate
from foretouch.models.fallback import Fallback
from foretouch.models.familiarity import Familiarity, describe
from foretouch.models.preparation import PreparedCloud, prepare_cloud, prepare_grasps
from foretouch.models.settings import ModelConfig
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.tactile.ranges import TactileRanges
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp

if TYPE_CHECKING:
    from foretouch.models.folding import FoldedNetwork

__all__ = ["Member", "NetworkEstimator"]


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

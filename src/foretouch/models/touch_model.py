# SPDX-License-Identifier: Apache-2.0
"""Prediction of touch: one cloud and K grasps in, K predictions out, by one network or several.

    cloud ─ sample, unit sphere ─ features (once) ─┐
    K grasps ─ unit sphere ────────────────────────┴─ head, in blocks ─► K x 50 counts ─► flags

The same interface serves the shared network with 50 outputs and the ensemble of one network a modality.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.familiarity import Familiarity, describe
from foretouch.models.preparation import PreparedCloud, prepare_cloud, prepare_grasps
from foretouch.models.settings import ModelConfig
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp, Touch, TouchPrediction

if TYPE_CHECKING:
    from foretouch.models.folding import FoldedNetwork

__all__ = ["Member", "TouchModel"]


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


class TouchModel:
    """Networks that together predict all four modalities; immutable, so threads may share it.

    Args:
        members: One network with all outputs, or several that share them out.
        card: The card of the model.

    Attributes:
        name: From the card.
        sha256: From the card: of the weights, or over those of all members.
        card: As read.

    Raises:
        ModelError: If a modality is predicted by no member, or by two.
    """

    def __init__(self, members: Sequence[Member], card: Mapping[str, Any]) -> None:
        self.name: str = card["name"]
        self.sha256: str = card["sha256"]
        self.card = dict(card)
        self._members = tuple(members)
        predicted = [output for member in members for output in member.config.outputs]
        for modality in MODALITIES:
            if predicted.count(modality) != 1:
                raise ModelError(
                    f"{self.name}: outputs: {modality} is predicted by {predicted.count(modality)} networks, not by one"
                )

    def predict(self, cloud: Cloud, grasps: Sequence[Grasp], *, tare: Touch | None = None) -> list[TouchPrediction]:
        """What both fingertips would read at each grasp.

        The cloud's features are computed once. A prediction does not depend on the grasps beside it,
        to the last bit, and one cloud always gives the same.

        Args:
            cloud: The object's points [m]; those without depth are left out.
            grasps: In the cloud's frame.
            tare: A reading without contact. No network of this version was trained with one, so it is not used
                and `reference` says "none".

        Returns:
            One prediction a grasp, in order. Flags: `out_of_range` where a value leaves the model's ranges
            (it is not clipped), `unfamiliar` where cloud or grasp is unlike the training data.

        Raises:
            CloudError: If the cloud holds too few points or all in one place.
            ModelError: If it lacks a colour that the model needs.
        """
        del tare
        counts = np.zeros((len(grasps), TOUCH_SIZE))
        outside = np.zeros(len(grasps), np.bool_)
        strange = np.zeros(len(grasps), np.bool_)
        for member in self._members:
            prepared = prepare_cloud(cloud, member.config)
            place = columns(member.config.outputs)
            counts[:, place] = _run(member, prepared, grasps)
            outside |= member.config.ranges.outside(counts)[:, place].any(axis=1)
            if member.familiar is not None:
                faults = member.familiar.unfamiliar(describe(prepared, grasps))
                strange |= np.array([bool(fault) for fault in faults], np.bool_)
        return [
            _prediction(grasp, row, out_of_range=bool(out), unfamiliar=bool(odd))
            for grasp, row, out, odd in zip(grasps, counts, outside, strange, strict=True)
        ]


def _run(member: Member, prepared: PreparedCloud, grasps: Sequence[Grasp]) -> Float64:
    """(K, M) predictions of one network [counts]."""
    import torch

    features = member.network.features(torch.from_numpy(prepared.points))
    fed = prepare_grasps(grasps, prepared.frame, member.config)
    return member.network.regress(features, torch.from_numpy(fed)).numpy().astype(np.float64)


def _prediction(grasp: Grasp, counts: Float64, *, out_of_range: bool, unfamiliar: bool) -> TouchPrediction:
    if not np.isfinite(counts).all():
        return TouchPrediction(grasp, None, status="refused", reason="the network gives a value that is not finite")
    named = {"out_of_range": out_of_range, "unfamiliar": unfamiliar}
    return TouchPrediction(grasp, Touch.from_vector(counts), flags=tuple(k for k, v in named.items() if v))

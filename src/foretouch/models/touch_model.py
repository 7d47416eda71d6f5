# SPDX-License-Identifier: Apache-2.0
"""Prediction of touch: one cloud and K grasps in, K predictions out, with an interval, a reference and flags.

cloud, K grasps ─ estimator ─► counts ─ + tare - rest ─ + what touches taught ─► value ± half width, flags
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from foretouch.errors import ModelError, TactileError
from foretouch.models.calibration import Calibration
from foretouch.models.estimator import Estimate, Estimator
from foretouch.models.touch_memory import TouchMemory
from foretouch.tactile.validity import check_touch
from foretouch.types import Cloud, Float64, Grasp, Reference, Touch, TouchPrediction

__all__ = ["TouchModel"]


class TouchModel:
    """An estimator and what to make of its estimates; immutable, so threads may share it.

    Args:
        estimator: What predicts from sight alone.
        card: The card of the model.
        trust: Rest level, adaptation and intervals; None if its card holds no calibration.

    Attributes:
        name: From the card.
        sha256: From the card: of the weights, or over those of all members.
        card: As read.
        trust: As given.
        ranges: Beyond which a value is told to be out of range.
    """

    def __init__(self, estimator: Estimator, card: Mapping[str, Any], trust: Calibration | None = None) -> None:
        self.name: str = card["name"]
        self.sha256: str = card["sha256"]
        self.card = dict(card)
        self.trust = trust
        self.ranges = estimator.ranges
        self._estimator = estimator

    def predict(
        self,
        cloud: Cloud,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        memory: TouchMemory | None = None,
    ) -> list[TouchPrediction]:
        """What both fingertips would read at each grasp.

        The cloud's features are computed once. A prediction does not depend on the grasps beside it,
        to the last bit, and one cloud always gives the same.

        Args:
            cloud: The object's points [m]; those without depth are left out.
            grasps: In the cloud's frame.
            tare: A reading without contact, taken shortly before.
            memory: What was read on this object in this session. Its own tare is used, and `tare` must be left out.

        Returns:
            One prediction a grasp, in order. `reference` tells what it leans on, the strongest named: touches,
            tare or none. Flags: `out_of_range` where a value leaves the model's ranges (it is not clipped), `unfamiliar`
            where cloud or grasp is unlike the training data.

        Raises:
            CloudError: If the cloud holds too few points or all in one place.
            ModelError: If it lacks a colour that the model needs; if tare or memory is given to a model without `trust`, or
                both are; if the memory is of another model.
            TactileError: If the tare is not that of working sensors.
        """
        if memory is not None:
            if tare is not None:
                raise ModelError("tare: the memory has its own")
            if memory.model.sha256 != self.sha256:
                raise ModelError(f"{self.name}: memory: is of {memory.model.name}, which expected other readings")
            self._require_trust()
            tare = memory.tare
        estimate = self._estimator.estimate(cloud, grasps)
        counts = self._shifted(estimate.counts, tare)
        touches = memory.count if memory is not None else 0
        half = np.full_like(counts, np.nan)
        if self.trust is not None:
            touched = memory.means() if memory is not None else None
            counts, half = self.trust.lean(
                counts, estimate.familiar, tare=tare is not None, touched=touched, count=touches
            )
        reference: Reference = "touches" if touches else "none" if tare is None else "tare"
        return self._predictions(grasps, Estimate(counts, estimate.familiar), half, reference)

    def expect(self, cloud: Cloud, grasps: Sequence[Grasp], tare: Touch | None = None) -> Float64:
        """(K, 50) predicted counts before any touch: what readings are compared with.

        Raises:
            CloudError: As of `predict`.
            ModelError: As of `predict`.
            TactileError: As of `predict`.
        """
        self._require_trust()
        return self._shifted(self._estimator.estimate(cloud, grasps).counts, tare)

    def _require_trust(self) -> None:
        if self.trust is None:
            raise ModelError(f"{self.name}: cannot learn from touches: its card holds no calibration")

    def _shifted(self, counts: Float64, tare: Touch | None) -> Float64:
        """Counts of sensors at rest as in training, moved to those of the tare."""
        if tare is None:
            return counts
        if self.trust is None:
            raise ModelError(f"{self.name}: tare: cannot be used: its card tells no rest level")
        faults = check_touch(tare).faults
        if faults:
            raise TactileError(f"tare: {faults[0]}")
        return counts + (tare.vector() - self.trust.rest)

    def _predictions(
        self, grasps: Sequence[Grasp], estimate: Estimate, half: Float64, reference: Reference
    ) -> list[TouchPrediction]:
        outside = np.any(self.ranges.outside(estimate.counts), axis=1)
        predictions = []
        for grasp, counts, width, out, known in zip(
            grasps, estimate.counts, half, outside, estimate.familiar, strict=True
        ):
            if not np.isfinite(counts).all():
                reason = "the model gives a value that is not finite"
                predictions.append(TouchPrediction(grasp, None, status="refused", reason=reason))
                continue
            named = {"out_of_range": bool(out), "unfamiliar": not known}
            bounded = self.trust is not None
            predictions.append(
                TouchPrediction(
                    grasp,
                    Touch.from_vector(counts),
                    lower=Touch.from_vector(counts - width) if bounded else None,
                    upper=Touch.from_vector(counts + width) if bounded else None,
                    reference=reference,
                    flags=tuple(name for name, set_ in named.items() if set_),
                )
            )
        return predictions

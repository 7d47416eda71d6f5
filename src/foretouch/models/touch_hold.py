# SPDX-License-Identifier: Apache-2.0
"""Whether a grasp will hold when it is lifted, from one reading of the three BioTac SP that touch the object.

The model sees the pattern of each finger alone: how its electrodes differ from their mean, in units of their spread. So neither the level
of a finger nor how hard it presses decides, and no tare is needed. It is a mean of small networks with one hidden layer, fitted by
`python -m benchmarks.other_recordings`; what it was fitted to and where it fails is in its card.
"""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ModelError
from foretouch.models.card import read_card
from foretouch.models.files import TensorRecord, read_tensors
from foretouch.types import Float64

OUTSIDE: Final = 0.05
"""Share of the pattern that may be out of the range of training."""


def patterns(readings: Float64) -> Float64:
    """Return (S, D) patterns of (S, F, N) electrodes of the fingers, in the order of the card [counts]; D = F x N."""
    apart = readings - readings.mean(axis=-1, keepdims=True)
    pattern: Float64 = (apart / np.maximum(apart.std(axis=-1, keepdims=True), 1.0)).reshape(len(readings), -1)
    return pattern


@dataclass(frozen=True, eq=False)
class TouchHold(TensorRecord):
    """K networks with H hidden units, of patterns of D numbers."""

    low: Float64  # (D,) lowest and
    high: Float64  # (D,) highest of a pattern in training
    hidden: Float64  # (K, D, H)
    hidden_bias: Float64  # (K, H)
    out: Float64  # (K, H), logits by
    out_bias: Float64  # (K,)
    calibration: Float64  # (2,) slope and offset of their mean

    def chance(self, readings: Float64) -> Float64:
        """Return (S,) probabilities that grasps hold, of (S, F, N) electrodes [counts]."""
        slope, offset = self.calibration
        probability: Float64 = 1.0 / (1.0 + np.exp(-slope * self.logits(readings) - offset))
        return probability

    def logits(self, readings: Float64) -> Float64:
        """Return (S,) means of the networks, not calibrated."""
        units = np.tanh(np.einsum("sd,kdh->skh", patterns(readings), self.hidden) + self.hidden_bias)
        logit: Float64 = (np.einsum("skh,kh->sk", units, self.out) + self.out_bias).mean(axis=1)
        return logit

    def outside(self, readings: Float64) -> Float64:
        """Return (S,) share of each pattern that is out of the range of training; see `OUTSIDE`."""
        pattern = patterns(readings)
        share: Float64 = ((pattern < self.low) | (pattern > self.high)).mean(axis=1)
        return share

    RULES = {  # noqa: RUF012
        "low": "D",
        "high": "D",
        "hidden": "KDH",
        "hidden_bias": "KH",
        "out": "KH",
        "out_bias": "K",
        "calibration": "2",
    }


def load_touch_hold(card_path: Path | None = None) -> tuple[TouchHold, dict[str, Any]]:
    """Return the model and its card, whose `config` names the fingers; by default the model of the package.

    Raises:
        ModelError: Names the file and what is wrong with it.
    """
    path = card_path or Path(str(resources.files("foretouch.models"))) / "weights" / "hold" / "touch-hold.json"
    card = read_card(path)
    if card["kind"] != "hold":
        raise ModelError(f"{path}: kind: {card['kind']} is not hold")
    _, tensors = read_tensors(path, card)
    model, fingers = TouchHold.from_tensors(tensors), card["config"].get("fingers")
    if not isinstance(fingers, list) or not fingers or len(model.low) % len(fingers):
        raise ModelError(f"{path}: config.fingers: are not those of {len(model.low)} numbers")
    return model, card

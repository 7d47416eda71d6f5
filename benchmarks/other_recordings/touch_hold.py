# SPDX-License-Identifier: Apache-2.0
"""Fits the model `touch-hold` (`foretouch.models.touch_hold`)."""

import warnings
from typing import Final

import numpy as np

from foretouch.models.novelty import standardisation
from foretouch.models.touch_hold import TouchHold, patterns
from foretouch.types import Bool, Float64
from foretouch.types.channels import Channels

FINGERS: Final = ("TH", "MF", "FF")
CONFIG: Final = {"networks": 5, "units": 16, "decay": 1.0, "epochs": 60}
_USUAL: Final = (0.001, 0.999)  # quantiles of the training readings, between which a pattern is in range


def electrodes(touches: Float64, channels: Channels) -> Float64 | None:
    """(S, 3, 24) electrodes of (S, D) touches by `FINGERS`; None of another sensor."""
    names = [f"E_{finger}" for finger in FINGERS]
    if not set(names) <= set(channels.modalities):
        return None
    return touches[:, channels.columns(names)].reshape(len(touches), len(FINGERS), -1)


def fit(readings: Float64, held: Bool, seed: int) -> TouchHold:
    """A model of (S, 3, 24) readings and whether the grasps held, not calibrated."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    found = patterns(readings)
    mean, deviation = standardisation(found)
    how = {"activation": "tanh", "alpha": CONFIG["decay"], "max_iter": CONFIG["epochs"]}
    networks = [MLPClassifier((CONFIG["units"],), random_state=seed + k, **how) for k in range(CONFIG["networks"])]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is part of the recipe
        for one in networks:
            one.fit((found - mean) / deviation, held)
    # The standardisation is part of the first layer.
    hidden = np.stack([one.coefs_[0] / deviation[:, None] for one in networks])
    bias = np.stack([one.intercepts_[0] for one in networks]) - np.einsum("d,kdh->kh", mean, hidden)
    out = np.stack([one.coefs_[1][:, 0] for one in networks])
    last = np.array([one.intercepts_[1][0] for one in networks])
    low, high = np.quantile(found, _USUAL, axis=0)
    return TouchHold(low, high, hidden, bias, out, last, np.array([1.0, 0.0]))

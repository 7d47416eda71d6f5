# SPDX-License-Identifier: Apache-2.0
"""Touch models: networks and contact models, their files, calibration and prediction.

Importing this imports no torch.
"""

from foretouch.models.registry import DEFAULT_MODEL, available_models, load_model
from foretouch.models.touch_model import History, Readings, TouchModel

__all__ = ["DEFAULT_MODEL", "History", "Readings", "TouchModel", "available_models", "load_model"]

# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.learning.training.contact`; alias until merge."""

from foretouch.learning.training.calibration import calibration_folds
from foretouch.learning.training.contact import ContactPredictor

__all__ = ["ContactPredictor", "calibration_folds"]

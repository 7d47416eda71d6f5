# SPDX-License-Identifier: Apache-2.0
"""Old address of the statistics of `foretouch.models.network.batch_norm`."""

from foretouch.models.network.batch_norm import Inputs, calibrate, freeze, statistics_kept

__all__ = ["Inputs", "calibrate", "freeze", "statistics_kept"]

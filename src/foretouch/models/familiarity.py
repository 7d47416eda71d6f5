# SPDX-License-Identifier: Apache-2.0
"""Old address of `foretouch.models.novelty`."""

from foretouch.models.novelty import LENGTHS, Familiarity, describe

__all__ = ["LENGTHS", "Familiarity", "describe"]

# SPDX-License-Identifier: Apache-2.0
"""Old address of `foretouch.models.touch_model`."""

from foretouch.models.touch_model import TouchMemory

__all__ = ["TouchMemory"]

# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.ros.messages.requests`."""

from foretouch.ros.messages.requests import plan_targets

__all__ = ["plan_targets"]

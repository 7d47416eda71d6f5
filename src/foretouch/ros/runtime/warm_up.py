# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.ros.runtime`."""

from foretouch.ros.runtime.processing_node import warm_up_cloud

__all__ = ["tabletop"]

tabletop = warm_up_cloud

# SPDX-License-Identifier: Apache-2.0
"""Alias until merge."""

from foretouch.cloud.geometry.pcl_filters import *  # noqa: F403

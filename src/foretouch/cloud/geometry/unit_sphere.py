# SPDX-License-Identifier: Apache-2.0
"""Alias until merge."""

from foretouch.cloud.geometry.sampling import *  # noqa: F403

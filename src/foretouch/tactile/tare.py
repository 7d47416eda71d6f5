# SPDX-License-Identifier: Apache-2.0
"""Alias until merge."""

from foretouch.tactile.readings import *  # noqa: F403

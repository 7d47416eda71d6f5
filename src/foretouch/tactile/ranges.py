# SPDX-License-Identifier: Apache-2.0
"""Alias until merge."""

from foretouch.tactile.channels import *  # noqa: F403

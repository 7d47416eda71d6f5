# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.ros.messages.requests`."""

from foretouch.ros.messages.requests import RefusalError, status_code, status_name

__all__ = ["RefusalError", "status_code", "status_name"]

# SPDX-License-Identifier: Apache-2.0
"""Moved to `touch_figure`."""

from foretouch.report.touch_figure import save_contact_sheet

__all__ = ["save_contact_sheet"]

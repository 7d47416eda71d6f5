# SPDX-License-Identifier: Apache-2.0
"""Moved to `foretouch.learning.data.dataset`; alias until merge."""

from foretouch.learning.data.dataset import Dataset as Collection
from foretouch.learning.data.dataset import load_dataset as load_collection

__all__ = ["Collection", "load_collection"]

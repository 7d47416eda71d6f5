# SPDX-License-Identifier: Apache-2.0
"""One folder or module for each area; each holds an `EXPERIMENT`, an `Area` (see `foretouch.tradeoff.area`)."""

# SPDX-License-Identifier: Apache-2.0
"""Metrics, baselines, and comparisons with confidence intervals."""

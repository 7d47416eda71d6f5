# SPDX-License-Identifier: Apache-2.0
"""Splits, metrics, baselines and supervised training.

Nothing is re-exported: `splits`, `metrics` and `baselines` stay free of torch, which `train` imports.
"""

# SPDX-License-Identifier: Apache-2.0
"""Metrics, baselines, comparisons with confidence intervals, and the evaluation of models (`evaluate`)."""

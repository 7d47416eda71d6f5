# SPDX-License-Identifier: Apache-2.0
"""Predictors, data, folds, scores and figures that several experiments share."""

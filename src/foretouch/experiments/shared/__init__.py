# SPDX-License-Identifier: Apache-2.0
"""What several experiments share: predictors, folds, real grasps and simulated data."""

# SPDX-License-Identifier: Apache-2.0
"""Predictions within a time: the most accurate level of a model that meets a budget on this machine."""

from foretouch.tradeoff.budget.chooser import Answer, LatencyBudget
from foretouch.tradeoff.budget.levels import Level, levels_of
from foretouch.tradeoff.budget.profile import Profile, load_profile

__all__ = ["Answer", "LatencyBudget", "Level", "Profile", "levels_of", "load_profile"]

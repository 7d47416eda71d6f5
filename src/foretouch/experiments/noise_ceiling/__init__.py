# SPDX-License-Identifier: Apache-2.0
"""How much of a touch can be told from cloud and grasp at all, and how much of that do predictors tell?"""

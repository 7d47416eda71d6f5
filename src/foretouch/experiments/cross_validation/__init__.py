# SPDX-License-Identifier: Apache-2.0
"""How well is another grasp of the same sessions predicted? P1's five random folds, over all objects."""

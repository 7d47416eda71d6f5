# SPDX-License-Identifier: Apache-2.0
"""How well is a later or earlier grasp of the same objects predicted? Five blocks of time within each object."""

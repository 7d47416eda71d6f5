# SPDX-License-Identifier: Apache-2.0
"""Run any experiment: define it, run its cells locally or on Ray, and keep its results in a folder."""

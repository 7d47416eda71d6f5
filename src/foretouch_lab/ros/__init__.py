# SPDX-License-Identifier: Apache-2.0
"""The simulated hand: a node that stands in for a robot's fingertips."""

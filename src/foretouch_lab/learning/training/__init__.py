# SPDX-License-Identifier: Apache-2.0
"""Training of networks and contact models, and calibration of their intervals."""

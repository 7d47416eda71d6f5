# SPDX-License-Identifier: Apache-2.0
"""Depth cameras: a RealSense that is connected, recorded, or fed with synthetic frames, on one code path."""

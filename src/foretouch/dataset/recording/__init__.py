# SPDX-License-Identifier: Apache-2.0
"""Crash-safe recording of grasps in files that ROS tools can open: MCAP, one chunk a sample."""

# SPDX-License-Identifier: Apache-2.0
"""Recordings in files that ROS tools can open: crash-safe ones of grasps (MCAP, one chunk a sample), and bags of others."""

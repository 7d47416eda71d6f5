# SPDX-License-Identifier: Apache-2.0
"""Decoders of tactile messages, one module for each type; they accept messages of rclpy and of rosbags alike."""

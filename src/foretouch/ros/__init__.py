# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 graph, the only user of rclpy. Nothing is imported here (see `foretouch.ros.runtime`)."""

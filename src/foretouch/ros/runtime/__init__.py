# SPDX-License-Identifier: Apache-2.0
"""What every node is built on. Nothing is imported here, since `environment` must run before NumPy and rclpy load."""

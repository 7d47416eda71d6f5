# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 graph, the only user of rclpy. Nothing is imported here (see `foretouch.ros.runtime`).

nodes                the nodes, one module each
runtime              what every node is built on
messages             messages to arrays and back: pure functions
touch                online adaptation and prediction for `touch_predictor`
recorder             subscriptions, queue and session of the recorder
executables          the table of nodes, and the entry point of each
graph                several nodes in one process, for the command line
"""

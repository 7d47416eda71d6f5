# SPDX-License-Identifier: Apache-2.0
"""What every node is built on. Nothing is imported here, since `environment` must run before NumPy and rclpy load.

environment          environment variables that are set before anything else is imported
lifecycle_node       ForetouchNode: lifecycle, parameters, QoS and diagnostics
processing_node      ProcessingNode: matches its inputs by stamp and answers every cloud in a thread
parameters           ROS parameters made from settings
diagnostics          counts, rates and latencies of a node's inputs, and its report in /diagnostics
discovery            whether publishers and subscribers have found each other; a second graph
heartbeat            which other nodes were killed or hang
internal_errors      errors of callbacks: counted, logged, answered, and never the end of the process
workers              threads for topics, services and actions
"""

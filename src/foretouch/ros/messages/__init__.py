# SPDX-License-Identifier: Apache-2.0
"""Messages to the core's types and back, RViz markers and tactile adapters: pure functions without a node.

conversions          grasps, planes, predictions
clouds               PointCloud2, objects, and the layout of `object_cloud`
requests             inputs from other nodes, read or refused with a status
markers              what RViz shows
tactile              readings of several tactile drivers
"""

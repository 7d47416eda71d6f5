# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 graph: nodes, parameters, and the conversion of messages; the only user of rclpy.

Nothing is imported here: `environment` has to run before NumPy and rclpy are loaded.

    executables          one `main` a node, and `perception` for the whole chain in one process
    node_base            lifecycle, parameters, QoS, diagnostics: what every node shares
    pairing, worker      how a node waits for its inputs and works without blocking
    offload              the same for services and actions
    segmentation_node    points -> objects, table, object_cloud
    grasp_node           object_cloud + table -> grasps
    touch_predictor_node object_cloud + grasps -> touch; predict_touch, sample_grasps
    conversions, clouds  messages <-> arrays, pure functions
"""

__all__: list[str] = []

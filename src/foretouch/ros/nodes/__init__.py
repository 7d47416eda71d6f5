# SPDX-License-Identifier: Apache-2.0
"""The nodes, one module each; `foretouch.ros.executables` lists and starts them.

camera               points from a RealSense or a simulated camera
replay               points and other topics from a recording or files
segmentation         points -> objects, table, object_cloud
grasp                object_cloud + table -> grasps
touch_predictor      object_cloud + grasps -> touch; predict_touch, sample_grasps
hand                 a simulated hand: grasps -> executed_grasp and tactile readings
recorder             grasps and tactile readings -> dataset
monitor              counts answers and collects diagnostics for the command line
"""

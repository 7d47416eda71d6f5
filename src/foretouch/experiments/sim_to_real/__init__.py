# SPDX-License-Identifier: Apache-2.0
"""Is what was learned in simulation of use on real grasps of objects that were never felt?"""

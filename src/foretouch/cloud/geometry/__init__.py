# SPDX-License-Identifier: Apache-2.0
"""Normals, neighbours, outliers, voxel grids and sampling."""

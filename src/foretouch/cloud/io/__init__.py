# SPDX-License-Identifier: Apache-2.0
"""Cloud files (PCD, PLY, NumPy) and the bytes of a PointCloud2."""

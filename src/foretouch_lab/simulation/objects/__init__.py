# SPDX-License-Identifier: Apache-2.0
"""Objects made here, closed meshes from formulas, no downloads; and meshes from files."""

from foretouch_lab.simulation.objects.mesh import TriangleMesh, read_mesh_file
from foretouch_lab.simulation.objects.shapes import SHAPES, unit_mesh

__all__ = ["SHAPES", "TriangleMesh", "read_mesh_file", "unit_mesh"]

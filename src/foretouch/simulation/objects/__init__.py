# SPDX-License-Identifier: Apache-2.0
"""Objects made here: closed meshes from formulas, no downloads."""

from foretouch.simulation.objects.mesh import TriangleMesh
from foretouch.simulation.objects.shapes import SHAPES, unit_mesh

__all__ = ["SHAPES", "TriangleMesh", "unit_mesh"]

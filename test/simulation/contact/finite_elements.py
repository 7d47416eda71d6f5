# SPDX-License-Identifier: Apache-2.0
"""An oracle that knows nothing of influence functions: axisymmetric finite elements of a bonded layer.

Four-node rings with 2x2 Gauss points; the layer rests on a rigid base, is free at its outer rim and
pressed without friction by a rigid paraboloid. The bound of the contact is met by an active set.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu


def surface_compliance(modulus, poisson, r, z):
    """(n, n) vertical displacement of the surface nodes per vertical force on each (whole rings)."""
    nr, nz = len(r), len(z)
    node = np.arange(nr * nz).reshape(nz, nr)
    quads = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1).reshape(-1, 4)
    position = np.stack(np.meshgrid(r, z), axis=-1).reshape(-1, 2)
    stiffness = _elements(position[quads], modulus, poisson)
    dof = np.stack([2 * quads, 2 * quads + 1], axis=-1).reshape(len(quads), 8)
    rows, columns = np.repeat(dof, 8, axis=1).ravel(), np.tile(dof, (1, 8)).ravel()
    K = coo_matrix((stiffness.ravel(), (rows, columns))).tocsc()
    fixed = np.union1d(
        np.concatenate([2 * node[0], 2 * node[0] + 1]), 2 * node[:, 0]
    )  # base; the axis has no radial motion
    free = np.setdiff1d(np.arange(2 * nr * nz), fixed)
    top = np.searchsorted(free, 2 * node[-1] + 1)
    loads = np.zeros((len(free), nr))
    loads[top, np.arange(nr)] = -1.0
    return -splu(K[free][:, free]).solve(loads)[top]


def press(compliance, gap, depth):
    """Forces of the nodes with C f + gap >= depth, f >= 0, f (C f + gap - depth) = 0."""
    active = gap < depth
    for _ in range(100):
        force = np.zeros_like(gap)
        force[active] = np.linalg.solve(compliance[np.ix_(active, active)], (depth - gap)[active])
        wrong = (force < 0.0) | (~active & (compliance @ force + gap < depth - 1e-12))
        if not wrong.any():
            return force
        active = (active & (force >= 0.0)) | (~active & wrong)
    raise AssertionError("the active set does not settle")


def _elements(corners, modulus, poisson):
    """(M, 8, 8) stiffness of rings with corners (M, 4, 2) in (r, z), counter-clockwise."""
    lame = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = modulus / (2 * (1 + poisson))
    D = lame * np.pad(np.ones((3, 3)), (0, 1)) + shear * np.diag([2.0, 2.0, 2.0, 1.0])  # rr, zz, θθ, rz
    result = np.zeros((len(corners), 8, 8))
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for xi, eta in signs / np.sqrt(3.0):
        N = (1 + xi * signs[:, 0]) * (1 + eta * signs[:, 1]) / 4
        dN = np.stack([signs[:, 0] * (1 + eta * signs[:, 1]), signs[:, 1] * (1 + xi * signs[:, 0])]) / 4
        J = np.einsum("an,mni->mai", dN, corners)
        grad = np.linalg.solve(J, np.broadcast_to(dN, (len(corners), 2, 4)))
        radius = corners[:, :, 0] @ N
        B = np.zeros((len(corners), 4, 8))
        B[:, 0, 0::2] = B[:, 3, 1::2] = grad[:, 0]
        B[:, 1, 1::2] = B[:, 3, 0::2] = grad[:, 1]
        B[:, 2, 0::2] = N / radius[:, None]
        result += np.einsum("mki,kl,mlj,m->mij", B, D, B, 2 * np.pi * radius * np.linalg.det(J))
    return result

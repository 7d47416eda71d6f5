# SPDX-License-Identifier: Apache-2.0
"""What `layer.c` computes: constrained conjugate gradients (Polonsky & Keer 1999), with NumPy's FFT."""

import numpy as np

from foretouch_lab.simulation.contact import layer as layers


def descend(problem, command, gap, start, tolerance, max_iterations):
    """As `layers._descend`, step by step."""
    by_force = command.force_n is not None
    total = command.force_n / problem.cell_m2 if by_force else None
    spectrum = layers._spectra(problem.layers, len(gap), problem.step_m)[1]
    safe_length = 1.0 / np.abs(spectrum).max()
    p = start * (total / start.sum()) if by_force else start
    u, t = layers._convolve(p, spectrum), np.zeros_like(gap)
    last, residual, iterations = np.inf, np.inf, 0
    while iterations < max_iterations and residual >= tolerance:
        wet = p > 0.0
        r = u + gap - (np.mean((u + gap)[wet]) if by_force else command.depth_m)
        g = r * wet
        t = g + (g**2).sum() / last * t * wet
        q = layers._convolve(t, spectrum)
        bend = (t * q).sum() - (t.sum() * q[wet].mean() if by_force else 0.0)  # at a given force the depth is free
        length = (g * t).sum() / bend if bend > 0.0 else safe_length
        new = p - length * t
        overlap = (r < 0.0) & ~wet
        new[overlap] -= min(length, safe_length) * r[overlap]
        disturbed = overlap.any() or (new < 0.0).any()
        last = np.inf if overlap.any() or not g.any() else (g**2).sum()
        new = np.maximum(new, 0.0)
        u = layers._convolve(new, spectrum) if disturbed else u - length * q
        if by_force:
            new, u = new * (total / new.sum()), u * (total / new.sum())
        residual, p, iterations = np.abs(new - p).sum() / new.sum(), new, iterations + 1
    depth = np.mean((u + gap)[p > 0.0]) if by_force else command.depth_m
    return p, depth, iterations, residual

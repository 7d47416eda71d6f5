# SPDX-License-Identifier: Apache-2.0
"""Surfaces whose normals are known, grasps on them, and a small contact model that is really fitted."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from experiment_samples import make_samples
from hypothesis import assume
from hypothesis import strategies as st

from foretouch.models.contact.estimator import ContactEstimator
from foretouch.types import Cloud, Float64, Grasp
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.training.contact import ContactTrainingConfig, describe_samples, fit_contact

FEW_TREES = ContactTrainingConfig(trees=4, thinned=1.0)
HAND = np.column_stack([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Rotation of a hand in front of the camera: X away from it, Y up, Z to its right."""


def patch(normal: Float64, at: Float64, step: float = 0.002, count: int = 41) -> Float64:
    """(count², 3) points of a square of a plane, centred at a point [m]."""
    first = np.cross(normal, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    grid = step * (np.arange(count) - count // 2)
    u, v = np.meshgrid(grid, grid)
    return at + u.reshape(-1, 1) * first + v.reshape(-1, 1) * np.cross(normal, first)


def cylinder(radius: float, at: Float64) -> Float64:
    """(N, 3) points round an axis along y, even in angle and height [m]."""
    angle, height = np.meshgrid(np.arange(180) * np.radians(2.0), np.linspace(-0.05, 0.05, 51))
    ring = radius * np.column_stack([np.cos(angle.reshape(-1)), np.zeros(angle.size), np.sin(angle.reshape(-1))])
    return at + ring + np.column_stack([np.zeros(angle.size), height.reshape(-1), np.zeros(angle.size)])


def sphere(radius: float, at: Float64, count: int = 8000) -> Float64:
    """(count, 3) points on Fibonacci's lattice [m]."""
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sin(polar)
    return at + radius * np.column_stack([np.cos(around) * ring, np.sin(around) * ring, np.cos(polar)])


def moved(grasp: Grasp, turn: Float64, shift: Float64) -> Grasp:
    """The grasp after the rigid motion p -> turn p + shift."""
    return Grasp(turn @ grasp.g1 + shift, turn @ grasp.g2 + shift, turn @ grasp.rotation, id=grasp.id)


@cache
def small_estimator() -> ContactEstimator:
    """A contact model fitted to five made-up objects of ten grasps each."""
    samples = make_samples(5, 10)
    return fit_contact(describe_samples(samples), labels_of(samples), [sample.object for sample in samples], FEW_TREES)


def scaled(cloud: Cloud, factor: float) -> Cloud:
    """The same object, larger or smaller, where it was."""
    centre = cloud.xyz.mean(axis=0)
    return Cloud((centre + factor * (cloud.xyz - centre)).astype(np.float32))


@st.composite
def lines_sheets_and_repeated_points(draw: st.DrawFn, place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 3) points on a line, a sheet or a grid around a place, many of them equal, and two contacts."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count, axes = draw(st.integers(8, 24)), draw(st.sets(st.integers(0, 2), min_size=1))
    step = draw(st.sampled_from([1e-9, 1e-3, 0.01, 10.0]))
    points = np.zeros((count, 3)) + place
    for axis in axes:
        points[:, axis] += step * rng.integers(-2, 3, count)
    points[0, min(axes)] += step  # not all in one place
    points[1, min(axes)] -= step
    g1, g2 = points[0] + step * rng.integers(-1, 2, 3), points[1] + [0.0, 0.0, 2 * step]
    assume((g1 != g2).any())
    return points, g1, g2


def edit_card(card: Path, **changes: Any) -> None:
    """Replace fields of a model card, or remove those whose value is `...`."""
    document = json.loads(card.read_text()) | changes
    card.write_text(json.dumps({key: value for key, value in document.items() if value is not ...}))


def can_with_grasps(count: int) -> tuple[Cloud, list[Grasp]]:
    """Make a can of 3000 points on a table below the camera, and grasps across it."""
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(0.0, np.pi, 3000), rng.uniform(-0.055, 0.055, 3000)
    xyz = np.column_stack([along, 0.035 * np.cos(angle), 1.15 - 0.035 * np.sin(angle)])
    cloud = Cloud((xyz + rng.normal(0.0, 5e-4, xyz.shape)).astype(np.float32))
    across = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # z across the can
    places = rng.uniform(-0.04, 0.04, count)
    return cloud, [Grasp(np.array([x, 0.034, 1.148]), np.array([x, -0.034, 1.148]), across) for x in places]

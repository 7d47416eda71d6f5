# SPDX-License-Identifier: Apache-2.0
"""The lines along which two fingers close, and what an object hides, against the references."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from kernels.references import closing as reference
from seen_solids import Camera, Solid, about_vertical, ball, box, can

from foretouch.grasp import GeoGraspConfig, GraspPlan, HandConfig, Obstacles, completed, hand, outline, plan_grasps
from foretouch.grasp import unseen as unseen_pixels
from foretouch.kernels import struct
from foretouch.types import Cloud

SOLIDS = {
    "can": (can(0.033, 0.12), Camera(50.0)),
    "can from above": (can(0.04, 0.05), Camera(90.0)),
    "ball": (ball(0.035), Camera(60.0)),
    "ball from above": (ball(0.035), Camera(86.0)),
    "box": (box(0.06, 0.09, 0.05), Camera(55.0)),
    "upright box": (box(0.05, 0.08, 0.15), Camera(45.0)),
    "lying bar": (box(0.2, 0.03, 0.03), Camera(60.0)),
    "plate": (box(0.05, 0.08, 0.012), Camera(70.0)),
}
BLOCK = np.mgrid[-0.0298:0.0303:0.001, -0.0198:0.0203:0.001, 0.001:0.08:0.002].reshape(3, -1).T.copy()  # filled
LINES = np.array([0.004, 0.008, 0.01, 0.001, 1.0, 0.0, 0.038, 0.005])  # settings of `closing_lines`


class Recorder:
    """Calls a kernel and its reference with the same arguments, and keeps both answers: the last so many arguments."""

    def __init__(self, kernel: Callable[..., None], plain: Callable[..., None], results: int = 1) -> None:
        self._kernel, self._plain, self._results = kernel, plain, results
        self.answers: list[tuple[Any, Any]] = []

    def __call__(self, *arguments: Any) -> None:
        others = [np.empty_like(argument) for argument in arguments[-self._results :]]
        self._plain(*arguments[: -self._results], *others)
        self._kernel(*(argument["struct"] if isinstance(argument, dict) else argument for argument in arguments))
        self.answers.append(([argument.copy() for argument in arguments[-self._results :]], others))


def fields(name: str, **values: Any) -> dict[str, Any]:
    """Keep the fields of a struct, and itself, in place of `struct`."""
    return values | {"struct": struct(name, **values)}


def unseen() -> Any:
    """Return the outline of an object of which nothing is known to be unseen."""
    nothing = np.empty((0, 0), np.float32)
    return struct("Outline", camera=np.zeros(15), nearest=nothing, inside=nothing, rows=0, columns=0, per_cell=0.0)


def planned(solid: Solid, camera: Camera, noise: np.random.Generator | None = None, **settings: Any) -> GraspPlan:
    xyz = camera.see(solid, yaw=0.3).xyz
    if noise is not None:
        xyz = (xyz * (1.0 + noise.normal(0.0, 0.001, (*xyz.shape[:2], 1)))).astype(np.float32)
    return plan_grasps(Cloud(xyz), camera.table(), GeoGraspConfig(count=5), **settings)


def around(camera: Camera) -> Obstacles:
    """Posts in a ring of 60 mm."""
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 9), np.linspace(0.0, 0.1, 8))
    posts = np.stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), height], axis=-1).reshape(-1, 3)
    return Obstacles(camera.to_camera(posts).astype(np.float32), np.arange(len(posts), dtype=np.int32))


@pytest.mark.slow
def test_lines_and_completed_objects(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """Equal but where a point at the border of two bins falls into the other by rounding; with noise few do."""
    blocked = n_hidden = 0
    hands = itertools.cycle(({}, {"hand": HandConfig(tip_radius_m=0.0125, clearance_m=0.0)}, {"slide_m": 0.004}))

    def check(solid: Solid, camera: Camera) -> None:
        nonlocal blocked, n_hidden
        closing = Recorder(completed._closing_lines, reference.closing_lines)
        whole = Recorder(completed._complete_object, reference.complete_object, 3)
        outlines = Recorder(completed._outline, reference.outline, 2)
        with monkeypatch.context() as patch:
            patch.setattr(completed, "_outline", outlines)
            patch.setattr(completed, "_closing_lines", closing)
            patch.setattr(completed, "_complete_object", whole)
            patch.setattr(completed, "struct", fields)
            planned(solid, camera, rng, obstacles=around(camera), **next(hands))
        for (nearest, inside), (depths, filled) in outlines.answers:
            np.testing.assert_array_equal(nearest, depths)
            own = np.s_[4:-4, 4:-4]  # gaps are not closed in the empty cells around
            np.testing.assert_allclose(inside[own], filled[own], atol=1e-6)
        for (points, shares, found), (others, parts, expected) in whole.answers:
            n, size = len(points) // 2, round(found[0])
            np.testing.assert_allclose(found[1:], expected[1:], atol=1e-5)
            gap = np.abs(points[:n] - others[:n]).max()
            assert gap < 1e-5
            if size == expected[0]:
                np.testing.assert_allclose(points[:size], others[:size], atol=2e-5)
                assert np.count_nonzero(np.abs(shares[:size] - parts[:size]) > 1e-9) <= 0.002 * size
            assert abs(size - expected[0]) <= 0.002 * size
            n_hidden += size - n
        for (found,), (other,) in closing.answers:
            met = np.isfinite(found[..., 0])
            assert np.count_nonzero(met != np.isfinite(other[..., 0])) <= 0.005 * met.size
            both = met & np.isfinite(other[..., 0])
            gaps = np.abs(found - other)[both]
            low, high, height, top, blocker, solid, *palm, outer_low, outer_high = gaps.T
            assert not np.any(palm)
            lengths = np.stack([low, high, height, top, outer_low, outer_high])  # [m]
            if met.size > 1:
                assert np.quantile(lengths, 0.9) < 1e-6
                assert np.mean(blocker > 0.0) < 0.01
                assert np.mean(solid > 1e-3) < 0.01
            assert lengths.max() < 0.002
            blocked += int((other[both][:, 4] >= 0.0).sum())

    every_case(SOLIDS, check)
    assert blocked > 100
    assert n_hidden > 1000


def an_image(rng: np.random.Generator) -> dict[str, Any]:
    """Return a depth image of two depths and pixels without one, of millimetre-wide pixels."""
    xyz = rng.choice([0.8, 0.803, 0.9, np.nan], (60, 80, 3)).astype(np.float32)
    return fields("Depths", xyz=xyz, h=60, w=80, camera=np.array([800.0, 40.0, 790.0, 30.0]))


def test_where_an_object_ends_by_its_image(rng: np.random.Generator) -> None:
    """Also of rows without a point, without one at the height of the line, and without any point."""
    points = rng.uniform((-0.03, -0.01, 0.78), (0.03, 0.004, 0.82), (400, 3)).astype(np.float32)
    low = np.array([[0.05, 0.0, 0.7921], [-0.001, 0.0, 0.85]], np.float32)
    frame, image = np.append(about_vertical(0.4).T, [0.001, 0.002, 0.8]), an_image(rng)
    own = (rng.random((60, 80)) > 0.1).astype(np.uint8)
    for some in (points, low, points[:0]):
        arguments = some, len(some), own, image, frame, np.array([0.006, 0.008, 0.0014, 0.005, 2.0]), 9
        answers = Recorder(outline._outline_ends, reference.outline_ends, 2)
        answers(*arguments, np.empty((4, 2, 9)), np.empty((2, 2)))
        for found, expected in zip(*answers.answers[0], strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.isnan(answers.answers[0][0][1]).all()


def test_how_far_pixels_without_depth_reach(rng: np.random.Generator) -> None:
    """Outwards from contacts, of which some are out of view."""
    contacts = rng.uniform((-0.06, -0.04, 0.78), (0.06, 0.04, 0.82), (200, 3))
    turn = rng.uniform(0.0, 2.0 * np.pi, 200)
    outwards, image = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1), an_image(rng)
    image["xyz"][:, 20:60] = np.nan
    answers = Recorder(unseen_pixels._unseen_beyond, reference.unseen_beyond)
    answers(contacts, outwards, 200, image, 30, np.array([0.002, 0.005, 0.1, 0.0, 1.0]), np.empty(200))
    (found,), (expected,) = answers.answers[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.count_nonzero(found) > 20


def test_an_ideal_box_is_as_wide_as_it_is() -> None:
    """A block of points that is filled from 0 to 80 mm: worked by hand."""
    turns = np.array([[0.0, 0.0, np.nan], [np.pi / 2.0, 0.0, np.nan], [0.0, 0.004, np.nan]])
    others = np.array([[0.05, 0.0, 0.04], [0.0, -0.03, 0.04], [0.08, 0.0, 0.04], [0.05, 0.0, 0.02]])
    found = np.empty((3, 3, 10))
    completed._closing_lines(
        *(BLOCK, np.ones(len(BLOCK)), len(BLOCK), turns, 3, 3, LINES, unseen()),
        *(others, len(others), np.zeros(2), 0, 0, found),
    )
    np.testing.assert_allclose(found[0, :, 0], -0.0298, atol=0.0006)
    np.testing.assert_allclose(found[0, :, 1], 0.0302, atol=0.0006)
    np.testing.assert_allclose(found[1, :, 0], -0.0198, atol=0.0006)
    np.testing.assert_allclose(found[1, :, 1], 0.0202, atol=0.0006)
    np.testing.assert_allclose(found[0, :, 8:], [[-0.0298, 0.0302]] * 3, atol=0.0006)  # where the outermost points are
    np.testing.assert_allclose(found[:, :, 3], 0.076, atol=0.002)  # 95 % of the points are lower
    np.testing.assert_allclose(found[:, :, 2], found[:, :, 3] / 2.0 - 0.006, atol=1e-9)
    np.testing.assert_array_equal(
        found[0, :, 4], 0
    )  # the first, 20 mm outside of the end and no more than a tip beside
    np.testing.assert_array_equal(found[1, 1:, 4], 1)
    np.testing.assert_array_equal(found[:, :, 5], 1.0)  # without a view nothing is seen through
    np.testing.assert_allclose(found[2, 0], found[0, 1], atol=1e-8)  # moved by one step: the same line


def test_a_line_is_raised_where_a_palm_would_meet_the_object() -> None:
    """A block of 60 x 40 x 80 mm, worked by hand: its line is 6 mm below half of 76 mm, and the palm reaches down to the free depth over it."""

    def line(beside_middle: float, middle: float, tilts: tuple[float, ...] = (0.0,), lift: float = 0.0) -> Any:
        found = np.empty((1, 1, 10))
        palm = np.array([0.03, 0.01, *tilts, *[lift] * len(tilts), *[beside_middle] * 20, *[middle] * 20])
        completed._closing_lines(
            *(BLOCK, np.ones(len(BLOCK)), len(BLOCK), np.array([[0.0, 0.0, np.nan]]), 1, 1, LINES, unseen()),
            *(np.empty((0, 3)), 0),
            *(palm, len(tilts), 20, found),
        )
        return found[0, 0]

    free = line(1.0, 1.0)
    assert free[2] == pytest.approx(0.032, abs=0.001)
    assert free[7] == 0.0
    middle_m = line(0.041, 0.041)[2]  # no room to spare
    assert middle_m == pytest.approx(0.038, abs=0.001)
    for one in (line(0.03, 0.05), line(0.05, 0.03)):  # 79 mm of block less 30 mm
        assert one[2] == pytest.approx(0.049, abs=0.003)
        assert one[7] == pytest.approx(one[2] - middle_m)
        assert one[6] == pytest.approx(0.0, abs=1e-6)
    none = line(0.005, 0.005)  # 74 mm would be nearer than 12 mm to the top
    assert none[7] == 0.0
    assert none[6] == pytest.approx(0.079 - 0.038 - 0.005, abs=0.003)
    from_the_side = line(0.03, 0.03, (0.0, np.pi / 2.0))  # which is 20 mm deep
    assert from_the_side[7] == 0.0
    assert from_the_side[6] == pytest.approx(0.02 - 0.03, abs=0.005)
    assert line(0.03, 0.03, (0.0, np.pi / 2.0), lift=0.05)[7] > 0.007  # but where the hand would be in the table


def test_points_that_are_hardly_certain_raise_no_line() -> None:
    """Mirrored points appear and vanish as the camera moves: with next to no weight, and in whatever order, they count for nothing."""
    palm = np.array([0.03, 0.01, 0.0, 0.0, *[0.03] * 20, *[0.03] * 20])

    def height(points: np.ndarray, weights: np.ndarray) -> float:
        found = np.empty((1, 1, 10))
        completed._closing_lines(
            *(points, weights, len(points), np.array([[0.0, 0.0, np.nan]]), 1, 1, LINES, unseen()),
            *(np.empty((0, 3)), 0, palm, 1, 20, found),
        )
        return float(found[0, 0, 2])

    ghosts = np.mgrid[-0.01:0.011:0.004, -0.01:0.011:0.004, 0.1:0.12:0.004].reshape(3, -1).T
    both, weights = np.concatenate([ghosts, BLOCK]), np.concatenate([np.full(len(ghosts), 1e-4), np.ones(len(BLOCK))])
    alone = height(BLOCK, np.ones(len(BLOCK)))
    assert alone == pytest.approx(0.049, abs=0.003)
    for order in (slice(None), slice(1, None), slice(None, None, -1)):
        assert height(both[order].copy(), weights[order].copy()) == pytest.approx(alone, abs=1e-4)


def test_how_far_a_hand_can_go_on(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    recorder = Recorder(hand._hand_clearance, reference.hand_clearance, 2)
    monkeypatch.setattr(hand, "_hand_clearance", recorder)
    for name in ("shadow_thumb_middle", "franka_hand"):
        own = rng.uniform((-0.04, -0.04, -0.05), (0.04, 0.04, 0.03), (300, 3))
        others = rng.uniform(-0.3, 0.3, (60, 3))  # also outside of the map
        for points in (others, others[:0]):
            hand.load_hand(name).clearance(0.05, own, points, 0.06)
    for answer, expected in recorder.answers:
        for one, other in zip(answer, expected, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-6)

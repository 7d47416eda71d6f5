# SPDX-License-Identifier: Apache-2.0
"""What is background: against rays that are cast into rooms of boxes with a wall, the edge of a table, an arm and a second table."""

import numpy as np
import pytest
from every_case import every_case
from scipy.spatial import ConvexHull

from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.pipeline import Pipeline
from foretouch.types import Cloud
from foretouch.types.scene import Scene

HEIGHT, WIDTH, FOCAL = 240, 320, 300.0
TABLE, FLOOR = 1, 2  # labels; boxes follow
SURFACE = ((-0.45, -0.35, -0.02), (0.45, 0.35, 0.0))  # the table's least and largest x, y, z [m]; its top at z = 0
CAN, PACKET = ((-0.10, -0.05, 0.0), (-0.02, 0.03, 0.10)), ((0.05, 0.0, 0.0), (0.15, 0.06, 0.06))
BIN = (
    ((-0.20, -0.14, 0.0), (-0.195, 0.16, 0.12)),
    ((0.20, -0.14, 0.0), (0.205, 0.16, 0.12)),
    ((-0.20, -0.14, 0.0), (0.20, -0.135, 0.12)),
    ((-0.20, 0.155, 0.0), (0.20, 0.16, 0.12)),
)  # its sides
# On the table, and on the top of a box beside it.
SHELF = (CAN, ((0.12, -0.20, 0.0), (0.45, 0.30, 0.15)), ((0.22, 0.0, 0.15), (0.30, 0.06, 0.21)))
ON_SHELF = (0.2464, -0.0423, 0.7465)  # in `room(*SHELF, tilt_deg=35.0, distance_m=0.9)`


def room(*boxes, tilt_deg: float = 40.0, distance_m: float = 0.8, noise_m: float = 0.0005) -> tuple[Cloud, np.ndarray]:
    """A cloud of boxes above a table and a floor .7 m below, with noise, and the label of each pixel."""
    tilt = np.radians(tilt_deg)
    forward, right = np.array([0.0, np.sin(tilt), -np.cos(tilt)]), np.array([1.0, 0.0, 0.0])
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    v, u = np.indices((HEIGHT, WIDTH))
    pixels = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones(u.shape)], axis=-1)
    rays, eye = pixels @ axes.T, -distance_m * forward
    depth, labels = (-0.7 - eye[2]) / rays[..., 2], np.full(u.shape, FLOOR)
    for number, (low, high) in enumerate((SURFACE, *boxes)):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(np.array(low) - eye) / rays, (np.array(high) - eye) / rays], axis=0)
        near, far = np.nanmax(ends[0], axis=-1), np.nanmin(ends[1], axis=-1)
        hit = (near < far) & (near > 0) & (near < depth)
        depth, labels = np.where(hit, near, depth), np.where(hit, (number and number + 2) or TABLE, labels)
    noise = np.random.default_rng(0).normal(0.0, noise_m, depth.shape)
    depth = np.where(depth < 0, np.nan, depth + noise * depth**2)
    return Cloud((pixels * depth[..., None]).astype(np.float32)), labels


def labelled(found: Scene, labels: np.ndarray) -> list[int]:
    """The true label of most pixels of each object, sorted."""
    return sorted(int(np.bincount(labels.ravel()[object_.pixels]).argmax()) for object_ in found.objects)


def reasons(found: Scene, labels: np.ndarray) -> dict[int, str]:
    """Why the true label of each background segment is none."""
    return {int(np.bincount(labels.ravel()[one.pixels]).argmax()): one.background for one in found.background}


def test_objects_within_the_outline_stand_on_the_table() -> None:
    for tilt in (0.0, 25.0, 50.0):
        cloud, labels = room(CAN, PACKET, tilt_deg=tilt)
        found = segment(cloud)
        assert labelled(found, labels) == [3, 4], tilt
        assert found.background == ()
        assert found.counts["n_background"] == 0


@pytest.mark.parametrize("tilt", [30.0, 45.0])
def test_an_arm_from_the_border_enters_the_view_and_is_an_obstacle_not_a_target(tilt: float) -> None:
    arm = ((0.20, -0.9, 0.12), (0.28, -0.02, 0.20))
    cloud, labels = room(CAN, PACKET, arm, tilt_deg=tilt)
    scene = Pipeline().segment(cloud)
    found = scene
    assert labelled(found, labels) == [3, 4]
    assert reasons(found, labels) == {5: "enters_view"}
    assert found.counts["n_enters_view"] == len(found.background) == found.counts["n_background"]
    assert all(target.id in {object_.id for object_ in found.objects} for target in scene.targets)
    assert scene.obstacles is not None
    on_arm = scene.obstacles.xyz[scene.obstacles.object_ids == 0]
    assert len(on_arm) > 50
    assert set(scene.obstacles.object_ids.tolist()) == {0, 1, 2}
    assert not (found.labels.ravel()[found.background[0].pixels] > 0).any()


def test_a_table_that_the_image_cuts_off_goes_on_beyond_it() -> None:
    """So that a thing whose foot is out of view enters the view, and is not beyond the table."""
    cloud, labels = room(
        ((0.10, 0.10, 0.0), (0.15, 0.15, 0.08)), ((-0.04, -0.30, 0.0), (0.04, -0.23, 0.10)), distance_m=0.6
    )
    found = segment(cloud)
    assert labelled(found, labels) == [3]
    assert reasons(found, labels) == {4: "enters_view"}


def test_what_the_image_cuts_and_stands_on_the_table_is_an_object_and_no_target_beside_whole_ones() -> None:
    """Its foot is seen; that of a thing before the lower border is not, but its front is, down to half of its height and more."""
    beside, before = ((0.20, 0.0, 0.0), (0.34, 0.08, 0.08)), ((-0.04, -0.27, 0.0), (0.04, -0.18, 0.12))
    for cut, tilt in ((beside, 40.0), (before, 50.0)):
        cloud, labels = room(CAN, cut, tilt_deg=tilt, distance_m=0.6)
        border = np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()])
        assert (border == 4).sum() > 10
        scene = Pipeline().segment(cloud)
        assert labelled(scene, labels) == [3, 4]
        flags = {int(np.bincount(labels.ravel()[one.pixels]).argmax()): one.flags for one in scene.objects}
        assert flags == {3: (), 4: ("cut_by_image",)}
        (target,) = scene.targets
        assert target.flags == ()
        alone = Pipeline().segment(room(cut, tilt_deg=tilt, distance_m=0.6)[0])
        assert [one.flags for one in alone.targets] == [("cut_by_image",)]


def test_what_stands_behind_the_edge_of_the_table_is_beyond_it() -> None:
    chair = ((-0.15, 0.50, -0.7), (0.10, 0.60, 0.10))  # on the floor, as high as the table and a little more
    cloud, labels = room(CAN, chair, tilt_deg=45.0, distance_m=1.0)
    found = segment(cloud)
    assert labelled(found, labels) == [3]
    assert reasons(found, labels) == {4: "beyond_table"}


def test_what_hovers_over_the_table_is_no_object() -> None:
    above = ((-0.1, 0.1, 0.2), (0.0, 0.2, 0.25))
    cloud, labels = room(PACKET, above, tilt_deg=50.0, distance_m=1.1)
    found = segment(cloud)
    assert labelled(found, labels) == [3]
    assert reasons(found, labels) == {4: "floating"}


@pytest.mark.parametrize("tilt", [10.0, 25.0, 40.0])
def test_the_sides_of_a_bin_are_walls_and_what_lies_in_it_are_objects(tilt: float) -> None:
    cloud, labels = room(CAN, PACKET, *BIN, tilt_deg=tilt, noise_m=0.001)
    found = segment(cloud)
    assert labelled(found, labels) == [3, 4]
    assert set(reasons(found, labels).values()) == {"wall"}
    assert set(reasons(found, labels)) <= {5, 6, 7, 8}


@pytest.mark.parametrize("tilt", [10.0, 25.0])
def test_what_touches_the_side_of_a_bin_is_no_side(tilt: float) -> None:
    against = ((0.105, -0.05, 0.0), (0.195, 0.02, 0.06)), ((-0.08, 0.07, 0.0), (0.0, 0.155, 0.05))
    cloud, labels = room(*against, *(side for side in BIN), tilt_deg=tilt, noise_m=0.001)
    found = segment(cloud)
    assert labelled(found, labels) == [3, 4]
    assert set(reasons(found, labels).values()) == {"wall"}


def test_of_several_planes_the_chosen_one_carries_the_objects() -> None:
    cloud, labels = room(*SHELF, tilt_deg=35.0, distance_m=0.9)

    def check(table: str, point: tuple[float, ...], expected: list[int]) -> None:
        config = SegmentationConfig().updated({"plane.table": table, "plane.point": point})
        assert labelled(segment(cloud, config), labels) == expected

    every_case([("largest", (), [3]), ("nearest", (), [5]), ("point", ON_SHELF, [5])], check)


def test_large_boxes_whose_tops_are_seen_are_no_bin() -> None:
    boxes = ((-0.25, -0.1, 0.0), (0.04, 0.0, 0.1)), ((0.05, -0.1, 0.0), (0.15, 0.2, 0.1))
    cloud, labels = room(*boxes, tilt_deg=50.0, distance_m=1.0)
    found = segment(cloud)
    assert labelled(found, labels) == [3, 4]
    assert found.background == ()


def test_a_full_table_and_a_bin_whose_floor_is_half_hidden_are_answered() -> None:
    def boxes(columns: range, rows: range, step: float) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
        middle = [(step * x, step * y, 0.05 + 0.02 * ((x + y) % 2)) for x in columns for y in rows]
        return [((x - 0.035, y - 0.03, 0.0), (x + 0.035, y + 0.03, top)) for x, y, top in middle]

    cases = {"table": (boxes(range(-3, 4), range(-2, 3), 0.09), ()), "bin": (boxes(range(-1, 2), range(-1, 2), 0.09), BIN)}  # fmt: skip
    for name, (things, sides) in cases.items():
        cloud, labels = room(*things, *sides, tilt_deg=20.0)
        found = segment(cloud)
        assert labelled(found, labels) == list(range(3, 3 + len(things))), name
        assert {part.background for part in found.background} == ({"wall"} if sides else set()), name


def test_an_object_that_hides_the_edge_of_the_table_stands_on_it() -> None:
    cloud, labels = room(((-0.05, 0.26, 0.0), (0.06, 0.34, 0.25)), tilt_deg=45.0, distance_m=1.0)
    found = segment(cloud)
    assert labelled(found, labels) == [3]
    assert found.background == ()


def test_the_outline_is_the_hull_of_the_table_with_its_holes_and_dents_filled() -> None:
    cloud, labels = room(CAN, PACKET, tilt_deg=45.0, distance_m=1.1, noise_m=0.0)
    xyz = cloud.xyz.copy()
    xyz[100:130, 60:120] = np.nan  # a hole in the depth
    found = segment(Cloud(xyz))
    on = xyz[labels == TABLE].astype(np.float64)
    on = on[np.isfinite(on).all(axis=1)]
    across = np.linalg.svd(found.table.normal[None])[2][1:]
    assert np.abs(found.outline @ found.table.normal + found.table.offset).max() < 1e-6
    area = ConvexHull(found.outline @ across.T).volume
    assert ConvexHull(on @ across.T).volume == pytest.approx(area, rel=0.08)  # it is seen in cells of two pixels
    assert area > 0.5


@pytest.mark.parametrize(("half_m", "floor"), [(0.12, True), (0.02, False)])
def test_what_is_as_high_as_the_table_but_apart_from_it_does_not_widen_the_outline(half_m: float, floor: bool) -> None:
    """A second table beyond the floor, and a few pixels beyond pixels without depth."""
    outlines = []
    for apart in ((), (((-half_m, 0.65, -0.7), (half_m, 0.65 + half_m, 0.0)),)):
        cloud, labels = room(CAN, *apart, tilt_deg=45.0, distance_m=1.2)
        xyz = cloud.xyz if floor else np.where((labels == FLOOR)[..., None], np.float32(np.nan), cloud.xyz)
        outlines.append(segment(Cloud(xyz)).outline)
    for edge in (np.min, np.max):
        np.testing.assert_allclose(*(edge(outline, axis=0) for outline in outlines), atol=0.02)


@pytest.mark.parametrize("side", [1, -1])
def test_an_arm_enters_the_view_across_a_margin_without_depth(side: int) -> None:
    reach = sorted((side * 0.12, side * 0.9))
    cloud, labels = room(CAN, ((reach[0], -0.1, 0.12), (reach[1], -0.02, 0.20)))
    xyz = cloud.xyz[:, ::side].copy()
    xyz[:, -20:] = np.nan
    found = segment(Cloud(xyz[:, ::side]))
    assert labelled(found, labels) == [3]
    assert reasons(found, labels) == {4: "enters_view"}


def test_a_list_of_points_without_an_image_has_no_outline_and_no_background() -> None:
    cloud, _ = room(CAN, PACKET)
    rng = np.random.default_rng(3)
    few = cloud.xyz.reshape(-1, 3)[rng.permutation(cloud.size)[::9]] + rng.normal(0.0, 0.003, (1, 3)).astype(np.float32)
    found = segment(Cloud(few.astype(np.float32)))
    assert found.outline.shape == (0, 3)
    assert found.background == ()


def test_why_there_is_no_object_names_the_background() -> None:
    cloud, labels = room(((0.02, -0.9, 0.12), (0.10, -0.12, 0.20)))
    found = segment(cloud)
    assert found.status == "no_object"
    assert "background" in found.reason
    assert reasons(found, labels) == {3: "enters_view"}


# The sides of a bin, one rule after the other: two upright boards that face the camera, without sides between them.
BOARD_M, BEHIND_M = 0.3, 0.24


def boards(tops: tuple[float, float], *, length_m: float = BOARD_M) -> dict[int, str]:
    """Why boards with these tops are background."""
    sides = [
        ((-length_m / 2, y, 0.0), (length_m / 2, y + 0.006, top))
        for y, top in zip((-BEHIND_M / 2, BEHIND_M / 2), tops, strict=True)
    ]
    cloud, labels = room(*sides, tilt_deg=30.0)
    found = segment(cloud)
    assert len(found.objects) + len(found.background) == 2
    return reasons(found, labels)


def leaning_boards(angle_deg: float) -> dict[int, str]:
    """Why boards without thickness that lean back are background."""
    cloud, labels = room(tilt_deg=30.0)
    tilt, right = np.radians(30.0), np.array([1.0, 0.0, 0.0])
    forward = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    xyz = cloud.xyz.astype(np.float64)
    rays = xyz / xyz[..., 2:] @ np.stack([right, np.cross(forward, right), forward])
    up = 0.1 * np.array([0.0, np.tan(np.radians(angle_deg)), 1.0])
    for label, y in enumerate((-BEHIND_M / 2, BEHIND_M / 2), 3):
        from_eye = np.array([-BOARD_M / 2, y, 0.0]) + 0.8 * forward  # to the lower left corner
        edges = np.broadcast_to(np.stack([-BOARD_M * right, -up], axis=1), (*rays.shape, 2))
        steps = np.linalg.inv(np.concatenate([rays[..., None], edges], axis=-1)) @ from_eye
        depth, *along = np.moveaxis(steps, -1, 0)  # along the ray, and along both edges
        hit = np.all([(share > 0) & (share < 1) for share in along], axis=0) & (depth < xyz[..., 2])
        xyz[hit] *= (depth[hit] / xyz[hit][:, 2])[:, None]
        labels[hit] = label
    found = segment(Cloud(xyz.astype(np.float32)))
    assert len(found.objects) + len(found.background) == 2
    return reasons(found, labels)


WALLS = {3: "wall", 4: "wall"}


def test_long_upright_boards_of_one_height_are_the_sides_of_a_bin_and_others_are_objects() -> None:
    cases = {
        "one height": (boards, (0.10, 0.10), WALLS),
        "two heights": (boards, (0.10, 0.115), {}),
        "low": (boards, (0.04, 0.04), {}),
        "leaning by 16 degrees": (leaning_boards, 16.0, WALLS),
        "leaning by 26 degrees": (leaning_boards, 26.0, {}),
    }
    every_case(cases, lambda why, given, expected: np.testing.assert_equal(why(given), expected))
    assert boards((0.10, 0.10), length_m=0.16) == {}

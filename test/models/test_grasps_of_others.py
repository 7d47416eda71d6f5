# SPDX-License-Identifier: Apache-2.0
"""Grasps that other planners give: columns in another order, and contacts in the air. Every entrance says the same of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from experiment_samples import make_samples
from seen_solids import Camera, box

import foretouch as ft
from foretouch.errors import DatasetError, GraspError
from foretouch.grasp.reach import OFF_OBJECT, in_the_air
from foretouch.types import Float64, Grasps, Predictions
from foretouch.types.scene import Object

CAMERA = Camera(60.0)
TARGET = Object.of("1", CAMERA.see(box(0.05, 0.06, 0.08)), CAMERA.table())
PLANNED = ft.plan(TARGET, count=3)
MODEL = ft.load_model()


def in_the_order_of_graspnet(rotation: Float64) -> Float64:
    """Columns: the approach, the line of the contacts, and what is across both."""
    x, y, z = np.moveaxis(rotation, -1, 0)
    return np.stack([-x, z, y], axis=-1)


def lifted(grasps: ft.Grasps, by_m: float) -> ft.Grasps:
    """The same grasps farther above the table."""
    up = CAMERA.table().towards_camera.normal * by_m
    return grasps.replace(g1=grasps.g1 + up, g2=grasps.g2 + up)


def answers(grasps: ft.Grasps) -> dict[str, Predictions]:
    """Predictions by every entrance of the library."""
    pipeline = ft.Pipeline()
    return {
        "model": MODEL.predict(TARGET, grasps),
        "pipeline": pipeline.predict(TARGET, grasps),
        "history": ft.History(MODEL).predict(TARGET, grasps),
    }


def test_every_entrance_of_the_library_gives_one_answer() -> None:
    rotations = np.concatenate([PLANNED.rotation[:2], in_the_order_of_graspnet(PLANNED.rotation[2:])])
    asked = PLANNED.replace(rotation=rotations)
    whole, *others = answers(asked).values()
    assert whole.status.tolist() == ["ok", "ok", "bad_grasp"]
    assert "pose: its Z is 90 degrees from g1 - g2, more than 30; the second column is along it" in whole.reason[2]
    for other in others:
        assert (other.status == whole.status).all()
        assert (other.flags == whole.flags).all()
        assert (other.reason == whole.reason).all()
        np.testing.assert_array_equal(other.value, whole.value)


def test_equal_pressures_are_flagged_in_python_as_in_the_graph() -> None:
    for name, found in answers(PLANNED).items():
        assert sum("equal_pressure" in flags for flags in found.flags) >= 2, name
        assert not any("equal_pressure" in flags for flags in answers(PLANNED[:1])[name].flags)


def test_a_grasp_in_the_air_is_flagged() -> None:
    """5 cm above its top, or beside it; a planned grasp, whose far contact the camera does not see, is not."""
    for grasps, expected in ((PLANNED, False), (lifted(PLANNED, 0.09), True)):
        for name, found in answers(grasps).items():
            assert [OFF_OBJECT in flags for flags in found.flags] == 3 * [expected], name
    aside = np.array([0.08, 0.0, 0.0])
    beside = PLANNED.replace(g1=PLANNED.g1 + aside, g2=PLANNED.g2 + aside)
    assert in_the_air(beside, TARGET.cloud.xyz).all()
    hidden = PLANNED.replace(g1=PLANNED.g1 * 1.03, g2=PLANNED.g2 * 1.03)  # farther along the rays through both contacts
    assert not in_the_air(hidden, TARGET.cloud.xyz).any()


@pytest.mark.slow
def test_a_contact_is_in_the_air_beyond_20_mm_of_all_points_and_of_the_rays_behind_them(rng) -> None:
    """By the distance from each ray, in double precision; most contacts are decided without it."""
    points = TARGET.cloud.finite.astype(np.float64)
    contacts = points[rng.integers(0, len(points), 400)] + rng.normal(0.0, 0.02, (400, 3))
    gaps = contacts[:, None] - points
    behind = np.maximum((gaps * points).sum(axis=2) / (points**2).sum(axis=1), 0.0)
    away = np.linalg.norm(gaps - behind[:, :, None] * points, axis=2).min(axis=1)
    assert 40 < np.count_nonzero(away > 0.02) < 360
    order, turned = rng.permutation(400), np.tile(np.eye(3), (400, 1, 1))
    found = in_the_air(Grasps(contacts, contacts[order], turned), TARGET.cloud.xyz)
    assert found.tolist() == (np.maximum(away, away[order]) > 0.02).tolist()


def test_predictions_without_a_table_say_that_it_is_assumed() -> None:
    """Seen at a tilt they are others than with the table."""
    with_table, without = MODEL.predict(TARGET, PLANNED), MODEL.predict(TARGET.cloud, PLANNED)
    assumed = MODEL.predict(Object.of("1", TARGET.cloud, ft.types.ASSUMED_TABLE), PLANNED)
    assert [["assumed_table" in flags for flags in found.flags] for found in (with_table, without, assumed)] == [
        3 * [False], 3 * [True], 3 * [True],
    ]  # fmt: skip
    assert (with_table.value != without.value).any()
    np.testing.assert_array_equal(without.value, assumed.value)


def test_what_a_hand_has_read_at_such_a_grasp_is_refused_by_name(tmp_path: Path) -> None:
    samples = make_samples(2, 12)
    wrong = samples[3].grasp
    turned = ft.Grasp(wrong.g1, wrong.g2, in_the_order_of_graspnet(wrong.rotation[None])[0])
    bad = [*samples[:3], ft.Sample(**{**vars(samples[3]), "grasp": turned}), *samples[4:]]
    rule = "pose: its Z is 90 degrees from g1 - g2, more than 30; the second column is along it"

    def check(error: type[Exception], prefix: str, call: Any) -> None:
        with pytest.raises(error, match=prefix + rule):
            call()

    cases = {
        "touched": (GraspError, "^", lambda: ft.History(MODEL).touched(bad[3].cloud, turned, bad[3].touch)),
        "write": (DatasetError, r"^sample 3 \(campbells/3\): grasp: ", lambda: ft.write(tmp_path / "bad", bad)),
        "fit": (
            DatasetError,
            r"^sample 3 \(campbells/3\): grasp: ",
            lambda: ft.fit(bad, calibrate=False, contact={"trees": 3}),
        ),
    }
    every_case(cases, check)
    assert not (tmp_path / "bad").exists()

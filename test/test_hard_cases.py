# SPDX-License-Identifier: Apache-2.0
"""Each hard case of `test/corpus` is answered right or refused by name: no NaN, no traceback, no warning."""

import re
import tracemalloc
import warnings
from collections.abc import Iterator

import numpy as np
import pytest
from corpus import learning, simulation
from corpus.clouds import MANY, ObjectCase, SceneCase, across, object_cases, scene_cases
from corpus.outcome import check_outcome
from counted_work import calls_at_most
from every_case import every_case

from foretouch.cloud.segmentation.segment import segment
from foretouch.errors import ForetouchError
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.grasp.reach import check_reach
from foretouch.models import available_models, load_model
from foretouch.models.touch_model import TouchModel
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import ASSUMED_TABLE, Cloud, Predictions
from foretouch.types.rotations import check_rotation

OBJECTS = {case.name: case for case in object_cases()}
SCENES = {case.name: case for case in scene_cases()}


@pytest.fixture(autouse=True)
def warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


@pytest.fixture(scope="module", params=sorted(available_models()))
def model(request) -> TouchModel:
    return load_model(request.param)


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return Pipeline(PipelineConfig.from_mapping({"target": {"mode": "all"}}))


def _check_predictions(predictions: Predictions) -> None:
    for prediction in predictions:
        if prediction.status != "ok":
            assert np.isnan(prediction.value.values).all()
            assert prediction.reason
            continue
        vectors = [
            touch.values
            for touch in (prediction.value, prediction.lower, prediction.upper)[: 3 if prediction.calibrated else 1]
        ]
        assert np.isfinite(vectors).all()


def test_plan() -> None:
    def check(case: ObjectCase) -> None:
        configs = (GeoGraspConfig(method=method) for method in ("original", "completed"))
        original, completed = (plan_grasps(case.cloud, case.plane, config) for config in configs)
        for plan, expected, away_m in ((original, case.planned, 0.03), (completed, case.by_default, 0.1)):
            assert plan.reason
            if expected != "ok":
                assert (plan.status, len(plan.grasps)) == ("no_grasp", 0)
                assert re.search(expected, plan.reason), plan.reason
            else:
                assert plan.status in ("ok", "initial_points"), plan.reason
            assert (plan.status == "no_grasp") == (not plan.grasps)
            for grasp in plan.grasps:
                assert np.isfinite(grasp.score) or "score" in plan.reason
                check_rotation(grasp.rotation)
                check_reach(grasp, case.cloud.xyz, 0.2, away_m)
            values = (plan.axis, plan.centroid, plan.initial_points)
            assert all(np.isfinite(value).all() for value in values if value is not None)
            assert not plan.grasps or all(value is not None for value in values)

    every_case(OBJECTS, check)


def test_touch(model) -> None:
    def check(case: ObjectCase) -> None:
        try:
            predictions = model.predict(case.cloud, [case.grasp])
        except ForetouchError as err:
            reason = str(err)
        else:
            _check_predictions(predictions)
            reason = "; ".join(prediction.reason for prediction in predictions if prediction.status != "ok")
        assert re.search(case.predicted, reason) if case.predicted != "ok" else reason == "", reason

    every_case(OBJECTS, check)


def test_segment_and_pipeline_of_a_scene(pipeline) -> None:
    def check(case: SceneCase) -> None:
        found, result = segment(case.cloud), pipeline.run(case.cloud)
        assert found.status == case.segmented, found.reason
        assert re.search(case.reason, found.reason)
        parts = ("not_finite", "out_of_range", "off_ray", "background", "rejected", "flying", "objects")
        assert found.counts["received"] == case.cloud.size == sum(found.counts[name] for name in parts)
        assert min(found.counts.values()) >= 0
        if case.segmented != "ok":
            assert (result.status, result.targets) == (case.segmented, ())
            assert re.search(case.reason, result.reason)
            return
        assert len(found.objects) == 1
        assert np.isfinite(found.table.coefficients).all()
        assert all(
            np.isfinite(object_.cloud.xyz).all() and np.abs(object_.bounds).max() < 2.0 for object_ in found.objects
        )
        assert result.status == "ok", result.reason
        for target in result.targets:
            assert target.predictions
            _check_predictions(list(target.predictions))

    every_case(SCENES, check)


@pytest.mark.parametrize(
    "cases",
    [
        learning.calibration_cases,
        pytest.param(learning.run_cases, marks=pytest.mark.slow),
        simulation.contact_cases,
        simulation.sample_cases,
        pytest.param(simulation.effect_cases, marks=pytest.mark.slow),
    ],
)
def test_outcomes(cases) -> None:
    every_case(cases(), check_outcome)


def test_a_million_points_take_bounded_work_and_memory_and_an_answer_does_not_depend_on_other_grasps(model) -> None:
    cloud = OBJECTS["a million points"].cloud
    assert cloud.size == MANY
    tracemalloc.start()
    with calls_at_most(100_000):  # not for each point
        grasps = plan_grasps(cloud, ASSUMED_TABLE, GeoGraspConfig()).grasps
        assert [one.status for one in model.predict(cloud, grasps)] == ["ok"]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20 * cloud.xyz.nbytes
    cloud, fine, thin = OBJECTS["bar"].cloud, across(), across(0.04)
    alone = {name: model.predict(cloud, [grasp])[0] for name, grasp in (("fine", fine), ("thin", thin))}
    together = model.predict(Cloud(cloud.xyz), [thin, across(1.0), fine, thin])
    assert [one.status for one in together] == ["ok", "bad_grasp", "ok", "ok"]
    for number, name in ((0, "thin"), (2, "fine"), (3, "thin")):
        np.testing.assert_array_equal(alone[name].value.values, together[number].value.values)

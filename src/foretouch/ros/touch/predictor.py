# SPDX-License-Identifier: Apache-2.0
"""Predictions as messages, in the same way for the topic, the service and the action."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from std_msgs.msg import Header

from foretouch.errors import CloudError, ForetouchError, GraspError, ModelError
from foretouch.grasp import GeoGraspConfig, check_closing, surely_closing
from foretouch.grasp.messages import has_orientation
from foretouch.models import TouchModel, load_model
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.report.equal_pressure import flag_equal_pressures
from foretouch.ros.messages.answers import Refusal, TouchAnswer
from foretouch.ros.messages.conversions import duration_to_msg, grasp_to_msg
from foretouch.ros.messages.requests import GraspArrays, RefusalError
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.ros.touch.config import TouchSettings
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.ros.touch.posing import posed_grasps, refusal_of
from foretouch.tactile.description import Sensor
from foretouch.types import ASSUMED_TABLE, LATE, REDUCED, Cloud, Grasp, TouchPredictions
from foretouch.types import TouchPrediction as Prediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status

if TYPE_CHECKING:  # loaded only for a budget
    from foretouch.models.budget import Answer, LatencyBudget

_COUNTS: Final = (1, 10, 100)  # grasps of the requests whose messages are timed


class Predictor:
    """A model that may be absent: every answer then gives the reason. `fallback` is used if it cannot be loaded."""

    def __init__(self, model: str, fallback: str = "") -> None:
        self.model: TouchModel | None = None  # None if neither could be loaded
        self.adapter: OnlineAdapter | None = None  # adapts predictions to tactile readings; None for vision alone
        self.fault = ""  # why `model` could not be loaded
        self.flags: tuple[str, ...] = ()  # of every prediction
        self.budget: LatencyBudget | None = None  # chooses the level of each request
        try:
            self.model = load_model(model)
        except ForetouchError as err:
            self.fault = f"model: {err}"
        if self.model is None and fallback:
            try:
                self.model, self.flags = load_model(fallback), ("fallback_model",)
            except ForetouchError as err:
                self.fault = f"{self.fault}; fallback_model: {err}"
        if self.model is not None:  # predict once, so that the first real cloud does not wait for torch
            pipeline = Pipeline()
            for target in pipeline.segment(warm_up_cloud()).targets:
                self.model.predict(target.cloud, pipeline.plan(target).grasps)

    @property
    def sensor(self) -> Sensor | None:
        """Sensor of the model, whose readings are predicted."""
        return None if self.model is None else self.model.sensor

    def keep_to(self, budget_ms: float, config: TouchSettings, say: Callable[[str], object]) -> None:
        """Answer within a budget from now on, if there is a model; measures this machine."""
        from foretouch.models.budget import LatencyBudget, load_warm, profile_scene

        if self.model is None:
            return
        levels, times = load_warm(self.model)
        around = self._around(levels[-1].model, config, profile_scene(max(_COUNTS)))
        self.budget = LatencyBudget(budget_ms / 1e3, levels, times, around)
        for count in around:
            best = self.budget.affordable(count)
            name = best.name if best else f"none; the fastest is used, {levels[-1].name}"
            say(f"budget: {budget_ms:g} ms for {count} grasps: {name}")

    def _around(self, model: TouchModel, config: TouchSettings, scene: tuple[Cloud, list[Grasp]]) -> dict[int, float]:
        """By number of grasps, the time of their messages: what `answer` takes beyond the prediction, as processor time [s]."""
        from foretouch.models.budget import PAUSE_S

        cloud, grasps = scene
        target, messages, around = FoundObject("", cloud, ASSUMED_TABLE), [grasp_to_msg(one) for one in grasps], {}
        for count in _COUNTS:
            beyond = []
            for _ in range(5):
                time.sleep(PAUSE_S)
                start = time.thread_time()
                model.predict(cloud, grasps[:count], limits=config.limits, reach=config)
                time.sleep(PAUSE_S)
                middle = time.thread_time()
                _ = self.answer([target], messages[:count], Header(), config, model=model).message
                beyond.append(time.thread_time() - middle - (middle - start))
            around[count] = max(0.0, statistics.median(beyond))
        return around

    def end(self, message: TouchAnswer, answer: "Answer | None") -> Any:
        """The `TouchPredictionArray`, or the `TouchPredictionBatch` of arrays, to be published right after this call.

        Its predictions are flagged if they miss their budget, of which `answer` is what `LatencyBudget.begin` returned.
        """
        if self.budget is None or answer is None:
            return message.reply
        if self.budget.is_over(answer) and LATE not in message.flags:
            message.flags += (LATE,)
        made = message.reply
        if self.budget.end(answer) and LATE not in message.flags:  # meanwhile
            message.flags += (LATE,)
            return message.reply
        return made

    def answer(
        self,
        targets: Sequence[FoundObject],
        grasps: Sequence[GraspMsg] | GraspArrays,
        header: Header,
        config: TouchSettings,
        posing: GeoGraspConfig | None = None,
        model: TouchModel | None = None,
    ) -> TouchAnswer:
        """Predict or refuse every grasp, in order.

        Args:
            targets: The objects; features are computed once for each that has grasps.
            grasps: Messages, each on the object that it names, or on the only one; or arrays, which are all on one.
            header: Header of the cloud.
            config: The limits of objects and the hand's reach.
            posing: Settings to compute missing orientations with, on the target's table; None refuses such grasps.
            model: The model in a reduced form; by default the model itself.

        Raises:
            RefusalError: If none of the targets is the object of arrays.
        """
        model = model or self.model
        if isinstance(grasps, GraspArrays):
            try:
                target = targets[_target_of(grasps.object_id, targets)]
            except GraspError as err:
                raise RefusalError(Status.BAD_GRASP, str(err)) from err
            posed = posed_grasps(grasps, target, config, posing)
            rotations = None
            if grasps.rotations is None:
                rotations = np.array([np.zeros((3, 3)) if isinstance(one, Refusal) else one.rotation for one in posed])
            found = self.predict(target.cloud, posed, config, model)
            return TouchAnswer(header, posed, found, sensor=self.sensor, arrays=True, rotations=rotations)
        outcomes: list[Prediction | Refusal] = [Refusal(Status.BAD_GRASP, "")] * len(grasps)
        by_target: dict[int, list[int]] = {}
        for i, grasp in enumerate(grasps):
            try:
                by_target.setdefault(_target_of(grasp.object_id, targets), []).append(i)
            except GraspError as err:
                outcomes[i] = Refusal(Status.BAD_GRASP, str(err))
        for k, members in by_target.items():
            posed = posed_grasps([grasps[i] for i in members], targets[k], config, posing)
            found = self.predict(targets[k].cloud, posed, config, model)
            for i, outcome in zip(members, found, strict=True):
                outcomes[i] = outcome
        if posing is not None:
            grasps = [_as_predicted(*pair) for pair in zip(grasps, outcomes, strict=True)]
        return TouchAnswer(header, grasps, outcomes, sensor=self.sensor)

    def finish(self, message: TouchAnswer, age_s: float, late_after_s: float, *, reduced: bool = False) -> TouchAnswer:
        """Add the model, the age of its input [s] and the resulting flags to each prediction.

        Beyond an age of `late_after_s`, 0 for never, it is `late`; `reduced` is that of a cheaper form of the model.
        """
        message.flags += (*self.flags, *(REDUCED,) * reduced, *(LATE,) * (0.0 < late_after_s < age_s))
        message.age = duration_to_msg(age_s)
        if self.model is not None:
            message.model, message.model_sha256 = self.model.name, self.model.sha256
        return message

    def predict(
        self, cloud: Cloud, posed: Sequence[Grasp | Refusal], config: TouchSettings, model: TouchModel | None = None
    ) -> Sequence[Prediction | Refusal]:
        """Predict for the grasps on one object, adapted to the readings; refusals stay, the model may be a reduced form."""
        model = model or self.model
        if model is None:
            return [Refusal(Status.NO_MODEL, self.fault)] * len(posed)
        usable = [one for one in posed if isinstance(one, Grasp)]
        options: dict[str, Any] = {"limits": config.limits, "reach": config}
        try:
            if not usable:
                found: Sequence[Prediction] = []
            elif self.adapter is not None:
                found = self.adapter.predict(cloud, usable, **options, model=model)
            else:
                found = model.predict(cloud, usable, **options)
        except (CloudError, ModelError) as err:
            return [one if isinstance(one, Refusal) else refusal_of(err) for one in posed]
        outcomes = _outcomes(flag_equal_pressures(found, model))
        if len(usable) == len(posed):
            return outcomes
        predicted = iter(outcomes)
        return [one if isinstance(one, Refusal) else next(predicted) for one in posed]


def _as_predicted(message: GraspMsg, outcome: Prediction | Refusal) -> GraspMsg:
    """The message of a grasp, with the pose that was computed for it."""
    if isinstance(outcome, Refusal) or has_orientation(message):
        return message
    return grasp_to_msg(outcome.grasp, message.status, message.reason)


def _outcomes(predictions: Sequence[Prediction]) -> Sequence[Prediction | Refusal]:
    """The predictions that have a value and whose fingers close along the line of the contacts; else why there is none."""
    if isinstance(predictions, TouchPredictions):
        closing = surely_closing(predictions.grasps)
        if closing.all() and not predictions.refused:
            return predictions
    else:
        closing = surely_closing([one.grasp for one in predictions])
    return [_outcome(*pair) for pair in zip(predictions, closing.tolist(), strict=True)]


def _outcome(prediction: Prediction, closing: bool) -> Prediction | Refusal:
    if prediction.value is None:
        return Refusal(Status.BAD_GRASP if prediction.status == "bad_grasp" else Status.REFUSED, prediction.reason)
    if not closing:  # the constructor of a message makes w = 1, which is an orientation
        try:
            check_closing(prediction.grasp)
        except GraspError as err:
            return refusal_of(err)
    return prediction


def _target_of(object_id: str, targets: Sequence[FoundObject]) -> int:
    """Index of a grasp's target; a single target matches if it or the grasp has no object id."""
    ids = [target.id for target in targets]
    if object_id in ids:
        return ids.index(object_id)
    if len(ids) == 1 and (not object_id or not ids[0]):
        return 0
    raise GraspError(f"object_id: {object_id!r} is not one of {', '.join(map(repr, ids)) or 'the objects'}")

# SPDX-License-Identifier: Apache-2.0
"""Predictions as messages, in the same way for the topic, the service and the action."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.dataset.messages import decode_grasp, decode_grasps, has_orientation
from foretouch.errors import CloudError, ForetouchError, GraspError, LimitError, ModelError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.grasp.reach import ReachConfig
from foretouch.models import TouchModel, load_model
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.ros.messages.answers import Refusal, TouchAnswer, middleware_reads_cdr
from foretouch.ros.messages.conversions import duration_to_msg, grasp_to_msg
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.types import ASSUMED_TABLE, LATE, REDUCED, Cloud, Float64, Grasp
from foretouch.types import TouchPrediction as Prediction
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status

if TYPE_CHECKING:  # loaded only for a budget
    from foretouch.models.budget import Answer, LatencyBudget

_COUNTS: Final = (1, 10, 100)  # grasps of the requests whose messages are timed
_TIMINGS: Final = 5  # of each
_SWITCH_S: Final = 5e-4  # after which a thread gives way to another; Python's 5 ms may be the whole budget


class Predictor:
    """A model that may be absent: every answer then gives the reason.

    Args:
        model: Name or path.
        fallback: Name or path of the model to use if `model` cannot be loaded; "" for none.

    Attributes:
        model: None if neither could be loaded.
        adapter: Adapts predictions to tactile readings; None for vision alone.
        fault: Why `model` could not be loaded; "" if it could.
        flags: Flags of every prediction.
        budget: Chooses the level of each request; None without a budget.
    """

    def __init__(self, model: str, fallback: str = "") -> None:
        self.model: TouchModel | None = None
        self.adapter: OnlineAdapter | None = None
        self.fault = ""
        self.flags: tuple[str, ...] = ()
        self.budget: LatencyBudget | None = None
        self._switch_s = 0.0  # before `keep_to`
        try:
            self.model = load_model(model)
        except ForetouchError as err:
            self.fault = f"model: {err}"
            if fallback:
                self._fall_back(fallback)

    def warm_up(self) -> None:
        """Predict once, so that the first real cloud does not wait for torch."""
        if self.model is not None:
            pipeline = Pipeline()
            for target in pipeline.segment(warm_up_cloud()).targets:
                self.model.predict(target.cloud, pipeline.plan(target).grasps)

    def keep_to(self, budget_ms: float, config: TouchPredictorConfig, say: Callable[[str], None]) -> None:
        """Answer within a budget from now on, if there is a model; measures this machine where there is no profile."""
        from foretouch.models.budget import LatencyBudget, levels_of, load_profile, profile_scene

        if self.model is None:
            return
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(min(self._switch_s, _SWITCH_S))
        levels = levels_of(self.model)
        profile = load_profile(levels, say=say)
        cloud, grasps = profile_scene(1)
        for level in levels:  # each is warm before the first cloud
            level.model.predict(cloud, grasps)
        around = self._around(levels[-1].model, config, profile_scene(max(_COUNTS)))
        self.budget = LatencyBudget(budget_ms / 1e3, levels, profile, around)
        for count in around:
            best = self.budget.affordable(count)
            name = f"none; the fastest is used, {levels[-1].name}" if best is None else best.name
            say(f"budget: {budget_ms:g} ms for {count} grasps: {name}")

    def close(self) -> None:
        """Let threads switch as before `keep_to`."""
        if self._switch_s:
            sys.setswitchinterval(self._switch_s)

    def _around(
        self, model: TouchModel, config: TouchPredictorConfig, scene: tuple[Cloud, list[Grasp]]
    ) -> dict[int, float]:
        """By number of grasps, the time of their messages: what `array` takes beyond the prediction, as processor time [s]."""
        from foretouch.models.budget import PAUSE_S

        cloud, grasps = scene
        target, messages, around = FoundObject("", cloud, ASSUMED_TABLE), [grasp_to_msg(one) for one in grasps], {}
        for count in _COUNTS:
            beyond = []
            for _ in range(_TIMINGS):
                time.sleep(PAUSE_S)
                start = time.thread_time()
                model.predict(cloud, grasps[:count], limits=config.limits, reach=config)
                time.sleep(PAUSE_S)
                middle = time.thread_time()
                _made(self.array([target], messages[:count], Header(), config, model=model), encoded=True)
                beyond.append(time.thread_time() - middle - (middle - start))
            around[count] = max(0.0, statistics.median(beyond))
        return around

    def begin(self, count: int, arrived: float) -> Answer | None:
        """Choose the level of a request of so many grasps that arrived at a `time.monotonic` [s]; None without a budget."""
        return self.budget.begin(count, arrived) if self.budget is not None else None

    def end(self, message: TouchAnswer, answer: Answer | None, *, encoded: bool = False) -> Any:
        """The message to be published right after this call, whose predictions are flagged if they miss their budget.

        Args:
            message: The predictions; their flags are changed.
            answer: What `begin` returned.
            encoded: Whether it may be given as bytes.

        Returns:
            A `TouchPredictionArray`, or its bytes.
        """
        if self.budget is None or answer is None:
            return _made(message, encoded=encoded)
        if self.budget.is_over(answer) and LATE not in message.flags:
            message.flags += (LATE,)
        made = _made(message, encoded=encoded)
        if self.budget.end(answer) and LATE not in message.flags:  # meanwhile
            message.flags += (LATE,)
            if isinstance(made, bytes):
                return message.encoded()
            for prediction in made.predictions:
                prediction.flags = [*prediction.flags, LATE]
        return made

    def _fall_back(self, name: str) -> None:
        try:
            self.model = load_model(name)
            self.flags = ("fallback_model",)
        except ForetouchError as err:
            self.fault = f"{self.fault}; fallback_model: {err}"

    def array(
        self,
        targets: Sequence[FoundObject],
        grasps: Sequence[GraspMsg],
        header: Header,
        config: TouchPredictorConfig,
        posing: GeoGraspConfig | None = None,
        model: TouchModel | None = None,
    ) -> TouchAnswer:
        """Predict or refuse every grasp, in order.

        Args:
            targets: The objects; features are computed once for each that has grasps.
            grasps: Each on the object that it names, or on the only one.
            header: Header of the cloud.
            config: The limits of objects and the hand's reach.
            posing: Settings to compute missing orientations with, on the target's table; None refuses such grasps.
            model: The model in a reduced form; by default the model itself.
        """
        outcomes: list[Prediction | Refusal] = [Refusal(Status.BAD_GRASP, "")] * len(grasps)
        by_target: dict[int, list[int]] = {}
        for i, grasp in enumerate(grasps):
            try:
                by_target.setdefault(_target_of(grasp, targets), []).append(i)
            except GraspError as err:
                outcomes[i] = Refusal(Status.BAD_GRASP, str(err))
        for k, members in by_target.items():
            poser = _Poser(targets[k], config.limits, posing)
            predicted = self._on_target(poser, [grasps[i] for i in members], config, model)
            for i, outcome in zip(members, predicted, strict=True):
                outcomes[i] = outcome
        return TouchAnswer(header, grasps, outcomes)

    def finish(self, message: TouchAnswer, age_s: float, late_after_s: float, *, reduced: bool = False) -> TouchAnswer:
        """Add the model, the age of its input and the resulting flags to each prediction.

        Args:
            message: Changed and returned.
            age_s: Time since the cloud's stamp [s].
            late_after_s: Age beyond which a prediction is `late`; 0 for never [s].
            reduced: Whether a cheaper form of the model predicted.
        """
        cheaper = (REDUCED,) * reduced
        late = (LATE,) if 0.0 < late_after_s < age_s else ()
        message.flags = (*message.flags, *self.flags, *cheaper, *late)
        message.age = duration_to_msg(age_s)
        if self.model is not None:
            message.model, message.model_sha256 = self.model.name, self.model.sha256
        return message

    def _on_target(
        self, poser: _Poser, grasps: Sequence[GraspMsg], config: TouchPredictorConfig, model: TouchModel | None
    ) -> Sequence[Prediction | Refusal]:
        model = model or self.model
        if model is None:
            return [Refusal(Status.NO_MODEL, self.fault)] * len(grasps)
        posed = poser.grasps(grasps)
        usable = [one for one in posed if isinstance(one, Grasp)]
        cloud, limits = poser.target.cloud, config.limits
        try:
            predicted = iter(self._predicted(model, cloud, usable, limits, config) if usable else [])
        except (CloudError, ModelError) as err:
            refusal = _refusal_of(err)
            return [one if isinstance(one, Refusal) else refusal for one in posed]
        return [one if isinstance(one, Refusal) else _outcome(next(predicted)) for one in posed]

    def _predicted(
        self, model: TouchModel, cloud: Cloud, grasps: Sequence[Grasp], limits: ObjectLimits, reach: ReachConfig
    ) -> Sequence[Prediction]:
        if self.adapter is not None:
            return self.adapter.predict(cloud, grasps, limits=limits, reach=reach, model=model)
        return model.predict(cloud, grasps, limits=limits, reach=reach)


class _Poser:
    """Decodes grasps on one object.

    Missing orientations are computed as `Pipeline.grasp_between` does, with one search for the object's axis.
    """

    def __init__(self, target: FoundObject, limits: ObjectLimits, config: GeoGraspConfig | None) -> None:
        self.target = target
        self._limits = limits
        self._config = config
        self._axis: Float64 | None = None

    def grasps(self, messages: Sequence[GraspMsg]) -> list[Grasp | Refusal]:
        """The grasp of each message, or why there is none."""
        return [
            found or self._grasp_or_refusal(one) for found, one in zip(decode_grasps(messages), messages, strict=True)
        ]

    def _grasp_or_refusal(self, message: GraspMsg) -> Grasp | Refusal:
        try:
            return self.grasp(message)
        except (GraspError, CloudError, RefusalError) as err:
            return _refusal_of(err)

    def grasp(self, message: GraspMsg) -> Grasp:
        """The grasp of a message, with an orientation computed if the message has none."""
        if has_orientation(message):
            return decode_grasp(message)
        if self._config is None:
            raise GraspError("pose: no orientation, and no table to compute it with")
        unposed = decode_grasp(message, np.eye(3))
        if self._axis is None:
            self._axis = self._find_axis(self._config)
        return decode_grasp(message, hand_rotation(unposed.g1, unposed.g2, self._axis))

    def _find_axis(self, config: GeoGraspConfig) -> Float64:
        try:
            check_table(self.target.plane, self._limits)
        except LimitError as err:
            raise RefusalError(Status.BAD_PLANE, str(err)) from err
        check_object(self.target.cloud.xyz, self._limits)
        axis, _ = object_axis(self.target.cloud, self.target.plane, config)
        return axis


def _made(message: TouchAnswer, *, encoded: bool) -> Any:
    return message.encoded() if encoded and middleware_reads_cdr() else message.message


def _outcome(prediction: Prediction) -> Prediction | Refusal:
    if prediction.value is not None:
        return prediction
    return Refusal(Status.BAD_GRASP if prediction.status == "bad_grasp" else Status.REFUSED, prediction.reason)


def _refusal_of(err: ForetouchError) -> Refusal:
    return Refusal(_status_of(err), str(err))


def _status_of(err: ForetouchError) -> int:
    """The status of what an error keeps from being predicted."""
    if isinstance(err, RefusalError):
        return err.status
    if isinstance(err, CloudError):
        return Status.BAD_CLOUD if isinstance(err, LimitError) else Status.TOO_FEW_POINTS
    return Status.BAD_GRASP if isinstance(err, GraspError) else Status.REFUSED


def _target_of(grasp: GraspMsg, targets: Sequence[FoundObject]) -> int:
    """Index of a grasp's target; a single target matches if it or the grasp has no object id."""
    ids = [target.id for target in targets]
    if grasp.object_id in ids:
        return ids.index(grasp.object_id)
    if len(ids) == 1 and (not grasp.object_id or not ids[0]):
        return 0
    raise GraspError(f"object_id: {grasp.object_id!r} is none of {', '.join(map(repr, ids)) or 'the objects'}")

# SPDX-License-Identifier: Apache-2.0
"""`object_cloud` + `grasps` -> `touch`, the service `predict_touch` and the action `sample_grasps`, for the sensor of the model.

If a hand sends tactile messages and reports executed grasps, predictions adapt to them (see `online_adapter`): to the
tare, to touches of the current object, and to the readings of the hand before. Call `forget_touches` after changing the
object, and `forget_history` after changing a fingertip. Without tactile messages,
predictions use vision alone.

Service and action run in threads of their own (see `ThreadPool`), beside the worker that answers the topics: the
model is immutable and serves all of them. A model that cannot be loaded does not stop the node: every answer then
gives the reason, and cleaning up and configuring again retries.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET
from foretouch.dataset.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC
from foretouch.errors import TactileError, quoted
from foretouch.grasp import GeoGraspConfig
from foretouch.pipeline import Object
from foretouch.report.equal_pressure import predicted_pressures, scale_of
from foretouch.report.taxel_view import TaxelView
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.messages.markers import touch_markers
from foretouch.ros.messages.requests import (
    GraspArrays,
    Latest,
    RefusalError,
    check_frames,
    passed_on,
    read_arrays,
    read_plane,
    read_targets,
    status_name,
    with_latest,
)
from foretouch.ros.messages.tactile import tactile_class
from foretouch.ros.runtime.lifecycle_node import REQUESTS
from foretouch.ros.runtime.processing_node import ProcessingNode
from foretouch.ros.runtime.workers import ThreadPool
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.grasp_actions import (
    PLANNER_ACTION,
    PLANNER_TYPE,
    Predicted,
    planner_action_class,
    planner_feedback,
    planner_goal,
    planner_result,
    refused_goal,
    sample_grasps,
)
from foretouch.ros.touch.history_keeper import HistoryKeeper
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.ros.touch.predictor import Predictor
from foretouch.tactile.description import require_same
from foretouch.tactile.messages.table import make_reader, stamp_ns
from foretouch.types import ASSUMED_TABLE, UNKNOWN_FRAME
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import (
    ExecutedGrasp,
    Grasp,
    GraspArray,
    Status,
    TablePlane,
    TouchPredictionArray,
    TouchPredictionBatch,
)
from foretouch_msgs.srv import PredictTouch

if TYPE_CHECKING:
    from foretouch.models.budget import Answer

_T = TypeVar("_T")


class TouchPredictorNode(ProcessingNode[TouchPredictorConfig]):
    """Predicts touch (`TouchModel.predict`)."""

    exclusive_topics = ("touch",)

    def __init__(self, **options: Any) -> None:
        super().__init__(
            "touch_predictor", TouchPredictorConfig, [(PointCloud2, CLOUD_TOPIC), (GraspArray, GRASPS_TOPIC)], **options
        )
        self._predictor: Predictor | None = None
        self._adapter: OnlineAdapter | None = None
        self._keeper: HistoryKeeper | None = None
        self._used_tare = self.config.use_tare
        self._threads: ThreadPool | None = None
        self._planner_action: Any = None  # class of the action of MoveIt Task Constructor
        self._tables: dict[int, TablePlane] = {}
        self._latest: Latest | None = None
        self._warned = False  # that no level meets the budget
        self._requests: Counter[str] = Counter()  # by name and status
        self._other_hand = ""  # why readings of the hand are not those of the model's sensor

    def _setup(self) -> None:
        config, closing = self.config, self._closing
        self._planner_action = planner_action_class()
        self._predictor = Predictor(config.model, config.fallback_model)
        closing.callback(self._predictor.close)
        if self._predictor.fault:
            self.get_logger().error(self._predictor.fault)
        if config.latency_budget_ms > 0.0:
            self._predictor.keep_to(config.latency_budget_ms, config, self.get_logger().info)
        self._adapt(self._predictor)
        self._touch = self.advertise(TouchPredictionArray, "touch", keep=True)
        self._markers = self.advertise(MarkerArray, "markers")
        self._threads = ThreadPool(self, 2, 100)  # more threads would only share the processor
        closing.callback(self._threads.close)
        group = ReentrantCallbackGroup()
        self.serve(PredictTouch, "predict_touch", self._predict_touch, group)
        self.serve(Trigger, "forget_touches", partial(self._forget, OnlineAdapter.forget, "touches"), group)
        self.serve(Trigger, "forget_history", partial(self._forget, OnlineAdapter.forget_history, "readings"), group)
        self._offer(
            SampleGrasps,
            "sample_grasps",
            lambda goal: self._sample(goal, goal.request, goal.publish_feedback),
            refused_goal,
        )
        if self._planner_action is not None:
            self._offer(
                self._planner_action, PLANNER_ACTION, self._sample_poses, partial(planner_result, self._planner_action)
            )
        self.subscribe(TablePlane, "table", self._remember_table)
        super()._setup()

    def _offer(self, kind: Any, name: str, work: Callable[[Any], Any], failure: Callable[[RefusalError], Any]) -> None:
        """Make the server of an action, whose goals are worked on in a thread; one with an internal error is aborted."""
        self._closing.callback(
            ActionServer(
                self,
                kind,
                name,
                partial(self._execute, name, work, failure),
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=ReentrantCallbackGroup(),
                goal_service_qos_profile=REQUESTS,
                result_service_qos_profile=REQUESTS,
                cancel_service_qos_profile=REQUESTS,
            ).destroy
        )

    def _teardown(self) -> None:
        self._threads = self._predictor = self._keeper = self._adapter = self._latest = None
        self._tables.clear()

    def errors(self) -> tuple[str, ...]:
        """Why the model could not be loaded, too."""
        fault = (self._predictor.fault,) if self._predictor and self._predictor.fault else ()
        return (*fault, *super().errors())

    def warnings(self) -> tuple[str, ...]:
        """Why the model does not adapt to readings, and whether it is made for another hand than they come from."""
        model, found = self._predictor.model if self._predictor else None, list(super().warnings())
        if model is not None and model.calibration is None:
            reason = next(iter(model.card.get("limits", [])), "its card holds no calibration")
            found.append(f"model {model.name} gives no intervals and does not adapt to readings: {reason}")
        found += [self._other_hand] * bool(self._other_hand)
        if model is not None and model.simulated:
            topic = self.resolve_topic_name(self.config.tactile_topic)
            others = {end.node_name for end in self.get_publishers_info_by_topic(topic)} - {"hand"}
            if others:
                senders = ", ".join(sorted(others))
                found.append(
                    f"model {model.name} is made for the simulated hand only, but {topic} comes from {senders}"
                )
        return tuple(found)

    def notes(self) -> dict[str, str]:
        """The model's name and hash, and the state of online adaptation too."""
        predictor, found = self._predictor, super().notes()
        if predictor is not None and predictor.model is not None:
            found |= {"model": predictor.model.name, "model_sha256": predictor.model.sha256}
            if self._adapter is None:
                found["regime"] = self._other_hand or "none: the model's card holds no calibration"
        for part in (predictor.budget if predictor else None, self._adapter, self._keeper):
            found |= part.notes() if part is not None else {}
        found |= {f"requests.{name}": str(count) for name, count in dict(self._requests).items()}
        return found | ({PLANNER_ACTION: "/".join(PLANNER_TYPE)} if self._planner_action is not None else {})

    def _config_changed(self, config: TouchPredictorConfig) -> None:
        """Touches with and without a tare cannot be combined: a change of `use_tare` forgets them."""
        if config.use_tare != self._used_tare:
            self._used_tare = config.use_tare
            if self._adapter is not None:
                self._adapter.forget()

    # The topic.

    def _answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        cloud, grasps = messages[CLOUD_TOPIC], messages[GRASPS_TOPIC]
        self._remember_cloud(cloud)
        if not grasps.grasps:
            raise passed_on(GRASPS_TOPIC, grasps.status or Status.NO_GRASP, grasps.reason or "grasps: is empty")
        check_frames(GRASPS_TOPIC, grasps.header, header)
        targets = read_targets(cloud, ASSUMED_TABLE, self.config.limits)  # predictions do not use the table
        message, answer = self._predict(targets, grasps.grasps, header, None, self._arrived)
        if grasps.reason.startswith(AMBIGUOUS_TARGET):
            message.flags += (AMBIGUOUS_TARGET,)
        if self._adapter is not None:
            self._adapter.add_grasps(cloud, grasps.grasps)
        self._touch.publish(_configured(self._predictor).end(message, answer))
        if self._markers.wanted:  # the answer is out: an error must not refuse the cloud
            self.internal_errors.guarded("markers", self._draw)(message)
        return message.summary

    def _draw(self, answer: TouchAnswer) -> None:
        """Publish the markers of the first prediction."""
        model = _configured(self._predictor).model
        markers = MarkerArray()
        if model is not None and answer.predictions[0].ok:
            rest, ranges = scale_of(model)
            shown, view = answer.predictions[:1], TaxelView(model.sensor)
            for flag in answer.flags:
                shown = shown.flagged(flag)
            first_at_g1 = self.config.thumb_takes_g1
            markers = touch_markers(shown[0], answer.header, view, ranges, rest, thumb_takes_g1=first_at_g1)
        self._markers.publish(markers)

    def _refuse(self, header: Header, status: int, reason: str) -> None:
        self._touch.publish(TouchPredictionArray(header=header, status=status, reason=reason))

    def _predict(
        self,
        targets: Sequence[Object],
        grasps: Sequence[Any] | GraspArrays,
        header: Header,
        posing: GeoGraspConfig | None,
        arrived: float,
    ) -> "tuple[TouchAnswer, Answer | None]":
        """The predictions of a request that arrived at a time [s], to be published by `Predictor.end`."""
        predictor, config = _configured(self._predictor), self.config
        answer = None if predictor.budget is None else predictor.budget.begin(len(grasps), arrived)
        if answer is not None and not (answer.affordable or self._warned):  # rclpy's own `once` takes 0.5 ms each time
            self._warned = True
            self.get_logger().warning(f"budget: {config.latency_budget_ms:g} ms: no level of the model meets it for "
                       f"{len(grasps)} grasps: the fastest is used, {answer.level.name}")  # fmt: skip
        model, reduced = (None, False) if answer is None else (answer.level.model, answer.reduced)
        message = predictor.answer(targets, grasps, header, config, posing, model)
        age_s = self.age_s(stamp_ns(header.stamp))
        return predictor.finish(message, age_s, config.late_after_s, reduced=reduced), answer

    def _remember_table(self, message: TablePlane) -> None:
        self._tables[stamp_ns(message.header.stamp)] = message
        while len(self._tables) > 16:  # one has the stamp of the latest object_cloud
            del self._tables[next(iter(self._tables))]

    def _frame_flags(self, cloud: Header) -> tuple[str, ...]:
        """The flag of a request whose cloud is in a frame that is not that of the graph's clouds."""
        latest = self._latest
        return () if latest is None or cloud.frame_id == latest.cloud.header.frame_id else (UNKNOWN_FRAME,)

    def _remember_cloud(self, message: PointCloud2 | TargetCloud) -> None:
        if (table := self._tables.get(stamp_ns(message.header.stamp))) is not None:
            self._latest = Latest(message, table)

    # Online adaptation.

    def _adapt(self, predictor: Predictor) -> None:
        """Subscribe to the topics of the hand, if the model has a calibration and is for the sensor of the hand."""
        config, model = self.config, predictor.model
        reader = make_reader(config.tactile)  # wrong settings are reported in any case
        message = tactile_class(config.tactile.message_type)
        self._other_hand = ""
        if model is None or model.calibration is None:
            return
        try:
            require_same(reader.channels, model.sensor.channels, config.tactile_topic)
        except TactileError as err:
            self._other_hand = f"model {model.name} does not adapt to readings: {err}; set tactile.sensor to its sensor"
            self.get_logger().warning(self._other_hand)
            return
        log = self.get_logger()
        self._keeper = HistoryKeeper(
            model, config.hand, config.history_folder, now_ns=self._now_ns, info=log.info, warn=log.warning
        )
        self._closing.callback(self._keeper.close)
        self._adapter = predictor.adapter = OnlineAdapter(
            model, reader, self._keeper, lambda: self.config, self._now_ns, log.warning
        )
        self.subscribe(message, config.tactile_topic, self._adapter.add_tactile, depth=200)  # two seconds of a hand
        self.subscribe(ExecutedGrasp, EXECUTED_TOPIC, self._adapter.add_executed, depth=10)

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _add_requested(self, cloud: PointCloud2 | TargetCloud, grasps: Sequence[Grasp]) -> None:
        """Keep grasps of a request, which may be executed."""
        if self._adapter is not None:
            self._adapter.add_grasps(cloud, grasps, requested=True)

    def _forget(self, forget: Callable[[OnlineAdapter], int], what: str, _request: Any, response: Any) -> Any:
        count = forget(self._adapter) if self._adapter else 0
        response.success, response.message = True, f"{count} {what} forgotten"
        return response

    # The service.

    async def _predict_touch(self, request: Any, response: Any) -> Any:
        try:
            answer = await self._do("predict_touch", partial(self._answer_request, request, time.monotonic()))
        except RefusalError as refusal:
            status, reason = refusal.status, refusal.reason
        except Exception as err:  # noqa: BLE001  the answer names the request's cloud
            status, reason = Status.FAILED, self.internal_errors.report("predict_touch", err)
        else:
            name = "batch" if isinstance(answer, TouchPredictionBatch) else "touch"
            setattr(response, name, answer)
            return response
        refused = {"header": request.cloud.header, "status": status, "reason": reason}
        response.touch, response.batch = TouchPredictionArray(**refused), TouchPredictionBatch(**refused)
        return response

    async def _do(self, name: str, work: Callable[[], _T]) -> _T:
        """Answer a request in a thread, and count its outcome."""
        outcome = Status.FAILED
        try:
            answer = await _configured(self._threads).run(work)
            outcome = Status.OK
        except RefusalError as refusal:
            outcome = refusal.status
            raise
        finally:
            self._requests[f"{name}.{status_name(outcome).lower()}"] += 1
        return answer

    def _answer_request(self, request: Any, arrived: float) -> Any:
        config = self.config
        grasps = read_arrays(request) if len(request.contacts) or len(request.rotations) else request.grasps
        if len(grasps) > config.max_grasps:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: {len(grasps)} is above max_grasps, {config.max_grasps}")
        ids = sorted(grasp.id for grasp in request.grasps if grasp.id)
        if twice := [one for one, other in pairwise(ids) if one == other]:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: id {quoted(twice[0])} occurs twice")
        cloud, planes = with_latest(request.cloud, request.table, self._latest)
        table = read_plane(planes[0]) if planes else None
        targets = read_targets(cloud, table or ASSUMED_TABLE, config.limits)
        if not grasps:
            raise RefusalError(Status.NO_GRASP, "grasps: is empty")
        message, answer = self._predict(targets, grasps, cloud.header, config.grasp if table else None, arrived)
        message.flags += self._frame_flags(cloud.header)
        self._add_requested(cloud, message.answered)  # not before: the same grasp may have been executed already
        return _configured(self._predictor).end(message, answer)

    # The actions.

    def _sample_poses(self, goal_handle: Any) -> Any:
        """Answer a goal of MoveIt Task Constructor on the latest object."""
        goal = planner_goal(goal_handle.request, self.config.max_grasps)
        sampled = self._sample(goal_handle, goal, lambda _: None)
        goal_handle.publish_feedback(planner_feedback(self._planner_action, sampled))
        return planner_result(self._planner_action)

    async def _execute(
        self, name: str, work: Callable[[Any], Any], failure: Callable[[RefusalError], Any], goal_handle: Any
    ) -> Any:
        """The result of work on a goal, which then has succeeded, or was aborted or cancelled."""
        try:
            result = await self._do(name, partial(work, goal_handle))
            end = goal_handle.succeed
        except RefusalError as refusal:
            result, end = failure(refusal), goal_handle.abort
        except Exception as err:  # noqa: BLE001  it would end the process
            reason = self.internal_errors.report(name, err)
            result, end = failure(RefusalError(Status.FAILED, reason)), goal_handle.abort
        if goal_handle.is_cancel_requested:
            end = goal_handle.canceled
        end()
        return result

    def _sample(self, goal_handle: Any, goal: Any, feedback: Callable[[Any], None]) -> Any:
        """Sample grasps for a `SampleGrasps.Goal`."""
        latest, given = self._latest, goal.cloud.width * goal.cloud.height
        sampled = goal.cloud if given or latest is None else latest.cloud
        flags = self._frame_flags(goal.cloud.header) if given else ()
        result = sample_grasps(
            goal,
            latest,
            self.config,
            bytes(goal_handle.goal_id.uuid).hex()[:8],
            self._predict_candidates,
            feedback,
            lambda: goal_handle.is_cancel_requested,
        )
        for prediction in result.predictions:
            prediction.flags = [*prediction.flags, *flags]
        self._add_requested(sampled, result.grasps)
        return result

    def _predict_candidates(self, target: Object, grasps: Sequence[Grasp], header: Header) -> Sequence[Predicted]:
        message, answer = self._predict([target], grasps, header, None, time.monotonic())
        predictor, pressed = _configured(self._predictor), np.full((3, len(grasps), 1), np.nan)
        if (model := predictor.model) is not None:
            pressed = predicted_pressures(message.predictions, model)
        return list(zip(predictor.end(message, answer).predictions, pressed.swapaxes(0, 1), strict=True))


def _configured(part: _T | None) -> _T:
    """A part of the node that exists while it is configured."""
    if part is None:
        raise RefusalError(Status.NO_MODEL, "the node is not configured")
    return part

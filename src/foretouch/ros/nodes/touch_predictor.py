# SPDX-License-Identifier: Apache-2.0
"""`object_cloud` + `grasps` -> `touch`, the service `predict_touch` and the action `sample_grasps`.

If a hand sends tactile messages and reports executed grasps, predictions adapt to them (see `online_adapter`): to the
tare, to touches of the current object, and to the readings of the hand before. Call `forget_touches` after changing the
object, and `forget_history` after changing a fingertip. Without tactile messages,
predictions use vision alone.

Service and action run in threads of their own (see `ThreadPool`), beside the worker that answers the topics: the
model is immutable and serves all of them. A model that cannot be loaded does not stop the node: every answer then
gives the reason, and cleaning up and configuring again retries.

Touch is predicted in the frame of the camera. With `output_frame`, grasps and requests in that frame are brought there,
and everything that is published is brought back (see `output_frame` and `framed_request`).
"""

import threading
import time
from collections.abc import Callable, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any, TypeVar

from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.service import Service
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Plane
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET
from foretouch.grasp import GeoGraspConfig
from foretouch.pipeline import FoundObject, PipelineConfig
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.messages.frames import FrameTransform
from foretouch.ros.messages.markers import touch_markers
from foretouch.ros.messages.requests import (
    RefusalError,
    check_frames,
    check_optical,
    passed_on,
    read_plane,
    read_targets,
)
from foretouch.ros.messages.tactile import tactile_class
from foretouch.ros.runtime.direct import DirectPublisher
from foretouch.ros.runtime.output_frame import OutputFrame
from foretouch.ros.runtime.processing_node import ProcessingNode
from foretouch.ros.runtime.workers import ThreadPool
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.framed_request import FramedRequest, in_cloud_frame
from foretouch.ros.touch.grasp_sampler import GraspSampler, Latest, failed
from foretouch.ros.touch.history_keeper import HistoryKeeper
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.ros.touch.planner_action import PLANNER_ACTION, planner_action_class, planner_feedback, planner_result
from foretouch.ros.touch.predictor import Predictor
from foretouch.tactile.messages import make_reader
from foretouch.tactile.messages.table import stamp_ns
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import (
    ExecutedGrasp,
    Grasp,
    GraspArray,
    Status,
    TablePlane,
    TouchPrediction,
    TouchPredictionArray,
)
from foretouch_msgs.srv import PredictTouch

if TYPE_CHECKING:
    from foretouch.models.budget import Answer

_T = TypeVar("_T")
_PARALLEL_REQUESTS = 2  # more would only share the processor
_TABLES_KEPT = 16  # of which one has the stamp of the latest object_cloud
_TACTILE_DEPTH = 200  # two seconds of a hand's messages
_EXECUTED_DEPTH = 10


class TouchPredictorNode(ProcessingNode[TouchPredictorConfig]):
    """Predicts touch (`TouchModel.predict`)."""

    _touch: DirectPublisher
    _markers: DirectPublisher

    def __init__(self, **options: Any) -> None:
        inputs = [(PointCloud2, CLOUD_TOPIC), (GraspArray, GRASPS_TOPIC)]
        super().__init__("touch_predictor", TouchPredictorConfig, inputs, **options)
        self._predictor: Predictor | None = None
        self._adapter: OnlineAdapter | None = None
        self._keeper: HistoryKeeper | None = None
        self._used_tare = self.config.use_tare
        self._threads: ThreadPool | None = None
        self._answering: list[Service[Any, Any]] = []
        self._actions: list[ActionServer[Any, Any, Any]] = []
        self._planner_action: Any = None  # class of the action of MoveIt Task Constructor
        self._frame: OutputFrame | None = None
        self._tables: dict[int, TablePlane] = {}
        self._latest: Latest | None = None
        self._latest_lock = threading.Lock()
        self._warned = False  # that no level meets the budget

    # Hooks of the base class.

    def _setup(self) -> None:
        self._frame = OutputFrame(self, self.config)
        self._planner_action = planner_action_class(self.config.planner_action_type)
        self._predictor = Predictor(self.config.model, self.config.fallback_model)
        if self._predictor.fault:
            self.get_logger().error(self._predictor.fault)
        self._predictor.warm_up()
        if self.config.latency_budget_ms > 0.0:
            self._predictor.keep_to(self.config.latency_budget_ms, self.config, self._say)
        self._adapt(self._predictor)
        self._touch = self.advertise(TouchPredictionArray, "touch", keep=True)
        self._markers = self.advertise(MarkerArray, "markers")
        self._threads = ThreadPool(self, _PARALLEL_REQUESTS)
        group = ReentrantCallbackGroup()
        self._answering = [
            self.create_service(PredictTouch, "predict_touch", self._predict_touch, callback_group=group),
            self.create_service(Trigger, "forget_touches", self._forget_touches, callback_group=group),
            self.create_service(Trigger, "forget_history", self._forget_history, callback_group=group),
        ]
        self._offer(SampleGrasps, "sample_grasps", self._sample_grasps, failed)
        if self._planner_action is not None:
            self._offer(self._planner_action, PLANNER_ACTION, self._sample_grasp_poses, self._planner_failure)
        self.subscribe(TablePlane, "table", self._remember_table)
        super()._setup()

    def _offer(
        self, kind: Any, name: str, execute: Callable[[Any], Any], failure: Callable[[RefusalError], Any]
    ) -> None:
        """Make the server of an action; a goal with an internal error is aborted."""

        def aborted(arguments: tuple[Any, ...], reason: str) -> Any:
            (goal_handle,) = arguments
            if goal_handle.is_active:
                goal_handle.abort()
            return failure(RefusalError(Status.FAILED, reason))

        self._actions.append(
            ActionServer(
                self,
                kind,
                name,
                self.internal_errors.guarded(name, execute, aborted),
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=ReentrantCallbackGroup(),
            )
        )

    def _teardown(self) -> None:
        for service in self._answering:
            self.destroy_service(service)
        self._answering.clear()
        for action in self._actions:
            action.destroy()
        self._actions.clear()
        if self._frame is not None:
            self._frame.close()
            self._frame = None
        if self._threads is not None:
            self._threads.close()
        if self._predictor is not None:
            self._predictor.close()
        if self._keeper is not None:
            self._keeper.close()
            self._keeper = None
        self._threads = self._predictor = self._adapter = self._latest = None
        self._tables.clear()

    def errors(self) -> tuple[str, ...]:
        """Why the model could not be loaded."""
        return (self._predictor.fault,) if self._predictor and self._predictor.fault else ()

    def notes(self) -> dict[str, str]:
        """The model's name and hash, and the state of online adaptation, for /diagnostics."""
        model = self._predictor.model if self._predictor else None
        known = {"model": model.name, "model_sha256": model.sha256} if model else {}
        if model is not None and self._adapter is None:
            known["regime"] = "none: the model's card holds no calibration"
        adapted = self._adapter.notes() if self._adapter else {}
        budget = self._predictor.budget.notes() if self._predictor and self._predictor.budget else {}
        offered = {PLANNER_ACTION: self.config.planner_action_type} if self._planner_action is not None else {}
        frame = self._frame.notes() if self._frame else {}
        kept = self._keeper.notes() if self._keeper else {}
        return {**super().notes(), **known, **budget, **adapted, **kept, **frame, **offered}

    def _config_changed(self, config: TouchPredictorConfig) -> None:
        if config.use_tare != self._used_tare:
            self._used_tare = config.use_tare
            if self._adapter is not None:
                self._adapter.forget()



    # The topic.

    def _answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        grasps = messages[GRASPS_TOPIC]
        self._remember_cloud(messages[CLOUD_TOPIC])
        if not grasps.grasps:
            raise passed_on(GRASPS_TOPIC, grasps.status or Status.NO_GRASP, grasps.reason or "grasps: is empty")
        transform = self._output().transform(header)
        planned = _in_frame_of(header, grasps, transform)
        targets = read_targets(messages[CLOUD_TOPIC], ASSUMED_TABLE)  # predictions do not use the table
        if isinstance(messages[CLOUD_TOPIC], PointCloud2):  # not of our segmentation in this process
            check_optical(targets, self.config.limits)
        message, answer = self._predict(targets, planned, header, None, self.arrived)
        if grasps.reason.startswith(AMBIGUOUS_TARGET):
            message.flags += (AMBIGUOUS_TARGET,)
        if self._adapter is not None:
            self._adapter.add_grasps(messages[CLOUD_TOPIC], planned)
        published = message
        if transform is not None:
            published = transform.answer(message, None if planned is grasps.grasps else grasps.grasps)
        self._touch.publish(self._loaded().end(published, answer, encoded=True))
        if self._markers.wanted:
            message.flags = published.flags
            self.internal_errors.guarded("markers", self._draw)(message.prediction(0), transform)  # the answer is out
        return message.status, message.reason

    def _draw(self, prediction: TouchPrediction, transform: FrameTransform | None) -> None:
        """Publish the markers of a prediction in the frame of its cloud, brought to that of the answers."""
        touches = self._adapter.touches() if self._adapter else 0
        config = self.config
        markers = touch_markers(prediction, config.ranges, thumb_takes_g1=config.thumb_takes_g1, touches=touches)
        self._markers.publish(markers if transform is None else transform.markers(markers))

    def _refuse(self, header: Header, status: int, reason: str) -> None:
        self._touch.publish(TouchPredictionArray(header=header, status=status, reason=reason))

    def _predict(
        self,
        targets: Sequence[FoundObject],
        grasps: Sequence[Any],
        header: Header,
        posing: GeoGraspConfig | None,
        arrived: float,
    ) -> "tuple[TouchAnswer, Answer | None]":
        """The predictions of a request that arrived at a time [s], to be published by `Predictor.end`."""
        predictor = self._loaded()
        answer = predictor.begin(len(grasps), arrived)
        if answer is not None and not (answer.affordable or self._warned):  # rclpy's own `once` takes 0.5 ms each time
            self._warned = True
            self._warn(f"budget: {self.config.latency_budget_ms:g} ms: no level of the model meets it for "
                       f"{len(grasps)} grasps: the fastest is used, {answer.level.name}")  # fmt: skip
        message = predictor.array(
            targets, grasps, header, self.config, posing, None if answer is None else answer.level.model
        )
        reduced = answer is not None and answer.reduced
        age_s, late_after_s = self.age_s(stamp_ns(header.stamp)), self.config.late_after_s
        return predictor.finish(message, age_s, late_after_s, reduced=reduced), answer

    def _loaded(self) -> Predictor:
        if self._predictor is None:
            raise RefusalError(Status.NO_MODEL, "the node is not configured")
        return self._predictor

    def _output(self) -> OutputFrame:
        if self._frame is None:
            raise RefusalError(Status.NO_MODEL, "the node is not configured")
        return self._frame

    async def _in_thread(self, work: Callable[[], _T]) -> _T:
        if self._threads is None:
            raise RefusalError(Status.NO_MODEL, "the node is not configured")
        return await self._threads.run(work)

    # Online adaptation.

    def _adapt(self, predictor: Predictor) -> None:
        """Subscribe to the topics of the hand, if the model has a calibration."""
        reader = make_reader(self.config.tactile)  # wrong settings are reported in any case
        message = tactile_class(self.config.tactile.type)
        if predictor.model is None or predictor.model.calibration is None:
            return
        self._keeper = HistoryKeeper(
            predictor.model, self.config.hand, self.config.history_folder, say=self._say, warn=self._warn
        )
        self._adapter = predictor.adapter = OnlineAdapter(
            predictor.model,
            reader,
            self._keeper.history,
            config=lambda: self.config,
            now_ns=self._now_ns,
            warn=self._warn,
            on_reading=self._keeper.changed,
        )
        self._keeper.start(self._adapter.locked)
        self.subscribe(message, self.config.tactile_topic, self._adapter.add_tactile, depth=_TACTILE_DEPTH)
        self.subscribe(ExecutedGrasp, EXECUTED_TOPIC, self._adapter.add_executed, depth=_EXECUTED_DEPTH)

    def _add_requested(self, cloud: PointCloud2 | TargetCloud, grasps: Sequence[Grasp]) -> None:
        """Keep grasps of a request, which may be executed."""
        if self._adapter is not None:
            self._adapter.add_grasps(cloud, grasps, requested=True)

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _say(self, text: str) -> None:
        self.get_logger().info(text)

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)

    def _forget_touches(self, _request: Any, response: Any) -> Any:
        count = self._adapter.forget() if self._adapter else 0
        response.success, response.message = True, f"{count} touches forgotten"
        return response

    def _forget_history(self, _request: Any, response: Any) -> Any:
        count = self._adapter.forget_history() if self._adapter else 0
        response.success, response.message = True, f"{count} readings forgotten"
        return response

    # The services.

    async def _predict_touch(self, request: Any, response: Any) -> Any:
        arrived = time.monotonic()
        response.touch = await self._in_thread(lambda: self._response_or_refusal(request, arrived))
        return response

    def _response_or_refusal(self, request: Any, arrived: float) -> TouchPredictionArray:
        header = request.cloud.header
        try:
            return self._answer_request(request, arrived)
        except RefusalError as refusal:
            return TouchPredictionArray(header=header, status=refusal.status, reason=refusal.reason)
        except Exception as err:  # noqa: BLE001  the answer names the request's cloud
            reason = self.internal_errors.report("predict_touch", err)
            return TouchPredictionArray(header=header, status=Status.FAILED, reason=reason)

    def _answer_request(self, request: Any, arrived: float) -> TouchPredictionArray:
        if len(request.grasps) > self.config.max_grasps:
            raise RefusalError(
                Status.BAD_REQUEST, f"grasps: {len(request.grasps)} is above max_grasps, {self.config.max_grasps}"
            )
        asked = self._framed(request.cloud, request.table, request.grasps)
        table = read_plane(asked.table[0]) if asked.table else None
        targets = read_targets(asked.cloud, table or ASSUMED_TABLE)
        check_optical(targets, self.config.limits)
        if not asked.grasps:
            raise RefusalError(Status.NO_GRASP, "grasps: is empty")
        posing = self.config.grasp if table else None
        message, answer = self._predict(targets, asked.grasps, asked.cloud.header, posing, arrived)
        self._add_requested(asked.cloud, asked.grasps)  # not before: the same grasp may have been executed already
        if asked.transform is not None:
            moved = asked.grasps is not request.grasps
            message = asked.transform.answer(message, request.grasps if moved else None)
        made: TouchPredictionArray = self._loaded().end(message, answer)
        return made

    def _framed(self, cloud: PointCloud2, table: Sequence[Plane], grasps: Sequence[Grasp]) -> FramedRequest:
        with self._latest_lock:
            latest = self._latest
        return in_cloud_frame(self._output(), cloud, table, grasps, latest)

    # The actions.

    async def _sample_grasps(self, goal_handle: Any) -> Any:
        def work() -> Any:
            return self._sample(goal_handle, goal_handle.request, goal_handle.publish_feedback)

        return await self._finished(goal_handle, work, failed)

    async def _sample_grasp_poses(self, goal_handle: Any) -> Any:
        """Answer a goal of MoveIt Task Constructor on the latest object."""

        def work() -> Any:
            count = min(self.config.planner_action_count, self.config.max_grasps)
            goal = SampleGrasps.Goal(action_name=goal_handle.request.action_name, count=count)
            sampled = self._sample(goal_handle, goal, lambda _: None)
            goal_handle.publish_feedback(planner_feedback(self._planner_action, sampled))
            return planner_result(self._planner_action)

        return await self._finished(goal_handle, work, self._planner_failure)

    def _planner_failure(self, refusal: RefusalError) -> Any:
        return planner_result(self._planner_action, refusal)

    async def _finished(self, goal_handle: Any, work: Callable[[], Any], failure: Callable[[RefusalError], Any]) -> Any:
        """The result of work on a goal, which then has succeeded, or was aborted or cancelled."""
        try:
            result = await self._in_thread(work)
            end = goal_handle.succeed
        except RefusalError as refusal:
            result, end = failure(refusal), goal_handle.abort
        if goal_handle.is_cancel_requested:
            end = goal_handle.canceled
        end()
        return result

    def _sample(self, goal_handle: Any, goal: Any, feedback: Callable[[Any], None]) -> Any:
        """Sample grasps for a `SampleGrasps.Goal`; result and feedback are in the frame of the answers."""
        with self._latest_lock:
            latest = self._latest
        transform = None
        if goal.cloud.width * goal.cloud.height:
            asked = self._framed(goal.cloud, goal.table, ())
            goal, transform = copy(goal), asked.transform
            goal.cloud, goal.table = asked.cloud, list(asked.table)
        elif latest is not None:
            transform = self._output().transform(latest.cloud.header)
        config = self.config
        settings = PipelineConfig(grasp=config.grasp, limits=config.limits)
        sampler = GraspSampler(self._predict_candidates, settings, config.ranges, config.max_grasps, config.sample_cost)
        result = sampler.sample(
            goal,
            latest,
            feedback if transform is None else lambda message: feedback(transform.sampled(message)),
            lambda: goal_handle.is_cancel_requested,
        )
        own = goal.cloud.width * goal.cloud.height > 0
        self._add_requested(goal.cloud if own or latest is None else latest.cloud, result.grasps)
        return result if transform is None else transform.sampled(result)

    def _predict_candidates(
        self, target: FoundObject, grasps: Sequence[Grasp], header: Header
    ) -> Sequence[TouchPrediction]:
        message, answer = self._predict([target], grasps, header, None, time.monotonic())
        return list(self._loaded().end(message, answer).predictions)

    def _remember_table(self, message: TablePlane) -> None:
        with self._latest_lock:
            self._tables[stamp_ns(message.header.stamp)] = message
            while len(self._tables) > _TABLES_KEPT:
                del self._tables[next(iter(self._tables))]

    def _remember_cloud(self, message: PointCloud2 | TargetCloud) -> None:
        with self._latest_lock:
            table = self._tables.get(stamp_ns(message.header.stamp))
            if table is not None:
                self._latest = Latest(message, table)


def _in_frame_of(cloud: Header, message: GraspArray, transform: FrameTransform | None) -> Sequence[Grasp]:
    """The grasps of a message in the frame of their cloud, or in that of the answers.

    Raises:
        RefusalError: UNKNOWN_FRAME, if they are in another.
    """
    if transform is not None and message.header.frame_id == transform.target:
        back = transform.inverse()
        return [back.grasp(grasp) for grasp in message.grasps]
    check_frames(GRASPS_TOPIC, message.header, cloud)
    return message.grasps

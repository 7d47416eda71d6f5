# SPDX-License-Identifier: Apache-2.0
"""Targets and their grasps -> `touch`, for the sensor of the model.

If a hand sends tactile messages and reports executed grasps, predictions adapt to them (see `online_adapter`): to the
tare, to touches of the current object, and to the readings of the hand before. Call `forget_touches` after changing the
object, and `forget_history` after changing a fingertip. Without tactile messages, predictions use vision alone.

A model that cannot be loaded does not stop the node: every answer then gives the reason, and cleaning up and configuring
again retries.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET
from foretouch.errors import TactileError
from foretouch.grasp import GeoGraspConfig, GraspPlan
from foretouch.models.equal_pressure import scale_of
from foretouch.models.history_keeper import HistoryKeeper
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.conversions import duration_to_msg
from foretouch.ros.messages.markers import touch_markers
from foretouch.ros.messages.requests import RequestedGrasps, Targets
from foretouch.ros.messages.tactile import message_class
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.ros.steps.frames import Frames
from foretouch.ros.steps.online_adapter import OnlineAdapter
from foretouch.ros.steps.predictor import Predictor
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.stream import SELECTED
from foretouch.tactile.description import require_same
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.taxel_view import TaxelView
from foretouch.topics import EXECUTED_TOPIC
from foretouch.types import LATE, UNKNOWN_FRAME, Predictions, stamp_ns
from foretouch.types.scene import Object
from foretouch_msgs.msg import ExecutedGrasp, GraspArray, TouchPredictionArray


class TouchStep(Step):
    """Predicts touch (`TouchModel.predict`) for planned and requested grasps.

    Args:
        node: Publishes and serves; it must be configuring, and its settings are `TouchSettings`.
        frames: Of its results.

    Attributes:
        frames: Of the results.
        latest: The newest objects, for requests without a cloud.
        predictor: The model.
        adapter: Adapts predictions to readings; None for vision alone.
    """

    def __init__(self, node: ForetouchNode[Any], frames: Frames) -> None:
        self._node, self.frames = node, frames
        config: TouchSettings = node.config
        self.latest: Targets | None = None
        self.adapter: OnlineAdapter | None = None
        self._keeper: HistoryKeeper | None = None
        self._other_hand = ""  # why the model's sensor is not the sensor of the hand
        self._used_tare = config.use_tare
        self.predictor = Predictor(config.model, config.fallback_model, config.predictor)
        if self.predictor.fault:
            node.get_logger().error(self.predictor.fault)
        self._adapt()
        self._touch = node.advertise(TouchPredictionArray, "touch", keep=True)
        self._markers = node.advertise(MarkerArray, "markers")

    @property
    def uses_colours(self) -> bool:
        """Whether the model predicts from the colours of the points."""
        return self.predictor.model is not None and self.predictor.model.uses_colours

    def configure(self, config: TouchSettings) -> None:
        """Use other settings; touches with and without a tare cannot be combined, so a change of `use_tare` forgets them."""
        if config.use_tare != self._used_tare:
            self._used_tare = config.use_tare
            if self.adapter is not None:
                self.adapter.forget()

    # The topic.

    def answer_plans(self, targets: Sequence[Object], plans: Sequence[GraspPlan], grasps: GraspArray) -> TouchAnswer:
        """Predict for planned grasps.

        Args:
            targets: The objects.
            plans: Of each target.
            grasps: The message of all plans.
        """
        predict = partial(self.predictor.predict, config=self._node.config)
        parts = list(map(predict, targets, [plan.grasps for plan in plans]))
        answer = TouchAnswer(grasps.header, grasps.grasps, Predictions.join(parts), sensor=self.predictor.sensor)
        return self._end(answer)

    def answer(self, targets: Targets, requested: RequestedGrasps, posing: GeoGraspConfig | None = None) -> TouchAnswer:
        """Predict for requested grasps.

        Args:
            targets: The objects.
            requested: The grasps.
            posing: Settings to compute missing orientations with; None refuses such grasps.
        """
        return self._end(self.predictor.answer(targets, requested, self._node.config, posing))

    def publish(self, answer: TouchAnswer, grasps: GraspArray, targets: Targets) -> None:
        """Publish the answer to planned grasps.

        Args:
            answer: The predictions.
            grasps: The message of the grasps.
            targets: The objects of their cloud.
        """
        stated = (flag for flag in (AMBIGUOUS_TARGET, SELECTED) if grasps.reason.startswith(flag))
        own = {flag for flags in answer.predictions.flags for flag in flags}  # of an object that was segmented here
        answer.flags += tuple(flag for flag in stated if flag not in own)
        self._touch.publish(answer.placed(targets.answered_in).message)
        guarded = self._node.internal_errors.guarded  # the answer is out: an error must not refuse the cloud
        if self.adapter is not None:
            guarded("adaptation", self.adapter.add_grasps)(targets, grasps.grasps)
        if self._markers.get_subscription_count():
            guarded("markers", self._draw)(answer)

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that nothing was predicted, and why."""
        self._touch.publish(TouchPredictionArray(header=header, status=status, reason=reason))

    def add_requested(self, targets: Targets, grasps: Sequence[Any]) -> None:
        """Keep grasps of a request, which may be executed.

        Args:
            targets: The objects of the cloud.
            grasps: On them, as messages or not.
        """
        if self.adapter is not None:
            self.adapter.add_grasps(targets, grasps, requested=True)

    def diagnose(self, report: Report) -> None:
        """Report the model, the state of online adaptation, and why the model does not fit the hand."""
        model, topic = self.predictor.model, self._node.resolve_topic_name(self._node.config.tactile_topic)
        if self.predictor.fault:
            report.errors.append(self.predictor.fault)
        if self._other_hand:
            report.warnings.append(self._other_hand)
        if model is None:
            return
        report.values |= {"model": model.name, "model_sha256": model.sha256}
        if model.calibration is None:
            reason = next(iter(model.card.get("limits", [])), "its card holds no calibration")
            report.warnings.append(f"model {model.name} gives no intervals and does not adapt to readings: {reason}")
        senders = {end.node_name for end in self._node.get_publishers_info_by_topic(topic)} - {"hand"}
        if model.simulated and senders:
            rule = f"made for the simulated hand only, but {topic} comes from {', '.join(sorted(senders))}"
            report.warnings.append(f"model {model.name} is {rule}")
        if self.adapter is None or self._keeper is None:
            report.values["regime"] = self._other_hand or "none: the model's card holds no calibration"
        else:
            report.values |= {"regime": self.predictor.regime} | self.adapter.notes() | self._keeper.notes()

    # Details.

    def _end(self, answer: TouchAnswer) -> TouchAnswer:
        """Add the model, the age of the input and the flags of both.

        The flag `unknown_frame` is for a request whose cloud is in another frame than the clouds of the graph.
        """
        age_s, late_after_s = self._node.age_s(stamp_ns(answer.header.stamp)), self._node.config.late_after_s
        answer.age = duration_to_msg(age_s)
        answer.flags += self.predictor.flags
        if 0.0 < late_after_s < age_s:
            answer.flags += (LATE,)
        if self.latest is not None and answer.header.frame_id != self.latest.header.frame_id:
            answer.flags += (UNKNOWN_FRAME,)
        if (model := self.predictor.model) is not None:
            answer.model, answer.model_sha256 = model.name, model.sha256
        return answer

    def _draw(self, answer: TouchAnswer) -> None:
        """Publish the markers of the first prediction."""
        model = self.predictor.model
        markers = MarkerArray()
        if model is not None and answer.predictions[0].ok:
            rest, ranges = scale_of(model)
            shown, view = answer.predictions[:1], TaxelView(model.sensor)
            for flag in answer.flags:
                shown = shown.flagged(flag)
            first_at_g1 = self._node.config.thumb_takes_g1
            markers = touch_markers(shown[0], answer.header, view, ranges, rest, thumb_takes_g1=first_at_g1)
        self._markers.publish(markers)

    def _adapt(self) -> None:
        """Subscribe to the topics of the hand, if the model has a calibration and is for the sensor of the hand."""
        node, model = self._node, self.predictor.model
        config: TouchSettings = node.config
        reader = make_reader(config.tactile)  # wrong settings are reported in any case
        message = message_class(config.tactile.message_type)
        if model is None or model.calibration is None:
            return
        try:
            require_same(reader.channels, model.sensor.channels, config.tactile_topic)
        except TactileError as err:
            self._other_hand = f"model {model.name} does not adapt to readings: {err}; set tactile.sensor to its sensor"
            node.get_logger().warning(self._other_hand)
            return
        log = node.get_logger()
        self._keeper = HistoryKeeper(
            model, config.hand_name, config.history_folder, now_ns=self._now_ns, info=log.info, warn=log.warning
        )
        node.closing.callback(self._keeper.close)
        self.adapter = self.predictor.adapter = OnlineAdapter(
            model, reader, self._keeper, lambda: node.config, self._now_ns, log.warning
        )
        two_seconds = InputTopic(config.tactile_topic, message, depth=200)
        node.subscribe(two_seconds, self.adapter.add_tactile)
        node.subscribe(InputTopic(EXECUTED_TOPIC, ExecutedGrasp, depth=10), self.adapter.add_executed)

    def _now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

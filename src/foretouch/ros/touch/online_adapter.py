# SPDX-License-Identifier: Apache-2.0
"""What the hand has felt, and predictions that lean on it. No node.

Tactile readings give a tare; a reading, by stamps, of a grasp that the robot tells of as executed is paired with its cloud
exactly as the recorder pairs it, and added to the memory of the object at hand.

Threads: callbacks store, under one lock; who predicts settles first what is complete by then, under another, so that a
touch is taken in before the next prediction and never within a callback.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2

from foretouch.dataset.pairing import (
    CloudBuffer,
    Execution,
    GraspTouchMatcher,
    Interval,
    MatchedGrasp,
    PairingError,
    RejectedGrasp,
    TouchBuffer,
    TouchReading,
)
from foretouch.errors import CloudError, ForetouchError, TactileError
from foretouch.models.touch_model import TouchModel
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.tactile import TactileAdapter
from foretouch.ros.recorder.samples import SampleMaker
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.live_tare import LiveTare
from foretouch.ros.touch.object_memory import ObjectMemory
from foretouch.types import Cloud, Grasp, Touch, TouchPrediction
from foretouch_msgs.msg import ExecutedGrasp
from foretouch_msgs.msg import Grasp as GraspMsg

__all__ = ["OnlineAdapter"]

_MAKER = SampleMaker(object="", note="", others=(), flags=())


class OnlineAdapter:
    """Of one model that has a calibration.

    Args:
        model: Predicts.
        adapter: Reads tactile messages.
        config: Gives the settings now in force.
        now_ns: The node's clock [ns].
        warn: Told of touches that were refused.
    """

    def __init__(
        self,
        model: TouchModel,
        adapter: TactileAdapter,
        config: Callable[[], TouchPredictorConfig],
        now_ns: Callable[[], int],
        warn: Callable[[str], None],
    ) -> None:
        settings = config()
        self._model = model
        self._adapter = adapter
        self._config = config
        self._now_ns = now_ns
        self._warn = warn
        self._inbox = threading.Lock()  # of what callbacks fill; never held while the model works
        self._buffer = TouchBuffer(settings.pairing.kept_s)
        self._tare = LiveTare(settings.contact)
        self._jumps = 0
        self._readings = 0
        self._unreadable = 0
        self._last_unreadable = ""
        self._learning = threading.Lock()  # of the memory; taken before the other one
        self._object = ObjectMemory(model)
        self._outcomes: Counter[str] = Counter()
        self._last_refusal = ""
        self._regime = ""
        self._begin()

    def _begin(self) -> None:
        settings = self._config()
        self._clouds = CloudBuffer(settings.pairing.kept_s, settings.pairing.kept_mb)
        self._book: GraspTouchMatcher[Any] = GraspTouchMatcher(
            self._buffer, self._clouds, settings.pairing, settings.contact
        )

    # What callbacks and the worker store.

    def take_tactile(self, message: Any) -> None:
        """A message of the hand; one that holds no reading is counted."""
        arrived_ns = self._now_ns()
        with self._inbox:
            self._readings += 1
            try:
                reading = self._adapter.read(message)
            except TactileError as err:
                self._unreadable += 1
                self._last_unreadable = str(err)
                return
            stamp = arrived_ns if reading.stamp_ns is None else reading.stamp_ns
            self._buffer.add(TouchReading(stamp, reading.counts, reading.others, arrived_ns))
            if self._buffer.oddities["clock_jump"] != self._jumps:
                self._jumps = self._buffer.oddities["clock_jump"]
                self._tare.forget()
            self._tare.update(stamp, reading.counts, time.monotonic())

    def take_executed(self, message: ExecutedGrasp) -> None:
        """The robot tells of a grasp; one that failed teaches nothing."""
        start, contact, release = (stamp_ns(t) for t in (message.start, message.contact, message.release))
        with self._inbox:
            self._tare.held(contact, release)
            if not self._config().use_touches or not self._readings:
                return
            if not message.success:
                self._outcomes["refused.grasp_failed"] += 1
                return
            interval = Interval(start=start, contact=contact, release=release)
            self._book.tell(Execution(grasp_id=message.grasp_id, interval=interval, success=True), time.monotonic())

    def see(self, cloud: PointCloud2, frame_id: str, grasps: Sequence[GraspMsg]) -> None:
        """Keep a cloud with grasps on it, planned or asked about, where there is a hand that may execute one.

        Args:
            cloud: With a stamp: without one, nothing could tell which cloud a grasp was planned on.
            frame_id: Of the grasps.
            grasps: Those without an id cannot be told of later, and are left out.
        """
        stamp, named = stamp_ns(cloud.header.stamp), [grasp for grasp in grasps if grasp.id]
        if not self._config().use_touches or not self._readings or not stamp or not named:
            return
        data = bytes(serialize_message(cloud))
        with self._inbox:
            plan = self._book.planned(stamp)
            if plan is None:
                for gone in self._clouds.add(stamp, data, time.monotonic()):
                    self._book.forget(gone.stamp_ns)
            known = {} if plan is None else {grasp.id: grasp for grasp in plan.grasps}
            self._book.plan(stamp, frame_id, list({**known, **{grasp.id: grasp for grasp in named}}.values()))

    # What whoever predicts asks for.

    def predict(self, cloud: Cloud, grasps: Sequence[Grasp]) -> list[TouchPrediction]:
        """As of `TouchModel.predict`, leaning on the touches of the object in this cloud, else on a fresh tare.

        Raises:
            CloudError: As of `TouchModel.predict`.
            ModelError: Likewise.
        """
        config = self._config()
        self.settle()
        with self._learning:
            memory = self._object.of(cloud, config.same_object_m) if config.use_touches else None
            if memory is not None:
                return self._noted(self._model.predict(cloud, grasps, memory=memory), memory.tare)
        tare = self._fresh_tare(config)
        return self._noted(self._model.predict(cloud, grasps, tare=tare), tare)

    def settle(self) -> None:
        """Take in the touches that are complete by now, and forget those that are too old."""
        config, now_s = self._config(), time.monotonic()
        with self._learning:
            self._object.expire(now_s, config.forget_after_s)
            with self._inbox:
                results = self._book.poll(now_s) if self._book.pending else []
            for result in results:
                if isinstance(result, RejectedGrasp):
                    self._refuse(result.grasp_id, result.reason, result.message)
                else:
                    self._learn(result, config)

    def forget(self) -> int:
        """Another object is at hand: forget touches, and grasps planned so far; gives the number of touches."""
        with self._learning, self._inbox:
            count = self._object.count
            self._object.forget()
            self._begin()
            return count

    def touches(self) -> int:
        """In memory."""
        return self._object.count

    def notes(self) -> dict[str, str]:
        """For /diagnostics."""
        with self._inbox:
            age_s, fault = self._tare.age_s(time.monotonic()), self._tare.fault
            outcomes = {"waiting": self._book.pending, **self._outcomes}
            words = {
                "tare.fault": fault,
                "touches.last_refusal": self._last_refusal,
                "tactile.last_unreadable": self._last_unreadable,
            }
        return {
            "regime": self._regime,
            "touches": str(self.touches()),
            **{f"touches.{outcome}": str(count) for outcome, count in sorted(outcomes.items())},
            "tare_age_s": "none" if age_s == float("inf") else f"{age_s:.1f}",
            "tactile.received": str(self._readings),
            "tactile.unreadable": str(self._unreadable),
            **{name: text for name, text in words.items() if text},
        }

    # Its own affairs.

    def _fresh_tare(self, config: TouchPredictorConfig) -> Touch | None:
        if not config.use_tare:
            return None
        with self._inbox:
            return self._tare.tare(time.monotonic(), config.tare_max_age_s)

    def _learn(self, linked: MatchedGrasp[Any], config: TouchPredictorConfig) -> None:
        try:
            sample = _MAKER.labelled(linked).sample
            tare, touch = sample.tare if config.use_tare else None, sample.touch
            assert touch is not None  # noqa: S101  a labelled sample has one
            self._object.add(sample.cloud, sample.grasp, touch, tare, time.monotonic(), config.same_object_m)
        except PairingError as err:
            self._refuse(linked.execution.grasp_id, err.reason, str(err))
        except ForetouchError as err:
            reasons = {TactileError: "sensor_fault", CloudError: "bad_cloud"}
            self._refuse(linked.execution.grasp_id, reasons.get(type(err), "refused"), str(err))
        else:
            self._count("taken_in")

    def _refuse(self, grasp_id: str, reason: str, message: str) -> None:
        self._count(f"refused.{reason}")
        self._last_refusal = f"grasp {grasp_id}: {message}"
        self._warn(f"touch of grasp {grasp_id}: refused: {reason}: {message}")

    def _count(self, outcome: str) -> None:
        with self._inbox:
            self._outcomes[outcome] += 1

    def _noted(self, predictions: list[TouchPrediction], tare: Touch | None) -> list[TouchPrediction]:
        """Keep, for /diagnostics, what the first prediction leaned on and which calibration it took."""
        if predictions:
            first = predictions[0]
            regime = ("new" if "unfamiliar" in first.flags else "known") + ("_tare" if tare is not None else "")
            known = self._model.trust is not None and regime in self._model.trust.regimes
            self._regime = f"{first.reference} ({regime}{'' if known else ', which its calibration lacks'})"
        return predictions

# SPDX-License-Identifier: Apache-2.0
"""Online adaptation: predictions that use the tare and the tactile readings of executed grasps. No node.

Tactile messages give a tare. The touch of an executed grasp is assembled exactly as the recorder assembles it. Both are
added to the history of the hand.

Ids of objects are valid within one cloud only. Therefore the current object is identified by its position and size (see
`History.is_current`). A different object that looks the same at the same position cannot be distinguished: after
changing the object, call `forget_touches` or wait for `forget_after_s`.

Threads: callbacks store, under one lock; the thread that predicts first adds the touches that are complete, under
another lock, so that a touch is used in the next prediction and never processed within a callback.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.cloud.messages import decode_objects
from foretouch.dataset.pairing.assembler import AssemblerConfig, SampleAssembler
from foretouch.dataset.pairing.buffers import SerializedCloud
from foretouch.dataset.pairing.matcher import RejectedGrasp
from foretouch.errors import CloudError, ForetouchError, TactileError
from foretouch.grasp.reach import ReachConfig
from foretouch.models.history_keeper import HistoryKeeper
from foretouch.models.touch_model import History, TouchModel
from foretouch.ros.messages.requests import Targets
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.tactile import tdc_of
from foretouch.tactile.dead_taxels import usable
from foretouch.tactile.live_tare import LiveTare
from foretouch.tactile.messages.table import TactileReader
from foretouch.types import Cloud, Float32, Grasp, Plane, Predictions, Sample, Touch, stamp_ns
from foretouch.types.scene import Object
from foretouch_msgs.msg import ExecutedGrasp

_TABLES = 64  # of the latest clouds, which come before the clouds themselves are kept


class OnlineAdapter:
    """Adapts the predictions of one model, which has a calibration.

    Args:
        model: The model.
        reader: Of the model's sensor.
        keeper: Of the history of the hand.
        config: Gives the current settings.
        now_ns: Gives the time of the node's clock [ns].
        warn: Called with a line for each touch that is refused.
    """

    def __init__(
        self,
        model: TouchModel,
        reader: TactileReader,
        keeper: HistoryKeeper,
        config: Callable[[], TouchSettings],
        now_ns: Callable[[], int],
        warn: Callable[[str], object],
    ) -> None:
        settings = config()
        self._model = model
        self._keeper = keeper
        self._history = keeper.history
        self._config = config
        self._now_ns = now_ns
        self._warn = warn
        # Guards what callbacks store; taken after the lock of the history, and never while the model works.
        self._input_lock = threading.Lock()
        self._assembler = SampleAssembler(AssemblerConfig(pairing=settings.pairing, successes_only=True), reader)
        self._tare = LiveTare(reader.channels)
        self._channels = reader.others
        self._valid = reader.sensor.valid_values
        self._others: Float32 | None = None  # of the newest reading, by channel
        self._received = self._unreadable = 0
        self._touch_counts: Counter[str] = Counter()
        self._tare_refused = False
        self._tables: dict[int, Plane] = {}  # of the clouds that were predicted on, by stamp [ns]
        self._texts = {"tare.fault": "", "touches.last_refusal": "", "tactile.last_unreadable": ""}  # for /diagnostics
        self._calibration_group = ""

    # Input, from callbacks and from the worker.

    def add_tactile(self, message: Any) -> None:
        """Add a tactile message; one without a reading is counted."""
        received_ns = self._now_ns()
        with self._input_lock:
            self._received += 1
            jumps = self._assembler.readings.anomalies["clock_jump"]
            try:
                accepted = self._assembler.add_tactile(message, received_ns=received_ns, now_s=time.monotonic())
            except TactileError as err:
                self._unreadable += 1
                self._texts["tactile.last_unreadable"] = str(err)
                return
            if self._assembler.readings.anomalies["clock_jump"] != jumps:
                self._tare.reset()
            for reading in accepted:
                self._tare.update(reading.time_ns, reading.counts, time.monotonic())
                self._others = reading.others

    def add_executed(self, message: ExecutedGrasp) -> None:
        """Add the robot's report of an executed grasp; grasps that failed are refused."""
        with self._input_lock:
            self._tare.exclude(stamp_ns(message.contact), stamp_ns(message.release))
            if self._config().use_touches and self._received:
                self._assembler.add("executed", message, received_ns=0, now_s=time.monotonic())

    def add_grasps(self, targets: Targets, grasps: Sequence[Any], *, requested: bool = False) -> None:
        """Keep a cloud and the grasps on it that have an id, if there is a hand that may execute one.

        Args:
            targets: The objects of the cloud.
            grasps: The grasps, as messages or not.
            requested: Whether a cloud from the topic with the same stamp is used instead, if there is one.
        """
        header = targets.header
        stamp, named = stamp_ns(header.stamp), [grasp for grasp in grasps if grasp.id]
        if not self._config().use_touches or not self._received or not stamp or not named:
            return
        with self._input_lock:
            known = requested and self._assembler.clouds.get(stamp) is not None
        data = b"" if known else bytes(serialize_message(targets.message()))
        with self._input_lock:
            if not known:
                message = SerializedCloud(data, lambda: decode_objects(deserialize_message(data, PointCloud2)))
                self._assembler.add("cloud", message, received_ns=0, now_s=time.monotonic())
            self._assembler.matcher.add_plan(stamp, header.frame_id, named)

    # Output, for the thread that predicts.

    def predict(
        self, target: Object, grasps: Sequence[Grasp], *, limits: ObjectLimits, reach: ReachConfig
    ) -> Predictions:
        """Predict touch, adapted to the readings so far.

        Args:
            target: The object.
            grasps: On the object.
            limits: Of objects.
            reach: Of the hand.
        """
        config, model = self._config(), self._model
        self.process_touches()
        tare = self._recent_tare(config)
        history = self._history_for(target.cloud, tare, config) if config.use_touches else None
        alone = tare if history is None else None
        predictions = model.predict(target, grasps, tare=alone, history=history, limits=limits, reach=reach)
        self._keep_table(target.cloud.stamp_ns, target.plane)
        if predictions:
            first = predictions[0]
            self._calibration_group = f"{first.reference} ({'new' if 'unfamiliar' in first.flags else 'known'})"
        return predictions

    def _keep_table(self, stamp: int, table: Plane) -> None:
        """Keep the table of a cloud for as long as the cloud itself, since a grasp may be executed on it until then."""
        with self._input_lock:
            self._tables[stamp] = table
            while len(self._tables) > _TABLES:
                oldest = next(iter(self._tables))
                if self._assembler.clouds.get(oldest) is not None:
                    return
                del self._tables[oldest]

    def _history_for(self, cloud: Cloud, tare: Touch | None, config: TouchSettings) -> History | None:
        """Copy the readings so far, with a tare of now; None if it is refused, such as after the clock was set back."""
        now_ns, others = self._now_ns(), self._others
        tdc = (
            None
            if others is None
            else tdc_of(dict(zip(self._channels, others.tolist(), strict=True)), self._model.sensor.channels)
        )
        with self._keeper.lock:
            try:
                if tare is not None:
                    self._history.tare(tare, stamp_ns=now_ns, tdc=tdc)
            except TactileError as err:
                if not self._tare_refused:  # not for every cloud
                    self._warn(f"tare: refused: {err}")
                self._tare_refused = True
                return None
            self._tare_refused = False
            same = self._history.is_current(cloud, config.same_object_m)
            snapshot = self._history.snapshot(now_ns, same_object=same, tare=tare is not None, tdc=tdc)
        self._keeper.changed()
        return snapshot

    def process_touches(self) -> None:
        """Add the touches that are complete by now to the history, and forget an object that was touched too long ago."""
        config, now_s = self._config(), time.monotonic()
        with self._keeper.lock:
            if self._history.keep_to_clock(self._now_ns()):
                self._warn("history: the clock was set back: readings that are ahead of it count as taken now")
            age_s = self._history.tracker.evidence(self._now_ns()).touch_age_s
            if age_s is not None and age_s > config.forget_after_s:
                self._history.start_object()
            with self._input_lock:
                results = self._assembler.poll(now_s) if self._assembler.matcher.pending else []
            for result in results:
                if isinstance(result, RejectedGrasp):
                    self._refuse(result.grasp_id, result.reason, result.message)
                else:
                    self._add_touch(result, config)
        if results:
            self._keeper.changed()

    def forget(self) -> int:
        """Forget the object and all grasps so far, since the object was changed; gives the number of its touches."""
        with self._keeper.lock, self._input_lock:
            count = self._history.touches
            self._history.start_object()
            self._assembler.reset_grasps()
            return count

    def forget_history(self) -> int:
        """Forget all readings of the hand, such as after a sensor was exchanged; gives their number."""
        with self._keeper.lock, self._input_lock:
            count = self._history.forget()
            self._assembler.reset_grasps()
        self._keeper.changed()
        return count

    def notes(self) -> dict[str, str]:
        """Make the entries for /diagnostics."""
        with self._input_lock:
            age_s, self._texts["tare.fault"] = self._tare.age_s(time.monotonic()), self._tare.fault
            counts = {"waiting": len(self._assembler.matcher.pending), **self._touch_counts}
            kept = self._assembler.clouds
        return {
            "regime": self._calibration_group,
            "touches": str(self._history.touches),
            "tdc.readings": str(self._history.tracker.tdc_readings),
            "tdc.jumps": str(self._history.tracker.tdc_jumps),
            **{f"touches.{name}": str(count) for name, count in sorted(counts.items())},
            "tare_age_s": "none" if age_s == float("inf") else f"{age_s:.1f}",
            "clouds.kept": str(len(kept)),
            "clouds.kept_mb": f"{kept.bytes / 1e6:.1f}",
            "tactile.received": str(self._received),
            "tactile.unreadable": str(self._unreadable),
            **{name: text for name, text in self._texts.items() if text},
        }

    def _recent_tare(self, config: TouchSettings) -> Touch | None:
        if not config.use_tare:
            return None
        with self._input_lock:
            tare = self._tare.tare(time.monotonic(), config.tare_max_age_s)
            return None if tare is None else self._usable(tare)

    def _usable(self, reading: Touch) -> Touch:
        """Give taxels that the hand's description declares dead the mean of others."""
        return Touch(usable(reading.values, reading.channels, self._valid), reading.channels)

    def _add_touch(self, sample: Sample, config: TouchSettings) -> None:
        assert sample.touch is not None  # noqa: S101  samples without a touch are not asked for
        touch, tare = self._usable(sample.touch), None
        if config.use_tare and sample.tare is not None:
            tare = self._usable(sample.tare)
        try:
            now_ns = self._now_ns()
            extra = sample.extra
            if tare is not None:
                self._history.tare(tare, stamp_ns=now_ns, tdc=tdc_of(extra, tare.channels, "tare_"))
            same = self._history.is_current(sample.cloud, config.same_object_m)
            table = self._tables.get(sample.cloud.stamp_ns)
            estimate = self._history.model.estimate_executed(sample.cloud, [sample.grasp], config.limits, table)
            tdc = tdc_of(extra, touch.channels)
            read = (sample.cloud, sample.grasp, touch)
            self._history.touched(*read, stamp_ns=now_ns, same_object=same, estimate=estimate, tdc=tdc)
        except ForetouchError as err:
            reasons = {TactileError: "sensor_fault", CloudError: "bad_cloud"}
            self._refuse(sample.grasp.id, reasons.get(type(err), "refused"), str(err))
        else:
            with self._input_lock:
                self._touch_counts["taken_in"] += 1

    def _refuse(self, grasp_id: str, reason: str, message: str) -> None:
        with self._input_lock:
            self._touch_counts[f"refused.{reason}"] += 1
            self._texts["touches.last_refusal"] = f"grasp {grasp_id}: {message}"
        self._warn(f"touch of grasp {grasp_id}: refused: {reason}: {message}")

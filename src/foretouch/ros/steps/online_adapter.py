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

from foretouch.dataset.labelling.assembler import AssemblerConfig, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.dataset.labelling.matcher import RejectedGrasp
from foretouch.errors import CloudError, ForetouchError, TactileError
from foretouch.models.history_keeper import HistoryKeeper
from foretouch.models.touch_model import Readings, TouchModel
from foretouch.ros.messages.requests import Targets
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.tactile import tdc_of
from foretouch.tactile.contact_detector import LiveTare
from foretouch.tactile.dead_taxels import usable
from foretouch.tactile.messages.table import TactileReader
from foretouch.types import ASSUMED_TABLE, Cloud, Float32, Sample, Touch, stamp_ns
from foretouch_msgs.msg import ExecutedGrasp


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
        self._texts = {"tare.fault": "", "touches.last_refusal": "", "tactile.last_unreadable": ""}  # for /diagnostics

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
        seen = None if known else SeenObjects.of(targets.objects, stamp)
        with self._input_lock:
            if seen is not None:
                self._assembler.add("cloud", seen, received_ns=0, now_s=time.monotonic())
            self._assembler.matcher.add_plan(stamp, header.frame_id, named)

    # Output, for the thread that predicts.

    def readings_for(self, cloud: Cloud) -> Readings | None:
        """Return what the next prediction on an object is adapted to: touches that are complete by now, and a recent tare.

        Args:
            cloud: Of the object.

        Returns:
            None if nothing is adapted to. If a tare is refused, such as after the clock was set back, that tare alone.
        """
        config = self._config()
        self.process_touches()
        tare = self._recent_tare(config)
        if not config.use_touches:
            return self._after(tare)
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
                return self._after(tare)
            self._tare_refused = False
            same = self._history.is_current(cloud, config.same_object_m)
            readings = self._history.at(now_ns, same_object=same, tared=tare is not None, tdc=tdc)
        self._keeper.changed()
        return readings

    def _after(self, tare: Touch | None) -> Readings | None:
        return None if tare is None else self._model.after_tare(tare)

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
            table = sample.table or ASSUMED_TABLE  # as it was predicted on
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

# SPDX-License-Identifier: Apache-2.0
"""Assembles labelled samples from messages: the recorder, online adaptation, bag import and monitor all use this.

Input are tactile messages, object clouds and their tables, planned grasps, executed grasps and the operator's labels, decoded by rclpy
or by rosbags. Output are samples, or rejected grasps with a reason. Nothing here depends on ROS, and every time is
given by the caller.
"""

from collections import Counter, OrderedDict
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from foretouch.cloud.messages import decode_plane
from foretouch.dataset.labelling.buffers import CloudBuffer, SeenObjects, TouchBuffer
from foretouch.dataset.labelling.cut import PairingConfig, PairingError
from foretouch.dataset.labelling.matcher import (
    ExecutedGrasp,
    GraspTouchMatcher,
    Label,
    MatchedGrasp,
    PlannedGrasps,
    RejectedGrasp,
)
from foretouch.dataset.labelling.sensors import ALIVE, NO_DATA, ContactEpisodes, SensorHealth
from foretouch.errors import CloudError, DatasetError, GraspError
from foretouch.grasp.messages import decode_grasp
from foretouch.tactile.messages.table import TactileReader, TactileReading
from foretouch.types import DISCARDED, Cloud, Float32, Grasp, Outcome, Plane, Sample, stamp_ns
from foretouch.types.scene import Object

Role = Literal["tactile", "cloud", "table", "grasps", "executed"]

_TACTILE_TIMEOUT_S: Final = 1.0
_CLOUD_TIMEOUT_S: Final = 3.0  # a busy scene may give one object cloud a second
_TABLES: Final = 10_000  # of the latest clouds


@dataclass(frozen=True, kw_only=True)
class AssemblerConfig:
    """How samples are assembled."""

    pairing: PairingConfig = PairingConfig()
    object: str = ""  # label of the object on the table; "" becomes `unknown`
    note: str = ""  # for every sample
    unlabelled_s: float | None = None  # minimum time between two samples without a touch, by stamps of clouds [s]
    assume_grasps: bool = False  # whether a contact without a report belongs to the best grasp of the last cloud before
    successes_only: bool = False  # whether grasps that failed after contact are rejected too
    watch_sensors: bool = False  # whether contacts are detected and the sensors' state is followed, which takes time
    colours: bool = True  # whether samples keep the colours of their points, where these have some
    check_clock: bool = True  # whether messages are received live, so that clocks can be compared


class SampleAssembler:
    """Assembles samples of one session; `reader` decodes tactile messages. Not thread-safe."""

    def __init__(self, config: AssemblerConfig, reader: TactileReader) -> None:
        self.config = config
        self.results: Counter[str] = Counter()  # executed grasps: `recorded`, or why they were rejected
        self.rejected_clouds: Counter[str] = Counter()  # no samples without a touch, as `unlabelled <reason>`
        self.invalid: Counter[str] = Counter()  # `taxels_<reason>` that were replaced, `not_read_<finger>` messages
        self.clouds_without_grasps = 0  # that left the buffer without a plan
        self._reader = reader
        self.readings = TouchBuffer(config.pairing.kept_s, reader.channels, reader.others)
        self._episodes = ContactEpisodes(reader.channels)
        self._health = SensorHealth(reader.channels)
        self._last_unlabelled_ns: int | None = None
        self._last_tactile_s = self._last_cloud_s = float("-inf")
        # Stamps from which on an object is on the table [ns], with its label, in order; may be changed.
        self.objects = [(0, config.object)]
        self.reset_grasps()

    def reset_grasps(self) -> None:
        """Forget clouds and all grasps, planned or executed; tactile readings are kept."""
        pairing = self.config.pairing
        self.clouds = CloudBuffer(pairing.kept_s, pairing.kept_mb)
        self._tables: OrderedDict[int, tuple[str, Plane]] = OrderedDict()  # frame and plane, by the stamp of the cloud
        self.matcher = GraspTouchMatcher(
            self.readings,
            self.clouds,
            pairing,
            assume=self.config.assume_grasps,
            successes_only=self.config.successes_only,
        )
        self._labelled_clouds: set[int] = set()
        self._unlabelled: list[Sample] = []

    # State.

    def sensor_states(self, now_s: float) -> dict[str, str]:
        """Return the state by finger, and of the camera: `alive`, `no data`, or the fault."""
        return {**self._health.states, "camera": ALIVE if now_s - self._last_cloud_s <= _CLOUD_TIMEOUT_S else NO_DATA}

    @property
    def held_ns(self) -> int | None:
        """For how long both fingers have touched (see `ContactEpisodes.held_ns`), where `watch_sensors` is set."""
        return self._episodes.held_ns

    def expects_grasp(self, now_s: float) -> bool:
        """Return whether a grasp is being executed, as far as the fingers show, or is not complete yet."""
        return len(self._episodes.touching) > 1 or self.matcher.expects_grasp(now_s)

    # Input.

    def add(self, role: Role, message: Any, *, received_ns: int, now_s: float) -> None:
        """Add a tactile message of the reader's type, `SeenObjects` of a cloud, a `TablePlane`, a `GraspArray` or an `ExecutedGrasp`.

        Args:
            role: What its topic holds.
            message: The message.
            received_ns: When it was received, by the clock of the stamps [ns].
            now_s: Time of a clock that never goes back [s].

        Raises:
            TactileError: If a tactile message holds no reading.
            CloudError: If the numbers of a table are no plane.
        """
        if role == "tactile":
            self.add_tactile(message, received_ns=received_ns, now_s=now_s)
        elif role == "cloud":
            self._last_cloud_s = now_s
            self._remove(self.clouds.add(message, now_s))
        elif role == "table":
            self._add_table(message)
        elif role == "grasps":
            self.matcher.add_plan(stamp_ns(message.header.stamp), message.header.frame_id, message.grasps)
        else:
            self.matcher.add_executed(ExecutedGrasp.from_message(message), now_s)

    def add_tactile(self, message: Any, *, received_ns: int, now_s: float) -> tuple[TactileReading, ...]:
        """Add a tactile message; gives the readings that are accepted now, see `TouchBuffer.add` (raises as `add`).

        One in which a finger was not read is left out, and counted as `invalid`, as are taxels.
        """
        reading = replace(self._reader.read(message), received_ns=received_ns)
        self.invalid.update({f"taxels_{reason}": count for reason, count in reading.invalid.items()})
        if np.isnan(reading.counts).any():
            self._leave_out(reading.counts)
            return ()
        if not self.config.check_clock:
            reading = replace(reading, received_ns=reading.time_ns)
        jumps = self.readings.anomalies["clock_jump"]
        accepted = self.readings.add(reading)
        self._last_tactile_s = now_s
        if self.config.watch_sensors:
            self._health.update(reading.counts)
            if self.readings.anomalies["clock_jump"] != jumps:
                self._episodes.reset()
            for accepted_reading in accepted:
                episode = self._episodes.update(accepted_reading.time_ns, accepted_reading.counts)
                if episode is not None:
                    self.matcher.add_episode(episode, now_s)
        return accepted

    def _add_table(self, message: Any) -> None:
        """Keep the plane of a `TablePlane`, unless it says that there is none."""
        if message.status == 0 and (plane := decode_plane(message.plane)) is not None:
            self._tables[stamp_ns(message.header.stamp)] = message.header.frame_id, plane
            while len(self._tables) > _TABLES:
                self._tables.popitem(last=False)

    def _leave_out(self, counts: Float32) -> None:
        """Count a reading without one of the fingers."""
        self._health.update(counts)
        for finger, columns in self._reader.channels.finger_columns.items():
            self.invalid[f"not_read_{finger}"] += bool(np.isnan(counts[columns]).any())

    # Output.

    def poll(self, now_s: float, *, ending: bool = False) -> list[Sample | RejectedGrasp]:
        """Return the samples, without ids, and rejected grasps that are complete by now; at the end, all."""
        if now_s - self._last_tactile_s > _TACTILE_TIMEOUT_S:
            self._health.silence()
        results: list[Sample | RejectedGrasp] = [*self._unlabelled]
        self._unlabelled.clear()
        for match in self.matcher.poll(now_s, ending=ending):
            result = match if isinstance(match, RejectedGrasp) else self._labelled(match)
            self.results["recorded" if isinstance(result, Sample) else result.reason] += 1
            results.append(result)
        if ending:
            self._remove(self.clouds.clear())
            results += self._unlabelled
            self._unlabelled.clear()
        return results

    def _remove(self, clouds: list[SeenObjects]) -> None:
        """Turn clouds that left the buffer into samples without a touch."""
        every_s = self.config.unlabelled_s
        for cloud in clouds:
            plan, last = self.matcher.forget_plan(cloud.stamp_ns), self._last_unlabelled_ns
            soon = last is not None and abs(cloud.stamp_ns - last) < (every_s or 0.0) * 1e9
            if cloud.stamp_ns in self._labelled_clouds:
                self._labelled_clouds.remove(cloud.stamp_ns)
            elif plan is None:
                self.clouds_without_grasps += 1
            elif every_s is not None and not cloud.ambiguous and not soon:
                try:
                    self._unlabelled.append(self._without_touch(cloud, plan))
                    self._last_unlabelled_ns = cloud.stamp_ns
                except PairingError as err:
                    self.rejected_clouds[f"unlabelled {err.reason}"] += 1

    # Records.

    def _labelled(self, match: MatchedGrasp) -> Sample | RejectedGrasp:
        label, executed = match.label or Label(), match.executed
        try:
            planned = self._planned(match.plan, match.cloud, executed.grasp_id, label.note)
        except PairingError as err:
            return RejectedGrasp(grasp_id=executed.grasp_id, reason=err.reason, message=str(err))
        stated = {"clock_offset_s", *self._reader.temperatures}
        self._labelled_clouds.add(match.cloud.stamp_ns)
        return replace(
            match.sample,
            **planned,
            object=label.object or self._object_at(executed.interval.start if executed.interval else 0),
            stamp_ns=executed.interval.contact if executed.interval else 0,
            extra={name: value for name, value in match.sample.extra.items() if name.removeprefix("tare_") in stated},
            outcome=_outcome(match),
            flags=(*self._reader.flags, *executed.flags, *match.sample.flags, *([DISCARDED] if label.discard else [])),
        )

    def _without_touch(self, cloud: SeenObjects, plan: PlannedGrasps) -> Sample:
        planned = self._planned(plan, cloud, plan.grasps[0].id)
        return Sample(id="", object=self._object_at(cloud.stamp_ns), stamp_ns=cloud.stamp_ns, **planned)

    def _planned(self, plan: PlannedGrasps, cloud: SeenObjects, grasp_id: str, remark: str = "") -> dict[str, Any]:
        """Return what a sample holds besides its touch: the points, the table, the grasps and the note.

        Its table is that of the object, or of a message about its cloud in the same frame. Raises a `PairingError` if the grasp or its
        object is not known.
        """
        grasp, candidates, left_out = _grasps(plan, grasp_id)
        seen = _object_of(cloud, plan.frame_id, grasp)
        points = seen.cloud if self.config.colours or seen.cloud.rgb is None else replace(seen.cloud, rgb=None)
        frame_id, table = self._tables.get(points.stamp_ns, ("", seen.plane))
        return {
            "cloud": points,
            "table": table if seen.plane.assumed and frame_id == points.frame_id else seen.plane,
            "grasp": grasp,
            "candidates": candidates,
            "note": "; ".join(filter(None, (self.config.note, remark, left_out))),
        }

    def _object_at(self, stamp_ns: int) -> str:
        """Return the label of the object on the table at a time, such as when the hand began to close; by default the first."""
        return next((label for since, label in reversed(self.objects) if since <= stamp_ns), "") or "unknown"


def _grasps(plan: PlannedGrasps, wanted: str) -> tuple[Grasp, tuple[Grasp, ...], str]:
    """Return the grasp, the others planned on the same object, and which of these cannot be decoded and why."""
    grasps, faults = [], {}
    for message in plan.grasps:
        try:
            grasps.append(message if isinstance(message, Grasp) else decode_grasp(message))
        except GraspError as err:
            faults[message.id] = str(err)
    grasp = next((planned for planned in grasps if planned.id == wanted), None)
    if wanted in faults:
        raise PairingError("bad_grasp", faults[wanted])
    if grasp is None:
        raise PairingError("grasp_unknown", f"grasp {wanted}: is not among the grasps of its cloud any more")
    others = tuple(planned for planned in grasps if planned.object_id == grasp.object_id and planned.id != wanted)
    return grasp, others, "; ".join(f"candidate {name} left out: {fault}" for name, fault in faults.items())


def _object_of(cloud: SeenObjects, frame_id: str, grasp: Grasp) -> Object:
    """Return the object of a cloud that a grasp in a frame is on; a `PairingError` if it is not known."""
    try:
        objects = cloud.decode()
    except (CloudError, DatasetError) as err:
        raise PairingError("bad_cloud", str(err)) from err
    if objects and objects[0].cloud.frame_id != frame_id:
        raise PairingError("frame_differs", f"cloud in {objects[0].cloud.frame_id!r}, grasps in {frame_id!r}")
    if cloud.by_place and objects:
        return min(objects, key=lambda candidate: _gap(candidate.cloud, grasp))
    object_id = grasp.object_id
    alone = len(objects) == 1  # then it is the object of a grasp without an id too, as for the prediction
    match = [
        candidate for candidate in objects if candidate.id == object_id or (alone and "" in (candidate.id, object_id))
    ]
    if len(match) != 1:
        raise PairingError("object_unknown", f"object {object_id!r} is not in the cloud of {cloud.stamp_ns}")
    return match[0]


def _gap(cloud: Cloud, grasp: Grasp) -> float:
    """Return the distance of the nearest point of an object from the middle of the contacts [m]."""
    apart = cloud.xyz.astype(np.float64) - grasp.midpoint
    return float(np.sqrt((apart * apart).sum(axis=1).min()))


def _outcome(match: MatchedGrasp) -> Outcome:
    """Return the outcome by the operator's label, else by the robot's report."""
    if match.label is not None and match.label.outcome != "unknown":
        return match.label.outcome
    success = match.executed.success
    return "unknown" if success is None else "success" if success else "failure"

# SPDX-License-Identifier: Apache-2.0
"""From contact to counts: the ideal fingertip, then what the sensor adds over time."""

from dataclasses import replace
from typing import Literal, cast

import numpy as np

from foretouch.errors import ContactError
from foretouch.simulation.contact import ContactSolution, PadWindow, solve_contact
from foretouch.simulation.effect import Effect, Job, SampleState, always, called_for, keys
from foretouch.simulation.finger_contact import command_of, contact_failure, contact_problem, pad_of, surface_behind
from foretouch.simulation.fingertip import (
    Finger,
    creep,
    fresh_samples,
    hold,
    kill_electrodes,
    quantise,
    read_contact,
    slip_path,
    temperature_drift,
    wander,
    warming,
    white_noise,
)
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.scene.ranges import draw
from foretouch.simulation.world import SampleKey
from foretouch.types import ELECTRODES, Float64, Touch

_DOWN = np.array([0.0, 0.0, -1.0])


def _mounted(job: Job, state: SampleState) -> None:
    state.sensors = job.world.fingers


def _ideal(job: Job, state: SampleState) -> None:
    fingers = state.sensors
    at_rest = [np.append(finger.pdc_rest, finger.electrode_rest) for finger in fingers]
    touched = [_felt(job, *each) for each in zip(fingers, state.pads, state.contacts, strict=True)]
    state.readings = np.array([at_rest, touched])


def _felt(job: Job, finger: Finger, window: PadWindow, contact: ContactSolution) -> Float64:
    """(25,) PDC and electrodes of one ideal fingertip in contact."""
    config = job.scene.fingers
    reading = read_contact(config.fingertip, pad_of(job.scene, job.item), finger, window, contact)
    return np.append(reading.pdc, reading.electrodes)


def _moments(_job: Job, state: SampleState) -> None:
    state.times, state.load, state.hold_row = np.zeros(2), np.array([0.0, 1.0]), 1
    state.series = state.readings.copy()


def _timeline(job: Job, state: SampleState) -> None:
    """Rest, closing, hold, release; while a finger closes, its counts go straight from rest to hold."""
    config = job.scene.fingers.timeline
    if config is None:
        return
    rest, close, hold = (max(1, round(s * config.rate_hz)) for s in (config.rest_s, config.close_s, config.hold_s))
    ramp = np.arange(1, close) / close
    state.load = np.concatenate([np.zeros(rest), ramp, np.ones(hold), ramp[::-1], np.zeros(rest)])
    state.times = np.arange(len(state.load)) / config.rate_hz
    state.hold_row = rest + len(ramp) + hold - 1
    low, high = state.readings
    state.series = low + state.load[:, None, None] * (high - low)


def _slip(job: Job, state: SampleState) -> None:
    """The object slides down through the fingers during the hold.

    The contact is solved once more where the slip ends, and the readings change from one solution to the other along
    the path.
    """
    config, timeline = job.scene.fingers.slip, job.scene.fingers.timeline
    if config is None or timeline is None:
        return
    in_hold = state.load == 1.0
    path = slip_path(config, int(np.count_nonzero(in_hold)), timeline.rate_hz, job.rng())
    if path[-1] == 0.0:
        return
    moved = np.stack([_felt_after(job, state, k, float(path[-1])) for k in range(2)])
    share = (path / path[-1])[:, None, None]
    state.series[in_hold] += share * (moved - state.readings[1])


def _felt_after(job: Job, state: SampleState, k: int, slid_m: float) -> Float64:
    """(25,) of finger k, the object having slid down by so much across its normal."""
    frame, window, scene = state.touches[k], state.pads[k], job.scene
    across = _DOWN - (_DOWN @ frame.approach) * frame.approach
    length = float(np.linalg.norm(across))
    if length > 0.0:
        frame = replace(frame, origin=frame.origin - slid_m * across / length)
    behind = surface_behind(window, state.bodies[0], frame)
    try:
        problem = contact_problem(scene, job.item, window, behind)
        target = command_of(scene, float(state.targets[k]))
        contact = solve_contact(
            problem, target, "auto" if scene.fidelity == "auto" else _level(scene), scene.fingers.contact
        )
    except ContactError as err:
        raise contact_failure(f"{job.item.name}: after a slip of {slid_m * 1e3:.1f} mm: {err}", err) from err
    return _felt(job, state.sensors[k], window, contact)


def _level(scene: SceneConfig) -> Literal["hertz", "winkler", "layer"]:
    return cast("Literal['hertz', 'winkler', 'layer']", scene.fidelity)


def _creep(job: Job, state: SampleState) -> None:
    config, timeline = job.scene.fingers.creep, job.scene.fingers.timeline
    if config is not None and timeline is not None:
        state.series = creep(config, state.series, timeline.rate_hz)


def _drift(job: Job, state: SampleState) -> None:
    """Rows before contact are as old as the tare; the liquid has warmed on since."""
    config = job.scene.fingers.drift
    if config is None:
        return
    rng = job.rng()
    now, age = draw(rng, config.session_s), draw(rng, config.tare_age_s)
    first = int(np.argmax(state.load > 0.0))
    since = now + age + state.times - state.times[first]
    since[:first] -= age
    pdc, electrodes = temperature_drift(config.temperature, warming(config.temperature, np.maximum(since, 0.0)))
    state.series[..., 0] += pdc[:, None]
    state.series[..., 1:] += electrodes[:, None, None]


def _sessions(job: Job, state: SampleState) -> None:
    """All grasps of one object share a session, tare and touch alike."""
    config, scene = job.scene.fingers.sessions, job.scene
    if config is None:
        return
    session = SampleKey(job.key.seed, job.key.slot % len(scene.objects), 0, job.key.repeat)
    rng = session.stream(job.name, again=job.again)
    state.series[..., 0] += config.pdc_counts * rng.standard_normal(2)
    common, alone = rng.standard_normal((2, 1)), rng.standard_normal((2, ELECTRODES))
    state.series[..., 1:] += config.finger_counts * common + config.electrode_counts * alone


def _noise(job: Job, state: SampleState) -> None:
    config, timeline = job.scene.fingers.noise, job.scene.fingers.timeline
    if config is None:
        return
    rng, rows = job.rng(), len(state.series)
    rate_hz = 1e-9 if timeline is None else timeline.rate_hz  # tare and touch alone are too far apart to share wander
    slow = wander(rows, 2 * ELECTRODES, config.wander_counts, config.wander_s, rate_hz, rng)
    state.series[..., 1:] += white_noise((rows, 2, ELECTRODES), config.electrode_counts, rng)
    state.series[..., 1:] += slow.reshape(rows, 2, ELECTRODES)
    state.series[..., 0] += white_noise((rows, 2), config.pdc_counts, rng)


def _scan(job: Job, state: SampleState) -> None:
    config = job.scene.fingers.scan
    if config is None:
        return
    rng = job.rng()
    for finger in range(2):
        fresh = fresh_samples(config, len(state.series), ELECTRODES, rng)
        state.series[:, finger, 1:] = hold(state.series[:, finger, 1:], fresh)


def _dead(job: Job, state: SampleState) -> None:
    config = job.scene.fingers.dead
    if config is None:
        return
    stuck_at = cast("Literal['low', 'high', 'last']", config.stuck_at)
    for finger, dead in enumerate((config.thumb, config.middle)):
        alive = state.series[:, finger, 1:]
        state.series[:, finger, 1:] = kill_electrodes(alive, [k - 1 for k in dead], stuck_at)


def _counts(job: Job, state: SampleState) -> None:
    """Round and clip; the touch is the last message of the hold, the tare the median of those before contact."""
    pdc, electrodes = quantise(job.scene.fingers.fingertip, state.series[..., 0], state.series[..., 1:])
    first = int(np.argmax(state.load > 0.0))
    row = state.hold_row
    state.touch = _touch(pdc[row], electrodes[row])
    state.tare = _touch(np.median(pdc[:first], axis=0), np.median(electrodes[:first], axis=0))


def _touch(pdc: Float64, electrodes: Float64) -> Touch:
    thumb, middle = electrodes.astype(np.float64)
    return Touch(float(pdc[0]), float(pdc[1]), thumb, middle)


_TIMED = keys("times", "load", "hold_row", "series")
_SERIES = keys("series")

EFFECTS = (
    Effect("sensors", _mounted, always("fingers"), writes=keys("sensors")),
    Effect("fingertip", _ideal, always("fingers"), reads=keys("sensors", "pads", "contacts"), writes=keys("readings")),
    Effect(
        "moments",
        _moments,
        lambda scene, _item: "fingers" if scene.fingers.timeline is None else None,
        off="fingers.timeline makes them",
        reads=keys("readings"),
        writes=_TIMED,
    ),
    Effect(
        "timeline",
        _timeline,
        called_for("fingers.timeline"),
        off="no fingers.timeline",
        reads=keys("readings"),
        writes=_TIMED,
    ),
    Effect(
        "slip",
        _slip,
        called_for("fingers.slip"),
        off="no fingers.slip",
        reads=keys("sensors", "readings", "bodies", "touches", "pads", "targets", "load"),
        modifies=_SERIES,
        again=True,
    ),
    Effect("creep", _creep, called_for("fingers.creep"), off="no fingers.creep", modifies=_SERIES),
    Effect(
        "drift",
        _drift,
        called_for("fingers.drift"),
        off="no fingers.drift",
        reads=keys("times", "load"),
        modifies=_SERIES,
        again=True,
    ),
    Effect("sessions", _sessions, called_for("fingers.sessions"), off="no fingers.sessions", modifies=_SERIES),
    Effect("noise", _noise, called_for("fingers.noise"), off="no fingers.noise", modifies=_SERIES, again=True),
    Effect("scan_hold", _scan, called_for("fingers.scan"), off="no fingers.scan", modifies=_SERIES, again=True),
    Effect("dead_electrodes", _dead, called_for("fingers.dead"), off="no fingers.dead", modifies=_SERIES),
    Effect(
        "counts", _counts, always("fingers"), reads=keys("series", "load", "hold_row"), writes=keys("touch", "tare")
    ),
)

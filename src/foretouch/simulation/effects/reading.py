# SPDX-License-Identifier: Apache-2.0
"""From contact to counts: the ideal fingertip, then what the sensor adds over time."""

from dataclasses import replace

import numpy as np

from foretouch.simulation.contact.grip import solve_contact
from foretouch.simulation.contact.pad import PadWindow
from foretouch.simulation.contact.problem import ContactSolution
from foretouch.simulation.disturbances import (
    PAC_REST,
    VIBRATION_S,
    WANDER_COUNTS,
    WANDER_S,
    CreepConfig,
    NoiseConfig,
    creep,
    mask_dead_electrodes,
    ou_noise,
    scan,
    slip_path,
    temperature_drift,
)
from foretouch.simulation.effect import Effect, Job, SampleState
from foretouch.simulation.effects import campaign
from foretouch.simulation.effects.approach import pad_of, surface_behind
from foretouch.simulation.effects.contact import command_of, contact_problem
from foretouch.simulation.fingertip import Finger, quantise, read_contact
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.scene.fingers import DeadConfig, DriftConfig, TimelineConfig, VibrationConfig
from foretouch.simulation.scene.objects import ObjectConfig
from foretouch.simulation.scene.ranges import draw
from foretouch.simulation.world import SampleKey
from foretouch.tactile import ELECTRODES, biotac_touch
from foretouch.tactile.messages.biotac_all import OTHERS
from foretouch.types import Float64, Touch

_DOWN = np.array([0.0, 0.0, -1.0])

# Standard deviations between the sessions of objects [counts]. Between the eight objects of the public recordings, which have no
# tare, the lower end of PDC varies by 54 and the upper end of the electrodes by 50 to 80. That holds the touches of the objects
# too and so bounds the rest from above; these stay well below, so that an object's mean explains about as much as it does there.
_SESSION_PDC = 20.0
_SESSION_FINGER = 20.0  # of all electrodes of a finger in common
_SESSION_ELECTRODE = 10.0  # of each electrode by itself


def _mounted(job: Job, state: SampleState) -> None:
    state.sensors = job.world.fingers


def _ideal(job: Job, state: SampleState) -> None:
    fingers = state.sensors
    at_rest = [np.append(finger.pdc_rest, finger.electrode_rest) for finger in fingers]
    in_contact = [_reading(job, *each) for each in zip(fingers, state.pads, state.contacts, strict=True)]
    state.readings = np.array([at_rest, in_contact])


def _reading(job: Job, finger: Finger, window: PadWindow, contact: ContactSolution) -> Float64:
    """(25,) PDC and electrodes of one ideal fingertip in contact."""
    return read_contact(pad_of(job.scene, job.item), finger, window, contact)


def _tare_and_touch(_job: Job, state: SampleState) -> None:
    state.times, state.load, state.hold_row = np.zeros(2), np.array([0.0, 1.0]), 1
    state.series = state.readings.copy()


def _timeline(job: Job, state: SampleState) -> None:
    """Rest, closing, hold, release; while a finger closes, its counts go straight from rest to hold."""
    config: TimelineConfig = job.settings
    rest, close, hold = (max(1, round(s * config.rate_hz)) for s in (config.rest_s, config.close_s, config.hold_s))
    ramp = np.arange(1, close) / close
    state.load = np.concatenate([np.zeros(rest), ramp, np.ones(hold), ramp[::-1], np.zeros(rest)])
    state.times, state.slid = np.arange(len(state.load)) / config.rate_hz, np.zeros(len(state.load))
    state.hold_row = rest + len(ramp) + hold - 1
    low, high = state.readings
    state.series = low + state.load[:, None, None] * (high - low)


def _rate_hz(job: Job) -> float:
    timeline = job.scene.fingers.timeline
    return 1e-9 if timeline is None else timeline.rate_hz  # tare and touch alone are too far apart to correlate


def _slip(job: Job, state: SampleState) -> None:
    """The object slides down through the fingers during the hold.

    The contact is solved once more where the slip ends, and the readings change from one solution to the other along
    the path.
    """
    in_hold = state.load == 1.0
    path = slip_path(int(np.count_nonzero(in_hold)), _rate_hz(job), job.rng())
    state.slid[in_hold] = path
    if path[-1] == 0.0:
        return
    moved = np.stack([_reading_after_slip(job, state, k, float(path[-1])) for k in range(2)])
    state.series[in_hold] += (path / path[-1])[:, None, None] * (moved - state.readings[1])


def _reading_after_slip(job: Job, state: SampleState, k: int, slid_m: float) -> Float64:
    """(25,) of finger k, the object having slid down by so much across its normal."""
    frame, window, scene = state.touches[k], state.pads[k], job.scene
    across = _DOWN - (_DOWN @ frame.normal) * frame.normal
    length = float(np.linalg.norm(across))
    if length > 0.0:
        frame = replace(frame, origin=frame.origin - slid_m * across / length)
    problem = contact_problem(scene, job.item, window, surface_behind(window, state.bodies[0], frame))
    contact = solve_contact(problem, command_of(scene, float(state.targets[k])), scene.fidelity)
    return _reading(job, state.sensors[k], window, contact)


def _others(_job: Job, state: SampleState) -> None:
    state.others = np.zeros((len(state.times), 2, len(OTHERS)))


def _needs_others(scene: SceneConfig, item: ObjectConfig) -> str | None:
    return _VIBRATION.reason(scene, item) or campaign.FINGER_TEMPERATURE.reason(scene, item)


def _vibration(job: Job, state: SampleState) -> None:
    """First touch and release shake a fingertip, and so does each slip; the skin damps it."""
    config: VibrationConfig = job.settings
    edges = np.diff(state.load > 0.0, prepend=False)
    slips_m = np.maximum(np.diff(state.slid, prepend=0.0), 0.0)
    struck = config.contact_counts * edges + 1e3 * config.slip_counts_mm * slips_m
    kept = np.exp(-1.0 / (_rate_hz(job) * VIBRATION_S))
    rng, swing = job.rng(), 0.0
    for row, blow in zip(state.others, struck, strict=True):
        swing = max(kept * swing, float(blow))
        row[:, :2] = PAC_REST + np.hypot(config.noise_counts, swing) * rng.standard_normal((2, 2))


def _creep(job: Job, state: SampleState) -> None:
    config: CreepConfig = job.settings
    late = creep(state.series, _rate_hz(job))
    if config.slow_share > 0.0:
        late += creep(state.series, _rate_hz(job), share=config.slow_share, time_s=config.slow_s) - state.series
    state.series = late


def _drift(job: Job, state: SampleState) -> None:
    """Rows before contact are as old as the tare; the liquid has warmed on since."""
    config: DriftConfig = job.settings
    rng = job.rng()
    now, age = draw(rng, config.session_s), draw(rng, config.tare_age_s)
    first = int(np.argmax(state.load > 0.0))
    since = now + age + state.times - state.times[first]
    since[:first] -= age
    state.series += temperature_drift(config.temperature, np.maximum(since, 0.0))[:, None]


def _sessions(job: Job, state: SampleState) -> None:
    """All grasps of one object share a session, tare and touch alike."""
    session = SampleKey(job.key.seed, job.key.slot % len(job.scene.objects), 0, job.key.repeat)
    rng = session.stream(job.effect.name, again=job.effect.again)
    state.series[..., 0] += _SESSION_PDC * rng.standard_normal(2)
    common, single = rng.standard_normal((2, 1)), rng.standard_normal((2, ELECTRODES))
    state.series[..., 1:] += _SESSION_FINGER * common + _SESSION_ELECTRODE * single


def _noise(job: Job, state: SampleState) -> None:
    config: NoiseConfig = job.settings
    rng, rows = job.rng(), len(state.series)
    slow = ou_noise(rows, 2 * ELECTRODES, WANDER_COUNTS, WANDER_S, _rate_hz(job), rng)
    state.series[..., 1:] += config.electrode_counts * rng.standard_normal((rows, 2, ELECTRODES))
    state.series[..., 1:] += slow.reshape(rows, 2, ELECTRODES)
    state.series[..., 0] += config.pdc_counts * rng.standard_normal((rows, 2))


def _scan(job: Job, state: SampleState) -> None:
    rng = job.rng()
    for finger in range(2):
        state.series[:, finger, 1:] = scan(state.series[:, finger, 1:], rng)


def _dead(job: Job, state: SampleState) -> None:
    config: DeadConfig = job.settings
    for finger, dead in enumerate((config.thumb, config.middle)):
        electrodes = state.series[:, finger, 1:]
        state.series[:, finger, 1:] = mask_dead_electrodes(electrodes, [k - 1 for k in dead], config.stuck_at)


def _counts(_job: Job, state: SampleState) -> None:
    """Round and clip; the touch is the last message of the hold, the tare the median of those before contact."""
    counts = quantise(state.series)
    first = int(np.argmax(state.load > 0.0))
    state.touch, state.tare = _touch(counts[state.hold_row]), _touch(np.median(counts[:first], axis=0))


def _touch(counts: Float64) -> Touch:
    thumb, middle = counts.astype(np.float64)
    return biotac_touch(np.hstack([thumb[0], middle[0], thumb[1:], middle[1:]]))


_TIMED = ("times", "load", "hold_row", "series")
_VIBRATION = Effect(
    "vibration", _vibration, "fingers.vibration", reads=("load", "slid"), changes=("others",), again=True
)

EFFECTS = (
    Effect("sensors", _mounted, "fingers", writes=("sensors",)),
    *campaign.MOUNTING,
    Effect("fingertip", _ideal, "fingers", reads=("sensors", "pads", "contacts"), writes=("readings",)),
    Effect(
        "moments",
        _tare_and_touch,
        lambda scene, _item: "fingers" if scene.fingers.timeline is None else None,
        reads=("readings",),
        writes=_TIMED,
        off="fingers.timeline makes them",
    ),
    Effect("timeline", _timeline, "fingers.timeline", reads=("readings",), writes=(*_TIMED, "slid")),
    Effect("other_channels", _others, _needs_others, reads=("times",), writes=("others",), off="no PAC, TAC or TDC"),
    *campaign.DRIFT,
    Effect(
        "slip",
        _slip,
        "fingers.slip",
        reads=("sensors", "readings", "bodies", "touches", "pads", "targets", "load"),
        changes=("series", "slid"),
        again=True,
    ),
    _VIBRATION,
    Effect("creep", _creep, "fingers.creep", changes=("series",)),
    Effect("drift", _drift, "fingers.drift", reads=("times", "load"), changes=("series",), again=True),
    Effect("sessions", _sessions, "fingers.sessions", changes=("series",)),
    Effect("noise", _noise, "fingers.noise", changes=("series",), again=True),
    Effect("scan_hold", _scan, "fingers.scan", changes=("series",), again=True),
    Effect("dead_electrodes", _dead, "fingers.dead", changes=("series",)),
    Effect("counts", _counts, "fingers", reads=("series", "load", "hold_row"), writes=("touch", "tare")),
    *campaign.TARES,
)

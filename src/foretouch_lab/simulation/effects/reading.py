# SPDX-License-Identifier: Apache-2.0
"""From contact to counts: the ideal fingertip, then what the sensor adds over time."""

from dataclasses import replace

import numpy as np

from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.biotac import OTHERS
from foretouch.types import Float64, Int64, Touch
from foretouch.types.channels import Channels
from foretouch_lab.simulation.contact.grip import solve_contact
from foretouch_lab.simulation.contact.pad import ContactFrame
from foretouch_lab.simulation.contact.problem import Command, ContactSolution, skin_slopes, tractions
from foretouch_lab.simulation.effects import campaign
from foretouch_lab.simulation.effects.grasp import command_of, contact_problem, pad_of, surface_behind
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.fingertip import (
    PAC_REST,
    VIBRATION_CONTACT,
    VIBRATION_NOISE,
    VIBRATION_S,
    VIBRATION_SLIP,
    WANDER_COUNTS,
    WANDER_S,
    NoiseConfig,
    creep,
    ou_noise,
    quantise,
    read_contact,
    scan,
    slip_path,
    temperature_drift,
    warming,
)
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.fingers import DeadConfig, DriftConfig, TimelineConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.world import SampleKey, World

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
    at_rest = job.world.array.rest if job.world.array else [finger.rest for finger in state.sensors]
    touched = zip(state.touches, state.relief, state.contacts, strict=True)
    in_contact = [_reading(job, state, k, *each) for k, each in enumerate(touched)]
    state.readings = np.array([at_rest, in_contact])


def _reading(
    job: Job, state: SampleState, k: int, frame: ContactFrame, behind: Float64, contact: ContactSolution
) -> Float64:
    """(V,) values of the ideal fingertip k in contact with a surface that lies so far behind its tangent plane."""
    array, window = job.world.array, state.pads[k]
    if array is None:
        return read_contact(pad_of(job), state.sensors[k], window, contact)
    if contact.force_n == 0.0:
        return np.asarray(array.rest[k])
    problem, friction = contact_problem(job, window, behind), job.item.friction
    closing = state.fingers[k].normal
    force_n = contact.force_n * (frame.normal - closing / float(closing @ frame.normal)) + state.tangential_n[k]
    slopes = skin_slopes(window.depth + contact.displacement[0], problem.step_m)
    return array.read(
        k,
        tractions(
            contact,
            problem.cell_m2,
            slopes,
            force_n @ frame.rotation[:, :2],
            friction,
            lambda less_n: solve_contact(problem, Command(force_n=less_n), job.scene.fidelity).pressure,
        ),
    )


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
    """(V,) of finger k, the object having slid down by so much across its normal."""
    frame, window, scene = state.touches[k], state.pads[k], job.scene
    across = _DOWN - (_DOWN @ frame.normal) * frame.normal
    length = float(np.linalg.norm(across))
    if length > 0.0:
        frame = replace(frame, origin=frame.origin - slid_m * across / length)
    behind = surface_behind(window, state.bodies[0], frame)
    command = command_of(scene, float(state.targets[k]))
    contact = solve_contact(contact_problem(job, window, behind), command, scene.fidelity)
    return _reading(job, state, k, frame, behind, contact)


def _others(_job: Job, state: SampleState) -> None:
    state.others = np.zeros((len(state.times), 2, len(OTHERS)))


def _needs_others(scene: SceneConfig, item: ObjectConfig) -> str | None:
    return _VIBRATION.reason(scene, item) or campaign.FINGER_TEMPERATURE.reason(scene, item)


def _vibration(job: Job, state: SampleState) -> None:
    """First touch and release shake a fingertip, and so does each slip; the skin damps it."""
    edges = np.diff(state.load > 0.0, prepend=False)
    slips_m = np.maximum(np.diff(state.slid, prepend=0.0), 0.0)
    struck = VIBRATION_CONTACT * edges + 1e3 * VIBRATION_SLIP * slips_m
    kept = np.exp(-1.0 / (_rate_hz(job) * VIBRATION_S))
    rng, swing = job.rng(), 0.0
    for row, blow in zip(state.others, struck, strict=True):
        swing = max(kept * swing, float(blow))
        row[:, :2] = PAC_REST + np.hypot(VIBRATION_NOISE, swing) * rng.standard_normal((2, 2))


def _creep(job: Job, state: SampleState) -> None:
    state.series = creep(state.series, _rate_hz(job))


def _drift(job: Job, state: SampleState) -> None:
    """Rows before contact are as old as the tare; the liquid has warmed on since."""
    config: DriftConfig = job.settings
    rng = job.rng()
    now, age = draw(rng, config.session_s), draw(rng, config.tare_age_s)
    first = int(np.argmax(state.load > 0.0))
    since = now + age + state.times - state.times[first]
    since[:first] -= age
    state.series += drift_of(job.world, config, np.maximum(since, 0.0))


def drift_of(world: World, config: DriftConfig, since_s: Float64) -> Float64:
    """(T, 2, V) by how much readings have drifted at times (T,) since the sensors are on [s]."""
    if world.array is not None:
        return np.asarray(warming(config.temperature, since_s)[:, None, None] * world.array.kelvin)
    return np.asarray(temperature_drift(config.temperature, since_s)[:, None])


def _crosstalk(job: Job, state: SampleState) -> None:
    assert job.world.array is not None  # noqa: S101  # the settings are of arrays alone
    state.series = job.world.array.with_crosstalk(state.series, job.settings)


def _sessions(job: Job, state: SampleState) -> None:
    """All grasps of one object share a session, tare and touch alike."""
    session = SampleKey(job.key.seed, job.key.slot % len(job.scene.objects), 0, job.key.repeat)
    rng = session.stream(job.effect.name, again=job.effect.again)
    if job.world.array:
        state.series += job.world.array.session(rng)
        return
    state.series[..., 0] += _SESSION_PDC * rng.standard_normal(2)
    common, single = rng.standard_normal((2, 1)), rng.standard_normal((2, ELECTRODES))
    state.series[..., 1:] += _SESSION_FINGER * common + _SESSION_ELECTRODE * single


def _noise(job: Job, state: SampleState) -> None:
    config: NoiseConfig = job.settings
    rng, rows = job.rng(), len(state.series)
    if job.world.array:
        state.series += job.world.array.noise(rows, rng)
        return
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
        state.series[:, finger, list(dead)] = 0.0  # column 0 is PDC


def _counts(job: Job, state: SampleState) -> None:
    """Round and clip; the touch is the last message of the hold, the tare the median of those before contact."""
    world = job.world
    rows = world.array.quantise(state.series) if world.array else quantise(state.series)
    first = int(np.argmax(state.load > 0.0))
    state.touch = _touch(world.channels(), rows[state.hold_row])
    state.tare = _touch(world.channels(), np.median(rows[:first], axis=0))


def _touch(channels: Channels, fingers: Float64 | Int64) -> Touch:
    values = np.empty(channels.size)
    for columns, finger in zip(channels.finger_columns.values(), fingers, strict=True):
        values[columns] = finger
    return Touch(values, channels)


_TIMED = ("times", "load", "hold_row", "series")
_VIBRATION = Effect(
    "vibration", _vibration, "fingers.vibration", reads=("load", "slid"), changes=("others",), again=True
)

EFFECTS = (
    Effect("sensors", _mounted, "fingers", writes=("sensors",)),
    *campaign.MOUNTING,
    Effect(
        "fingertip",
        _ideal,
        "fingers",
        reads=("sensors", "fingers", "pads", "touches", "relief", "contacts", "tangential_n"),
        writes=("readings",),
    ),
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
        reads=("sensors", "readings", "bodies", "fingers", "touches", "pads", "targets", "tangential_n", "load"),
        changes=("series", "slid"),
        again=True,
    ),
    _VIBRATION,
    Effect("crosstalk", _crosstalk, "fingers.crosstalk", changes=("series",)),
    Effect("creep", _creep, "fingers.creep", changes=("series",)),
    Effect("drift", _drift, "fingers.drift", reads=("times", "load"), changes=("series",), again=True),
    Effect("sessions", _sessions, "fingers.sessions", changes=("series",)),
    Effect("noise", _noise, "fingers.noise", changes=("series",), again=True),
    Effect("scan_hold", _scan, "fingers.scan", changes=("series",), again=True),
    Effect("dead_electrodes", _dead, "fingers.dead", changes=("series",)),
    Effect("counts", _counts, "fingers", reads=("series", "load", "hold_row"), writes=("touch", "tare")),
    *campaign.TARES,
)

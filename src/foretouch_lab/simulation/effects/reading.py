# SPDX-License-Identifier: Apache-2.0
"""From contact to counts: the ideal fingertip, then what the sensor adds over time.

In a campaign also when a grasp is executed, which sensors are mounted, and how their levels drifted.
"""

from dataclasses import replace

import numpy as np

from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.biotac import OTHERS
from foretouch.types import Float64, Int64, Touch
from foretouch.types.channels import Channels
from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.contact.grip import solve_contact
from foretouch_lab.simulation.contact.pad import ContactFrame
from foretouch_lab.simulation.contact.problem import Command, ContactSolution, skin_slopes, tractions
from foretouch_lab.simulation.effects.grasp import command_of, contact_problem, pad_of, surface_behind
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.campaign import CONTACT_S, WarmUpConfig
from foretouch_lab.simulation.scene.fingers import DeadConfig, TimelineConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.world import Campaign, SampleKey, World

_DOWN = np.array([0.0, 0.0, -1.0])
_CONTACT_HZ = 1.0  # in a campaign without a timeline, the touch is read a second after contact

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
    """Return (V,) values of the ideal fingertip k in contact with a surface that lies so far behind its tangent plane."""
    array, window = job.world.array, state.pads[k]
    if array is None:
        return fingertip.read_contact(pad_of(job), state.sensors[k], window, contact)
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
    state.hold_row, (low, high) = 1, state.readings
    start(state, np.zeros(2), np.array([0.0, 1.0]), low, high)


def start(state: SampleState, times: Float64, load: Float64, low: Float64, high: Float64) -> None:
    """Start with messages that go from `low` to `high` with the load; nothing else is added yet.

    Args:
        state: Of the sample.
        times: (T,) of the messages [s].
        load: (T,) from 0 without contact to 1 in full contact.
        low: (2, V) values without contact.
        high: (2, V) values in full contact.
    """
    state.times, state.load = times, load
    state.series = low + load[:, None, None] * (high - low)
    state.others = np.zeros((len(load), 2, len(OTHERS)))
    state.level = np.zeros((len(load), 2, 1 + ELECTRODES))


def _timeline(job: Job, state: SampleState) -> None:
    """Rest, closing, hold, release; while a finger closes, its counts go straight from rest to hold."""
    config: TimelineConfig = job.settings
    rest, close, hold = (max(1, round(s * config.rate_hz)) for s in (config.rest_s, config.close_s, config.hold_s))
    ramp = np.arange(1, close) / close
    load = np.concatenate([np.zeros(rest), ramp, np.ones(hold), ramp[::-1], np.zeros(rest)])
    state.hold_row, (low, high) = rest + len(ramp) + hold - 1, state.readings
    start(state, np.arange(len(load)) / config.rate_hz, load, low, high)


def _rate_hz(job: Job) -> float:
    timeline = job.scene.fingers.timeline
    return 1e-9 if timeline is None else timeline.rate_hz  # tare and touch alone are too far apart to correlate


def _slip(job: Job, state: SampleState) -> None:
    """Let the object slide down through the fingers during the hold.

    The contact is solved once more where the slip ends, and the readings change from one solution to the other along
    the path.
    """
    in_hold = state.load == 1.0
    path = fingertip.slip_path(int(np.count_nonzero(in_hold)), _rate_hz(job), job.rng())
    if path[-1] == 0.0:
        return
    moved = np.stack([_reading_after_slip(job, state, k, float(path[-1])) for k in range(2)])
    state.series[in_hold] += (path / path[-1])[:, None, None] * (moved - state.readings[1])


def _reading_after_slip(job: Job, state: SampleState, k: int, slid_m: float) -> Float64:
    """Return (V,) of finger k, the object having slid down by so much across its normal."""
    frame = state.touches[k]
    window = state.pads[k]
    scene = job.scene
    across = _DOWN - (_DOWN @ frame.normal) * frame.normal
    length = float(np.linalg.norm(across))
    if length > 0.0:
        frame = replace(frame, origin=frame.origin - slid_m * across / length)
    behind = surface_behind(window, state.bodies[0], frame)
    command = command_of(scene, state.target)
    contact = solve_contact(contact_problem(job, window, behind), command, scene.fidelity)
    return _reading(job, state, k, frame, behind, contact)


def _creep(job: Job, state: SampleState) -> None:
    state.series = fingertip.creep(state.series, _rate_hz(job))


def _drift(job: Job, state: SampleState) -> None:
    """Add the drift: rows before contact are as old as the tare, and the liquid has warmed on since."""
    rng = job.rng()
    now, age = draw(rng, fingertip.SESSION_S), draw(rng, fingertip.TARE_AGE_S)
    first = int(np.argmax(state.load > 0.0))
    since = now + age + state.times - state.times[first]
    since[:first] -= age
    state.series += drift_of(job.world, np.maximum(since, 0.0))


def drift_of(world: World, since_s: Float64) -> Float64:
    """Return (T, 2, V) by how much readings have drifted at times (T,) since the sensors are on [s]."""
    if world.array is not None:
        return np.asarray(fingertip.warming(since_s)[:, None, None] * world.array.kelvin)
    return np.asarray(fingertip.temperature_drift(fingertip.warming(since_s))[:, None])


def _crosstalk(job: Job, state: SampleState) -> None:
    assert job.world.array is not None  # noqa: S101  # the settings are of arrays alone
    state.series = job.world.array.with_crosstalk(state.series)


def _sessions(job: Job, state: SampleState) -> None:
    """Shift all grasps of one object by the rest levels of their session, tare and touch alike."""
    session = SampleKey(job.key.seed, job.key.slot % len(job.scene.objects), 0, job.key.repeat)
    rng = session.stream(job.effect.name, again=job.effect.again)
    if job.world.array:
        state.series += job.world.array.session(rng)
        return
    state.series[..., 0] += _SESSION_PDC * rng.standard_normal(2)
    common, single = rng.standard_normal((2, 1)), rng.standard_normal((2, ELECTRODES))
    state.series[..., 1:] += _SESSION_FINGER * common + _SESSION_ELECTRODE * single


def _noise(job: Job, state: SampleState) -> None:
    rng, rows = job.rng(), len(state.series)
    if job.world.array:
        state.series += job.world.array.noise(rows, rng)
        return
    slow = fingertip.ou_noise(rows, 2 * ELECTRODES, fingertip.WANDER_COUNTS, fingertip.WANDER_S, _rate_hz(job), rng)
    state.series[..., 1:] += fingertip.NOISE_ELECTRODE * rng.standard_normal((rows, 2, ELECTRODES))
    state.series[..., 1:] += slow.reshape(rows, 2, ELECTRODES)
    state.series[..., 0] += fingertip.NOISE_PDC * rng.standard_normal((rows, 2))


def _scan(job: Job, state: SampleState) -> None:
    rng = job.rng()
    for finger in range(2):
        state.series[:, finger, 1:] = fingertip.scan(state.series[:, finger, 1:], rng)


def _dead(job: Job, state: SampleState) -> None:
    config: DeadConfig = job.settings
    for finger, dead in enumerate((config.thumb, config.middle)):
        state.series[:, finger, list(dead)] = 0.0  # column 0 is PDC


def _counts(job: Job, state: SampleState) -> None:
    """Round and clip; the touch is the last message of the hold, the tare the median of those before contact."""
    world = job.world
    rows = world.array.quantise(state.series) if world.array else fingertip.quantise(state.series)
    first = int(np.argmax(state.load > 0.0))
    state.touch = _touch(world.channels(), rows[state.hold_row])
    state.tare = _touch(world.channels(), np.median(rows[:first], axis=0))


def _touch(channels: Channels, fingers: Float64 | Int64) -> Touch:
    values = np.empty(channels.size)
    for columns, finger in zip(channels.finger_columns.values(), fingers, strict=True):
        values[columns] = finger
    return Touch(values, channels)


def _campaign(job: Job) -> Campaign:
    assert job.world.campaign is not None  # noqa: S101  # the scene calls for these effects only with a campaign
    return job.world.campaign


def _calendar(job: Job, state: SampleState) -> None:
    campaign, after = _campaign(job), job.key.slot + 1
    repeated = job.key.repeat > 0 and campaign.config.repeats(after)
    state.campaign_time = campaign.time_of(after if repeated else job.key.slot)


def _exchange(job: Job, state: SampleState) -> None:
    state.sensors = _campaign(job).fingers(state.campaign_time.session)


def _level_drift(job: Job, state: SampleState) -> None:
    state.level += _campaign(job).drift(state.campaign_time, state.times, state.load)


def _warm_up(job: Job, state: SampleState) -> None:
    """Let the liquid warm on; with TDC, fingers also approach the temperature of an object as long as they touch it."""
    config: WarmUpConfig = job.settings
    campaign = _campaign(job)
    now = state.campaign_time
    timeline = job.scene.fingers.timeline
    rise_k = fingertip.warming(now.powered_s + now.speed * state.times, config.body_kelvin, config.warming_s)
    if config.tdc is None:
        state.level += fingertip.temperature_drift(rise_k)[:, None]
        return
    start_k, object_k = campaign.kelvin(now.session, job.key.slot // campaign.config.grasps)
    rate_hz = _CONTACT_HZ if timeline is None else timeline.rate_hz
    cooled = fingertip.creep(state.load, rate_hz, share=1.0, time_s=CONTACT_S)
    change = fingertip.TDC_PER_KELVIN * ((rise_k + object_k * cooled)[:, None] + start_k)  # (T, 2)
    flow = fingertip.TAC_PER_KELVIN_S * object_k * (state.load - cooled) / CONTACT_S
    tac = np.broadcast_to((fingertip.TAC_REST + flow)[:, None], change.shape)
    state.others[..., 2:] = np.stack([tac, change + fingertip.TDC_REST], axis=2)
    state.level[..., 1:] += change[..., None] * campaign.slopes(now.session)


def _shift(_job: Job, state: SampleState) -> None:
    state.series += state.level


def _tares(job: Job, state: SampleState) -> None:
    """Leave out the tares that are not recorded."""
    config, now = _campaign(job).config, state.campaign_time
    recorded = config.tares != "none" and now.grasp == 0
    if config.tares == "session":
        recorded &= now.visit % config.objects == 0
    if not recorded:
        state.tare = None


def _needs_tares(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    kept = scene.campaign.tares if scene.campaign else "grasp"
    return None if kept == "grasp" else f"campaign.tares: {kept}"


EFFECTS = (
    Effect("sensors", _mounted, "fingers"),
    Effect("calendar", _calendar, "campaign"),
    Effect("exchange", _exchange, "campaign.exchanges"),
    Effect("fingertip", _ideal, "fingers"),
    Effect(
        "moments",
        _tare_and_touch,
        lambda scene, _item: "fingers" if scene.fingers.timeline is None else None,
        off="fingers.timeline makes them",
    ),
    Effect("timeline", _timeline, "fingers.timeline"),
    Effect("level_drift", _level_drift, "campaign.drift"),
    Effect("warm_up", _warm_up, "campaign.warm_up"),
    Effect("level_shift", _shift, "campaign"),
    Effect("slip", _slip, "fingers.slip", again=True),
    Effect("crosstalk", _crosstalk, "fingers.crosstalk"),
    Effect("creep", _creep, "fingers.creep"),
    Effect("drift", _drift, "fingers.drift", again=True),
    Effect("sessions", _sessions, "fingers.sessions"),
    Effect("noise", _noise, "fingers.noise", again=True),
    Effect("scan_hold", _scan, "fingers.scan", again=True),
    Effect("dead_electrodes", _dead, "fingers.dead"),
    Effect("counts", _counts, "fingers"),
    Effect("tares", _tares, _needs_tares, off="each grasp has a tare"),
)

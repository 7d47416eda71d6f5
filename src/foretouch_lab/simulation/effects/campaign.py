# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

from foretouch.tactile import ELECTRODES
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.fingertip import (
    TAC_PER_KELVIN_S,
    TAC_REST,
    TDC_PER_KELVIN,
    TDC_REST,
    creep,
    temperature_drift,
    warming,
)
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.campaign import CONTACT_S, CampaignConfig, ThermistorConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.world import Campaign

_CONTACT_HZ = 1.0  # without a timeline, the touch is read a second after contact


def _campaign(job: Job) -> Campaign:
    assert job.world.campaign is not None  # noqa: S101  # the scene calls for these effects only with a campaign
    return job.world.campaign


def _calendar(job: Job, state: SampleState) -> None:
    campaign, after = _campaign(job), job.key.slot + 1
    repeated = job.key.repeat > 0 and campaign.config.repeats(after)
    state.campaign_time = campaign.time_of(after if repeated else job.key.slot)


def _exchange(job: Job, state: SampleState) -> None:
    state.sensors = _campaign(job).fingers(state.campaign_time.session)


def _level(_job: Job, state: SampleState) -> None:
    state.level = np.zeros((len(state.times), 2, 1 + ELECTRODES))


def _drift(job: Job, state: SampleState) -> None:
    state.level += _campaign(job).drift(state.campaign_time, state.times, state.load)


def _warm_up(job: Job, state: SampleState) -> None:
    config, now = _campaign(job).config.warm_up, state.campaign_time
    assert config is not None  # noqa: S101  # which calls for it
    state.level += temperature_drift(config, now.powered_s + now.speed * state.times)[:, None]


def _finger_temperature(job: Job, state: SampleState) -> None:
    """Fingers warm on, and approach the temperature of an object as long as they touch it."""
    config: ThermistorConfig = job.settings
    campaign, now, timeline = _campaign(job), state.campaign_time, job.scene.fingers.timeline
    warm_up = campaign.config.warm_up
    assert warm_up is not None  # noqa: S101  # it holds the settings
    start_k, object_k = campaign.kelvin(config, now.session, job.key.slot // campaign.config.grasps)
    rate_hz = _CONTACT_HZ if timeline is None else timeline.rate_hz
    cooled = creep(state.load, rate_hz, share=1.0, time_s=CONTACT_S)
    common_k = warming(warm_up, now.powered_s + now.speed * state.times) + object_k * cooled
    change = TDC_PER_KELVIN * (common_k[:, None] + start_k)  # (T, 2)
    flow = TAC_PER_KELVIN_S * object_k * (state.load - cooled) / CONTACT_S
    tac = np.broadcast_to((TAC_REST + flow)[:, None], change.shape)
    state.others[..., 2:] = np.stack([tac, change + TDC_REST], axis=2)
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


def _calendar_detail(config: CampaignConfig) -> str:
    return (
        f"{config.size} grasps in {len(config.days)} sessions over {config.days[-1]:g} days, "
        f"{config.objects} objects each, {config.grasps} grasps of each"
        + (f", every {config.repeat_every}th repeats the one before" if config.repeat_every else "")
    )


def _warms_up(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    config = scene.campaign.warm_up if scene.campaign else None
    return None if config is None or config.tdc else f"campaign.warm_up: {config.warming_s:g} s after each power-on"


def _needs_level(scene: SceneConfig, item: ObjectConfig) -> str | None:
    reasons = (effect.reason(scene, item) for effect in (_DRIFT, _WARM_UP, FINGER_TEMPERATURE))
    return next(filter(None, reasons), None)


def _needs_tares(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    kept = scene.campaign.tares if scene.campaign else "grasp"
    return None if kept == "grasp" else f"campaign.tares: {kept}"


_NO_DRIFT = "no campaign.drift or campaign.warm_up"

_DRIFT = Effect(
    "level_drift",
    _drift,
    "campaign.drift",
    reads=("campaign_time", "times", "load"),
    changes=("level",),
    detail=lambda terms: f"memory {', '.join(f'{term.memory_days:g}' for term in terms)} days",
)
_WARM_UP = Effect(
    "warm_up",
    _warm_up,
    _warms_up,
    reads=("campaign_time", "times"),
    changes=("level",),
    off="no campaign.warm_up, or finger_temperature holds it",
)
FINGER_TEMPERATURE = Effect(
    "finger_temperature",
    _finger_temperature,
    "campaign.warm_up.tdc",
    reads=("campaign_time", "times", "load"),
    changes=("others", "level"),
)

#: Which sensors are mounted.
MOUNTING = (
    Effect("calendar", _calendar, "campaign", writes=("campaign_time",), detail=_calendar_detail),
    Effect(
        "exchange",
        _exchange,
        "campaign.exchanges",
        reads=("campaign_time",),
        writes=("sensors",),
        detail=lambda exchanges: ", ".join(f"{each.finger} at session {each.session}" for each in exchanges),
    ),
)

#: How far their levels have drifted.
DRIFT = (
    Effect("level", _level, _needs_level, reads=("times",), writes=("level",), off=_NO_DRIFT),
    _DRIFT,
    _WARM_UP,
    FINGER_TEMPERATURE,
    Effect("level_shift", _shift, _needs_level, reads=("level",), changes=("series",), off=_NO_DRIFT),
)

#: Which tares are recorded.
TARES = (
    Effect("tares", _tares, _needs_tares, reads=("campaign_time",), changes=("tare",), off="each grasp has a tare"),
)

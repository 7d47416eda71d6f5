# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

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
from foretouch_lab.simulation.scene.campaign import CONTACT_S, ThermistorConfig
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


def _warms_up(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    config = scene.campaign.warm_up if scene.campaign else None
    return None if config is None or config.tdc else f"campaign.warm_up: {config.warming_s:g} s after each power-on"


def _needs_tares(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    kept = scene.campaign.tares if scene.campaign else "grasp"
    return None if kept == "grasp" else f"campaign.tares: {kept}"


#: Which sensors are mounted.
MOUNTING = (Effect("calendar", _calendar, "campaign"), Effect("exchange", _exchange, "campaign.exchanges"))

#: How far their levels have drifted.
DRIFT = (
    Effect("level_drift", _drift, "campaign.drift"),
    Effect("warm_up", _warm_up, _warms_up, off="no campaign.warm_up, or finger_temperature holds it"),
    Effect("finger_temperature", _finger_temperature, "campaign.warm_up.tdc"),
    Effect("level_shift", _shift, "campaign"),
)

#: Which tares are recorded.
TARES = (Effect("tares", _tares, _needs_tares, off="each grasp has a tare"),)

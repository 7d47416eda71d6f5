# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.engine import Effect, Job, SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.campaign import CONTACT_S, WarmUpConfig
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


#: Which sensors are mounted.
MOUNTING = (Effect("calendar", _calendar, "campaign"), Effect("exchange", _exchange, "campaign.exchanges"))

#: How far their levels have drifted.
DRIFT = (
    Effect("level_drift", _drift, "campaign.drift"),
    Effect("warm_up", _warm_up, "campaign.warm_up"),
    Effect("level_shift", _shift, "campaign"),
)

#: Which tares are recorded.
TARES = (Effect("tares", _tares, _needs_tares, off="each grasp has a tare"),)

# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

from foretouch.simulation.campaign import Campaign
from foretouch.simulation.effect import Effect, Job, SampleState
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.types import ELECTRODES


def _campaign(job: Job) -> Campaign:
    assert job.campaign is not None  # noqa: S101  # the scene calls for these effects only with a campaign
    return job.campaign


def _calendar(job: Job, state: SampleState) -> None:
    state.campaign_time = _campaign(job).time_of(job.key.slot)


def _exchange(job: Job, state: SampleState) -> None:
    state.sensors = _campaign(job).fingers(state.campaign_time.session)


def _level(_job: Job, state: SampleState) -> None:
    state.level = np.zeros((len(state.times), 2, 1 + ELECTRODES))


def _drift(job: Job, state: SampleState) -> None:
    state.level += _campaign(job).drift(state.campaign_time, state.times, state.load)


def _warm_up(job: Job, state: SampleState) -> None:
    state.level += _campaign(job).warm_up(state.campaign_time, state.times)


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


def _needs_calendar(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    config = scene.campaign
    if config is None:
        return None
    return (
        f"campaign: {config.size} grasps in {len(config.days)} sessions over {config.days[-1]:g} days, "
        f"{config.objects} objects each, {config.grasps} grasps of each"
    )


def _needs_exchange(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    if scene.campaign is None or not scene.campaign.exchanges:
        return None
    exchanges = (f"{each.finger} at session {each.session}" for each in scene.campaign.exchanges)
    return f"campaign.exchanges: {', '.join(exchanges)}"


def _needs_drift(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    if scene.campaign is None or not scene.campaign.drift:
        return None
    memories = (f"{term.memory_days:g}" for term in scene.campaign.drift)
    return f"campaign.drift: memory {', '.join(memories)} days"


def _needs_warm_up(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    if scene.campaign is None or scene.campaign.warm_up is None:
        return None
    return f"campaign.warm_up: {scene.campaign.warm_up.warming_s:g} s after each power-on"


def _needs_level(scene: SceneConfig, item: ObjectConfig) -> str | None:
    return _needs_drift(scene, item) or _needs_warm_up(scene, item)


def _needs_tares(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    if scene.campaign is None or scene.campaign.tares == "grasp":
        return None
    return f"campaign.tares: {scene.campaign.tares}"


_TIME = "campaign_time"
_NO_DRIFT = "no campaign.drift or campaign.warm_up"

MOUNTING = (
    Effect("calendar", _calendar, _needs_calendar, writes=(_TIME,), off="no campaign"),
    Effect("exchange", _exchange, _needs_exchange, reads=(_TIME,), writes=("sensors",), off="no campaign.exchanges"),
)
"""Which sensors are mounted."""

DRIFT = (
    Effect("level", _level, _needs_level, reads=("times",), writes=("level",), off=_NO_DRIFT),
    Effect(
        "level_drift",
        _drift,
        _needs_drift,
        reads=(_TIME, "times", "load", "level"),
        writes=("level",),
        off="no campaign.drift",
    ),
    Effect(
        "warm_up",
        _warm_up,
        _needs_warm_up,
        reads=(_TIME, "times", "level"),
        writes=("level",),
        off="no campaign.warm_up",
    ),
    Effect("level_shift", _shift, _needs_level, reads=("level", "series"), writes=("series",), off=_NO_DRIFT),
)
"""How far their levels have drifted."""

TARES = (Effect("tares", _tares, _needs_tares, reads=(_TIME, "tare"), writes=("tare",), off="each grasp has a tare"),)
"""Which tares are recorded."""

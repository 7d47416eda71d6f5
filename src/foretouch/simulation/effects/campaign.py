# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

from foretouch.simulation.campaign import Campaign
from foretouch.simulation.disturbances import TemperatureConfig, temperature_drift
from foretouch.simulation.effect import Effect, Job, SampleState
from foretouch.simulation.scene import CampaignConfig, DriftTermConfig, ExchangeConfig, ObjectConfig, SceneConfig
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
    config: TemperatureConfig = job.settings
    now = state.campaign_time
    state.level += temperature_drift(config, now.powered_s + now.speed * state.times)[:, None]


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
    )


def _exchange_detail(exchanges: tuple[ExchangeConfig, ...]) -> str:
    return ", ".join(f"{each.finger} at session {each.session}" for each in exchanges)


def _drift_detail(terms: tuple[DriftTermConfig, ...]) -> str:
    return f"memory {', '.join(f'{term.memory_days:g}' for term in terms)} days"


def _warm_up_detail(config: TemperatureConfig) -> str:
    return f"{config.warming_s:g} s after each power-on"


def _needs_level(scene: SceneConfig, item: ObjectConfig) -> str | None:
    return _DRIFT.reason(scene, item) or _WARM_UP.reason(scene, item)


def _needs_tares(scene: SceneConfig, _item: ObjectConfig) -> str | None:
    kept = scene.campaign.tares if scene.campaign else "grasp"
    return None if kept == "grasp" else f"campaign.tares: {kept}"


_NO_DRIFT = "no campaign.drift or campaign.warm_up"

_DRIFT = Effect(
    "level_drift",
    _drift,
    "campaign.drift",
    reads=("campaign_time", "times", "load", "level"),
    writes=("level",),
    detail=_drift_detail,
)
_WARM_UP = Effect(
    "warm_up",
    _warm_up,
    "campaign.warm_up",
    reads=("campaign_time", "times", "level"),
    writes=("level",),
    detail=_warm_up_detail,
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
        detail=_exchange_detail,
    ),
)

#: How far their levels have drifted.
DRIFT = (
    Effect("level", _level, _needs_level, reads=("times",), writes=("level",), off=_NO_DRIFT),
    _DRIFT,
    _WARM_UP,
    Effect("level_shift", _shift, _needs_level, reads=("level", "series"), writes=("series",), off=_NO_DRIFT),
)

#: Which tares are recorded.
TARES = (
    Effect(
        "tares", _tares, _needs_tares, reads=("campaign_time", "tare"), writes=("tare",), off="each grasp has a tare"
    ),
)

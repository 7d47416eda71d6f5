# SPDX-License-Identifier: Apache-2.0
"""The course of a campaign: when a grasp is executed, which sensors are mounted, and how their levels drifted."""

import numpy as np

from foretouch.simulation.campaign import Campaign
from foretouch.simulation.effect import Effect, Job, SampleState, keys
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.types import ELECTRODES


def _of(job: Job) -> Campaign:
    assert job.campaign is not None  # noqa: S101  # the scene calls for these effects only with a campaign
    return job.campaign


def _calendar(job: Job, state: SampleState) -> None:
    state.moment = _of(job).moment(job.key.slot)


def _exchange(job: Job, state: SampleState) -> None:
    state.sensors = _of(job).fingers(state.moment.session)


def _level(_job: Job, state: SampleState) -> None:
    state.level = np.zeros((len(state.times), 2, 1 + ELECTRODES))


def _drift(job: Job, state: SampleState) -> None:
    state.level += _of(job).drift(state.moment, state.times, state.load)


def _warm_up(job: Job, state: SampleState) -> None:
    state.level += _of(job).warm_up(state.moment, state.times)


def _shift(_job: Job, state: SampleState) -> None:
    state.series += state.level


def _tares(job: Job, state: SampleState) -> None:
    """Leave out the tares that are not recorded."""
    config, moment = job.scene.campaign, state.moment
    if config is None:
        return
    first_of_object = moment.grasp == 0
    first_of_session = first_of_object and moment.visit % config.objects == 0
    if not {"object": first_of_object, "session": first_of_session}.get(config.tares, config.tares == "grasp"):
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


_LEVEL_OFF = "no campaign.drift or campaign.warm_up"

EFFECTS = (
    Effect("calendar", _calendar, _needs_calendar, off="no campaign", writes=keys("moment")),
    Effect(
        "exchange",
        _exchange,
        _needs_exchange,
        off="no campaign.exchanges",
        reads=keys("moment"),
        modifies=keys("sensors"),
    ),
    Effect("level", _level, _needs_level, off=_LEVEL_OFF, reads=keys("times"), writes=keys("level")),
    Effect(
        "level_drift",
        _drift,
        _needs_drift,
        off="no campaign.drift",
        reads=keys("moment", "times", "load"),
        modifies=keys("level"),
    ),
    Effect(
        "warm_up",
        _warm_up,
        _needs_warm_up,
        off="no campaign.warm_up",
        reads=keys("moment", "times"),
        modifies=keys("level"),
    ),
    Effect("level_shift", _shift, _needs_level, off=_LEVEL_OFF, reads=keys("level"), modifies=keys("series")),
    Effect("tares", _tares, _needs_tares, off="each grasp has a tare", reads=keys("moment"), modifies=keys("tare")),
)

# SPDX-License-Identifier: Apache-2.0
"""The touch model: skill on held-out grasps against the time of 1 to 1000 grasps on a cloud."""

from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.areas.model import skill, variants
from foretouch.tradeoff.areas.model.picture import draw_overview
from foretouch.tradeoff.areas.model.timed import timed

__all__ = ["EXPERIMENT"]

_SKILLS = {**{name: f"mean skill, {text}" for name, text in skill.SPLITS.items()}, skill.SIMULATED: "mean skill"}

EXPERIMENT = Area(
    name="model",
    question="How good a prediction of touch can I have in 10 ms?",
    module=__name__,
    settings=skill.ModelSettings,
    presets={
        "small": {"timing_s": 45.0, "splits": ["time", "object"]},
        "full": {
            "timing_s": 200.0,
            "seeds": [0, 1],
            "full": True,
            "recipes": list(variants.RECIPES),
            "simulated": 1000,
        },
    },
    load=skill.load,
    prepare=skill.prepare,
    cells=skill.cells,
    run=skill.run,
    tabulate=skill.tabulate,
    summarise=lambda _: (),
    figure=draw_overview,
    resumable_settings=skill.FREE,
    data_folder="vision2tactile",
    variants=lambda settings: variants.list_variants(full=settings.full),
    timed=timed,
    shipped=variants.SHIPPED,
    reference=variants.REFERENCE,
    skills=_SKILLS,
    panels=(
        Panel("time", 1, "Known objects (blocks of time), 1 grasp"),
        Panel("time", 100, "Known objects (blocks of time), 100 grasps"),
        Panel("time", 1000, "Known objects (blocks of time), 1000 grasps"),
        Panel("object", 100, "New objects (left out), 100 grasps"),
        Panel("random", 100, "Same sessions (random folds), 100 grasps"),
        Panel("simulated", 100, "New simulated objects, 100 grasps"),
    ),
    request="grasps",
    seconds=skill.seconds,
)

# SPDX-License-Identifier: Apache-2.0
"""The touch model: skill on held-out real grasps against the time of 1 to 1000 grasps on a cloud."""

from foretouch.experiments.shared import real_grasps
from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.areas.model import skill, variants
from foretouch.tradeoff.areas.model.timed import timed

__all__ = ["EXPERIMENT"]

EXPERIMENT = Area(
    name="model",
    question="How good a prediction of touch can I have in 10 ms?",
    module=__name__,
    settings=skill.ModelSettings,
    presets={"small": {"timing_s": 40.0}, "full": {"timing_s": 240.0, "seeds": [0, 1, 2]}},
    load=real_grasps.load,
    cells=skill.cells,
    run=skill.run,
    tabulate=skill.tabulate,
    summarise=lambda _: (),
    data_folder="vision2tactile",
    variants=lambda _: variants.list_variants(),
    timed=timed,
    shipped=variants.SHIPPED,
    reference=variants.REFERENCE,
    skills={name: f"mean skill, {text}" for name, text in skill.SPLITS.items()},
    panels=(
        Panel("time", 1, "Known objects (blocks of time), 1 grasp"),
        Panel("time", 100, "Known objects (blocks of time), 100 grasps"),
        Panel("object", 1, "New objects (left out), 1 grasp"),
        Panel("object", 100, "New objects (left out), 100 grasps"),
    ),
    request="grasps",
)

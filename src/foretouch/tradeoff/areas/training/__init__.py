# SPDX-License-Identifier: Apache-2.0
"""Training: grasps, objects, trees, epochs, points and precision against the time of a training and of the robot."""

from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.areas.training import measures, results, variants

__all__ = ["EXPERIMENT"]

EXPERIMENT = Area(
    name="training",
    question="What does one more hour buy, of the robot that grasps or of the computer that trains?",
    module=__name__,
    settings=measures.TrainingSettings,
    presets={"small": {"detail": "few", "splits": ["known"], "timing_s": 20.0}, "full": {"timing_s": 120.0}},
    prepare=measures.prepare,
    load=measures.load,
    cells=measures.cells,
    run=measures.run,
    tabulate=measures.tabulate,
    summarise=lambda _: (),
    figure=results.draw,
    data_folder="vision2tactile",
    variants=lambda settings: variants.list_variants(settings.detail),
    timed=measures.timed,
    shipped=variants.CONTACT,
    reference=variants.CONTACT,
    skills={
        "known": "mean skill, known objects in blocks of time",
        "new": "mean skill, objects left out",
        measures.ONE_BLOCK: "mean skill, the first block of time alone",
    },
    panels=(
        Panel("known", 1, "Contact model: skill on known objects (blocks of time)"),
        Panel("new", 1, "Contact model: skill on new objects (left out)"),
        Panel(measures.ONE_BLOCK, 1, "Networks and contact models: skill on the first block of time"),
    ),
    request="trainings",
    seconds=measures.seconds,
    notes=results.notes,
)

# SPDX-License-Identifier: Apache-2.0
"""Segmentation and GeoGrasp: masks, contacts and predicted touch against the time of a cloud."""

from collections.abc import Iterator, Sequence
from typing import Any

from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.areas.perception import data, measures, variants

__all__ = ["EXPERIMENT"]


def _notes(rows: Sequence[Row]) -> Iterator[str]:
    """What happens to best grasps, and whether those that move are worse."""
    for row in rows:
        if not row["moved"] or row["moved_equal"] is None or row["score_change"] is None:
            continue
        real = row["touch_half_real"]
        on_real = "" if real is None else f" (real objects {row['touch_counts_real']:.0f} = {real:.2f})"
        yield (
            f"{row['variant']}: {row['moved']:.0%} of best grasps move more than 5 mm; of these {row['moved_equal']:.0%} score "
            f"the same within {measures.EQUAL_SCORE:g}, {row['moved_better']:.0%} better, {row['moved_worse']:.0%} worse; mean "
            f"change of the score {row['score_change']:+.2f} [{row['score_change_low']:+.2f}, {row['score_change_high']:+.2f}], of touch {row['touch_counts']:.0f} counts = "
            f"{row['touch_half']:.2f} half widths{on_real}; contacts {row['contact_mm']:.1f} mm from the true surface."
        )


def _seconds(settings: Any, loaded: data.PerceptionData, cells: Sequence[Cell]) -> float:
    """About 0.15 s a scene and .03 s a real object, as measured for the shipped settings."""
    del settings
    return len(cells) * (0.15 * len(loaded.scenes) + 0.03 * len(loaded.real))


EXPERIMENT = Area(
    name="perception",
    question="How well can objects and grasps be found in a few milliseconds?",
    module=__name__,
    settings=data.PerceptionSettings,
    presets={"small": {"scenes": 8, "real": 12, "detail": "few", "timing_s": 25.0}, "full": {"timing_s": 150.0}},
    prepare=data.prepare,
    load=data.load,
    cells=measures.cells,
    run=measures.run,
    tabulate=measures.tabulate,
    summarise=lambda _: (),
    data_folder="",
    variants=lambda settings: variants.list_variants(settings.detail),
    timed=measures.timed,
    shipped=f"{variants.GRASP} as shipped",
    reference=variants.ALL_POINTS,
    skills={"iou": "mean IoU of the objects, 95 % interval", "score": "mean original score, 95 % interval"},
    panels=(
        Panel("iou", 1, "Segmentation, 848x480: masks of the objects", 0.99),
        Panel("score", 1, "GeoGrasp: score of the best grasp at full resolution", 0.98),
    ),
    request="clouds",
    unit="m",
    seconds=_seconds,
    notes=lambda rows: list(_notes(rows)),
)

# SPDX-License-Identifier: Apache-2.0
"""The simulator: level of contact, grid and effects against the time of a sample."""

from collections.abc import Iterator, Sequence

from foretouch.experiments.framework.experiment import Row
from foretouch.tradeoff.area import Area, Panel
from foretouch.tradeoff.areas.simulation import measures, variants

__all__ = ["EXPERIMENT"]


def _notes(rows: Sequence[Row]) -> Iterator[str]:
    for row in rows:
        if row["trained_change"] is None:
            continue
        change = f"{row['trained_change']:+.2f}"
        if row["trained_change_low"] is not None:
            change += f" [{row['trained_change_low']:+.2f}, {row['trained_change_high']:+.2f}]"
        trained = f"a model trained on it has a skill {change} different from one trained on the finest level"
        if row["pattern_error"]:
            yield (
                f"{row['variant']}: pattern error {100.0 * row['pattern_error']:.2g} % (largest "
                f"{100.0 * row['pattern_error_largest']:.2g} %), force error {100.0 * round(row['force_error'], 6):.2g} %; {trained}."
            )
        elif row["effect_ms"] is not None or row["counts"]:
            cost = "" if row["effect_ms"] is None else f", costs {row['effect_ms']:.2g} ms a sample"
            yield (
                f"{row['variant']}: readings change by {row['counts']:.3g} counts (largest {row['counts_largest']:.0f}){cost}; "
                f"{trained.replace('the finest level', 'all effects')}."
            )


EXPERIMENT = Area(
    name="simulation",
    question="How exact must the simulator be, and what does a sample cost?",
    module=__name__,
    settings=measures.SimulationSettings,
    presets={
        "small": {
            "compared": 16,
            "train": 60,
            "test": 60,
            "trees": 10,
            "finest_cells": 48,
            "detail": "few",
            "timing_s": 25.0,
        },
        "full": {"timing_s": 120.0},
    },
    prepare=measures.prepare,
    load=measures.load,
    cells=measures.cells,
    run=measures.run,
    tabulate=measures.tabulate,
    summarise=lambda _: (),
    variants=lambda settings: variants.list_variants(settings.detail, settings.finest_cells),
    timed=measures.timed,
    shipped=variants.shipped(variants.RIGID),
    reference=variants.finest(variants.RIGID),
    skills={
        **{f"digits_{name}": "correct decimal digits" for name in (variants.RIGID, variants.SOFT)},
        **{f"trained_{name}": "mean skill, 95 % interval" for name in variants.SCENES},
    },
    panels=(
        Panel("digits_rigid", 1, "Rigid objects: correct digits of the electrodes' pattern"),
        Panel("digits_deformables", 1, "Deformable objects: correct digits of the electrodes' pattern"),
        Panel("trained_rigid", 1, "Rigid objects: skill of a model trained on it, on the finest level", 0.98),
        Panel(
            "trained_deformables", 1, "Deformable objects: skill of a model trained on it, on the finest level", 0.98
        ),
        Panel("trained_everything", 1, "Effects left out: skill of a model trained without, with all effects", 0.98),
    ),
    request="samples",
    seconds=measures.seconds,
    notes=lambda rows: list(_notes(rows)),
)

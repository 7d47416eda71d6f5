# SPDX-License-Identifier: Apache-2.0
"""Publish what `make reference-times` measured: python docs/reference_times.py FOLDER.

Copies table, summary and picture of each area of FOLDER to docs/results/tradeoff, draws docs/budget.png of them, and writes the
generated parts of docs/accuracy_vs_time.md. Without FOLDER it draws and writes from the committed tables.
"""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.report.panels import FAINT, INK, PAGE_INCH, SMALL_PT, TEXT_PT, Axes, new_figure, save_small
from foretouch_lab.experiments.framework.manifest import read_results
from foretouch_lab.experiments.framework.tradeoff import late_time

DOCS: Final = Path(__file__).parent
BUDGETS_MS: Final = (5.0, 10.0, 30.0, 100.0)
_PUBLISHED: Final = ("summary.md", "tradeoff.csv", "tradeoff.png")
_LINES: Final = {"found": "objects found", "held": "grasps that hold", "touch": "touch explained"}
_COLOURS: Final = ("#00798c", "#b07d2b", "#d1495b")
_MODEL: Final = "contact-v3"

Rows = Sequence[dict[str, Any]]


def publish(source: Path) -> None:
    """Copy the results of each area."""
    for table in sorted(source.glob(f"*/{_PUBLISHED[1]}")):
        folder = DOCS / "results" / "tradeoff" / table.parent.name
        folder.mkdir(parents=True, exist_ok=True)
        for name in _PUBLISHED:
            shutil.copyfile(table.parent / name, folder / name)


def best_within(rows: Rows, budget_ms: float) -> dict[str, Any] | None:
    """Return the row with the largest product among the rows that take no longer than a time, or None."""
    fitting = [row for row in rows if row[late_time(rows)] <= budget_ms]
    return max(fitting, key=lambda row: row["chain"], default=None)


def grasps_within(rows: Rows, budget_ms: float) -> int:
    """Return how many grasps the default model predicts within a time, between the sizes that were measured; 0 for none."""
    own = sorted((row for row in rows if row["variant"] == _MODEL), key=lambda row: row["request"])
    column = late_time(own)
    times, sizes = (np.log([row[name] for row in own]) for name in (column, "request"))
    if np.log(budget_ms) < times[0]:
        return 0
    count = float(np.exp(np.interp(np.log(budget_ms), times, sizes)))
    return int(float(f"{count:.1g}"))


def draw(folder: Path) -> Path:
    """Draw what there is in 5, 10, 30 and 100 ms: the chain, and grasps on one object."""
    chain, model = (read_results(DOCS / "results/tradeoff" / area / _PUBLISHED[1]) for area in ("chain", "model"))
    figure = new_figure(PAGE_INCH, 3.4)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_chain(left, chain)
    _draw_grasps(right, model)
    kind = "95 of 100 calls" if late_time(chain) == "ms_p95" else "processor time, 95 of 100 calls (loaded machine)"
    figure.supxlabel(f"time [ms], {kind}, one thread", fontsize=TEXT_PT)
    return save_small(figure, folder / "budget.png")


def _draw_chain(axes: Axes, rows: Rows) -> None:
    times = np.geomspace(2.0, 200.0, 400)
    best = [best_within(rows, time) for time in times]
    for name, colour in zip(_LINES, _COLOURS, strict=True):
        heights = [np.nan if row is None else row[name] for row in best]
        axes.plot(times, heights, color=colour, linewidth=2)
    first = next(time for time, row in zip(times, best, strict=True) if row is not None)
    axes.axvspan(0.1, first, color=FAINT, alpha=0.25, linewidth=0.0)
    axes.text(3.0, 0.5, f"no answer\nbefore {first:.0f} ms", ha="left", va="center", fontsize=SMALL_PT)
    for budget in BUDGETS_MS:
        row = best_within(rows, budget)
        axes.axvline(budget, color=FAINT, linewidth=0.8)
        above = {"ha": "center", "va": "bottom", "fontsize": SMALL_PT, "transform": axes.get_xaxis_transform()}
        axes.text(budget, 1.26, f"{budget:g} ms", color=INK, **above)
        for k, (name, colour) in enumerate(zip(_LINES, _COLOURS, strict=True)):
            text = "–" if row is None else f"{row[name]:.0%}"
            axes.text(budget, 1.18 - 0.08 * k, text, color=colour, weight="bold", **above)
    for k, (label, colour) in enumerate(zip(_LINES.values(), _COLOURS, strict=True)):
        axes.text(0.0, 1.18 - 0.08 * k, label, color=colour, va="bottom", fontsize=SMALL_PT, transform=axes.transAxes)
    axes.set_ylim(0.0, 1.04)
    axes.set_ylabel("share, with the best settings for the time", fontsize=SMALL_PT)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0%}")
    axes.set_title("From a depth image to predicted touch\n\n\n\n\n", fontsize=TEXT_PT)
    _scale(axes, 0.6)


def _draw_grasps(axes: Axes, rows: Rows) -> None:
    times = np.geomspace(2.0, 200.0, 400)
    counts = [grasps_within(rows, time) or np.nan for time in times]
    axes.plot(times, counts, color=INK, linewidth=2)
    for budget in BUDGETS_MS:
        count = grasps_within(rows, budget)
        axes.axvline(budget, color=FAINT, linewidth=0.8)
        axes.text(
            budget,
            1.06,
            f"{budget:g} ms\n{count:,}" if count else f"{budget:g} ms\nnone",
            ha="center",
            va="bottom",
            fontsize=SMALL_PT,
            transform=axes.get_xaxis_transform(),
        )
    axes.set_yscale("log")
    axes.set_ylabel("grasps on one object", fontsize=SMALL_PT)
    axes.set_ylim(0.8, 3000.0)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.set_title("Touch of many grasps on one object\n\n\n\n\n", fontsize=TEXT_PT)
    _scale(axes, 2.0)


def _scale(axes: Axes, least_ms: float) -> None:
    axes.set_xscale("log")
    axes.set_xlim(least_ms, 200.0)
    axes.set_xticks(BUDGETS_MS, [f"{budget:g}" for budget in BUDGETS_MS])
    axes.minorticks_off()
    axes.tick_params(labelsize=SMALL_PT)


def main() -> None:
    """Publish and draw."""
    sys.path.insert(0, str(DOCS / "_ext"))
    import reference_pages

    if sys.argv[1:]:
        publish(Path(sys.argv[1]))
    print(f"drawn: {draw(DOCS)}")  # noqa: T201  what was done
    reference_pages.main()


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 from our own table: errors of both models at each label ratio, and below them their difference.

P2's figures come from other objects: its lowest error and the changes that its text tells stand beside ours, not in
competition with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from foretouch.experiments.label_ratio.table import P2_LOWEST, tally
from foretouch.report.panels import Rows, new_figure, save

__all__ = ["draw", "draw_changes", "draw_errors"]

_MODELS: Final = (("pointnet", "P", "#8d99ae"), ("srgan", "S", "#00798c"))
_BASELINES: Final = (("mean", "mean of the labels", "#d1495b"), ("trees", "trees on geometry", "#edae49"))
_VERDICTS: Final = {"win": "#2a9d4e", "tie": "#555555", "loss": "#d1495b", None: "#555555"}
_HALF: Final = 0.38
_LEAST_SPAN: Final = 5.0  # of a change [%] that the axis shows at least


def draw(rows: Rows, folder: Path) -> list[Path]:
    """`figure.png`: modalities side by side."""
    names = list(dict.fromkeys(row["modality"] for row in rows))
    figure = new_figure(3.6 * len(names) + 0.6, 7.2)
    above, below = figure.subplots(2, len(names), squeeze=False, sharey="row", height_ratios=(1.15, 1.0))
    for top, bottom, name in zip(above, below, names, strict=True):
        mine = sorted((row for row in rows if row["modality"] == name), key=lambda row: row["ratio"])
        draw_errors(top, mine)
        draw_changes(bottom, mine)
        top.set_title(name)
    above[0].set_ylabel("RMSE [% of the range]\nmean ± deviation of the runs")
    below[0].set_ylabel("change of the RMSE by the SR-GAN [%]\n95 % interval")
    figure.legend(*above[0].get_legend_handles_labels(), fontsize=9, loc="outside lower center", ncols=5)
    figure.suptitle("; ".join(tally(rows)), fontsize=10)
    return [save(figure, folder / "figure.png")]


def draw_errors(axes: Axes, rows: Rows) -> None:
    """Bars of both models at each ratio, S and P as in P2; baselines across them; the lowest error that P2 tells."""
    for side, (model, letter, colour) in zip((-0.5, 0.5), _MODELS, strict=True):
        places = [k + side * _HALF for k in range(len(rows))]
        heights = [row[f"{model}_percent"] for row in rows]
        widths = [row[f"{model}_percent"] / row[f"{model}_rmse"] * (row[f"{model}_sd"] or 0.0) for row in rows]
        label = f"{letter}: {'SR-GAN' if model == 'srgan' else 'PointNet'}"
        axes.bar(places, heights, _HALF, yerr=widths, capsize=2.5, color=colour, label=label)
    for name, label, colour in _BASELINES:
        for k, row in enumerate(rows):
            if row[f"{name}_rmse"] is not None:
                height = row["srgan_percent"] / row["srgan_rmse"] * row[f"{name}_rmse"]
                ends = [k - 1.1 * _HALF, k + 1.1 * _HALF]
                axes.plot(ends, [height, height], color=colour, linewidth=2, label=label if k == 0 else None)
    lowest = P2_LOWEST[rows[0]["modality"]]
    axes.axhline(lowest, color="black", linestyle=":", linewidth=1, label="lowest in P2 (its P30), other objects")
    _ticks(axes, rows)


def draw_changes(axes: Axes, rows: Rows) -> None:
    """The change in each cell with its interval, coloured by verdict; below, P2's where its text tells it."""
    for place, row in enumerate(rows):
        colour = _VERDICTS[row["verdict"]]
        axes.plot(place, row["change"], marker="o", color=colour)
        if row["change_low"] is not None:
            axes.plot([place, place], [row["change_low"], row["change_high"]], color=colour, linewidth=2)
    axes.axhline(0.0, color="black", linewidth=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -_LEAST_SPAN), max(high, _LEAST_SPAN))
    axes.margins(x=0.15)
    told = ["–" if row["p2_change"] is None else f"{row['p2_change']:+.1f}" for row in rows]
    _ticks(axes, rows, told)
    axes.set_xlabel("without labels (P2: change [%])")


def _ticks(axes: Axes, rows: Rows, below: Sequence[str] = ()) -> None:
    names = [f"T{row['ratio']}" for row in rows]
    names = [f"{name}\n({text})" for name, text in zip(names, below, strict=True)] if below else names
    axes.set_xticks(range(len(rows)), names)
    axes.grid(visible=True, axis="y", alpha=0.3)
    axes.set_axisbelow(True)

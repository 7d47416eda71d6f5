# SPDX-License-Identifier: Apache-2.0
"""The SR-GAN compared with the PointNet in each cell of P2's Fig. 3, with an interval for each difference.

With e_mri the squared error of model m in run r on test sample i, the RMSE of a run is the root of its mean over i, and

    change = 100 (mean_r RMSE_srgan,r - mean_r RMSE_pointnet,r) / mean_r RMSE_pointnet,r     [%]   (1)

It is below 0 where the SR-GAN has the lower error. Both models have the same test samples and, run by run, the same
seed, so their errors are compared in pairs. There are two sources of chance. Test grasps: they are resampled with
replacement within each object, since P2 has only four objects; with the same draw for both models and all runs. Runs:
with d_r the difference of a run and s its standard deviation over R runs, s / √R times a draw from Student's t with R -
1 degrees of freedom is added, since resampling three or five runs would underestimate their variance (by (R - 1) / R,
with the tails of a normal distribution). The interval is that between the 2.5 and 97.5 percentiles of the sum, over the
mean RMSE of the PointNet. It is valid for these objects, this split and these settings.

P2's figures are for other objects: its lowest error and the differences in its text are shown for reference only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Row, Table
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES, TactileRanges
from foretouch.types import Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


TREES: Final = "geometry_trees"
"""Value of the column `model` for the baseline that is trained on the labelled samples alone."""

P2_CHANGES: Final = {
    ("PDC_TH", 30): 0.09,
    ("PDC_TH", 70): -16.2,
    ("PDC_TH", 90): -6.2,
    ("PDC_MF", 30): 8.8,
    ("PDC_MF", 50): -7.7,
    ("PDC_MF", 70): -1.5,
    ("E_TH", 30): 1.5,
    ("E_TH", 50): -1.9,
    ("E_TH", 70): -15.2,
    ("E_MF", 50): 1.1,
    ("E_MF", 70): 14.5,
    ("E_MF", 90): -31.5,
}
"""P2, section IV: eq. 1 where its text gives it [%]. The other cells are only in its Fig. 3, without numbers."""

P2_LOWEST: Final = {"PDC_TH": 6.37, "E_TH": 5.17, "PDC_MF": 4.83, "E_MF": 6.06}
"""P2, section IV: lowest RMSE [% of the range], always P30, the PointNet at T30."""

P2_AVERAGES: Final = {"PDC_TH": 4, "PDC_MF": 4, "E_TH": 3, "E_MF": 1}
"""P2, section IV: number of the five ratios at which the SR-GAN's mean error is lower."""

_LEVEL: Final = 0.95
_WIN, _TIE, _LOSS = "win", "tie", "loss"

_MODELS: Final = (("pointnet", "P", "#8d99ae"), ("srgan", "S", "#00798c"))
_BASELINES: Final = (("mean", "mean of the labels", "#d1495b"), ("trees", "trees on geometry", "#edae49"))
_VERDICTS: Final = {"win": "#2a9d4e", "tie": "#555555", "loss": "#d1495b", None: "#555555"}
_HALF: Final = 0.38
_LEAST_SPAN: Final = 5.0  # lower limit of the axis of differences [%]


def compare_models(rows: Sequence[Row], ranges: TactileRanges, draws: int, seed: int = 0) -> list[Row]:
    """Rows of `results.csv`.

    Args:
        rows: Rows of the cells. A run that lacks one of its two networks, because its cell failed, is left out.
        ranges: Ranges whose widths P2's percentages refer to.
        draws: Number of bootstrap samples.
        seed: Seed of the bootstrap.

    Raises:
        DatasetError: If the compared models were not tested on the same samples.
    """
    found = {(row["ratio"], row["modality"], row["model"], row["seed"]): row for row in rows}
    cells = dict.fromkeys((row["ratio"], row["modality"]) for row in rows)
    order = sorted(cells, key=lambda cell: (MODALITIES.index(cell[1]), cell[0]))
    result = []
    for ratio, modality in order:
        seeds = sorted({row["seed"] for row in rows})
        pairs = [[found.get((ratio, modality, model, seed)) for model in ("pointnet", "srgan")] for seed in seeds]
        runs = [(one, other) for one, other in pairs if one is not None and other is not None]
        if runs:
            low, high = ranges.of(modality)
            result.append({"modality": modality, "ratio": ratio, **_compared(runs, high - low, draws, seed)})
            result[-1]["p2_change"] = P2_CHANGES.get((modality, ratio))
            result[-1] |= _baselines(runs[0][0], found.get((ratio, modality, TREES, 0)))
    return result


def _compared(runs: Sequence[tuple[Row, Row]], width: float, draws: int, seed: int) -> Row:
    """Both models in one cell; `width` is that of the range [counts]."""
    pointnet, srgan = (np.array([_samples(run[k], "squared") for run in runs]) for k in range(2))
    reference = np.array([_samples(run[0], "reference") for run in runs])
    sizes = _sizes(runs)
    first = runs[0][0]
    result: Row = {"runs": len(runs), "samples": int(sum(sizes)), "labelled": first["labelled"]}
    result["updates"] = first["updates"]
    for (name, squared), row in zip((("pointnet", pointnet), ("srgan", srgan)), runs[0], strict=True):
        rmse = np.sqrt(squared.mean(axis=1))
        result |= {
            f"{name}_trial": row["trial"],
            f"{name}_rmse": _rounded(rmse.mean()),
            f"{name}_sd": _rounded(rmse.std(ddof=1)) if len(runs) > 1 else None,
            f"{name}_percent": _rounded(100.0 * rmse.mean() / width),
            f"{name}_skill": _rounded(1.0 - squared.mean() / reference.mean()),
        }
    change, low, high = _change(srgan, pointnet, sizes, draws, seed)
    verdict = None if low is None or high is None else _WIN if high < 0.0 else _LOSS if low > 0.0 else _TIE
    ends = {"change": change, "change_low": low, "change_high": high}
    return result | {name: _rounded(value) for name, value in ends.items()} | {"verdict": verdict}


def _baselines(network: Row, trees: Row | None) -> Row:
    """RMSE [counts] of the mean of the training labels, and of the trees if they were run."""
    _sizes([(network, trees or network)])
    return {
        "mean_rmse": _rounded(np.sqrt(np.mean(_samples(network, "reference")))),
        "trees_rmse": _rounded(np.sqrt(np.mean(_samples(trees, "squared")))) if trees else None,
    }


def _change(
    srgan: Float64, pointnet: Float64, sizes: Sequence[int], draws: int, seed: int
) -> tuple[float, float | None, float | None]:
    """Eq. 1 and its interval from (R, S) squared errors, samples ordered by object; no interval for a single run."""
    each = np.sqrt(srgan.mean(axis=1)) - np.sqrt(pointnet.mean(axis=1))
    scale = 100.0 / float(np.sqrt(pointnet.mean(axis=1)).mean())
    change = scale * float(each.mean())
    if len(each) < 2:
        return change, None, None
    rng = np.random.default_rng(seed)
    weights = np.concatenate(
        [rng.multinomial(size, np.full(size, 1.0 / size), draws) for size in sizes], axis=1
    ) / float(sum(sizes))
    drawn = (np.sqrt(weights @ srgan.T) - np.sqrt(weights @ pointnet.T)).mean(axis=1)
    spread = each.std(ddof=1) / np.sqrt(len(each))
    drawn += spread * rng.standard_t(len(each) - 1, draws)
    tail = (1.0 - _LEVEL) / 2.0
    low, high = scale * np.quantile(drawn, [tail, 1.0 - tail])
    return change, float(low), float(high)


def _samples(row: Row, what: str) -> list[float]:
    """Values of all test samples of one network, object by object."""
    return [value for name in sorted(row["objects"]) for value in row["objects"][name][what]]


def _sizes(runs: Sequence[tuple[Row, Row]]) -> list[int]:
    """Number of test samples of each object, which all networks must share."""
    sizes = [{name: len(one["squared"]) for name, one in row["objects"].items()} for run in runs for row in run]
    references = [_samples(row, "reference") for run in runs for row in run]
    if any(one != sizes[0] for one in sizes) or any(one != references[0] for one in references):
        raise DatasetError("label_ratio: the compared models were not tested on the same samples")
    return [sizes[0][name] for name in sorted(sizes[0])]


def summarise(rows: Sequence[Row]) -> list[Table]:
    """Tables of the errors of both models and of the baselines, and of the differences."""
    notes = [
        "difference of the SR-GAN's RMSE from the PointNet's [95 % interval]",
        "`>` SR-GAN significantly better, `<` significantly worse, `=` no significant difference",
        *tally(rows),
        _against_mean(rows),
    ]
    errors = Table(
        "RMSE in counts, PointNet / SR-GAN, mean ± standard deviation over the runs",
        ["", *MODALITIES],
        list(_body(rows, _errors)),
    )
    baselines = Table(
        "Baselines with the same labels: mean of the labels / trees on geometry, RMSE in counts",
        ["", *MODALITIES],
        list(_body(rows, _baseline_errors)),
    )
    return [
        errors,
        baselines,
        Table("SR-GAN against PointNet [%]", ["", *MODALITIES], list(_body(rows, _change_text)), notes),
    ]


def tally(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Wins, ties and losses by interval, and by mean error alone, as P2 counts."""
    verdicts = [row["verdict"] for row in rows]
    counts = ", ".join(f"{verdicts.count(name)} {plural}" for name, plural in _PLURALS.items())
    counts += f"; {verdicts.count(None)} with a single run" if None in verdicts else ""
    lower = sum(row["change"] < 0.0 for row in rows)
    return [
        f"SR-GAN by 95 % interval: {counts}",
        f"by mean error the SR-GAN is better in {lower} of {len(rows)} cells (P2: {sum(P2_AVERAGES.values())} of 20)",
    ]


def _against_mean(rows: Sequence[Row]) -> str:
    lower = [sum(row[f"{model}_rmse"] < row["mean_rmse"] for row in rows) for model, *_ in _MODELS]
    cells = len(rows)
    return f"mean error below that of the mean of the labels: PointNet in {lower[0]} of {cells} cells, SR-GAN in {lower[1]}"


_PLURALS: Final = {_WIN: "wins", _TIE: "ties", _LOSS: "losses"}
_SIGNS: Final = {_WIN: ">", _TIE: "=", _LOSS: "<"}


def _body(rows: Sequence[Row], text: Any) -> Iterator[list[str]]:
    for ratio in sorted({row["ratio"] for row in rows}):
        subset = {row["modality"]: row for row in rows if row["ratio"] == ratio}
        yield [f"T{ratio}", *(text(subset[name]) if name in subset else "" for name in MODALITIES)]


def _errors(row: Row) -> str:
    parts = (
        f"{row[f'{name}_rmse']:.1f}" + ("" if row[f"{name}_sd"] is None else f" ± {row[f'{name}_sd']:.1f}")
        for name in ("pointnet", "srgan")
    )
    return " / ".join(parts)


def _baseline_errors(row: Row) -> str:
    return f"{row['mean_rmse']:.1f} / " + ("–" if row["trees_rmse"] is None else f"{row['trees_rmse']:.1f}")


def _change_text(row: Row) -> str:
    text = f"{row['change']:+.1f}"
    if row["verdict"] is None:
        return text
    return f"{text} {_SIGNS[row['verdict']]}\n[{row['change_low']:+.1f}, {row['change_high']:+.1f}]"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 4)


def draw_label_ratio_figure(rows: Rows, folder: Path) -> list[Path]:
    """Draw `figure.png`."""
    return [save(draw_panels(rows), folder / "figure.png")]


def draw_panels(rows: Rows) -> Figure:
    """Draw P2's Fig. 3 from our rows, modalities side by side, and the differences below."""
    names = list(dict.fromkeys(row["modality"] for row in rows))
    figure = new_figure(3.6 * len(names) + 0.6, 7.2)
    above, below = figure.subplots(2, len(names), squeeze=False, sharey="row", height_ratios=(1.15, 1.0))
    for top, bottom, name in zip(above, below, names, strict=True):
        subset = sorted((row for row in rows if row["modality"] == name), key=lambda row: row["ratio"])
        draw_errors(top, subset)
        draw_changes(bottom, subset)
        top.set_title(name)
    low, high = below[0].get_ylim()  # shared by the panels, so it is widened after all are drawn
    below[0].set_ylim(min(low, -_LEAST_SPAN), max(high, _LEAST_SPAN))
    above[0].set_ylabel("RMSE [% of the range]\nmean ± standard deviation of the runs")
    below[0].set_ylabel("difference of the SR-GAN's RMSE [%]\n95 % interval")
    figure.legend(*above[0].get_legend_handles_labels(), fontsize=9, loc="outside lower center", ncols=5)
    figure.suptitle("; ".join(tally(rows)), fontsize=10)
    return figure


def draw_errors(axes: Axes, rows: Rows) -> None:
    """Draw bars of both models at each ratio, S and P as in P2, baselines across them, and P2's lowest error."""
    for side, (model, letter, colour) in zip((-0.5, 0.5), _MODELS, strict=True):
        x = [k + side * _HALF for k in range(len(rows))]
        heights = [row[f"{model}_percent"] for row in rows]
        widths = [row[f"{model}_percent"] / row[f"{model}_rmse"] * (row[f"{model}_sd"] or np.nan) for row in rows]
        label = f"{letter}: {'SR-GAN' if model == 'srgan' else 'PointNet'}"
        axes.bar(x, heights, _HALF, yerr=widths, capsize=2.5, color=colour, label=label)
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
    """Draw the difference in each cell with its interval, coloured by verdict; P2's is given below where known."""
    for x, row in enumerate(rows):
        colour = _VERDICTS[row["verdict"]]
        axes.plot(x, row["change"], marker="o", color=colour)
        if row["change_low"] is not None:
            axes.plot([x, x], [row["change_low"], row["change_high"]], color=colour, linewidth=2)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.margins(x=0.15)
    published = ["–" if row["p2_change"] is None else f"{row['p2_change']:+.1f}" for row in rows]
    _ticks(axes, rows, published)
    axes.set_xlabel("share without labels (P2's difference [%])")


def _ticks(axes: Axes, rows: Rows, below: Sequence[str] = ()) -> None:
    names = [f"T{row['ratio']}" for row in rows]
    names = [f"{name}\n({text})" for name, text in zip(names, below, strict=True)] if below else names
    axes.set_xticks(range(len(rows)), names)
    axes.grid(visible=True, axis="y", alpha=0.3)
    axes.set_axisbelow(True)

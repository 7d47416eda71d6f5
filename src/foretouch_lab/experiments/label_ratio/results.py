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

from collections.abc import Sequence
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.errors import DatasetError
from foretouch.report.panels import Axes, Rows
from foretouch.tactile import MODALITIES, Ranges
from foretouch.types import Float64
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.label_ratio.training import MODELS
from foretouch_lab.experiments.shared.figures import Line, save_panels
from foretouch_lab.experiments.shared.tables import SIGNS, grouped, pivot, select, unique
from foretouch_lab.learning.evaluation.metrics import ScoreEstimate

# Value of the column `model` for the baseline that is trained on the labelled samples alone.
TREES: Final = "geometry_trees"

# P2, section IV: eq. 1 where its text gives it [%]. The other cells are only in its Fig. 3, without numbers.
P2_CHANGES: Final = {
    "PDC_TH": {30: 0.09, 70: -16.2, 90: -6.2},
    "PDC_MF": {30: 8.8, 50: -7.7, 70: -1.5},
    "E_TH": {30: 1.5, 50: -1.9, 70: -15.2},
    "E_MF": {50: 1.1, 70: 14.5, 90: -31.5},
}

# P2, section IV: lowest RMSE [% of the range], always P30, the PointNet at T30.
P2_LOWEST: Final = {"PDC_TH": 6.37, "E_TH": 5.17, "PDC_MF": 4.83, "E_MF": 6.06}

# Value of the column `srgan` for the trial that was chosen on held-out samples; the others are readings by name.
CHOSEN: Final = "chosen"

_TAIL: Final = 0.025
_COLOURS: Final = ("#8d99ae", "#00798c", "#3d5a80", "#b56576", "#6d597a")  # of the PointNet and of SR-GANs in order
_BASELINES: Final = (("mean", "mean of the labels", "#d1495b"), ("trees", "trees on geometry", "#edae49"))
_LINES: Final = {"mean": "mean of the labels", "trees": "trees on geometry", "pointnet": "PointNet"}
_GROUP: Final = 0.84  # width of all bars of a ratio
_LEAST_SPAN: Final = 5.0  # of the axis of differences to both sides [%]


def compare_models(rows: Sequence[Row], ranges: Ranges, draws: int) -> list[Row]:
    """Return rows of `results.csv`.

    Args:
        rows: Rows of the cells. A run that lacks one of its two networks, because its cell failed, is left out.
        ranges: Ranges whose widths P2's percentages refer to.
        draws: Number of bootstrap samples.

    Raises:
        DatasetError: If the compared models were not tested on the same samples.
    """
    by_run = {(row["ratio"], row["modality"], row["model"], row["seed"]): row for row in rows}
    seeds = sorted(set(unique(rows, "seed")))
    result = []
    for name, ratio in product(MODALITIES, sorted(set(unique(rows, "ratio")))):
        pairs = [[by_run.get((ratio, name, model, seed)) for model in MODELS] for seed in seeds]
        runs = [[row for row in pair if row is not None] for pair in pairs if None not in pair]
        if not runs:
            continue
        first, trees = runs[0][0], by_run.get((ratio, name, TREES, 0))
        tested = [
            {name: own["reference"] for name, own in run["objects"].items()}
            for run in [*chain.from_iterable(runs), trees or first]
        ]
        if any(reference != tested[0] for reference in tested):
            raise DatasetError("label_ratio: the compared models were not tested on the same samples")
        sizes = [len(first["objects"][name]["squared"]) for name in sorted(first["objects"])]
        row: Row = {"modality": name, "ratio": ratio, "runs": len(runs), "samples": sum(sizes)}
        row |= {key: first[key] for key in ("labelled", "updates")}
        pointnet, srgan = (np.array([_samples(run[k], "squared") for run in runs]) for k in range(2))
        low, high = ranges.of(name)
        for model, squared, first_run in zip(MODELS, (pointnet, srgan), runs[0], strict=True):
            rmse = np.sqrt(squared.mean(axis=1))
            deviation, percent = rmse.std(ddof=1) if len(runs) > 1 else None, 100.0 * rmse.mean() / (high - low)
            values = {"trial": first_run["trial"], "rmse": rmse.mean(), "sd": deviation, "percent": percent}
            row |= {f"{model}_{key}": value for key, value in values.items()}
        change, least, most = _change(srgan, pointnet, sizes, draws)
        verdict = ScoreEstimate(-change, -most, -least).verdict if least is not None and most is not None else None
        row |= {"change": change, "change_low": least, "change_high": most, "verdict": verdict}
        row |= {"p2_change": P2_CHANGES[name].get(ratio), "mean_rmse": np.sqrt(np.mean(_samples(first, "reference")))}
        result.append(row | {"trees_rmse": np.sqrt(np.mean(_samples(trees, "squared"))) if trees else None})
    return result


def _change(
    srgan: Float64, pointnet: Float64, sizes: Sequence[int], draws: int
) -> tuple[float, float | None, float | None]:
    """Eq. 1 and its interval from (R, S) squared errors, samples ordered by object; no interval for a single run."""
    each = np.sqrt(srgan.mean(axis=1)) - np.sqrt(pointnet.mean(axis=1))
    scale = 100.0 / float(np.sqrt(pointnet.mean(axis=1)).mean())
    change = scale * float(each.mean())
    if len(each) < 2:
        return change, None, None
    rng = np.random.default_rng(0)
    weights = np.concatenate(
        [rng.multinomial(size, np.full(size, 1.0 / size), draws) for size in sizes], axis=1
    ) / float(sum(sizes))
    drawn = (np.sqrt(weights @ srgan.T) - np.sqrt(weights @ pointnet.T)).mean(axis=1)
    drawn += (each.std(ddof=1) / np.sqrt(len(each))) * rng.standard_t(len(each) - 1, draws)
    low, high = scale * np.quantile(drawn, [_TAIL, 1.0 - _TAIL])
    return change, float(low), float(high)


def _samples(row: Row, what: str) -> list[float]:
    """Return values of all test samples of one network, object by object."""
    return [value for name in sorted(row["objects"]) for value in row["objects"][name][what]]


def summarise_models(rows: Sequence[Row]) -> list[Table]:
    """Return a table of errors and one of differences from the PointNet, with a line for each SR-GAN at each ratio."""
    errors: list[list[str]] = []
    changes: list[list[str]] = []
    for ratio, own in grouped(sorted(rows, key=lambda row: row["ratio"]), "ratio"):
        for name, label in _LINES.items():
            errors += [[f"T{ratio} {label}", *line[1:]] for line in pivot(own, "ratio", partial(_error, name))]
        errors += pivot(own, "srgan", partial(_error, "srgan"), label=f"T{ratio} SR-GAN {{}}".format)
        changes += pivot(own, "srgan", _change_text, label=f"T{ratio} {{}}".format)
    notes = [
        "difference of the SR-GAN's RMSE from the PointNet's [95 % interval, without correction for the number of cells]",
        "▲ SR-GAN significantly better, ▼ significantly worse, = no significant difference",
        f"`{CHOSEN}`: the trial with the lowest error on held-out labelled samples; the others are readings of P2's losses",
    ]
    columns = ["", *MODALITIES]
    return [
        Table("RMSE in counts, mean ± standard deviation over the runs", columns, errors),
        Table("SR-GAN against PointNet [%]", columns, changes, notes),
    ]


def _error(name: str, row: Row, *_: Row) -> str:
    error, deviation = row[f"{name}_rmse"], row.get(f"{name}_sd")
    if error is None:
        return "–"
    return f"{error:.1f}" if deviation is None else f"{error:.1f} ± {deviation:.1f}"


def _change_text(row: Row) -> str:
    text = f"{row['change']:+.1f}"
    if row["verdict"] is None:
        return text
    return f"{text} {SIGNS[row['verdict']]}\n[{row['change_low']:+.1f}, {row['change_high']:+.1f}]"


def draw_models(rows: Rows, folder: Path) -> list[Path]:
    """Draw `figure.png`: P2's Fig. 3 from our rows, modalities side by side, and the differences below."""
    ordered = sorted(rows, key=lambda row: row["ratio"])
    names, models = unique(rows, "modality"), unique(rows, "srgan")
    error, change = "RMSE [% of the range]\nmean ± sd of the runs", "difference of the SR-GAN's RMSE [%]\n95 % interval"
    lines = [
        Line(3.9, ordered, partial(_draw_errors, models), y_label=error, legend=True),
        Line(3.4, ordered, partial(_draw_changes, models), "", "share without labels (P2's difference [%])", change),
    ]
    return save_panels(folder / "figure.png", 3.6 * len(names) + 0.6, lines, modalities=names, sharey="row")


def _draw_errors(models: Sequence[str], axes: Axes, rows: Rows) -> None:
    """Draw bars of all models at each ratio, baselines across them, and P2's lowest error."""
    ratios, width = unique(rows, "ratio"), _GROUP / (1 + len(models))
    firsts = [next(iter(select(rows, ratio=ratio))) for ratio in ratios]
    for number, model in enumerate(["PointNet", *models]):
        own, name = (select(rows, srgan=model), "srgan") if number else (firsts, "pointnet")
        heights = [row[f"{name}_percent"] for row in own]
        spreads = [row[f"{name}_percent"] / row[f"{name}_rmse"] * (row[f"{name}_sd"] or np.nan) for row in own]
        places = [ratios.index(row["ratio"]) + (number + 0.5) * width - _GROUP / 2.0 for row in own]
        label = f"SR-GAN, {model}" if number else model
        axes.bar(places, heights, width, yerr=spreads, capsize=2.0, color=_COLOURS[number % len(_COLOURS)], label=label)
    for (name, label, colour), (k, row) in product(_BASELINES, enumerate(firsts)):
        if row[f"{name}_rmse"] is not None:
            height = row["srgan_percent"] / row["srgan_rmse"] * row[f"{name}_rmse"]
            ends = [k - 0.55 * _GROUP, k + 0.55 * _GROUP]
            axes.plot(ends, [height, height], color=colour, linewidth=2, label=label if k == 0 else None)
    lowest = P2_LOWEST[rows[0]["modality"]]
    axes.axhline(lowest, color="black", linestyle=":", linewidth=1, label="lowest in P2 (its P30), other objects")
    _ticks(axes, [f"T{ratio}" for ratio in ratios])


def _draw_changes(models: Sequence[str], axes: Axes, rows: Rows) -> None:
    """Draw the difference of each SR-GAN in each cell with its interval; P2's is given below where known."""
    ratios = unique(rows, "ratio")
    for row in rows:
        number = 1 + models.index(row["srgan"])
        x = ratios.index(row["ratio"]) + (number + 0.5) * _GROUP / (1 + len(models)) - _GROUP / 2.0
        colour = _COLOURS[number % len(_COLOURS)]
        axes.plot(x, row["change"], marker="o", markersize=4, color=colour)
        if row["change_low"] is not None:
            axes.plot([x, x], [row["change_low"], row["change_high"]], color=colour, linewidth=2)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.plot([0, 0], [-_LEAST_SPAN, _LEAST_SPAN], alpha=0.0)
    axes.margins(x=0.15)
    known = [P2_CHANGES[rows[0]["modality"]].get(ratio) for ratio in ratios]
    published = ["–" if change is None else f"{change:+.1f}" for change in known]
    _ticks(axes, [f"T{ratio}\n({text})" for ratio, text in zip(ratios, published, strict=True)])


def _ticks(axes: Axes, names: Sequence[str]) -> None:
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=True, axis="y", alpha=0.3)
    axes.set_axisbelow(True)

# SPDX-License-Identifier: Apache-2.0
"""The SR-GAN against the PointNet, cell by cell of P2's Fig. 3, with an interval for each difference.

With e_mri the squared error of model m in run r on test sample i, the RMSE of a run is the root of its mean over i, and

    change = 100 (mean_r RMSE_srgan,r - mean_r RMSE_pointnet,r) / mean_r RMSE_pointnet,r     [%]   (1)

It is below 0 where the SR-GAN errs less. Both models have the same test samples and, run by run, the same seed, so
their errors are compared in pairs. Two things are left to chance. Which grasps are tested: they are drawn again with
replacement, within each object, for P2's four objects are all there are; the same draw for both models and all runs.
And the runs: with d_r the difference of a run and s its deviation over R runs, s / √R times a draw from Student's t
with R - 1 degrees of freedom is added, since to draw again out of three or five runs would make them seem more alike
than they are (the variance of such draws is short by (R - 1) / R, and their tails are those of a normal). The
interval is that between the 2.5 and 97.5 percentiles of the sum, over the mean RMSE of the PointNet. It speaks of
these objects, this split and these settings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Row, Table
from foretouch.tactile.modalities import MODALITIES
from foretouch.tactile.ranges import TactileRanges
from foretouch.types import Float64

__all__ = ["P2_AVERAGES", "P2_CHANGES", "P2_LOWEST", "TREES", "compare_models", "summarise", "tally"]

TREES: Final = "geometry_trees"
"""In the column `model`: the baseline that learns from the labelled samples alone."""

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
"""P2, section IV: eq. 1 where its text tells it [%]. The other cells are in its Fig. 3 alone, without numbers."""

P2_LOWEST: Final = {"PDC_TH": 6.37, "E_TH": 5.17, "PDC_MF": 4.83, "E_MF": 6.06}
"""P2, section IV: its lowest RMSE [% of the range], all of P30, the PointNet at T30."""

P2_AVERAGES: Final = {"PDC_TH": 4, "PDC_MF": 4, "E_TH": 3, "E_MF": 1}
"""P2, section IV: ratios out of five at which the SR-GAN's average is the lower one."""

_LEVEL: Final = 0.95
_WIN, _TIE, _LOSS = "win", "tie", "loss"


def compare_models(rows: Sequence[Row], ranges: TactileRanges, draws: int, seed: int = 0) -> list[Row]:
    """The rows of `results.csv`.

    Args:
        rows: Of the cells. A run that lacks one of its two networks, because its cell failed, is left out.
        ranges: Whose widths P2's percents refer to.
        draws: Resamples.
        seed: Of the resamples.

    Raises:
        DatasetError: If those who are compared were not judged on the same samples.
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
    """One cell; `width` of the range [counts]."""
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
    """RMSE [counts] of the mean of the labels that were kept, and of the trees, where they were asked."""
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
    """Of one network, all test samples, object by object."""
    return [value for name in sorted(row["objects"]) for value in row["objects"][name][what]]


def _sizes(runs: Sequence[tuple[Row, Row]]) -> list[int]:
    """Test samples of each object, which all networks must share."""
    told = [{name: len(one["squared"]) for name, one in row["objects"].items()} for run in runs for row in run]
    references = [_samples(row, "reference") for run in runs for row in run]
    if any(one != told[0] for one in told) or any(one != references[0] for one in references):
        raise DatasetError("label_ratio: those who are compared were not judged on the same samples")
    return [told[0][name] for name in sorted(told[0])]


def summarise(rows: Sequence[Row]) -> list[Table]:
    """Rows of `results.csv` as tables of errors, of those of the baselines, and of changes."""
    notes = [
        "change of the SR-GAN's RMSE from the PointNet's [95 % interval]; > win, < loss, = tie",
        *tally(rows),
    ]
    errors = Table(
        "RMSE in counts, PointNet / SR-GAN, mean ± deviation over the runs",
        ["", *MODALITIES],
        list(_body(rows, _errors)),
    )
    baselines = Table(
        "Baselines with the same labels: mean of them / trees on geometry, RMSE in counts",
        ["", *MODALITIES],
        list(_body(rows, _told_baselines)),
    )
    return [
        errors,
        baselines,
        Table("SR-GAN against PointNet [%]", ["", *MODALITIES], list(_body(rows, _told_change)), notes),
    ]


def tally(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Wins, ties and losses by interval, and who is lower by average, which is all that P2 counts."""
    verdicts = [row["verdict"] for row in rows]
    counts = ", ".join(f"{verdicts.count(name)} {plural}" for name, plural in _PLURALS.items())
    lower = sum(row["change"] < 0.0 for row in rows)
    return [
        f"by interval: {counts}",
        f"by average the SR-GAN is lower in {lower} of {len(rows)} cells (P2: {sum(P2_AVERAGES.values())} of 20)",
    ]


_PLURALS: Final = {_WIN: "wins", _TIE: "ties", _LOSS: "losses"}
_SIGNS: Final = {_WIN: ">", _TIE: "=", _LOSS: "<"}


def _body(rows: Sequence[Row], text: Any) -> Iterator[list[str]]:
    for ratio in sorted({row["ratio"] for row in rows}):
        mine = {row["modality"]: row for row in rows if row["ratio"] == ratio}
        yield [f"T{ratio}", *(text(mine[name]) if name in mine else "" for name in MODALITIES)]


def _errors(row: Row) -> str:
    parts = (
        f"{row[f'{name}_rmse']:.1f}" + ("" if row[f"{name}_sd"] is None else f" ± {row[f'{name}_sd']:.1f}")
        for name in ("pointnet", "srgan")
    )
    return " / ".join(parts)


def _told_baselines(row: Row) -> str:
    return f"{row['mean_rmse']:.1f} / " + ("–" if row["trees_rmse"] is None else f"{row['trees_rmse']:.1f}")


def _told_change(row: Row) -> str:
    text = f"{row['change']:+.1f}"
    if row["verdict"] is None:
        return text
    return f"{text} {_SIGNS[row['verdict']]}\n[{row['change_low']:+.1f}, {row['change_high']:+.1f}]"


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 4)

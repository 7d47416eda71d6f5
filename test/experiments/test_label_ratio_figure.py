# SPDX-License-Identifier: Apache-2.0
"""The figure of the label ratios."""

from pathlib import Path

from matplotlib.figure import Figure

from foretouch.experiments.label_ratio.results import draw_changes, draw_errors, draw_label_ratio_figure

ROWS = [
    {
        "modality": "E_TH",
        "ratio": ratio,
        "pointnet_rmse": 80.0,
        "srgan_rmse": 76.0,
        "pointnet_percent": 2.3,
        "srgan_percent": 2.2,
        "mean_rmse": 90.0,
        "trees_rmse": None,
        "pointnet_sd": None,
        "srgan_sd": 1.0,
        "change": -5.0,
        "change_low": -7.0,
        "change_high": high,
        "verdict": verdict,
        "p2_change": None,
    }
    for ratio, high, verdict in ((90, -3.0, "win"), (10, 2.0, "tie"))
]


def test_bars_are_as_high_as_the_errors_in_order_of_the_ratios() -> None:
    axes = Figure().subplots()
    draw_errors(axes, ROWS)
    assert [round(bar.get_height(), 3) for bar in axes.patches] == [2.3, 2.3, 2.2, 2.2]
    assert axes.get_ylim()[0] == 0.0


def test_zero_is_always_seen() -> None:
    axes = Figure().subplots()
    draw_changes(axes, ROWS)
    low, high = axes.get_ylim()
    assert low < -7.0
    assert high >= 5.0
    assert [label.get_text().split("\n")[0] for label in axes.get_xticklabels()] == ["T90", "T10"]


def test_a_file_is_written(tmp_path: Path) -> None:
    (path,) = draw_label_ratio_figure(ROWS, tmp_path)
    assert path.name == "figure.png"
    assert path.stat().st_size > 5000

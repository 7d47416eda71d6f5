# SPDX-License-Identifier: Apache-2.0
"""Readings of grasps over time beside their outcome, and dead taxels in pictures, by what matplotlib is given to draw."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recording_builders import IDENTITY, QUICK, record

from foretouch.cli.main import main
from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import sensor_of_samples
from foretouch.report import touch_figure
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.types import HOLD, REST, Cloud, Sample, TouchSeries

DEAD = BIOTAC_SP.with_dead(np.arange(24) == np.array([[5], [99]]))


def pressed(number: int, stuck: float | None = 800.0) -> Sample:
    """Forty readings without a camera: rest, then every electrode of the thumb falls by ten times its number."""
    made, rng = record(number), np.random.default_rng(number)
    counts = 3000.0 + np.rint(rng.normal(0.0, 3.0, (40, 50)))
    counts[20:, 2:26] -= 10.0 * np.arange(24)
    if stuck is not None:
        counts[:, 2 + 5] = stuck
    stamps = 1_700_000_000_000_000_000 + 10**10 * number + 10_000_000 * np.arange(40)
    phases = np.where(np.arange(40) < 20, REST, HOLD).astype(np.uint8)
    series = TouchSeries(stamps, counts.astype(np.float32), phases)
    return replace(
        made,
        cloud=Cloud(np.empty((0, 3), np.float32)),
        tare=None,
        series=series,
        outcome="failure" if number else "success",
        contact_ns=int(stamps[20]),
    )


def drawn(monkeypatch: pytest.MonkeyPatch, module: Any) -> list[Any]:
    figures: list[Any] = []
    monkeypatch.setattr(module, "save", lambda figure, path, **_: figures.append(figure) or path)
    return figures


def test_a_row_has_the_changes_from_rest_and_the_pads_with_dead_ones_hollow(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = drawn(monkeypatch, touch_figure)
    records = [pressed(number) for number in range(2)]
    touch_figure.save_series_sheet("a.png", records, "two", DEAD)
    axes = figures[0].axes
    assert len(axes) == 2 * 4 + 1  # and the scale
    for number, one in enumerate(records):
        over_time, other, thumb, middle = axes[4 * number : 4 * number + 4]
        assert one.series is not None
        counts = one.series.counts.astype(np.float64)
        expected = np.median(counts[:20], axis=0) - counts
        expected[:, 2 + 5] = np.nan
        shown = np.ma.filled(over_time.collections[0].get_array(), np.nan).reshape(24, 40)
        np.testing.assert_array_equal(shown, expected[:, 2:26].T)
        np.testing.assert_array_equal(
            np.ma.filled(other.collections[0].get_array(), np.nan).reshape(24, 40), expected[:, 26:].T
        )
        assert over_time.get_title(loc="left").endswith(": failure" if number else ": success")
        hollow = [part for part in thumb.collections if not len(part.get_facecolors())]
        assert [part.get_offsets().shape for part in hollow] == [(1, 2)]
        np.testing.assert_array_equal(hollow[0].get_offsets()[0], 1e3 * BIOTAC_SP.layout.unrolled[5])
        assert not [part for part in middle.collections if not len(part.get_facecolors())]
        strongest = over_time.lines[0].get_xdata()[0]
        assert strongest >= 0.0  # seconds from contact
    colours = [axes[4 * number]._left_title.get_color() for number in range(2)]
    assert colours[0] != colours[1]


def test_a_recording_without_a_camera_is_drawn_and_its_dead_taxels_are_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        for number in range(3):
            writer.append(pressed(number))
    samples = open_samples(tmp_path / "ds")
    assert samples.sensor.dead == {}
    assert sensor_of_samples(samples).dead == {"TH": [5]}

    def printed(*words: object) -> Any:
        assert main([str(word) for word in (*words, "--json")]) == 0
        return json.loads(capsys.readouterr().out)

    assert printed("dataset", "show", tmp_path / "ds", "-o", tmp_path / "a.png")["dead_taxels"] == {"TH": [5]}
    with Image.open(tmp_path / "a.png") as image:
        assert len(image.convert("RGB").getcolors(1 << 24)) > 100
    exported = printed(
        "dataset", "export", tmp_path / "ds", "-o", tmp_path / "out", "--format", "lerobot", "--fps", "10"
    )
    assert (exported["samples"], exported["left_out"]) == (3, {})
    features = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]
    assert not {"action", "observation.pointcloud"} & features.keys()  # no camera, so no grasp
    assert (
        main(["dataset", "export", str(tmp_path / "ds"), "-o", str(tmp_path / "npz"), "--format", "npz", "--fps", "3"])
        == 1
    )
    assert "--fps: npz has no frames" in capsys.readouterr().err

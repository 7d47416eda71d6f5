# SPDX-License-Identifier: Apache-2.0
"""Recordings without a camera: their picture, their dead taxels, and what is exported of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recording_builders import IDENTITY, QUICK, record

from foretouch.cli.main import main
from foretouch.dataset.record import HOLD, REST, SampleRecord, TouchSeries
from foretouch.dataset.recording.writer import RecordingWriter
from foretouch.dataset.samples import open_samples, sensor_of_samples
from foretouch.types import Cloud


def pressed(number: int) -> SampleRecord:
    """Forty readings without a camera: rest, then every electrode of the thumb falls by ten times its number."""
    made, rng = record(number), np.random.default_rng(number)
    counts = 3000.0 + np.rint(rng.normal(0.0, 3.0, (40, 50)))
    counts[20:, 2:26] -= 10.0 * np.arange(24)
    counts[:, 2 + 5] = 800.0
    stamps = 1_700_000_000_000_000_000 + 10**10 * number + 10_000_000 * np.arange(40)
    phases = np.where(np.arange(40) < 20, REST, HOLD).astype(np.uint8)
    series = TouchSeries(stamps, counts.astype(np.float32), phases)
    sample = replace(made.sample, cloud=Cloud(np.empty((0, 3), np.float32)), tare=None)
    return replace(made, sample=sample, series=series, contact_ns=int(stamps[20]))


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

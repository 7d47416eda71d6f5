# SPDX-License-Identifier: Apache-2.0
"""Writes to a file system that is really full, a tmpfs: nothing half-written is left, and what was written before is kept.

The recorder's is in `test/dataset/recordings/test_writer.py`.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from calibrated_models import make_tracked_calibration
from contact_model_builders import small_estimator
from every_case import every_case
from experiment_samples import make_samples
from recording_builders import write_dataset
from run_builders import quiet, run_config, stop_after, write_store

from benchmarks.random_scenes import random_scene
from foretouch.cli.main import main
from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.formats import exported_formats
from foretouch.errors import FileError
from foretouch.models.history_keeper import HistoryFile
from foretouch.models.touch_model import History, TouchModel
from foretouch.types import Cloud
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.training.run import train_run

SIZE = 1 << 20
CARD = {"name": "small", "sha256": "0" * 64}


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB."""
    path = tmp_path / "disk"
    path.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", path], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a small file system cannot be mounted here: {mounted.stderr.strip()}")
    yield path
    subprocess.run(["umount", "-l", path], check=True)


def fill(disk: Path, left: int) -> Path:
    """Fill it but for so many bytes, rounded down to pages; returns the file."""
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            file.truncate(max(0, file.tell() - left))
    return ballast


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "ballast"}


def test_a_hand_history_keeps_what_was_written(disk: Path) -> None:
    samples = make_samples(3, 3)
    model = TouchModel(small_estimator(), CARD, make_tracked_calibration())
    history, file = History(model), HistoryFile(disk / "right.safetensors", "right")

    def read(count: int) -> None:
        for sample in samples[:count]:
            history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=True)

    read(1)
    file.write(history)
    before, ballast = files_of(disk), fill(disk, 0)
    read(3)
    with pytest.raises(
        FileError, match=r"right\.safetensors: cannot be written, the one before is kept: No space left"
    ):
        file.write(history)
    assert files_of(disk) == before
    assert file.read(model) is not None
    ballast.unlink()
    file.write(history)
    assert files_of(disk) != before


def test_a_run_folder_keeps_its_last_state_and_resumes(disk: Path, tmp_path: Path) -> None:
    chosen, run = run_config(), disk / "run"
    data = load_dataset(write_store(tmp_path / "store", make_samples(4, 8)))
    whole = train_run(chosen, data, tmp_path / "whole", quiet)
    with pytest.raises(KeyboardInterrupt):
        train_run(chosen, data, run, stop_after(1))
    before, ballast = files_of(run), fill(disk, 0)
    with pytest.raises(FileError, match="cannot be written, the one before is kept: No space left") as caught:
        train_run(chosen, data, run, quiet, resume=True)
    assert "\n" not in str(caught.value)
    assert files_of(run) == before
    ballast.unlink()
    resumed = train_run(chosen, data, run, quiet, resume=True)
    assert resumed.with_suffix(".safetensors").read_bytes() == whole.with_suffix(".safetensors").read_bytes()


def test_an_export_or_a_build_that_does_not_fit_leaves_nothing(disk: Path, tmp_path: Path, capsys) -> None:
    write_dataset(tmp_path / "ds", 12, points=12_000)
    names = exported_formats()
    assert len(names) >= 3
    commands = {name: ["dataset", "export", "--format", name] for name in names} | {"store": ["dataset", "build"]}

    def check(words: list[str]) -> None:
        status = main([*words, str(tmp_path / "ds"), "-o", str(disk / "out")])
        error = capsys.readouterr().err
        assert (status, error.count("\n")) == (1, 1), error
        assert str(disk) in error
        assert "No space left on device" in error
        assert list(disk.iterdir()) == []

    every_case(commands, check)


def test_labels_and_clouds_that_do_not_fit_leave_nothing_or_the_file_before(disk: Path, tmp_path: Path, capsys) -> None:
    image = random_scene(np.random.default_rng(3), width=424, height=240, n_objects=2).render()
    write_cloud(tmp_path / "scene.npz", image.cloud())
    labels, before = disk / "labels.npy", disk / "before.npz"
    write_cloud(before, Cloud(np.ones((4, 3), np.float32)))
    kept, _ = before.read_bytes(), fill(disk, 40_000)
    assert main(["segment", str(tmp_path / "scene.npz"), "--labels-out", str(labels)]) == 1
    assert "labels.npy: cannot be written, the one before is kept: No space left" in capsys.readouterr().err
    with pytest.raises(FileError, match=r"before\.npz: cannot be written"):
        write_cloud(before, image.cloud())
    assert before.read_bytes() == kept
    assert {path.name for path in disk.iterdir()} == {"ballast", "before.npz"}


def test_a_view_that_does_not_fit_is_refused_before_the_disk_is_full(disk: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip("rerun", reason="Rerun is not installed")
    write_cloud(tmp_path / "object.npz", Cloud(np.random.default_rng(1).normal((0, 0, 0.5), 0.02, (900, 3))))
    assert main(["view", str(tmp_path / "object.npz"), "--save", str(disk / "view.rrd")]) == 1
    error = capsys.readouterr().err
    assert "view.rrd: cannot be written: 1 MB of the disk are free, 100 are needed" in error
    assert list(disk.iterdir()) == []

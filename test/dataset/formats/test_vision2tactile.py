# SPDX-License-Identifier: Apache-2.0
"""Reader of the public recordings: on a made-up folder for its rules, on the real one for its contents."""

from pathlib import Path

import numpy as np
import pytest
from every_case import every_case
from numpy.testing import assert_allclose
from recording_builders import MF, TH, read_folder, write_sample

from foretouch.dataset.formats.vision2tactile import folder_sha256
from foretouch.errors import FileError


@pytest.fixture
def folder(tmp_path: Path, rng) -> Path:
    for name in ("mug/1562000060", "mug/1562000000", "box/1563000000"):
        write_sample(tmp_path / name, rng)
    return tmp_path


def test_fields_are_where_the_recordings_hold_them(folder: Path) -> None:
    (sample,) = read_folder(folder / "mug" / "1562000000")
    assert (sample.id, sample.object) == ("mug/1562000000", "mug")
    assert sample.stamp_ns == sample.cloud.stamp_ns == 1_562_000_000_000_000_000
    assert (sample.touch["PDC_MF"][0], sample.touch["PDC_TH"][0]) == (1894.0, 2876.0)
    assert_allclose(sample.touch["E_MF"], np.arange(3000, 3024))
    assert_allclose(sample.touch["E_TH"], np.arange(2000, 2024))
    assert sample.extra == {
        "PAC0_MF": 2048, "PAC1_MF": 2052, "TAC_MF": 2257, "TDC_MF": 2636,
        "PAC0_TH": 2060, "PAC1_TH": 2055, "TAC_TH": 2058, "TDC_TH": 2459,
    }  # fmt: skip
    rotation = sample.grasp.rotation
    assert_allclose(rotation[:, 2], [1, 0, 0])  # Z along g1 - g2
    assert abs(rotation[1, 0]) < 0.05  # X is perpendicular to Z and to the axis, here y
    assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)


def test_one_sample_one_object_or_everything_and_a_hash_of_the_contents_alone(folder: Path) -> None:
    assert [s.id for s in read_folder(folder)] == ["box/1563000000", "mug/1562000000", "mug/1562000060"]
    assert [s.id for s in read_folder(folder / "mug")] == ["mug/1562000000", "mug/1562000060"]
    before = folder_sha256(folder)
    folder = folder.rename(folder.with_name(f"{folder.name}-moved"))
    assert folder_sha256(folder) == before
    (folder / "box" / "1563000000" / "best-grasp.txt").write_text("0.03,0,1.2,-0.03,0,1.201")
    assert folder_sha256(folder) != before
    path = folder / "box" / "1563000000"
    for name in ("yesterday", "grasp 7", "99999999999", "9" * 200, "١٢"):  # no times
        path = path.rename(path.with_name(name))
        (sample,) = read_folder(folder / "box")
        assert (sample.id, sample.stamp_ns) == (f"box/{name}", 0)


def test_bad_files_and_folders_are_named(folder: Path) -> None:
    def check(name: str, text: str | None, message: str) -> None:
        path = folder / "mug" / "1562000000" / name
        good = path.read_bytes()
        path.unlink() if text is None else path.write_text(text)
        with pytest.raises(FileError, match=message):
            read_folder(folder)
        path.write_bytes(good)

    rest = ",".join(map(str, MF[1:] + TH))
    cases = [
        ("tactile.tac", ",1,2,3", r"tactile.tac: holds 3 numbers, not 58"),
        ("tactile.tac", f"1_0,{rest}", "tactile.tac: is not a list of numbers: .*'1.0'"),
        ("tactile.tac", f"nan,{rest}", "tactile.tac: number 1: nan is not finite"),
        ("tactile.tac", "\u00e9", "tactile.tac: cannot be read as text"),
        ("best-grasp.txt", "1,2,3", "best-grasp.txt: holds 3 numbers, not 6"),
        ("best-grasp.txt", "1,2,3,inf,5,6", "best-grasp.txt: number 4: inf is not finite"),
        ("best-grasp.txt", "1,2,3,1,2,3", "best-grasp.txt: g1 - g2"),
        ("best-grasp.txt", None, "best-grasp.txt: is missing"),
        ("cloud-object.pcd", None, "cloud-object.pcd"),
    ]
    every_case(cases, check)
    (folder / "empty").mkdir()
    with pytest.raises(FileError, match="empty: is not a dataset"):
        read_folder(folder / "empty")


@pytest.mark.real_data
def test_real_samples_lie_in_the_measured_bounds(real_data: Path) -> None:
    everything = read_folder(real_data / "vision2tactile")
    assert (len(everything), len({sample.object for sample in everything})) == (400, 8)
    samples = [sample for sample in everything if sample.object == "rugby"]
    assert len(samples) == 50
    for sample in samples:
        assert 1637 <= sample.touch["PDC_MF"][0] <= 2246
        assert 2546 <= sample.touch["PDC_TH"][0] <= 3360
        assert sample.touch["E_MF"].min() >= 569
        assert 0.026 <= sample.grasp.width_m <= 0.121
        gap = np.linalg.norm(sample.cloud.xyz - sample.grasp.g1, axis=1).min()
        assert gap < 1e-4  # contacts are points of the cloud

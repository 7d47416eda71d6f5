# SPDX-License-Identifier: Apache-2.0
"""Damaged and hostile files of every kind: one line that names file and rule, after little work, and in little memory."""

import io
import json
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated_models import save_calibrated_contact
from counted_work import calls_at_most
from every_case import every_case
from recording_builders import readable

from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import load_yaml, parse_overrides
from foretouch.dataset.formats import open_samples
from foretouch.dataset.source import open_source
from foretouch.dataset.store import Store
from foretouch.errors import ConfigError, ForetouchError
from foretouch.models.card import read_card
from foretouch.models.registry import load_model
from foretouch.pipeline import PipelineConfig
from foretouch.types import Cloud

DIGITS = "9" * 4400
MOST_CALLS = 300_000  # of functions, for a file
PCD = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary\n"
PLY = (
    "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    "end_header\n"
)
POINTS = np.zeros((2, 3), np.float32).tobytes()


def npy(header: str, body: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    """A .npy file with a header of free text."""
    text = header.encode("latin1") + b"\n"
    size = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + size + text + body


def npz(content: bytes) -> bytes:
    """An archive with one member."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xyz.npy", content)
    return buffer.getvalue()


def damaged_stream(content: bytes) -> bytes:
    """The archive with other bytes in the middle of its compressed data."""
    changed = bytearray(content)
    start = content.index(b"xyz.npy") + 7
    changed[start : start + 12] = b"\xff" * 12
    return bytes(changed)


GOOD_NPY = npy("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3)}", POINTS)
HUGE = "{'descr': '<f4', 'fortran_order': False, 'shape': (%s, 3)}"
CLOUDS: dict[str, tuple[str, bytes]] = {
    "pcd width of 4400 digits": (".pcd", PCD.replace("WIDTH 2", f"WIDTH {DIGITS}").encode() + POINTS),
    "pcd count 2e9": (".pcd", PCD.replace("FIELDS x y z", "FIELDS x y z a").replace("SIZE", "SIZE 4").replace("TYPE", "TYPE F").replace("COUNT 1 1 1", "COUNT 1 1 1 2000000000").encode() + POINTS),
    "pcd width 4e9, height 4e9": (".pcd", PCD.replace("WIDTH 2", "WIDTH 4000000000").replace("HEIGHT 1", "HEIGHT 4000000000").replace("POINTS 2\n", "").encode() + POINTS),
    "pcd ascii word of 1e6 digits": (".pcd", PCD.replace("binary", "ascii").encode() + b"1 2 3 4 5 " + b"7" * 1_000_000 + b"x\n"),
    "pcd compressed declares 4 GB": (".pcd", PCD.replace("binary", "binary_compressed").replace("WIDTH 2", "WIDTH 357913941").replace("POINTS 2\n", "").encode() + struct.pack("<II", 8, 4294967292) + bytes(8)),
    "ply vertices of 4400 digits": (".ply", PLY.replace("vertex 2", f"vertex {DIGITS}").encode() + POINTS),
    "ply 1e10 vertices": (".ply", PLY.replace("vertex 2", "vertex 10000000000").encode() + POINTS),
    "npy declares 1 GB": (".npy", npy(HUGE % 100_000_000, bytes(1_000_000))),
    "npy shape of 4400 digits": (".npy", npy(HUGE % DIGITS, bytes(100))),
    "npy deep brackets, version 2": (".npy", npy("(" * 200000, version=(2, 0))),
    "npy header of 4 GB": (".npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1) + b"{}"),
    "npy descr of objects": (".npy", npy("{'descr': '|O', 'fortran_order': False, 'shape': (2, 3)}", bytes(100))),
    "npz damaged stream": (".npz", damaged_stream(npz(GOOD_NPY * 20))),
    "npz truncated": (".npz", npz(GOOD_NPY)[:-30]),
    "npz zeros of 300 MB": (".npz", npz(npy(HUGE % 25_000_000, bytes(300_000_000)))),
}  # fmt: skip


def refused(call: Callable[[], Any], name: str) -> str:
    """The message of the refusal, which must be one line that names the file, of at most 1000 characters."""
    with pytest.raises(ForetouchError) as caught, calls_at_most(MOST_CALLS):
        call()
    message = str(caught.value)
    assert name in message
    assert "\n" not in message
    assert len(message) < 1000
    return message


def test_hostile_clouds_are_refused_with_little_work_and_memory_and_cost_one_item_of_a_folder(tmp_path: Path) -> None:
    def check(suffix: str, content: bytes) -> None:
        path = tmp_path / f"cloud{suffix}"
        path.write_bytes(content)
        tracemalloc.start()
        try:
            refused(lambda: read_cloud(path), path.name)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < 10 * len(content) + 2_000_000

    every_case(CLOUDS, check)
    for k, (suffix, content) in enumerate(CLOUDS.values()):  # each costs one item of a folder
        if len(content) < 100_000:
            (tmp_path / f"{k}{suffix}").write_bytes(content)
    os.mkfifo(tmp_path / "fifo.pcd")
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "loop.npy").symlink_to("loop.npy")
    write_cloud(tmp_path / "good.pcd", Cloud(np.ones((4, 3), np.float32)))
    reasons: list[str] = []
    found = [name for name, _ in readable(open_source(tmp_path), lambda name, err: reasons.append(str(err)))]
    assert found == [str(tmp_path / "good.pcd")]
    assert len(reasons) > 12


READERS: dict[str, Callable[[Path], Any]] = {
    "yaml": load_yaml,
    "card": read_card,
    "store": lambda path: Store(path.parent),
    "samples": lambda path: open_samples(path.parent),
}


YAML = {
    "alias bomb": "a: &a [x, x, x, x, x, x, x, x, x]\n"
    + "".join(f"{y}: &{y} [{', '.join([f'*{x}'] * 9)}]\n" for x, y in pairwise("abcdefghijk")),
    "merge bomb": "a: &a {x: 1}\n"
    + "".join(f"{y}: &{y} {{<<: [{', '.join([f'*{x}'] * 9)}]}}\n" for x, y in pairwise("abcdefghijk")),
    "deep brackets": "a: " + "[" * 10_000,
    "deep indents": "".join(" " * k + "a:\n" for k in range(500)),
    "odd date": "a: 2026-13-45\n",
    "NUL": "a: \0\n",
    "number of 400 digits": f"range_m: {'9' * 400}\n",
    "list as key": "? [a, b]\n: 1\n",
    "word as number": "a: !!int x\n",
    "python object": "a: !!python/object/apply:os.system [ls]\n",
    "2 MB": "a: 1\n" + "# x\n" * 500_000,
    "a number and a group": "1: 5\n'1': {a: 2}\n",
    "surrogate": 'range_m: "\\ud800"\n',
}


def test_hostile_yaml_and_overrides_are_refused_with_little_work_and_aliases_of_usual_size_are_read(
    tmp_path: Path,
) -> None:
    path = tmp_path / "settings.yaml"

    def check(text: str) -> None:
        path.write_text(text.replace("range_m:", "segmentation.crop.max_range_m:"), encoding="utf-8")
        refused(lambda: PipelineConfig.from_mapping(load_yaml(path), str(path)), "settings.yaml")

    every_case(YAML, check)
    path.write_text("a: &a {x: 1, y: [2, 3]}\nb: {<<: *a, x: 4}\nc: *a\n")
    assert load_yaml(path) == {"a": {"x": 1, "y": [2, 3]}, "b": {"x": 4, "y": [2, 3]}, "c": {"x": 1, "y": [2, 3]}}
    for text in ("2026-13-45", "[" * 5000, "9" * 5000, "&a [*a]", "\0", "!!int x"):
        with pytest.raises(ConfigError, match=r"^key: .*YAML") as caught:
            parse_overrides([f"key={text}"])
        assert len(str(caught.value)) < 1000


JSON_TEXTS = {
    "deep lists": "[" * 100_000,
    "closed objects": '{"format": "foretouch-model", "x": ' * 100 + "1" + "}" * 100,
    "number of 5000 digits": '{"format": ' + "9" * 5000 + "}",
    "not UTF-8": "\udcff",
    "empty": "",
    "NUL": "\0",
    "70 MB": " " * 70_000_000,
}


def test_hostile_json_is_refused_with_little_work(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"

    def check(text: str) -> None:
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
        for reader in ("card", "store", "samples"):
            refused(lambda reader=reader: READERS[reader](path), tmp_path.name)

    every_case(JSON_TEXTS, check)


LONG = "n" * 5000


def test_fields_of_a_card_have_a_type_and_bounds(tmp_path: Path) -> None:
    path = Path(save_calibrated_contact(tmp_path))
    card = json.loads(path.read_text())
    regimes = {"known": {"objects": 8, "coverage": {"PDC_TH": {"mean": 0.9}}}}
    card |= {"skill": {"random": {"PDC_TH": {"skill": 0.5}}}, "data": {"samples": 400}, "split": {"train": 400}}
    card["calibration"] |= {"level": 0.9, "regimes": regimes}
    path.write_text(json.dumps(card))
    load_model(path)  # so good
    absurd = (LONG, ["x"] * 50_000, 10**400, "a\0b", "../..")
    numbers = {
        "skill.random.PDC_TH.skill": (True, "7", 1e20, 10**30),
        "data.samples": (True, -5, 0.5),
        "calibration.level": ("7", 1.5),
        "calibration.regimes.known.coverage.PDC_TH.mean": (True, 1e20),
    }
    files = ("weights", "sha256", "calibration", "kind", "format_version", "calibration.weights")

    def check(place: str, value: Any, named: str) -> None:
        changed = json.loads(json.dumps(card))
        *groups, last = place.split(".")
        reduce(dict.__getitem__, groups, changed)[last] = value
        path.write_text(json.dumps(changed))
        refused(lambda: load_model(path), named)

    every_case([(place, value, place) for place, values in numbers.items() for value in values], check)
    every_case([(place, value, tmp_path.name) for place in files for value in absurd], check)
    for text in ("NaN", "Infinity", "-Infinity", "1e999"):
        path.write_text(json.dumps(card).replace("0.5", text))
        refused(lambda: load_model(path), "is not a number that can be used")

# SPDX-License-Identifier: Apache-2.0
"""Every option that takes a path, with what is no such file: one line, after little work, and nothing is changed."""

import io
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_answer import Answer
from every_case import every_case
from PIL import Image

from foretouch.cli.commands import COMMANDS
from foretouch.cli.main import command_parser

PATHS = {"IN", "DS", "SRC", "FILE", "YAML", "NAME|YAML", "F|sample", "PATH", "SCENE", "CONFIG", "MODEL", "DATASET", "SENSOR", "HAND"} | {
    "DIR|FILE|SCENE|TOPIC|camera"
}  # fmt: skip
"""What help calls an argument that is the path of something that is read."""

SCENES = (".png", ".tif", ".npy", ".npz", ".pcd", ".ply", ".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd", "")
CAMERAS = (".yaml", ".json", ".mat", ".txt", ".xml")
MASKS = (".png", ".tif", ".npy", ".npz")
YAML = (".yaml", "")
READ: dict[tuple[str, str], tuple[str, tuple[str, ...]]] = {
    ("segment", "inputs"): ("segment {}", SCENES),
    ("segment", "--config"): ("segment {depth} --config {}", YAML),
    ("segment", "--camera-info"): ("segment {image} --camera-info {}", CAMERAS),
    ("segment", "--mask"): ("segment {depth} --mask {}", MASKS),
    ("grasp", "--hand"): ("grasp {depth} --hand {}", YAML),
    ("predict", "inputs"): ("predict {}", SCENES),
    ("predict", "--model"): ("predict {depth} --model {}", (".json", ".safetensors", "")),
    ("predict", "--tare"): ("predict {depth} --tare {}", (".json", ".tac")),
    ("predict", "--touched"): ("predict {depth} --touched {}", (".mcap", "")),
    ("predict", "--history"): ("predict {depth} --history {}", (".safetensors", "")),
    ("simulate", "scene"): ("simulate {} --explain", YAML),
    ("dataset info", "path"): ("dataset info {}", ("", ".mcap", ".db3")),
    ("dataset verify", "paths"): ("dataset verify {}", ("", ".mcap")),
    ("dataset repair", "paths"): ("dataset repair {}", ("", ".mcap")),
    ("dataset edit", "path"): ("dataset edit {}", ("",)),
    ("dataset build", "sources"): ("dataset build {} -o {out}", ("",)),
    ("dataset import", "source"): ("dataset import {} -o {out}", ("", ".mcap", ".bag", ".db3.zstd")),
    ("dataset export", "source"): ("dataset export {} --format npz -o {out}", ("", ".mcap")),
    ("dataset show", "source"): ("dataset show {} -o {out}.png", ("", ".mcap")),
    ("train", "config"): ("train {} -o {out}", YAML),
    ("evaluate", "model"): ("evaluate {} {out}", (".json",)),
    ("evaluate", "dataset"): ("evaluate contact-v3 {}", ("",)),
    ("experiment", "--data"): ("experiment prequential --data {} -o {out}", ("",)),
    ("models", "models"): ("models {}", (".json", ".safetensors")),
    ("sensor check", "descriptions"): ("sensor check {}", YAML),
    ("sensor check", "--against"): ("sensor check biotac_sp --against {}", ("",)),
    ("hand check", "descriptions"): ("hand check {}", YAML),
    ("view", "path"): ("view {} --save {out}.rrd", SCENES),
}
SLOW = {"predict", "evaluate", "train", "view", "experiment", "models"}  # commands that load a model first
OTHER_LINES = (
    "dataset verify",
    "models",
    "view",
)  # lists all faults; a table of models; also that nothing is left to show
OF_THE_USER = ("--config", "train")  # settings, which no message names
ACCEPTED = {"segment {depth} --config {}": ("empty",), "dataset edit {}": ("empty",)}
"""What is no wrong file for some."""

SAME = {  # read by the same code as above
    ("grasp", "inputs"): ("segment", "inputs"),
    **{(command, "--config"): ("segment", "--config") for command in ("grasp", "predict", "view")},
    **{(command, "--camera-info"): ("segment", "--camera-info") for command in ("grasp", "predict", "view", "run", "replay")},
    **{(command, "--mask"): ("segment", "--mask") for command in ("grasp", "predict")},
    **{(command, "--hand"): ("grasp", "--hand") for command in ("predict", "view", "run")},
    **{("view", option): ("predict", option) for option in ("--tare", "--touched", "--history")},
    **{(command, "--sensor"): ("sensor check", "descriptions") for command in ("dataset import", "record")},
    ("sensor show", "descriptions"): ("sensor check", "descriptions"),
    ("hand show", "descriptions"): ("hand check", "descriptions"),
    ("run", "--source"): ("segment", "inputs"),
    ("replay", "path"): ("segment", "inputs"),
    ("run", "--params"): ("segment", "--config"),
    ("record", "--params"): ("segment", "--config"),
    **{(command, "--data"): ("experiment", "--data") for command in ("tradeoff", "benchmark")},
}  # fmt: skip


def declared() -> set[tuple[str, str]]:
    """Every option that takes the path of something that is read, by command."""
    found = set()
    for name in (one for one in COMMANDS if "." not in one):
        parser = command_parser(name).commands[name]
        for full, one in (
            {name: parser} | {f"{name} {action}": one for action, one in parser.commands.items()}
        ).items():
            names = {(action.option_strings or [action.dest])[-1] for action in one.declared if action.metavar in PATHS}
            found |= {(full, option) for option in names - {"--picture", "--out"}}
    return found


def test_every_option_that_takes_a_path_is_walked() -> None:
    assert declared() - READ.keys() - SAME.keys() == set()
    assert all(other in READ for other in SAME.values())


def eps(folder: Path) -> bytes:
    """A program for Ghostscript that leaves a file."""
    left = folder / "ghostscript"
    return f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n({left}) (w) file closefile\nshowpage\n".encode()


def png(width: int, height: int, before: bytes = b"") -> bytes:
    """A PNG of zeros of 16 bits that claims a size, with other chunks before its header."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">2I5B", width, height, 16, 0, 0, 0, 0)
    rows = zlib.compress(bytes(min(height, 300) * (2 * width + 1)))
    return b"\x89PNG\r\n\x1a\n" + before + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def bomb() -> bytes:
    """An archive of a few kilobytes whose mask has gigabytes."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("mask.npy", "w") as member:
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": "<i8", "fortran_order": False, "shape": (2**14, 2**11)})
        member.write(head.getvalue())
        for _ in range(64):
            member.write(bytes(2**22))
    return content.getvalue()


ALIASES = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{y}: &{y} [{', '.join([f'*{x}'] * 9)}]\n" for x, y in pairwise("abcdefghijk")
)
HUGE_NPY = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000)}".ljust(117)
    + b"\n"
)


def wrong(folder: Path) -> dict[str, Callable[[Path], Any]]:
    """What makes each wrong file."""
    good = io.BytesIO()
    Image.fromarray(np.full((240, 320), 900, np.uint16)).save(good, "PNG")
    contents = {
        "empty": b"",
        "zeros": bytes(5000),
        "truncated PNG": good.getvalue()[:-40],
        "EPS": eps(folder),
        "archive bomb": bomb(),
        "array of 10^12": HUGE_NPY,
        "large PNG": png(13_000, 13_000),
        "deep JSON": b"[" * 100_000,
        "aliases": ALIASES.encode(),
        "400 digits": f"K: [{'9' * 400}, 1, 1, 1]\nwidth: .inf\nname: {'9' * 400}\n".encode(),
        "secret": b"root:*:20228:0:99999:7:::\n",
    }
    return {
        **{name: lambda path, content=content: path.write_bytes(content) for name, content in contents.items()},
        "FIFO": os.mkfifo,
        "device": lambda path: path.symlink_to("/dev/zero"),
        "folder": Path.mkdir,
        "absent": lambda path: None,
    }


@pytest.fixture
def walk(tmp_path: Path, call: Callable[..., Answer]) -> Callable[[str, str, str], None]:
    """Call a command with a wrong file of a name."""
    np.savez(tmp_path / "depth.npz", depth=np.full((60, 80), 900, np.uint16), K=[70.0, 70.0, 39.5, 29.5])
    Image.fromarray(np.full((60, 80), 900, np.uint16)).save(tmp_path / "image.png")
    makers, numbers = wrong(tmp_path), count()
    known = {"depth": tmp_path / "depth.npz", "image": tmp_path / "image.png", "out": tmp_path / "out"}

    def check(words: str, suffix: str, kind: str) -> None:
        path = tmp_path / f"{kind.replace(' ', '-')}{next(numbers)}{suffix}"
        makers[kind](path)
        before = path.lstat().st_mtime_ns if os.path.lexists(path) else None
        answer = call(*[word.format(path, **known) for word in words.split()])
        if kind in ACCEPTED.get(words, ()):
            return
        assert answer.status == 1, answer
        lines = answer.err.splitlines()
        assert len(lines) == 1 or words.startswith(OTHER_LINES), answer
        assert all(line.startswith("foretouch: ") for line in lines), answer.err
        assert len(answer.err) < 2500
        assert "20228" not in answer.err or any(one in words for one in OF_THE_USER)  # of the secret
        assert "internal" not in answer.err
        assert kind == "folder" or (path.lstat().st_mtime_ns if os.path.lexists(path) else None) == before
        assert not (tmp_path / "ghostscript").exists()

    return check


@pytest.mark.slow
@pytest.mark.parametrize("option", READ, ids=" ".join)
def test_a_file_that_is_no_such_file_is_refused_in_one_line(option, walk, tmp_path) -> None:
    words, suffixes = READ[option]
    if option[0] == "view":
        pytest.importorskip("rerun", reason="Rerun is not installed")
    suffixes = suffixes if os.environ.get("FORETOUCH_FUZZ") and option[0] not in SLOW else suffixes[:1]
    every_case([(words, suffix, kind) for suffix in suffixes for kind in wrong(tmp_path)], walk)


def test_what_would_wait_start_a_program_or_tell_a_secret_is_refused_for_every_kind_of_option(walk) -> None:
    quick = {words: suffixes[0] for (command, _), (words, suffixes) in READ.items() if command not in SLOW}
    slow = {"predict {}": ".npz", "view {} --save {out}.rrd": ".ply"}  # by what loads a model or Rerun first
    cases = [
        *((*case, kind) for case in quick.items() for kind in ("FIFO", "EPS", "secret")),
        *((*case, "FIFO") for case in slow.items()),
    ]
    every_case(cases, walk)


def test_a_name_that_no_file_can_have_is_refused_in_one_line(call: Callable[..., Answer], tmp_path: Path) -> None:
    np.savez(tmp_path / "depth.npz", depth=np.full((60, 80), 900, np.uint16), K=[70.0, 70.0, 39.5, 29.5])

    def check(words: str, suffix: str) -> None:
        name = "a" * 5000 + suffix
        answer = call(
            *[
                word.format(name, depth=tmp_path / "depth.npz", image=tmp_path / "depth.npz", out=tmp_path / "out")
                for word in words.split()
            ]
        )
        assert (answer.status, answer.err.count("\n")) == (1, 1), answer.err[-500:]
        assert len(answer.err) < 2500

    every_case([(words, suffixes[0]) for (command, _), (words, suffixes) in READ.items() if command not in SLOW], check)

# SPDX-License-Identifier: Apache-2.0
"""Files that are consistent and wrong: nothing is overwritten, nothing hangs, and each is refused by name."""

import fcntl
import os
import re
import shutil
import stat
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case, every_refusal
from PIL import Image
from recording_builders import write_dataset

from foretouch.base.files import FileBytes, read_bytes, replace_files, require_schema, require_writable
from foretouch.cli.main import main
from foretouch.cli.output import print_table, warn
from foretouch.cloud.io.depth_files import camera_facts
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import dump_yaml, load_yaml, parse_overrides
from foretouch.dataset.recordings.editing import drop
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.source import open_source
from foretouch.errors import ConfigError, FileError, ForetouchError
from foretouch.models.history_keeper import HistoryFile
from foretouch.report.panels import new_figure, save_small
from foretouch.report.rerun_view import write_view
from foretouch.ros.runtime.environment import stale_bytes
from foretouch.types import Cloud
from foretouch_lab.experiments.framework.manifest import open_folder, write_manifest


def test_nothing_is_written_through_links_and_second_names_of_other_files(tmp_path: Path) -> None:
    victim, dataset = tmp_path / "victim", tmp_path / "ds"
    victim.write_text("precious")
    write_dataset(dataset, 1)
    cases = {
        "dataset/.lock": (dataset / ".lock", lambda: repair_dataset(dataset)),
        "dataset/edits.jsonl": (dataset / "edits.jsonl", lambda: drop(dataset, ["ball/000001"])),
        "run/x.part": (tmp_path / "x.part", lambda: replace_files({tmp_path / "x": b"new"})),
        "history.lock": (tmp_path / "h.lock", lambda: HistoryFile(tmp_path / "h", "right")),
        "view.rrd.part": (tmp_path / "view.rrd.part", lambda: write_view(tmp_path / "view.rrd", [], "x")),
    }

    def check(path: Path, write: Callable[[], object]) -> None:
        for make in (lambda: path.symlink_to(victim), lambda: os.link(victim, path), lambda: os.mkfifo(path)):
            path.unlink(missing_ok=True)
            make()
            with suppress(ForetouchError) if path.suffix == ".part" else pytest.raises(FileError, match=path.name):
                write()  # temporary files have other names
            assert victim.read_text() == "precious"
        path.unlink(missing_ok=True)

    every_case(cases, check)


def test_figures_and_cells_are_not_written_through_links(tmp_path: Path) -> None:
    victim, folder = tmp_path / "victim.png", tmp_path / "outside"
    victim.write_text("precious")
    folder.mkdir()
    (tmp_path / "figure.png").symlink_to(victim)
    save_small(new_figure(1.0, 1.0), tmp_path / "figure.png")
    assert victim.read_text() == "precious"
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    sweep, fixed = tmp_path / "sweep", {"experiment": "x", "settings": {}, "data": {"sha256": "0"}}
    write_manifest(sweep, open_folder(sweep, fixed))
    (sweep / "cells").rmdir()
    (sweep / "cells").symlink_to(folder)
    with pytest.raises(FileError, match="cells: is a link"):
        open_folder(sweep, fixed)


def test_devices_and_fifos_are_not_replaced_by_what_is_saved(tmp_path: Path) -> None:
    cloud = Cloud(np.ones((4, 3), np.float32))
    writers = {
        ".npz": lambda path: write_cloud(path, cloud),
        ".ply": lambda path: write_cloud(path, cloud),
        ".json": lambda path: replace_files({path: b"new"}),
        ".png": lambda path: require_writable(path, ".png"),
        ".rrd": lambda path: write_view(path, [], "x"),
    }

    def check(suffix: str, write: Callable[[Path], object]) -> None:
        for name, make in (
            ("fifo", os.mkfifo),
            ("device", lambda path: os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))),
        ):
            path = tmp_path / f"{name}{suffix}"
            try:
                make(path)
            except PermissionError:  # only root makes devices
                continue
            before = path.lstat()
            with pytest.raises(
                FileError,
                match=f"{path.name}: cannot be written: is a {name.upper() if name == 'fifo' else name}, not a regular",
            ):
                write(path)
            assert path.lstat() == before

    every_case(list(writers.items()), check)


def test_numbers_of_yaml_are_decimal_and_a_key_that_occurs_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    found = parse_overrides(
        ["a=010", "b=1:30", "c=1_0", "d=1e3", "e=-7", "f=.5", "g=0x1f", "h=1.", "i=.inf", "j=-08.5"]
    )
    assert found == {"a": 10, "b": "1:30", "c": "1_0", "d": 1000.0, "e": -7, "f": 0.5, "g": "0x1f", "h": 1.0} | {
        "i": float("inf"), "j": -8.5,
    }  # fmt: skip
    for text in ("a: 1\na: 2\n", "x: {b: 1, b: 1}\n", "l: [{c: 1, c: 2}]\n", "{a: 1, 'a': 2}"):
        path.write_text(text)
        with pytest.raises(ConfigError, match=r"settings.yaml: not YAML: key [abc] occurs twice"):
            load_yaml(path)
    document = {"z": "1e3", "a": ["010", "1:30", "0x1f", "yes", "", "1_0"], "n": [1, 0.5, 1e-7, True, None]}
    path.write_text(dump_yaml(document))
    assert load_yaml(path) == document
    assert list(load_yaml(path)) == ["z", "a", "n"]


def test_files_with_other_types_are_refused_by_name_though_nothing_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    schema = {"a": int, "b?": [float], "c?": {"d": (str, type(None))}}
    good = {"a": 1, "b": [1, 2.5], "c": {"d": None}, "other": {}}
    assert require_schema(path, good, schema) == good
    cases = [
        ("file.json: .* is not a mapping", [good]),
        ("file.json: a: is missing", {}),
        ("file.json: a: True is not a whole number", {"a": True}),
        ("file.json: a: 1000.* is not a number that can be used", {"a": 10**400}),
        (r"file.json: b\[1\]: inf is not a number", {"a": 1, "b": [1, float("inf")]}),
        (r"file.json: b\[0\]: 'x' is not a number", {"a": 1, "b": ["x"]}),
        ("file.json: c.d: 3 is not a text or null", {"a": 1, "c": {"d": 3}}),
    ]
    every_refusal(FileError, cases, lambda value: require_schema(path, value, schema))


def test_a_file_of_the_kernel_that_waits_and_one_that_grows_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="bytes exceed 10"):
        read_bytes("/proc/self/status", 10)
    path = tmp_path / "file"
    path.write_bytes(bytes(100_000))
    data = FileBytes(path)
    assert data[10:20] == bytes(10)
    os.truncate(path, 50_000)
    with pytest.raises(FileError, match=r"file: byte 50000: was truncated while it was read"):
        data[20_000:90_000]


def test_a_text_takes_a_few_times_its_size_and_long_lines_are_refused(tmp_path: Path) -> None:
    path, points = tmp_path / "text.pcd", 100_000
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {points}\nHEIGHT 1\nDATA ascii\n".encode()
    path.write_bytes(head + b"1 2 3\n" * points)
    read_cloud(path)
    tracemalloc.start()
    cloud = read_cloud(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (cloud.xyz == [1, 2, 3]).all()
    assert peak < 12 * path.stat().st_size
    for body, rule in ((b"1 2 3\n" * (points + 1), "100001 lines"), (b"1 2 3 " * points, "a line of more than")):
        path.write_bytes(head + body)
        with pytest.raises(FileError, match=rule):
            read_cloud(path)


def test_names_with_control_characters_do_not_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("a\x1b[2Jb", ["name"], [["x\x1b]0;title\x07y"], ["two\nlines"]])
    warn("name\x1b[31m\nsecond line")
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert r"a\x1b[2Jb" in out
    assert err == "foretouch: name\\x1b[31m\\nsecond line\n"


def test_shared_memory_of_processes_that_ended_is_freed_and_that_of_others_kept(tmp_path: Path) -> None:
    for name in ("fastdds_dead", "fastrtps_dead", "fastdds_alive", "fastdds_port7412"):
        (tmp_path / name).write_bytes(bytes(1000))
        (tmp_path / f"{name}_el").touch()
    (tmp_path / "fastdds_link_el").symlink_to(tmp_path / "fastdds_dead")
    os.mkfifo(tmp_path / "fastdds_fifo_el")
    with (tmp_path / "fastdds_alive_el").open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert stale_bytes(tmp_path) == 2000
        assert stale_bytes(tmp_path, free=True) == 2000
        assert stale_bytes(tmp_path) == 0
    left = sorted(path.name for path in tmp_path.iterdir() if not path.name.endswith("_el"))
    assert left == ["fastdds_alive", "fastdds_port7412"]


FAILING_DISK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
static int fails(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    if (size <= 0) return 0;
    path[size] = 0;
    return strstr(path, "/failing/") != 0;
}
ssize_t pread64(int fd, void *to, size_t size, off_t at) {
    ssize_t (*read_at)(int, void *, size_t, off_t) = dlsym(RTLD_NEXT, "pread64");
    return fails(fd) ? (errno = EIO, -1) : read_at(fd, to, size, at);
}
ssize_t pread(int fd, void *to, size_t size, off_t at) { return pread64(fd, to, size, at); }
ssize_t read(int fd, void *to, size_t size) {
    ssize_t (*next)(int, void *, size_t) = dlsym(RTLD_NEXT, "read");
    return fails(fd) ? (errno = EIO, -1) : next(fd, to, size);
}
"""
"""For the loader: the disk below a folder of this name cannot be read, which no file system of a test can show."""


def test_a_disk_that_fails_is_told_with_the_name_of_the_file(tmp_path: Path) -> None:
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("there is no C compiler")
    folder, library = tmp_path / "failing", tmp_path / "failing_disk.so"
    folder.mkdir()
    (tmp_path / "disk.c").write_text(FAILING_DISK)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "disk.c", "-ldl"], check=True)
    write_dataset(folder / "recorded", 2)
    for words in ("export --format npz", "build"):
        assert main(["dataset", *words.split(), str(folder / "recorded"), "-o", str(folder / words[:3])]) == 0
    for name in (
        "cloud.ply",
        "depth.png",
        "depth.npz",
        "settings.yaml",
        "camera.json",
        "bag.bag",
        "bag.db3",
        "bag.db3.zstd",
    ):
        (folder / name).write_bytes(b"never read")
    script = (
        "import contextlib, io, sys\n"
        "from foretouch.cli.main import main\n"
        "for line in sys.stdin.read().splitlines():\n"
        "    with contextlib.redirect_stdout(io.StringIO()): main(line.split())\n"
    )
    clouds = [
        f"segment {path}"
        for path in sorted(folder.iterdir())
        if path.suffix in (".ply", ".png", ".npz", ".bag", ".db3", ".zstd")
    ]
    image = tmp_path / "image.png"
    Image.fromarray(np.full((60, 80), 900, np.uint16)).save(image)
    sets = [f"dataset info {folder / name}" for name in ("recorded", "recorded/session-0001.mcap", "exp", "bui")]
    others = [f"segment {folder}/recorded/session-0001.mcap", f"segment {image} --config {folder}/settings.yaml"]
    lines = [*clouds, *sets, *others, f"segment {image} --camera-info {folder}/camera.json"]
    done = subprocess.run(
        [sys.executable, "-c", script], input="\n".join(lines), env=os.environ | {"LD_PRELOAD": str(library)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    told = done.stderr.splitlines()
    assert len(told) == len(lines) > 10, done.stderr
    for line, command in zip(told, lines, strict=True):
        assert "Input/output error" in line, (command, line)
        assert str(folder) in line, (command, line)


def test_what_a_parser_would_say_is_said_in_words_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "random.bag").write_bytes(bytes(range(250, 100, -1)) * 9)
    (tmp_path / "random.db3").write_bytes(bytes(range(250, 100, -1)) * 9)
    (tmp_path / "text.yaml").write_bytes(b"a: \xff")
    (tmp_path / "camera.json").write_text('{"fx": 1%s, "fy": 600, "cx": 320, "cy": 240}' % ("0" * 400))
    (tmp_path / "camera.yaml").write_text(f"K: [1{'0' * 5000}, 1, 1, 1]")
    np.savez(tmp_path / "secret.npz", depth=np.ones((9, 9), np.uint16), K=np.ones(4))
    content = bytearray((tmp_path / "secret.npz").read_bytes())
    for mark, flags in ((b"PK\3\4", 6), (b"PK\1\2", 8)):  # as an archive with a password has them
        for found in re.finditer(re.escape(mark), bytes(content)):
            content[found.start() + flags] |= 1
    (tmp_path / "secret.npz").write_bytes(content)
    number = "0000 is not a number that can be used"
    cases = [
        (r"random\.bag: is no ROS 1 bag: it does not begin as one", open_source, "random.bag"),
        (r"random\.db3: is no SQLite file: it does not begin as one", open_source, "random.db3"),
        (r"text\.yaml: byte 3: is no text in UTF-8", load_yaml, "text.yaml"),
        (
            rf"camera\.json: holds no camera: is not JSON: 1000.*{number}",
            lambda path: camera_facts(path, ""),
            "camera.json",
        ),
        (
            rf"camera\.yaml: holds no camera: not YAML: 1000.*{number}",
            lambda path: camera_facts(path, ""),
            "camera.yaml",
        ),
        (r"secret\.npz: depth: is encrypted: save it again without a password", read_cloud, "secret.npz"),
    ]
    every_refusal(ForetouchError, cases, lambda read, name: read(tmp_path / name))


def test_settings_without_a_setting_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none.yaml").write_text("# grasp.count: 3\n")
    write_cloud(tmp_path / "object.npz", Cloud(np.random.default_rng(1).normal((0, 0, 0.5), 0.02, (900, 3))))
    main(["grasp", str(tmp_path / "object.npz"), "--config", str(tmp_path / "none.yaml")])
    assert f"{tmp_path}/none.yaml: holds no settings: the defaults apply\n" in capsys.readouterr().err

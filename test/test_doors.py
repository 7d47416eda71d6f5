# SPDX-License-Identifier: Apache-2.0
"""What another package adds by entry points works as what foretouch brings; one that is broken keeps nobody from the rest."""

import configparser
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from every_case import every_case
from installed_package import install

from foretouch.camera.source import SOURCES, find_source
from foretouch.cloud.io.files import CLOUD_SUFFIXES
from foretouch.cloud.io.images import IMAGE_SUFFIXES
from foretouch.dataset.formats import open_samples
from foretouch.dataset.recordings.bag import RECORDING_SUFFIXES
from foretouch.dataset.recordings.bag_files import PACKED
from foretouch.doors import Door, needs_extras
from foretouch.errors import ConfigError, MissingDependencyError
from foretouch_lab.learning.training.run_config import load_run_config
from foretouch_lab.simulation.scene_source import SceneSource

ROOT = Path(__file__).parents[1]

COMMAND = """
from foretouch.cli.commands import CommandEntry
from foretouch.cli.output import print_json

COUNT = CommandEntry("Count the files of a folder", "their_commands", "foretouch count folder")
FILES = CommandEntry("Count the files of a dataset", "their_commands", "foretouch dataset files session")

def add_arguments(parser):
    parser.add_argument("folder", metavar="DIR", help="folder")

def run(arguments):
    from pathlib import Path
    print_json({"files": len(list(Path(arguments.folder).iterdir()))})
    return 0
"""


def foretouch(site: Path, *words: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of a command beside the packages of a folder."""
    done = subprocess.run(
        [sys.executable, "-m", "foretouch", *words],
        env={**os.environ, "PYTHONPATH": f"{site}:{os.environ.get('PYTHONPATH', '')}"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


def test_a_package_adds_a_command_and_an_action(tmp_path) -> None:
    site, folder = tmp_path / "site", tmp_path / "folder"
    folder.mkdir()
    (folder / "one").touch()
    parts = {"count": "their_commands:COUNT", "dataset.files": "their_commands:FILES", "bad": "absent_module:NONE"}
    install(site, {"foretouch.commands": parts}, {"their_commands": COMMAND})
    assert foretouch(site, "count", str(folder), "--json") == (0, '{"files": 1}\n', "")
    assert foretouch(site, "dataset", "files", str(folder), "--json") == (0, '{"files": 1}\n', "")
    status, out, told = foretouch(site, "--help")
    assert (status, "Count the files of a folder" in out, "Plan two-finger grasps" in out) == (0, True, True)
    status, _, err = foretouch(site, "bad")
    assert (status, err) == (1, told)
    assert err == (
        "foretouch: command bad: there is no module absent_module: others names it; install others again, from where it came from\n"
    )


def test_a_broken_package_keeps_nobody_from_the_rest(tmp_path) -> None:
    parts = {
        "foretouch.formats": {
            "number": "their_faults:NUMBER",
            "absent": "their_faults:ABSENT",
            "broken": "their_error",
        },
        "foretouch.commands": {
            "garbled": "a b c",
            "share": "their_faults:SHARE",
            "nothing": "their_faults:NOTHING",
            "dataset.info": "their_faults:SHARE",
            "dataset.bad": "their_error",
        },
    }
    code = (
        "from foretouch.cli.commands import CommandEntry\nNUMBER = 3\n"
        "SHARE = CommandEntry('Print 100 % of it', 'absent_module', 'foretouch share 5%')\n"
        "NOTHING = CommandEntry('Do nothing', 'json', 'foretouch nothing')\n"
    )
    install(tmp_path / "site", parts, {"their_faults": code, "their_error": "1 / 0\n"})
    can = str(Path(__file__).parents[1] / "examples/data/can.ply")
    status, out, told = foretouch(tmp_path / "site", "grasp", can, "--plane", "0,0,1,-1.27", "--json")
    assert (status, out.startswith("{"), "Traceback" in told) == (0, True, False)
    status, out, told = foretouch(tmp_path / "site", "dataset", "info", "--help")
    assert (status, "Print counts and ranges" in out, "Traceback" in told) == (0, True, False)
    assert "foretouch: format number: their_faults:NUMBER is a int and no FormatEntry" in told
    status, out, told = foretouch(tmp_path / "site", "--help")
    assert (status, "100 % of it" in out, "Traceback" in told) == (0, True, False)
    lines = {
        "garbled": "foretouch: command garbled: a b c cannot be imported: ",
        "share": "foretouch: command share: absent_module cannot be imported: ModuleNotFoundError",
        "nothing": "foretouch: command nothing: json has no function add_arguments",
    }

    def check(name: str, line: str) -> None:
        status, _, told = foretouch(tmp_path / "site", name)
        assert status == 1
        assert told.splitlines()[-1].startswith(line)
        assert "Traceback" not in told

    every_case({name: (name, line) for name, line in lines.items()}, check)


def test_a_package_adds_a_source_and_a_recipe(tmp_path, monkeypatch) -> None:
    code = "class Mine:\n    def nodes(self, show, rate_hz): return {'camera': {'source': 'mine'}}\n    def device(self, show, fps, *, color): ...\nSOURCE = Mine()\nQUICK = {'method': 'contact', 'contact': {'trees': 7}}\n"
    parts = {"foretouch.sources": {"mine": "their_parts:SOURCE", ".mine": "their_parts:SOURCE"}}
    install(tmp_path, parts | {"foretouch.recipes": {"quick": "their_parts:QUICK"}}, {"their_parts": code})
    monkeypatch.syspath_prepend(tmp_path)
    assert find_source("mine") is find_source("folder/shown.mine") is not None
    assert find_source("another") is None
    assert load_run_config("quick").contact.trees == 7
    with pytest.raises(ConfigError, match=r"is neither a file nor one of .*quick.*; did you mean quick"):
        load_run_config("quik")


def test_what_cannot_be_loaded_is_one_line_that_names_the_part_and_its_place(tmp_path, monkeypatch) -> None:
    places = {
        "absent": ("their_faults:ABSENT", "door absent: their_faults:ABSENT cannot be imported: AttributeError"),
        "other": ("their_faults:NUMBER", "door other: their_faults:NUMBER is a int and no dict"),
        "raising": ("their_error", "door raising: their_error cannot be imported: ZeroDivisionError"),
        "leaving": ("their_exit", "door leaving: their_exit cannot be imported: SystemExit"),
    }
    modules = {"their_faults": "NUMBER = 3\n", "their_error": "1 / 0\n", "their_exit": "raise SystemExit(3)\n"}
    modules["their_forest"] = "import sklearn\n"
    places["bare"] = ("their_forest", "door bare: scikit-learn is not installed: pip install 'foretouch[lab]'")
    install(tmp_path, {"foretouch.doors": {name: place for name, (place, _) in places.items()}}, modules)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "sklearn", None)
    door = Door("foretouch.doors", "door", {"own": "json:dumps"}, dict)

    def check(name: str, rule: str) -> None:
        with pytest.raises((ConfigError, MissingDependencyError)) as refused:
            door.load(name)
        assert str(refused.value).startswith(rule)

    every_case({name: (name, rule) for name, (_, rule) in places.items()}, check)
    assert list(door) == ["own", *sorted(places)]
    with pytest.raises(
        ConfigError, match=r"door raisin: is no entry point of the group .*, of which own.*mean raising\?"
    ):
        door.load("raisin")


def test_each_library_of_the_laboratory_that_is_absent_is_named_with_its_cure() -> None:
    extras = configparser.ConfigParser()
    extras.read(ROOT / "setup.cfg", encoding="utf-8")
    names = re.findall(r"^[\w-]+", extras["options.extras_require"]["lab"], re.MULTILINE)
    assert len(names) >= 5

    def check(name: str) -> None:
        module = {"scikit-learn": "sklearn"}.get(name, name)
        with (
            pytest.raises(
                MissingDependencyError, match=rf"^train: {name} is not installed: pip install 'foretouch\[lab\]'"
            ),
            needs_extras("train"),
        ):
            raise ModuleNotFoundError(name=f"{module}.part")

    every_case(names, check)


def test_no_package_replaces_a_part_of_foretouch_or_of_the_laboratory(tmp_path, monkeypatch, caplog) -> None:
    code = "THEIRS = 1\nclass Shown:\n    def nodes(self, show, rate_hz): ...\n    def device(self, show, fps, *, color): ...\nSHOWN = Shown()\n"
    shown = dict.fromkeys((".npz", ".yaml", "camera"), "their_own:SHOWN")
    install(tmp_path, {"foretouch.doors": {"own": "their_own:THEIRS"}, "foretouch.sources": shown}, {"their_own": code})
    monkeypatch.syspath_prepend(tmp_path)
    ours = {"k": 1}
    door = Door("foretouch.doors", "door", {"own": ours})
    assert (door.load("own"), list(door)) == (ours, ["own"])
    assert find_source("camera") is find_source(str(ROOT / "examples/data/table.npz")) is None
    assert isinstance(find_source(str(ROOT / "config/scenes/demo.yaml")), SceneSource)
    left_out = [f"foretouch: source {name} of others is left out: foretouch has this name" for name in sorted(shown)]
    assert caplog.messages == ["foretouch: door own of others is left out: foretouch has this name", *left_out]


def test_all_that_source_reads_is_reserved() -> None:
    assert {*CLOUD_SUFFIXES, *IMAGE_SUFFIXES, *RECORDING_SUFFIXES, PACKED}.isdisjoint(SOURCES)
    assert {*CLOUD_SUFFIXES, *IMAGE_SUFFIXES, *RECORDING_SUFFIXES, PACKED} <= SOURCES.reserved


def test_of_two_packages_with_one_name_the_first_by_name_counts(tmp_path, monkeypatch, caplog) -> None:
    for package in ("second", "first"):
        module = f"their_{package}"
        install(tmp_path, {"foretouch.doors": {"one": f"{module}:PART"}}, {module: f"PART = {package!r}\n"}, package)
    monkeypatch.syspath_prepend(tmp_path)
    door = Door("foretouch.doors", "door")
    assert (door.load("one"), door.load("one")) == ("first", "first")
    assert caplog.messages == ["foretouch: door one of second is left out: first has this name"]


def test_a_broken_part_is_named_once(tmp_path, monkeypatch, caplog) -> None:
    install(tmp_path, {"foretouch.doors": {"bad": "their_error"}}, {"their_error": "1 / 0\n"})
    monkeypatch.syspath_prepend(tmp_path)
    door = Door("foretouch.doors", "door", {"own": 1})
    assert [dict(door.loaded()), dict(door.loaded())] == [{"own": 1}, {"own": 1}]
    assert len(caplog.messages) == 1


def test_what_a_part_raises_at_work_is_one_line(tmp_path, monkeypatch) -> None:
    code = "from foretouch.dataset.formats import FormatEntry\nF = FormatEntry('tables', 'their_tables', files=('.table',))\n"
    code += "def recognise(path): return path.read_bytes().decode('ascii')\n"
    install(tmp_path / "site", {"foretouch.formats": {"tables": "their_tables:F"}}, {"their_tables": code})
    monkeypatch.syspath_prepend(tmp_path / "site")
    (tmp_path / "one.table").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match=r"format tables: UnicodeDecodeError: .* \(their_tables.py:3\)"):
        open_samples(tmp_path / "one.table")

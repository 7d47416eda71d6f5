# SPDX-License-Identifier: Apache-2.0
"""The commands of README, inputs and tutorials, run in order in a fresh folder; what the pages quote of their outputs must appear.

Fenced blocks: `sh` is run by one bash for the whole page, `text` holds lines of the output of the `sh` block before it, `python` with a first
line `# NAME.py` is saved under that name. `sh robot` needs a robot or a full installation of ROS 2 and is reported as not run; `sh public-data` is run
where FORETOUCH_DATA is set. In a quoted line `~1.5` is a number that differs by at most a fifth, and `…` any text.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from process_domain import process_environment

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "docs" / "inputs.md", *sorted((ROOT / "docs" / "tutorials").glob("*.md"))]
BLOCK = re.compile(r"^```(sh|text|python)( robot| public-data)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SAVED = re.compile(r"# (\w+\.py)\n")
NUMBER = r"[+-]?\d*\.?\d+"
END = "--- end of block ---"
BOXES = re.compile(r"[─-╿]+")
OWN = {".git", ".venv", "build", "demo-output"}
"""What a clone does not have, or is written to."""


@dataclass
class Step:
    """A block of commands, what it needs besides this machine, and the lines that its output must contain."""

    commands: str
    needs: str = ""
    quoted: list[str] = field(default_factory=list)

    @property
    def runs(self) -> bool:
        return not self.needs or (self.needs == "public-data" and "FORETOUCH_DATA" in os.environ)


def read_page(text: str) -> tuple[list[Step], dict[str, str]]:
    """The steps of a page, and the contents of the files that it asks to save."""
    steps: list[Step] = []
    files = {}
    for language, needs, content in BLOCK.findall(text):
        if language == "sh":
            steps.append(Step(content, needs.strip()))
        elif language == "text":
            steps[-1].quoted += content.splitlines()
        elif match := SAVED.match(content):
            files[match[1]] = content
    return steps, files


def words(text: str) -> str:
    """A text without the boxes around it and with single spaces."""
    return " ".join(BOXES.sub(" ", text).split())


def appears(quoted: str, output: str) -> bool:
    """Whether a quoted line is in an output, with its approximate numbers."""
    line = words(quoted)
    about = [float(one) for one in re.findall(rf"~({NUMBER})", line)]
    pattern = re.sub(r"(\\ )?…(\\ )?", ".*?", re.escape(line))
    pattern = re.sub(r"\\?~(\\?[+-])?\d*(\\\.)?\d+", lambda _: f"({NUMBER})", pattern)
    found = re.finditer(f"(?={pattern})", words(output))
    return any(
        all(abs(float(a) - b) <= 0.2 * abs(b) for a, b in zip(one.groups(), about, strict=True)) for one in found
    )


def prepare(folder: Path, files: dict[str, str]) -> dict[str, str]:
    """A folder `foretouch` as `git clone` and the installation leave it; the variables that lead there.

    A clone is made of links to the files of this one, and the installation is the environment that runs the tests.
    """
    clone, tools = folder / "cloned", folder / ".tools"
    for made in (clone / ".venv" / "bin", tools):
        made.mkdir(parents=True)
    for path in ROOT.iterdir():
        if path.name not in OWN:
            (clone / path.name).symlink_to(path)
    for name, content in files.items():
        (clone / name).write_text(content, encoding="utf-8")
    (clone / ".venv" / ".runtime").touch()
    (clone / ".venv" / "bin" / "activate").write_text(f"export VIRTUAL_ENV={sys.prefix}\n", encoding="utf-8")
    scripts = {
        "git": f'[ "$1" = clone ] && mv {clone} "$(basename "$2")"',
        "foretouch": f'exec {sys.executable} -m foretouch "$@"',
        "python": f'exec {sys.executable} "$@"',
    }
    for name, script in scripts.items():
        (tools / name).write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
        (tools / name).chmod(0o755)
    (clone / ".venv" / "bin" / "foretouch").symlink_to(tools / "foretouch")
    return {**process_environment(), "PATH": f"{tools}:{os.environ['PATH']}", "COLUMNS": "80", "LINES": "24"}


def run(page: Path, folder: Path) -> list[tuple[Step, str]]:
    """Run a page: its steps and the output of each. A tutorial begins in the folder of the repository."""
    steps, files = read_page(page.read_text(encoding="utf-8"))
    steps = [step for step in steps if step.runs]
    environment = prepare(folder, files)
    begin = [] if any("git clone" in step.commands for step in steps) else ["git clone foretouch && cd foretouch"]
    script = "\n".join(["set -e", *begin, *(f"{step.commands}\necho '{END}'" for step in steps)])
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL, "text": True}
    done = subprocess.run(["bash", "-c", script], cwd=folder, env=environment, check=False, timeout=580, **pipes)
    outputs = done.stdout.split(f"{END}\n")
    assert done.returncode == 0, f"{steps[min(len(outputs), len(steps)) - 1].commands}\n{outputs[-1]}"
    return list(zip(steps, outputs, strict=False))


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=pytest.mark.xdist_group(f"page_{page.stem}")) for page in PAGES]
)
def test_the_commands_of_a_page_run_and_print_what_it_quotes(page, tmp_path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    missing = [
        f"{line!r} is not in the output of\n{step.commands}\n{output}"
        for step, output in run(page, tmp_path)
        for line in step.quoted
        if not appears(line, output)
    ]
    assert not missing, "\n".join(missing)


def test_a_quoted_line_stands_for_numbers_that_are_near() -> None:
    output = "│ samples   │ 41 │\nskill -0.31 [-.4, .2] of\n run/model: ok"
    for line in (
        "samples ~40",
        "skill ~-0.3 [-.4, .2]",
        "~.2] … ok",
        "run/model: ok",
        "skill ~-.3",
        "samples ~40 … ~.2]",
    ):
        assert appears(line, output), line
    for line in ("samples ~20", "skill ~0.3", "skill ~-0.4", "samples ~40 … ~.9]", "sample s", "run/modelx"):
        assert not appears(line, output), line


def test_there_is_a_tutorial_for_each_user_and_each_quotes_an_output() -> None:
    assert [page.stem for page in PAGES] == [
        "README",
        "inputs",
        "collector",
        "operator",
        "other_recordings",
        "own_model",
        "planner",
        "researcher",
        "sensor",
    ]
    for page in PAGES:
        steps, _ = read_page(page.read_text(encoding="utf-8"))
        assert len([line for step in steps for line in step.quoted]) >= 4, page


def test_the_program_of_the_readme_is_the_example_that_it_runs() -> None:
    shown = re.findall(r"^```python\n(.*?)^```$", PAGES[0].read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(shown) == 1
    assert (ROOT / "examples" / "feel.py").read_text(encoding="utf-8").endswith(f'"""\n\n{shown[0]}')


def test_the_readme_is_short() -> None:
    lines = PAGES[0].read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 110
    assert [line for line in lines if len(line) > 200 and not line.startswith("[![")] == []

# SPDX-License-Identifier: Apache-2.0
"""The commands of the tutorials, run in order in an empty folder; what the tutorials quote of their outputs must appear.

Fenced blocks: `sh` is run by one bash for the whole page, `text` holds lines of the output of the `sh` block before it, `python` with a first
line `# NAME.py` is saved under that name, `console` needs a robot and is not run. In a quoted line, `~1.5` is any number and `…` any text.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"^```(sh|text|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SAVED = re.compile(r"# (\w+\.py)\n")
END = "--- end of block ---"
BOXES = re.compile(r"[─-╿]+")


@dataclass
class Step:
    """A block of commands, and the lines that its output must contain."""

    commands: str
    quoted: list[str] = field(default_factory=list)


def read_page(text: str) -> tuple[list[Step], dict[str, str]]:
    """The steps of a page, and the contents of the files that it asks to save."""
    steps: list[Step] = []
    files = {}
    for language, content in BLOCK.findall(text):
        if language == "sh":
            steps.append(Step(content))
        elif language == "text":
            steps[-1].quoted += content.splitlines()
        elif match := SAVED.match(content):
            files[match[1]] = content
    return steps, files


def words(text: str) -> str:
    """A text without the boxes around it and with single spaces."""
    return " ".join(BOXES.sub(" ", text).split())


def pattern(quoted: str) -> re.Pattern[str]:
    """What a quoted line stands for."""
    escaped = re.sub(r"(\\ )?…(\\ )?", ".*?", re.escape(words(quoted)))
    return re.compile(re.sub(r"\\?~\d+(?:\\?\.\d+)?", r"-?\\d+(?:\\.\\d+)?", escaped))


def run(page: Path, folder: Path) -> tuple[list[Step], list[str]]:
    """Run a page; its steps, and the output of each."""
    steps, files = read_page(page.read_text(encoding="utf-8"))
    for name in ("config", "examples"):
        (folder / name).symlink_to(ROOT / name)
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    tools = folder / ".tools"
    tools.mkdir()
    for name, module in (("foretouch", "-m foretouch.cli.main"), ("python", "")):
        (tools / name).write_text(f'#!/bin/sh\nexec {sys.executable} {module} "$@"\n', encoding="utf-8")
        (tools / name).chmod(0o755)
    script = "\n".join(["set -e", *(f"{step.commands}\necho '{END}'" for step in steps)])
    environment = {
        **os.environ,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "COLUMNS": "120",
        "ROS_DOMAIN_ID": str(76 + (os.getpid() + PAGES.index(page)) % 25),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "timeout": 580}
    done = subprocess.run(["bash", "-c", script], cwd=folder, env=environment, check=False, **pipes)
    outputs = done.stdout.split(f"{END}\n")
    assert done.returncode == 0, f"{steps[min(len(outputs), len(steps)) - 1].commands}\n{outputs[-1]}"
    return steps, outputs


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=pytest.mark.xdist_group(f"tutorial_{page.stem}")) for page in PAGES]
)
def test_the_commands_of_a_tutorial_run_and_print_what_it_quotes(page, tmp_path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    steps, outputs = run(page, tmp_path)
    for step, output in zip(steps, outputs, strict=False):
        for line in step.quoted:
            assert pattern(line).search(words(output)), f"{line!r} is not in the output of\n{step.commands}\n{output}"


def test_there_is_a_tutorial_for_each_user_and_each_quotes_an_output() -> None:
    assert [page.stem for page in PAGES] == ["collector", "operator", "planner"]
    for page in PAGES:
        steps, _ = read_page(page.read_text(encoding="utf-8"))
        assert len([step for step in steps if step.quoted]) >= 2, page

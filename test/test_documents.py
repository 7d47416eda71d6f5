# SPDX-License-Identifier: Apache-2.0
"""The documents: links resolve, the reference holds all that the code declares, and the site builds without a warning."""

from __future__ import annotations

import argparse
import importlib
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from foretouch.cli.main import COMMANDS
from foretouch.config import setting_infos

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?P<target>[^)\s#]*)(?:#(?P<anchor>[^)\s]*))?\)")
MARKDOWN = sorted(
    [ROOT / "README.md", *DOCS.rglob("*.md"), *ROOT.glob("benchmarks/*/README.md"), *ROOT.glob("examples/*.md")]
)


@pytest.fixture(scope="module")
def reference() -> Iterator[ModuleType]:
    """The generators."""
    sys.path.insert(0, str(DOCS / "_ext"))
    yield importlib.import_module("reference_pages")
    sys.path.remove(str(DOCS / "_ext"))


def anchors(page: Path) -> set[str]:
    """The anchors of the headings of a page, as GitHub and MyST make them."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", MARKDOWN, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page: Path, reference: ModuleType) -> None:
    broken = []
    for match in LINK.finditer(FENCED.sub("", page.read_text(encoding="utf-8"))):
        if ":" in match["target"]:
            continue  # of the web
        target = page.parent / match["target"] if match["target"] else page
        found = target.exists()
        if target.exists() and match["anchor"] and target.suffix == ".md":
            generated = f"#{match['anchor']}" in anchors_of_generated(target, reference)
            found = match["anchor"] in anchors(target) or generated
        if not found:
            broken.append(match[0])
    assert not broken


def anchors_of_generated(page: Path, reference: ModuleType) -> set[str]:
    """Anchors of a page's generated headings; those of nodes and messages suffice."""
    found = set()
    for name in re.findall(r"^```\{generated\} (\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        if name == "parameters":
            pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
            found |= {f"#{node}" for node in reference.node_configs()}
        elif name == "messages":
            kinds = ("msg", "srv", "action")
            found |= {f"#{one.name.lower()}" for kind in kinds for one in reference.interfaces(kind)}
    return found


def test_every_field_of_every_interface_is_listed_with_its_comment(reference: ModuleType) -> None:
    text = reference.messages()
    for kind in ("msg", "srv", "action"):
        for path in sorted((ROOT / "foretouch_msgs" / kind).glob("*")):
            section = text.partition(f"### {path.stem}\n")[2].partition("\n### ")[0]
            for line in path.read_text(encoding="utf-8").splitlines():
                code, _, comment = (piece.strip() for piece in line.partition("#"))
                if code and code != "---":
                    rows = [row for row in section.splitlines() if row.startswith(f"| `{code.split()[1]}` |")]
                    assert any(reference.cell(comment) in row for row in rows), (path.name, line)
                elif "SPDX" not in comment:
                    assert comment in section or reference.cell(comment) in section, (path.name, line)


def test_the_messages_are_those_that_are_built(reference: ModuleType) -> None:
    messages = pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    for one in reference.interfaces("msg"):
        fields = getattr(messages, one.name).get_fields_and_field_types()
        assert [f.name for f in one.parts[0] if not f.value] == list(fields)


def test_every_parameter_of_every_node_is_listed(reference: ModuleType) -> None:
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    from foretouch.ros.executables import NODES
    from foretouch.ros.runtime.lifecycle_node import NodeConfig

    text = reference.parameters()
    configs = reference.node_configs()
    assert configs.keys() == NODES.keys()
    shared = {info.name for info in setting_infos(NodeConfig)}
    for node, config in configs.items():
        section = text.partition(f"## `{node}`\n")[2].partition("\n## ")[0]
        everywhere = text.partition("## Every node\n")[2].partition("\n## ")[0]
        for info in setting_infos(config):
            where = everywhere if info.name in shared else section
            (row,) = [row for row in where.splitlines() if row.startswith(f"| `{info.name}` |")]
            assert reference.cell(info.description) in row
            assert row.endswith("| no |" if info.read_only else "| yes |")
            assert not info.unit or info.choices or f"[{info.unit}]" in row


@pytest.mark.ros
def test_topics_are_those_of_the_design(reference: ModuleType) -> None:
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    code = "import reference_pages; print(reference_pages.topics())"  # in a process of its own: it needs a context without discovery
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=DOCS / "_ext", capture_output=True, text=True, check=False, timeout=100
    )
    assert done.returncode == 0, done.stderr
    rows = {row.split("`")[1]: row for row in done.stdout.splitlines() if row.startswith("| `")}
    for name, ends in {
        "points": ("`camera`, `replay`", "`segmentation`"),
        "object_cloud": ("`segmentation`", "`grasp`, `touch_predictor`, `recorder`"),
        "touch": ("`touch_predictor`", ""),
        "/rh/tactile": ("`hand`", "`touch_predictor`, `recorder`"),
        "predict_touch": ("`touch_predictor`",),
        "sample_grasps": ("`touch_predictor`",),
        "start_recording": ("`recorder`",),
    }.items():
        assert all(f"| {end}" in rows[name] for end in ends if end), rows[name]
    assert "parameter" not in " ".join(rows)
    assert "transition" not in " ".join(rows)


def test_every_option_of_every_command_is_listed(reference: ModuleType) -> None:
    text = reference.commands()
    names = reference.command_names()
    assert set(COMMANDS) <= set(names)
    assert "dataset build" in names
    for name in names:
        section = text.partition(f"# `{name}`\n")[2].partition("\n## ")[0].partition("\n### ")[0]
        options = reference.options_of(reference.parser_of(name))
        assert options or name == "dataset", name
        for option in options:
            for word in option.option_strings or [str(option.metavar or option.dest)]:
                assert word.replace("|", "\\|") in section, (name, word)
            assert option.help is argparse.SUPPRESS or str(option.help).partition("%")[0].split()[0] in section


def test_lists_of_groups_and_optional_groups_are_listed(reference: ModuleType) -> None:
    scenes = reference.scenes()
    for name in ("objects[].shape", "camera.noise", "campaign.drift", "fingers.", "seed"):
        assert f"| `{name}" in scenes, name
    recipes = reference.recipes()
    for name in ("method: contact", "method: srgan", "contact.trees", "train.epochs"):
        assert name in recipes, name
    assert "| `seeds` |" in reference.experiments()
    assert "| `grasp.method` |" in reference.pipeline()


def test_cells_are_one_line_and_cannot_break_a_table(reference: ModuleType) -> None:
    assert reference.cell("a | b\n<c> *d*") == "a \\| b &lt;c> \\*d\\*"


def test_the_examples_of_the_python_pages_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from foretouch.cloud import write_cloud
    from foretouch.pipeline import Pipeline
    from foretouch.simulation import random_scene

    scene = random_scene(np.random.default_rng(3), width=424, height=240, n_objects=2).render().cloud()
    write_cloud(tmp_path / "scene.npz", scene)
    shutil.copytree(ROOT / "test" / "data" / "from_0_1_0" / "recording", tmp_path / "session")
    (tmp_path / "config").symlink_to(ROOT / "config")
    monkeypatch.chdir(tmp_path)
    target = Pipeline().run(scene).targets[0]
    given = {"cloud": target.target.cloud, "plane": target.target.plane, "grasps": target.plan.grasps, "tare": None}
    pages = sorted((DOCS / "api").glob("*.md"))
    examples = {
        page.stem: re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL) for page in pages
    }
    assert sum(map(len, examples.values())) == 6
    for name, codes in examples.items():
        for code in codes:
            names = dict(given)
            exec(compile(code, name, "exec"), names)  # the documents are ours
            printed = capsys.readouterr().out
            assert printed or name == "models", name
            assert name != "models" or names["predictions"][0].status == "ok"


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.timeout(600)
@pytest.mark.xdist_group("site")
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    for module in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(module, reason="the extra docs is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "dummy", DOCS, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=580)
    assert done.returncode == 0, done.stderr

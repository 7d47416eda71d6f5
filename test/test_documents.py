# SPDX-License-Identifier: Apache-2.0
"""The documents: links and files exist, words are those of the field, the reference is complete, the site builds."""

import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from command_answer import run_python
from every_case import every_case

from foretouch.cli.commands import COMMANDS
from foretouch.config import setting_infos
from foretouch_lab.simulation.objects import SHAPES
from foretouch_lab.simulation.scene.objects import MESH

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?P<target>[^)\s#]*)(?:#(?P<anchor>[^)\s]*))?\)")
MARKDOWN = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *DOCS.rglob("*.md"),
    *ROOT.glob("benchmarks/**/*.md"),
    *ROOT.glob("examples/*.md"),
]
KEY = re.compile(r"""(["'`])[\w./:]+\1|\*[A-Za-z][^*]+\*|\btell[(=]""")  # quoted names, *titles*, `file.tell()`


@pytest.fixture(scope="module")
def reference() -> Iterator[ModuleType]:
    """The generators of the reference pages."""
    sys.path.insert(0, str(DOCS / "_ext"))
    yield importlib.import_module("reference_pages")
    sys.path.remove(str(DOCS / "_ext"))


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    text = page.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.*)$", FENCED.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.ros
def test_reference_pages_are_those_of_the_code() -> None:
    """If not: make reference. In a process of its own, which turns the discovery of DDS off."""
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    done = run_python(
        "import sys, reference_pages as r; sys.argv += ['--check']; sys.exit(r.main())", cwd=DOCS / "_ext"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert {"commands", "messages", "parameters", "settings", "topics"} <= {page.stem for page in reference_pages()}


def reference_pages() -> list[Path]:
    return [page for page in DOCS.rglob("*.md") if "<!-- generated" in page.read_text(encoding="utf-8")]


def test_links_lead_to_files_and_headings() -> None:
    def check(page: Path) -> None:
        broken = []
        for match in LINK.finditer(FENCED.sub("", page.read_text(encoding="utf-8"))):
            if ":" in match["target"]:
                continue  # of the web
            target = page.parent / match["target"] if match["target"] else page
            in_page = match["anchor"] and target.suffix == ".md"
            if not target.exists() or (in_page and match["anchor"] not in anchors(target)):
                broken.append(match[0])
        assert not broken, broken

    every_case({str(page.relative_to(ROOT)): page for page in MARKDOWN}, check)


def test_the_files_that_the_architecture_names_exist() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    folders = (ROOT / name for name in ("src", "docs", "test", "benchmarks", "launch", "examples"))
    files = [*ROOT.glob("*"), *(path for folder in folders for path in folder.rglob("*"))]
    there = [f"/{path.relative_to(ROOT)}" for path in files if path.suffix in (".py", ".c", ".md")]
    named = set(re.findall(r"`([\w/]+\.(?:py|c|md))`", text))
    assert len(named) > 50
    assert sorted(name for name in named if not any(path.endswith(f"/{name}") for path in there)) == []


RETIRED_IN_DOCUMENTS = {
    "run folder": "model folder",
    "training labels": "training readings",
    "mean of the labels": "mean of the training readings",
    "label of the object": "object name",
    "label ratio": "training fraction",
    "scene cloud": "cloud",
    "calibration file": "hand-eye calibration",
}
THEIR_OWN_WORDS = {"papers", "accuracy_vs_time", "all_results"}
"""Pages that quote the papers, or tables with names of their own."""


def retired(pages: list[Path], words: dict[str, str], *, hidden: re.Pattern[str]) -> list[str]:
    """Where a page has a retired word outside of what is hidden."""
    pattern = re.compile(rf"\b({'|'.join(map(re.escape, sorted(words, key=len, reverse=True)))})\b")
    return [
        f"{page.relative_to(ROOT)}:{number}: {match[1]!r} is retired; use {words[match[1]]!r}"
        for page in pages
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for match in pattern.finditer(hidden.sub('""', line))
    ]


def test_no_retired_word_is_used_and_one_word_is_used_for_one_thing() -> None:
    """Names that are part of an interface may keep an old word; they stand in quotes. Results are of the past."""
    lines = (ROOT / "test" / "retired_words.txt").read_text(encoding="utf-8").splitlines()
    pairs = (line.split("|") for line in lines if line.strip() and not line.startswith("#"))
    pages = [path for path in MARKDOWN if not {"results", "benchmarks", "reference"} & set(path.parts)]
    sources = [path for name in ("src", "launch", "examples", "docs/_ext") for path in (ROOT / name).rglob("*.py")]
    found = retired(pages + sources, {word.strip(): term.strip() for word, term in pairs}, hidden=KEY)
    assert len(glossary()) == 38
    pages = [ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md"), DOCS / "results" / "README.md"]
    pages = [page for page in pages if page.stem not in THEIR_OWN_WORDS]
    found += retired(pages, RETIRED_IN_DOCUMENTS, hidden=re.compile("$^"))
    assert found == [], "\n".join(found)


def glossary() -> list[str]:
    return re.findall(r"^\| \*\*(.+?)\*\* \|", (DOCS / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE)


def test_data_collectors_meet_few_concepts() -> None:
    text = FENCED.sub("", (DOCS / "tutorials" / "collector.md").read_text(encoding="utf-8")).lower()
    text = LINK.sub("", text).replace("are run in", "")  # targets of links; a verb
    singular = {name: name.removesuffix("s") for name in glossary()}
    met = [name for name, word in singular.items() if re.search(rf"\b{re.escape(word)}(s|es)?\b", text)]
    assert {"readings", "tare", "sample"} <= set(met)
    assert len(met) <= 14, met


def test_the_reference_lists_every_field_parameter_and_option_with_what_is_said_of_it(reference) -> None:
    messages = pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    from foretouch.ros.nodes import NODES

    for interface in reference.interfaces("msg"):
        fields = getattr(messages, interface.name).get_fields_and_field_types()
        assert [f.name for f in interface.parts[0] if not f.value] == list(fields)
        section = reference.messages().partition(f"### {interface.name}\n")[2].partition("\n### ")[0]
        assert all(f"| `{f.name}` |" in section and reference.cell(f.comment) in section for f in interface.parts[0]), (
            interface.name
        )
    parameters, configs = reference.parameters(), reference.node_configs()
    assert list(configs) == list(NODES)
    everywhere = parameters.partition("## Every node\n")[2].partition("\n## ")[0]
    for node, config in configs.items():
        section = everywhere + parameters.partition(f"## `{node}`\n")[2].partition("\n## ")[0]
        for info in setting_infos(config):
            rows = [row for row in section.splitlines() if row.startswith(f"| `{info.name}` |")]
            assert any(reference.cell(info.description) in row for row in rows), (node, info.name)
            assert all(row.endswith("| no |" if info.read_only else "| yes |") for row in rows), (node, info.name)
    commands, names = reference.commands(), reference.command_names()
    assert {name.replace(".", " ") for name in COMMANDS} <= set(names)
    for name in names:
        section = commands.partition(f"# `{name}`\n")[2].partition("\n## ")[0].partition("\n### ")[0]
        for option in reference.parser_of(name).declared:
            for word in option.option_strings or [str(option.metavar or option.dest)]:
                assert word.replace("|", "\\|") in section, (name, word)
    scenes, recipes = reference.scenes(), reference.recipes()
    for name in ("objects[].shape", "camera.noise", "campaign.drift", "fingers.", "seed"):
        assert f"| `{name}" in scenes, name
    assert all(name in recipes for name in ("method: contact", "method: srgan", "contact.trees", "train.epochs"))
    assert "| `seeds` |" in reference.experiments()
    assert reference.cell("a | b\n<c> *d*") == "a \\| b &lt;c> \\*d\\*", "a cell is one line and breaks no table"


QUOTED = re.compile(
    r"(?P<before>\d+(?:\.\d+)?) ?(?P<unit1>mm|cm|m|s|ms|Hz|MB|kB|degrees)? \(`(?P<name1>[a-z_.]+)`[,)]"  # 3 mm (`cell_m`)
    r"|`(?P<name2>[a-z_.]+)`(?: \(| \| )(?P<after>\d+(?:\.\d+)?) ?(?P<unit2>mm|cm|m|s|ms|Hz|MB|kB)?[ )|]"  # `wait_s` (0.2 s)
)
ROW = re.compile(r"^\| `([\w.\[\]]+)` \| `(-?\d+(?:\.\d+)?(?:e-?\d+)?)` \|", re.MULTILINE)
METRES = {"mm": 1e-3, "cm": 1e-2}


def defaults() -> dict[str, set[float]]:
    """The numbers in the reference of parameters and settings, by the name and by its last parts."""
    found: dict[str, set[float]] = {}
    for page in ("parameters", "settings"):
        for name, value in ROW.findall((DOCS / "reference" / f"{page}.md").read_text(encoding="utf-8")):
            parts = name.split(".")
            for start in range(len(parts)):
                found.setdefault(".".join(parts[start:]), set()).add(float(value))
    return found


def test_numbers_beside_the_name_of_a_setting_are_its_default() -> None:
    known, checked, wrong = defaults(), set(), []
    for page in sorted(DOCS.rglob("*.md")):
        if {"reference", "results"} & set(page.parts) or page.stem == "papers":  # the settings of the papers
            continue
        for match in QUOTED.finditer(" ".join(page.read_text(encoding="utf-8").split())):
            name, value = match["name1"] or match["name2"], float(match["before"] or match["after"])
            unit = match["unit1"] or match["unit2"] or ""
            if name in known:
                checked.add(name)
                scaled = value * METRES.get(unit, 1.0) if name.endswith("_m") else value
                if not any(abs(scaled - one) < 1e-9 for one in known[name]):
                    wrong.append(f"{page.name}: {match[0]}: the default is {sorted(known[name])}")
    assert not wrong, "\n".join(wrong)
    assert len(checked) > 15, checked


def test_the_page_of_scenes_has_the_example_every_shape_and_every_field(reference) -> None:
    page = (DOCS / "scenes.md").read_text(encoding="utf-8")
    example = (ROOT / "examples" / "data" / "objects.yaml").read_text(encoding="utf-8").partition("\n")[2]
    assert f"```yaml\n{example}```" in page
    assert len(example.splitlines()) == 15
    assert all(f"| `{shape}` |" in page for shape in (*SHAPES, MESH))
    assert all(
        f"| `{field}` |" in page for field in ("seed", "families[].count", "objects[].pose.rest", "fingers.dead.thumb")
    )


@pytest.mark.slow
@pytest.mark.ros
@pytest.mark.timeout(600)
@pytest.mark.xdist_group("site")
def test_the_site_builds_without_a_warning(tmp_path) -> None:
    for module in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(module, reason="the extra docs is not installed")
    pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "dummy", DOCS, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=580)
    assert done.returncode == 0, done.stderr

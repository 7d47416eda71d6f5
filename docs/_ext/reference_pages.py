# SPDX-License-Identifier: Apache-2.0
"""Reference pages in Markdown, made from the code: messages, parameters, topics, commands and settings.

    python docs/_ext/reference_pages.py     # or make reference

writes the parts of the pages below docs that stand between `<!-- generated NAME -->` and `<!-- end -->`, where NAME is a key of `GENERATORS`.
"""

import argparse
import dataclasses
import inspect
import os
import re
import sys
import tempfile
import typing
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from foretouch.cli.main import command_parser
from foretouch.cli.parser import CommandParser
from foretouch.config import SettingInfo, Settings, setting_infos

ROOT = Path(__file__).resolve().parents[2]
INTERFACES = ROOT / "foretouch_msgs"


# Tables.


def cell(text: str) -> str:
    """Return a text as one cell of a table: in Markdown, `<`, `|` and new lines have meanings there."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table of cells that are Markdown themselves; "" without rows."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}", *lines, ""]) if lines else ""


def sections(parts: Iterable[str]) -> str:
    """Return parts with an empty line between them."""
    return "\n\n".join(part.strip("\n") for part in parts if part.strip()) + "\n"


# Messages, services and the action.


@dataclasses.dataclass
class Field:
    """One line of an interface file, with its comment."""

    type: str
    name: str
    value: str  # of a constant, "" for a field
    comment: str


@dataclasses.dataclass
class Interface:
    """One file of `foretouch_msgs`."""

    name: str
    comment: str  # above the first field
    parts: list[list[Field]]  # a message has one, a service two, an action three


_LINE = re.compile(r"(?P<type>[\w/]+(?:\[[<=\d]*\])?)\s+(?P<name>\w+)(?:\s*=\s*(?P<value>\"[^\"]*\"|\S+))?")


def interfaces(kind: str) -> list[Interface]:
    """Return the interfaces of a kind, `msg`, `srv` or `action`, in order of their names."""
    return [read_interface(path) for path in sorted((INTERFACES / kind).glob(f"*.{kind}"))]


def read_interface(path: Path) -> Interface:
    """Read one file: a comment beside or below a field belongs to it, one before the first field to the file."""
    header: list[str] = []
    parts: list[list[Field]] = [[]]
    last: Field | None = None
    for line in path.read_text(encoding="utf-8").splitlines():
        code, _, comment = (piece.strip() for piece in line.partition("#"))
        if "SPDX" in comment:
            continue
        if code == "---":
            parts.append([])
            last = None
        elif code:
            match = _LINE.fullmatch(code)
            if match is None:
                raise ValueError(f"{path}: {line!r} is no field")
            last = Field(match["type"], match["name"], match["value"] or "", comment)
            parts[-1].append(last)
        elif not comment:
            last = None
        elif last is not None:
            last.comment = f"{last.comment} {comment}".strip()
        else:
            header.append(comment)
    return Interface(path.stem, " ".join(header), parts)


def _type_link(name: str) -> str:
    bare = name.partition("[")[0]
    own = any((INTERFACES / kind / f"{bare}.{kind}").exists() for kind in ("msg", "srv", "action"))
    return f"[`{name}`](#{bare.lower()})" if own else f"`{name}`"


def _fields(fields: Sequence[Field]) -> str:
    constants = table(
        ["constant", "value", "meaning"], [(f"`{f.name}`", f"`{f.value}`", cell(f.comment)) for f in fields if f.value]
    )
    rows = [(f"`{f.name}`", _type_link(f.type), cell(f.comment)) for f in fields if not f.value]
    return sections([constants, table(["field", "type", "content"], rows)])


def messages() -> str:
    """Return all interfaces, each with its fields, their types and comments."""
    titles = {"msg": ("Messages", [""]), "srv": ("Services", ["Request", "Response"]),
              "action": ("Action", ["Goal", "Result", "Feedback"])}  # fmt: skip
    parts = []
    for kind, (title, names) in titles.items():
        parts.append(f"## {title}")
        for interface in interfaces(kind):
            parts += [f"### {interface.name}", interface.comment]
            for name, fields in zip(names, interface.parts, strict=True):
                parts += [f"**{name}**" if name else "", _fields(fields) if fields else "No fields."]
    return sections(parts)


# Settings, and the parameters of the nodes, which are settings.


def _kind(info: SettingInfo) -> str:
    names = {bool: "true or false", int: "whole number", float: "number", str: "text"}
    text = names.get(info.type, info.type.__name__) + (f" [{info.unit}]" if info.unit else "")
    if info.choices:
        text = ", ".join(f"`{choice}`" for choice in info.choices)
    elif info.minimum is not None or info.maximum is not None:
        low, high = ("" if limit is None else f"{limit:g}" for limit in (info.minimum, info.maximum))
        bounds = f"{low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}"
        text = f"{text}, {bounds}"
    return f"list: {text}" if info.is_list else text


def _default(info: SettingInfo) -> str:
    value = info.default
    if value is dataclasses.MISSING:
        return "required"
    if value is None:
        return "none"
    if isinstance(value, tuple):
        value = f"[{', '.join(str(item) for item in value)}]"
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f"`{text}`" if text else "empty"


def setting_rows(infos: Iterable[SettingInfo], *, live: bool) -> Iterator[tuple[str, ...]]:
    """Iterate over the rows, one for each setting; `live` adds whether a running node accepts a change."""
    for info in infos:
        row = (f"`{info.name}`", cell(_default(info)), cell(_kind(info)), cell(info.description))
        yield (*row, "no" if info.read_only else "yes") if live else row


def settings_table(infos: Iterable[SettingInfo], *, live: bool = False) -> str:
    """Return a table of settings."""
    columns = ["parameter" if live else "setting", "default", "values", "meaning"]
    return table([*columns, "while running"] if live else columns, setting_rows(infos, live=live))


def all_infos(cls: type[Settings], prefix: str = "") -> list[SettingInfo]:
    """Return settings of a class as `setting_infos` does, with optional groups, and lists of groups as `name[]`."""
    own = {info.name: info for info in setting_infos(cls)}
    infos: list[SettingInfo] = []
    for field in dataclasses.fields(cls):
        hint = typing.get_type_hints(cls)[field.name]
        inner = [
            kind for kind in (hint, *typing.get_args(hint)) if isinstance(kind, type) and issubclass(kind, Settings)
        ]
        if inner and not dataclasses.fields(inner[0]):
            infos.append(_switch(cls, field.name, prefix))
        elif inner:
            listed = "[]" if typing.get_origin(hint) is tuple else ""
            infos += all_infos(inner[0], f"{prefix}{field.name}{listed}.")
        else:
            infos.append(dataclasses.replace(own[field.name], name=prefix + field.name))
    return infos


def _switch(cls: type[Settings], name: str, prefix: str) -> SettingInfo:
    """Return a group without settings, described under `Attributes` of the class that has it."""
    described = re.search(rf"^ +{name}: (.*)", inspect.getdoc(cls) or "", re.MULTILINE)
    meaning = described[1].rstrip(".") if described else ""
    limits: dict[str, Any] = {"unit": "", "minimum": None, "maximum": None, "choices": ("{}",)}
    kind: dict[str, Any] = {"type": str, "is_list": False, "optional": True, "read_only": True}
    return SettingInfo(name=prefix + name, default=None, description=meaning, **limits, **kind)


def _summary(documented: Any) -> str:
    """Return the first paragraph of a docstring."""
    text = " ".join((inspect.getdoc(documented) or "").partition("\n\n")[0].split())
    text = text.removeprefix("Run the command; ").removeprefix("Make ")  # where the page says so itself
    return text[:1].upper() + text[1:]


def _grouped(cls: type[Settings]) -> str:
    """Return a section for the settings of a class, and one for each of its groups."""
    groups: dict[str, list[SettingInfo]] = {}
    for info in all_infos(cls):
        groups.setdefault(info.name.partition(".")[0] if "." in info.name else "", []).append(info)
    return sections(
        text for name, infos in groups.items() for text in (f"### `{name}`" if name else "", settings_table(infos))
    )


def pipeline() -> str:
    """Settings of the pipeline."""
    from foretouch.stream import StreamConfig

    return _grouped(StreamConfig)


def scenes() -> str:
    """Settings of a scene."""
    from foretouch_lab.simulation.scene import SceneConfig
    from foretouch_lab.simulation.scene.objects import FamilyConfig

    families = [dataclasses.replace(info, name=f"families[].{info.name}") for info in all_infos(FamilyConfig)]
    return sections([_grouped(SceneConfig), "### `families[]`", settings_table(families)])


def sensors() -> str:
    """Settings of a description of a sensor."""
    from foretouch.tactile.description import SensorConfig

    return _grouped(SensorConfig)


def shapes() -> str:
    """Return the shapes of simulated objects, each with what it looks like."""
    from foretouch_lab.simulation.objects import shapes as module

    random = "Between box, cylinder and ellipsoid, or a vase, or a wavy ball: another one for each `first_variant`."
    rows = [(f"`{name}`", cell(_summary(builder))) for name, builder in module.BUILDERS.items()]
    rows += [("`random`", random), ("`mesh`", "The surface of a [mesh file](#objects-from-mesh-files).")]
    return table(["shape", "body"], rows)


def recipes() -> str:
    """Settings of a training: those of every method, then each group with the methods that it is for."""
    from foretouch_lab.learning.training.run_config import GROUPS, RunConfig

    infos = all_infos(RunConfig)
    parts = ["### Every method", settings_table(info for info in infos if info.name.partition(".")[0] not in GROUPS)]
    for group, methods in GROUPS.items():
        words = " and ".join(f"`method: {name}`" for name in methods)
        parts += [f"### {words}", settings_table(info for info in infos if info.name.startswith(f"{group}."))]
    return sections(parts)


def experiments() -> str:
    """Return each experiment: its question, presets and settings."""
    from foretouch_lab.experiments import list_experiments

    parts = []
    for experiment in list_experiments():
        presets = ", ".join(f"`{preset}`" for preset in experiment.presets)
        parts += [f"### `{experiment.name}`", experiment.question, f"Presets: {presets}." if presets else ""]
        parts.append(settings_table(all_infos(experiment.settings)))
    return sections(parts)


def node_configs() -> dict[str, type[Settings]]:
    """Return the settings of each node by its name."""
    from foretouch.ros.nodes import NODES

    return {name: NODES.load(name).config_class for name in NODES}


def parameters() -> str:
    """Return the parameters of every node; the parameters that all nodes share come first, once."""
    from foretouch.ros.runtime.lifecycle_node import NodeConfig

    shared = {info.name for info in setting_infos(NodeConfig)}
    parts = ["## Every node", settings_table(setting_infos(NodeConfig), live=True)]
    for name, config in node_configs().items():
        own = [info for info in setting_infos(config) if info.name not in shared]
        parts += [f"## `{name}`", settings_table(own, live=True)]
    return sections(parts)


# Topics, as the nodes themselves report them.

_INTERNAL = re.compile(r"/(rosout|parameter_events)$|/_action/|/(change_state|get_[a-z_]*|transition_event)$"
                       r"|_parameters?(_types|_atomically)?$|type_description$")  # fmt: skip
_PURPOSES = {  # of topics and services whose types have no comment of their own, or are not ours
    "points": "the point cloud of the camera, while somebody subscribes; `perception` and `segmentation` receive it with `input: points`",
    "depth/image": "depth images of the camera; remap it, or give `depth:=TOPIC` to the launch files",
    "color/image": "colours of their pixels, aligned with them; remap it, or give `color:=TOPIC` to the launch files",
    "depth/camera_info": "the camera of the depth images, beside them",
    "object_cloud": "the points of the target",
    "grasp_poses": "the poses of the tool, best grasp first",
    "markers": "all results, for RViz",
    "/diagnostics": "rates, latencies and dropped messages of each node",
    "label_grasp": "change the label, the outcome or the note of a grasp, or discard it",
    "edit_grasp": 'change the object, the outcome or the note of a recorded grasp of this session, or drop it; `grasp_id` "" is the last',
    "next_object": "name the object that is on the table from now on; without a name the next of the parameter `objects`",
    "pause_recording": "record nothing until it is called with `false`",
    "undo_edit": "undo the latest action of this session that is in force",
    "start_recording": "start a recording",
    "stop_recording": "end the recording",
    "execute_grasp": "execute the best of the newest grasps now",
    "press_th": "press the thumb of the simulated hand for a second, as a person does for `record --check`",
    "press_mf": "the same of the middle finger",
    "forget_touches": "forget the readings of the current object",
    "forget_history": "forget all readings of the hand",
}


def topics() -> str:
    """Return topics, services and the action, from nodes that are configured for it, each alone, without discovery."""
    ends_of = graph()
    comments = {
        interface.name: interface.comment for kind in ("msg", "srv", "action") for interface in interfaces(kind)
    }
    parts = []
    for title, kind, ends in (
        ("Topics", "topic", ["publisher", "subscriber"]),
        ("Services", "service", ["server"]),
        ("Action", "action", ["server"]),
    ):
        rows = []
        for name, (type_name, nodes) in sorted(ends_of[kind].items()):
            users = [", ".join(f"`{node}`" for node in nodes.get(end, [])) or "–" for end in ends]
            package, _, own = type_name.split("/")
            link = f"[`{own}`](messages.md#{own.lower()})" if package == "foretouch_msgs" else f"`{package}/{own}`"
            rows.append((f"`{name}`", link, *users, cell(_PURPOSES.get(name) or comments.get(own, ""))))
        parts += [
            f"## {title}",
            table([kind, "type", *(f"{end}s" if end != "server" else "node" for end in ends), "content"], rows),
        ]
    return sections(parts)


Ends = dict[str, tuple[str, dict[str, list[str]]]]


def graph() -> dict[str, Ends]:
    """Return, by kind (topic, service, action) and name, the type, and the nodes at each end."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    import numpy as np
    import rclpy
    from rclpy.action import get_action_server_names_and_types_by_node
    from rclpy.context import Context
    from rclpy.parameter import Parameter

    from foretouch.ros.nodes import NODES

    ends_of: dict[str, Ends] = {"topic": {}, "service": {}, "action": {}}
    context = Context()
    rclpy.init(context=context)
    with tempfile.TemporaryDirectory() as folder:
        np.savez(f"{folder}/cloud.npz", xyz=np.ones((4, 4, 3), np.float32))
        scene = str(ROOT / "src/foretouch_lab/simulation/scenes/clean.yaml")
        needed: dict[str, dict[str, Any]] = {
            "camera": {"source": "scene", "scene.path": scene},
            "hand": {"scene.path": scene},
            "replay": {"path": f"{folder}/cloud.npz", "lockstep": True},
        }
        for name in NODES:
            values = {**needed.get(name, {}), "autostart": False}
            overrides = [Parameter(key, value=value) for key, value in values.items()]
            node = NODES.load(name)(parameter_overrides=overrides, context=context)
            node.trigger_configure()
            own = node.get_name(), node.get_namespace()
            for kind, end, pairs in (
                ("topic", "publisher", node.get_publisher_names_and_types_by_node(*own)),
                ("topic", "subscriber", node.get_subscriber_names_and_types_by_node(*own)),
                ("service", "server", node.get_service_names_and_types_by_node(*own)),
                ("action", "server", get_action_server_names_and_types_by_node(node, *own)),
            ):
                for full, types in pairs:
                    if not _INTERNAL.search(full):
                        short = full.removeprefix(f"{own[1]}/")
                        ends_of[kind].setdefault(short, (types[0], {}))[1].setdefault(end, []).append(name)
            node.destroy_node()
    context.try_shutdown()
    return ends_of


# The command line.


def parser_of(command: str) -> CommandParser:
    """Return the parser of one command, or of an action such as `dataset build`."""
    parser = command_parser(command.partition(" ")[0])
    for word in command.split():
        parser = parser.commands[word]
    return parser


def command_names() -> list[str]:
    """Return all commands, and the actions of each command that has actions."""
    from foretouch.cli.commands import COMMANDS

    return [
        name
        for command in COMMANDS
        if "." not in command
        for name in (command, *(f"{command} {action}" for action in parser_of(command).commands))
    ]


def commands() -> str:
    """Return every command with its arguments, options and exit status."""
    from foretouch.cli.commands import COMMANDS
    from foretouch.cli.main import main

    parts = ["## Exit status", _status(main)]
    for name in command_names():
        parser = parser_of(name)
        usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
        parts += [f"{'###' if ' ' in name else '##'} `{name}`", parser.description or "", f"```text\n{usage}\n```"]
        if name in COMMANDS:
            parts.append(_status(COMMANDS.load(name).load(name).run))
        parts.append(table(["argument", "meaning"], [_option_row(action) for action in parser.declared]))
    return sections(parts)


def _status(function: Callable[..., Any]) -> str:
    """Return what the docstring of a command states on its exit status."""
    text = (inspect.getdoc(function) or "").removeprefix("Run the command; ")
    return cell(text[:1].upper() + text[1:].partition("\n\nArgs:")[0]) if "exit status" in text.lower() else ""


def _option_row(action: argparse.Action) -> tuple[str, str]:
    """Return how an argument or option is written, and its help."""
    metavar = action.metavar or action.dest.upper()
    value = "" if action.nargs == 0 else " ".join(metavar) if isinstance(metavar, tuple) else metavar
    shown = f"{', '.join(action.option_strings)} {value}".strip()
    return f"`{shown}`".replace("|", "\\|"), cell((action.help or "") % vars(action))


def results() -> str:
    """Return a table of the pages of committed results, by folder."""
    rows = []
    for page in sorted((ROOT / "docs" / "results").glob("*/**/*.md")):
        place = page.relative_to(ROOT / "docs")
        title = page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        rows.append((f"[{place.parent.relative_to('results')}]({place})", cell(title)))
    return table(["folder", "question"], rows)


_TRADEOFFS = ROOT / "docs" / "results" / "tradeoff"
_AREAS = ("chain", "scene", "grasp", "model", "simulation", "training")


def _measured(area: str) -> str:
    """Return version, day and machine of the table of an area."""
    summary = (_TRADEOFFS / area / "summary.md").read_text(encoding="utf-8")
    found = re.search(r"^`foretouch tradeoff [^`]*`; (foretouch \S+ \(\w+\), [\d-]+, [^;\n]*)", summary, re.MULTILINE)
    return found[1] if found else "an unknown version"


def tradeoff_versions() -> str:
    """Return with which version the tables of the areas were measured: one, if they are of one."""
    areas: dict[str, list[str]] = {}
    for area in _AREAS:
        areas.setdefault(_measured(area), []).append(area)
    if len(areas) == 1:
        return f"All tables and pictures of this page were measured in one run with {next(iter(areas))}.\n"
    lines = [f"- {', '.join(names)}: {version}" for version, names in areas.items()]
    return "\n".join(["The tables are of several runs:", "", *lines, ""])


def tradeoff_table(name: str) -> str:
    """Return the summary of an area, and rows of its variants: those on a frontier, the default ones, and those of other programs."""
    from foretouch_lab.experiments.framework.manifest import read_results
    from foretouch_lab.experiments.framework.tradeoff import find_area

    area = find_area(name)
    results = read_results(_TRADEOFFS / name / area.results)
    *summaries, whole = area.tables(results)
    others = {row["variant"] for row in results if row["factor"] == "reference"}
    kept, notes = [], whole.notes[2:]  # of the chain, whose frontier is in the summary
    if name != "chain":
        notes = whole.notes
        kept = [
            [cell(text) for text in row]
            for row in whole.rows
            if row[0].endswith(" *") or row[0] in others or any(text.startswith("•") for text in row)
        ]
    parts = [table(list(one.columns), [list(map(cell, row)) for row in one.rows]) for one in summaries]
    lines = [f"- {cell(note)}" for note in (*(note for one in summaries for note in one.notes), *notes)]
    return sections([*parts, table(list(whole.columns), kept), "\n".join(lines)])


GENERATORS: dict[str, Callable[[], str]] = {
    "messages": messages,
    "parameters": parameters,
    "topics": topics,
    "commands": commands,
    "pipeline": pipeline,
    "scenes": scenes,
    "sensors": sensors,
    "shapes": shapes,
    "recipes": recipes,
    "experiments": experiments,
    "results": results,
    "tradeoff_versions": tradeoff_versions,
    **{f"tradeoff_{area}": partial(tradeoff_table, area) for area in _AREAS},
}
"""What a page can ask for, by name."""


GENERATED = re.compile(r"^<!-- generated (\w+) -->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)


def filled(text: str) -> str:
    """Return the text of a page with its generated parts made anew."""
    return GENERATED.sub(lambda part: f"<!-- generated {part[1]} -->\n\n{GENERATORS[part[1]]()}\n<!-- end -->", text)


def generated_pages() -> list[Path]:
    """Return the pages that have a generated part."""
    pages = sorted((ROOT / "docs").rglob("*.md"))
    return [page for page in pages if GENERATED.search(page.read_text(encoding="utf-8"))]


def main() -> int:
    """Write the pages, or with `--check` print those that would change; returns how many these are."""
    stale = {}
    for page in generated_pages():
        text = page.read_text(encoding="utf-8")
        new = filled(text)
        if new != text:
            stale[page] = new
    for page, new in stale.items():
        sys.stdout.write(
            f"{page.relative_to(ROOT)}: {'is not that of the code' if '--check' in sys.argv else 'written'}\n"
        )
        if "--check" not in sys.argv:
            page.write_text(new, encoding="utf-8")
    return len(stale) if "--check" in sys.argv else 0


if __name__ == "__main__":
    sys.exit(main())

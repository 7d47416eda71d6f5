# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset`: inspect, verify, repair, edit and convert datasets."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from foretouch.base.files import PICTURE_SUFFIXES, require_existing, require_writable
from foretouch.cli.commands import COMMANDS, CommandEntry
from foretouch.cli.inputs import add_options, positive_number
from foretouch.cli.output import print_json, print_table, progress_bar, warn
from foretouch.cli.parser import CommandParser, one_of
from foretouch.dataset import formats
from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.importing import BagTopics, import_samples
from foretouch.dataset.recordings import editing
from foretouch.dataset.recordings.folder import is_dataset
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.samples import PAIRING_EDGES_MS, describe, only_finite, sensor_of_samples
from foretouch.dataset.store import Store, is_store
from foretouch.doors import needs_extras
from foretouch.errors import ConfigError, FileError, ForetouchError
from foretouch.tactile.messages.table import TactileConfig
from foretouch.types import DISCARDED

_SHEET_SAMPLES = 12
_ASSUMED = "; of the others the camera is taken to look straight down on it"
_KINDS = ("clouds", "table", "grasps", "executed", "tactile")  # of topics in a bag


def add_arguments(parser: CommandParser) -> None:
    """Add one action each, with its options."""
    dataset = f"dataset: {formats.readable_formats()}"

    info = _action(parser, "info", _info, "Print counts and ranges of a dataset")
    info.add_argument("path", metavar="IN", help=dataset)

    verify = _action(parser, "verify", _verify, "Verify the checksums of every byte")
    verify.add_argument("paths", metavar="IN", nargs="+", help="recorded dataset, one of its files, or training store")

    repair = _action(parser, "repair", _repair, "Repair unfinished or damaged recordings, and keep the originals")
    repair.add_argument("paths", metavar="IN", nargs="+", help="recorded dataset, or one of its files")

    edit = _action(
        parser, "edit", _edit, "Relabel, drop or merge samples in a log beside the recordings; can be undone"
    )
    edit.add_argument("path", metavar="DS", help="recorded dataset; without an action, its edits are listed")
    edit.add_argument(
        "--id", action="append", default=[], metavar="ID", help="id of a sample to relabel or drop; may be repeated"
    )
    alternatives = edit.add_mutually_exclusive_group()
    edit.add_argument("--relabel", group=alternatives, metavar="NAME", help="give the samples another object name")
    edit.add_argument(
        "--drop", group=alternatives, action="store_true", help="discard the samples: builds and exports leave them out"
    )
    edit.add_argument(
        "--merge", group=alternatives, nargs=2, metavar=("A", "B"), help="give all samples of the object A the name B"
    )
    edit.add_argument("--undo", group=alternatives, action="store_true", help="undo the latest edit that is in force")

    _add_import(_action(parser, "import", _import, "Convert other datasets and ROS bags to a recorded dataset"))

    export = _action(parser, "export", _export, "Write samples in another format")
    export.add_argument("source", metavar="DS", help=dataset)
    _add_out(export, "DIR", "folder to create; must not exist")
    exported = formats.exported_formats()
    export.add_argument(
        "--format",
        required=True,
        type=one_of(*exported),
        metavar="{" + ",".join(exported) + "}",
        help="format to write",
    )
    fps = (
        "of lerobot: frames per second, each with the window of the newest readings; by default each reading is a frame"
    )
    export.add_argument("--fps", type=positive_number, metavar="N", help=fps)

    show = _action(parser, "show", _show, "Draw a contact sheet: clouds, contacts and electrode maps")
    show.add_argument("source", metavar="DS", help=dataset)
    _add_out(show, "F.png", "image file")
    count = "number of samples, evenly spaced over the dataset"
    show.add_argument("-n", "--count", type=positive_number, default=_SHEET_SAMPLES, help=count)

    for name in COMMANDS:
        of, _, action = name.partition(".")
        if of == "dataset" and action not in {"", *parser.commands}:
            _add_action(parser, name, action)


def _add_action(parser: CommandParser, name: str, action: str) -> None:
    """Add an action of another package; why it cannot be used is the answer to who asks for it."""
    words = f"dataset {action}"
    try:
        command: CommandEntry = COMMANDS.load(name)
        module = command.load(words)
    except ForetouchError as err:
        parser.faults[action] = err
        return
    module.add_arguments(_action(parser, action, partial(_added, module, words), command.summary, command.example))


def _action(
    parser: CommandParser, name: str, act: Callable[..., int], summary: str, example: str = ""
) -> CommandParser:
    action = parser.add_command(name, summary, example)
    action.set_defaults(act=act)
    action.add_json()
    return action


def _add_out(parser: CommandParser, metavar: str, summary: str) -> None:
    parser.add_argument("-o", "--out", type=Path, required=True, metavar=metavar, help=summary)


def _add_import(parser: CommandParser) -> None:
    parser.add_argument("source", metavar="SRC", help=f"dataset ({formats.readable_formats()}) or ROS bag")
    _add_out(parser, "DS", "recorded dataset to create or to extend")
    group = parser.add_argument_group("ROS bags without foretouch samples")
    parser.add_argument(
        "--topic",
        group=group,
        action="append",
        default=[],
        type=_topic,
        metavar="KIND=NAME",
        help="a topic of another name than the recorder's, such as tactile=/taxels; of the kinds clouds (of the object), table, grasps, executed, tactile",
    )
    add_options(parser, "--sensor", "--thumb", "--middle", group=group)
    parser.add_argument(
        "--object", group=group, metavar="NAME", help="name of the object on the table (default: unknown)"
    )


def _topic(text: str) -> tuple[str, str]:
    """Parse `KIND=NAME` for argparse."""
    kind, _, name = text.partition("=")
    if kind not in _KINDS or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not KIND=NAME with a kind of {', '.join(_KINDS)}")
    return kind, name


def run(arguments: argparse.Namespace) -> int:
    """Run an action; exit status 1 if something is damaged."""
    return int(arguments.act(arguments))


def _added(module: ModuleType, words: str, arguments: argparse.Namespace) -> int:
    """Run an action of another package."""
    with needs_extras(words):
        return int(module.run(arguments))


def _info(arguments: argparse.Namespace) -> int:
    facts = describe(open_samples(arguments.path, unfinished=True))
    if arguments.json:
        return print_result("", {"path": arguments.path, **facts, "pairing_edges_ms": PAIRING_EDGES_MS}, as_json=True)
    counts = "{samples} ({labelled} labelled, {tared} with tare, {discarded} discarded)".format(**facts)
    period = ""
    if facts["last_ns"]:
        period = f"{_utc(facts['first_ns'])} to {_utc(facts['last_ns'])}"
    elif facts["samples"]:
        period = "without stamps"
    least, median, most = facts["points"]
    bins = zip(PAIRING_EDGES_MS, PAIRING_EDGES_MS[1:], facts["pairing_ms"], strict=False)
    rows = {
        "kind": facts["kind"],
        "samples": counts,
        **{name: facts[name] for name in ("objects", "outcomes", "flags")},
        "time": period,
        "points a cloud": f"{least} to {most} (median {median})" if facts["samples"] else "",
        "table": f"known of {facts['tables']} of {facts['samples']}{_ASSUMED if facts['tables'] < facts['samples'] else ''}",
        "sensor": facts["sensor"],
        "dead taxels": facts["dead"],
        **{name: f"{low:g} to {high:g} {facts['units'][name]}" for name, (low, high) in facts["ranges"].items()},
        "hand": facts["hand"],
        "camera": facts["camera"],
        "not finished": ", ".join(facts["unfinished"]),
        "pairing error": ", ".join(f"{low:g}-{high:g} ms: {count}" for low, high, count in bins if count),
        **facts["accounts"],
        "edits": facts["edits"],
    }
    return print_result(arguments.path, rows, as_json=False)


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _verify(arguments: argparse.Namespace) -> int:
    failed = False
    rows = []
    for path in arguments.paths:
        require_existing(path)
    for path in arguments.paths:
        for record in _verified(path):
            failed |= record["status"] != "ok"
            if arguments.json:
                print_json({"input": path, **record})
            for fault in record["faults"]:
                warn(fault)
            counts = ["" if record[name] is None else str(record[name]) for name in ("samples", "messages", "bytes")]
            lost = str(sum(record.get("lost", {}).values()))
            rows.append([str(record["file"]), record["status"], *counts, lost, str(len(record["faults"]))])
    if not arguments.json:
        print_table(
            "faults were found" if failed else "all are whole",
            ["file", "state", "samples", "messages", "bytes", "lost", "faults"],
            rows,
        )
    return int(failed)


def _verified(path: str) -> Iterator[dict[str, Any]]:
    """Iterate over one record for each file of a recorded dataset, or one for a training store."""
    empty = {"file": path, "samples": None, "messages": None, "bytes": None}
    try:
        if is_store(path) and not is_dataset(path):
            store = Store(path)  # verifies the hashes of all files
            yield {**empty, "status": "ok", "samples": len(store), "sha256": store.sha256, "faults": []}
            return
        for report in verify_dataset(path):
            counts = {} if report.counts is None else report.counts.to_record()
            yield {
                "file": str(report.path),
                "status": "ok" if report.clean else "damaged" if report.finished else "unfinished",
                "samples": len(report.ids),
                "messages": report.messages.total(),
                "bytes": report.size,
                "dropped": {topic: count["dropped"] for topic, count in counts.items() if count["dropped"]},
                "lost": {topic: count["lost"] for topic, count in counts.items() if count["lost"]},
                "faults": report.fault_lines(),
            }
    except ForetouchError as err:
        yield {**empty, "status": "damaged", "faults": [str(err)]}


def _show(arguments: argparse.Namespace) -> int:
    from foretouch.report.touch_figure import save_contact_sheet, save_series_sheet

    require_writable(arguments.out, *PICTURE_SUFFIXES)
    samples = open_samples(arguments.source)
    count = min(arguments.count, len(samples))
    selected = [samples.read(k * len(samples) // count) for k in range(count)]
    if not selected:
        raise FileError(arguments.source, "holds no sample to show")
    sensor = sensor_of_samples(samples)
    if any(len(sample.cloud.finite) for sample in selected):
        save_contact_sheet(arguments.out, [only_finite(sample) for sample in selected], sensor)
    else:
        title = f"{Path(arguments.source).name}: {len(selected)} of {len(samples)} samples"
        save_series_sheet(arguments.out, selected, title, sensor)
    dropped = [sample.id for sample in selected if DISCARDED in sample.flags]
    record: dict[str, Any] = {"out": str(arguments.out), "samples": [sample.id for sample in selected]}
    record |= {"dropped": dropped, "dead_taxels": sensor.dead}
    return print_result("drawn", record, as_json=arguments.json)


def _repair(arguments: argparse.Namespace) -> int:
    failed, rows = False, []
    for path in arguments.paths:
        for report in repair_dataset(path):
            lost = [str(damage.error(report.path)) for damage in report.lost]
            if arguments.json:
                original = None if report.original is None else str(report.original)
                counts = {"samples": report.samples, "messages": report.messages}
                record = {"file": str(report.path), "changed": report.changed, **counts, "original": original}
                print_json({"input": path, **record, "lost": lost, "refusal": report.refusal})
            if report.refusal:
                warn(report.refusal)
            for line in lost:
                warn(f"{line}: not kept")
            if report.changed and not report.samples:
                warn(f"{report.path}: holds no whole sample: a sample is written when its grasp has ended")
            kept = report.original.name if report.original else ""
            failed |= bool(report.refusal)
            state = "refused" if report.refusal else "repaired" if report.changed else "not damaged"
            rows.append([str(report.path), state, str(report.samples), str(report.messages), kept])
    if not arguments.json:
        title = "repaired" if any(row[1] == "repaired" for row in rows) else "nothing repaired"
        print_table(title, ["file", "state", "samples", "messages", "original"], rows)
    return int(failed)


def _edit(arguments: argparse.Namespace) -> int:
    """Apply one edit; without one, list the edits."""
    path, ids = arguments.path, arguments.id
    needs_ids = arguments.relabel is not None or arguments.drop
    if needs_ids != bool(ids):
        raise ConfigError("--relabel and --drop need --id" if needs_ids else "--id needs --relabel or --drop")
    record: dict[str, Any] = {}
    if arguments.relabel is not None:
        record["edit"] = editing.relabel(path, ids, arguments.relabel)
    elif arguments.drop:
        record["edit"] = editing.drop(path, ids)
    elif arguments.merge:
        record["edit"] = editing.merge(path, *arguments.merge)
    elif arguments.undo:
        record["undone"] = editing.undo(path)
    edits = RecordedDataset(path).edits.descriptions()
    if arguments.json:
        print_json({**record, "edits": edits})
    else:
        print_table("edits", ["number", "edit"], [text.split(": ", 1) for text in edits])
    return 0


def _import(arguments: argparse.Namespace) -> int:
    sensor, thumb, middle = (getattr(arguments, name) or "" for name in ("sensor", "thumb", "middle"))
    config = TactileConfig(sensor=sensor, thumb=thumb, middle=middle)
    named = {"object": arguments.object} if arguments.object else {}
    topics = BagTopics(tactile_config=config, **named, **dict(arguments.topic))
    given = topics if topics != BagTopics() else None
    with progress_bar("importing", hidden=arguments.json) as advance:
        result = import_samples(arguments.source, arguments.out, topics=given, progress=advance)
    for note in result.notes:
        warn(note)
    record = {"out": str(arguments.out), **vars(result), "left_out": +result.left_out}
    return print_result("imported", record, as_json=arguments.json)


def _export(arguments: argparse.Namespace) -> int:
    if arguments.fps and arguments.format != "lerobot":
        raise ConfigError(f"--fps: {arguments.format} has no frames")
    options = {"fps": arguments.fps} if arguments.fps else {}
    with progress_bar("exporting", hidden=arguments.json) as advance:
        result = export_samples(arguments.source, arguments.out, arguments.format, advance, **options)
    record = {"out": str(arguments.out), "format": arguments.format, **vars(result), "lost": +result.lost}
    return print_result("exported", record, as_json=arguments.json)


def print_result(title: str, record: Mapping[str, Any], *, as_json: bool) -> int:
    """Print a JSON object, or a table without empty values; exit status 0."""
    if as_json:
        print_json(record)
    else:
        names = {name: name.replace("_", " ") if name.isidentifier() and name.islower() else name for name in record}
        rows = [[names[name], _text(value)] for name, value in record.items() if value not in ({}, [], (), "")]
        print_table(title, ["", "value"], rows)
    return 0


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        nested = any(isinstance(item, list | Mapping) for item in value.values())
        return ("; " if nested else ", ").join(f"{name} {_text(item)}" for name, item in value.items() if item != {})
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)

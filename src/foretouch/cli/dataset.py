# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset`: what recordings hold, whether they are whole, and the ways in and out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.output import print_json, print_table, warn
from foretouch.errors import ConfigError, FileError, ForetouchError

if TYPE_CHECKING:
    from foretouch.dataset.recording import Identity
    from foretouch.dataset.samples import SampleSet
    from foretouch.types import GraspSample

__all__ = ["add_arguments", "run"]

_SHEET_SAMPLES = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One action each, with its own options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, summary in _SUMMARIES.items():
        action = actions.add_parser(name, help=summary, description=f"{summary}.")
        _ARGUMENTS[name](action)
        action.add_argument("--json", action="store_true", help="JSON on stdout, and nothing else there")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 where something is damaged."""
    return _ACTIONS[arguments.action](arguments)


def _info(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.info import PAIRING_EDGES_MS, describe

    info = describe(arguments.path)
    if arguments.json:
        edges = [None if edge == float("inf") else edge for edge in PAIRING_EDGES_MS]
        print_json({"path": arguments.path, **vars(info), "pairing_edges_ms": edges})
        return 0
    rows = [
        ["kind", info.kind],
        ["samples", f"{info.samples} ({info.labelled} labelled, {info.tared} with tare, {info.discarded} discarded)"],
        ["objects", _counted(info.objects)],
        ["outcomes", _counted(info.outcomes)],
        ["flags", _counted(info.flags)],
        ["time", f"{_utc(info.first_ns)} to {_utc(info.last_ns)}"],
        ["points a cloud", f"{info.points[0]} to {info.points[2]} (median {info.points[1]})"],
        *([name, f"{low:g} to {high:g} counts"] for name, (low, high) in info.ranges.items()),
        ["hand", _facts(info.hand)],
        ["camera", _facts(info.camera)],
    ]
    if info.unfinished:
        rows.append(["not finished", f"{', '.join(info.unfinished)}: repair makes them whole"])
    if info.pairing_ms:
        spans = zip(PAIRING_EDGES_MS, PAIRING_EDGES_MS[1:], info.pairing_ms, strict=False)
        rows.append(["pairing error", ", ".join(f"{a:g}-{b:g} ms: {n}" for a, b, n in spans if n)])
    print_table(arguments.path, ["", "value"], [[name, value] for name, value in rows if value])
    return 0


def _verify(arguments: argparse.Namespace) -> int:
    failed = False
    rows = []
    for path in arguments.paths:
        for record in _verified(path):
            failed |= record["status"] != "ok"
            if arguments.json:
                print_json({"input": path, **record})
            for fault in record["faults"]:
                warn(fault)
            counts = ["" if record[name] is None else str(record[name]) for name in ("samples", "messages", "bytes")]
            rows.append([str(record["file"]), record["status"], *counts, str(len(record["faults"]))])
    if not arguments.json:
        print_table("verified", ["file", "state", "samples", "messages", "bytes", "faults"], rows)
    return int(failed)


def _verified(path: str) -> Iterator[dict[str, Any]]:
    """One record a file of a recorded dataset, or one for a store."""
    from foretouch.dataset.recording import is_dataset, verify_dataset
    from foretouch.dataset.store import Store, is_store

    empty = {"file": path, "samples": None, "messages": None, "bytes": None}
    try:
        if is_store(path) and not is_dataset(path):
            store = Store(path)
            store.verify()
            yield {**empty, "status": "ok", "samples": len(store), "sha256": store.sha256, "faults": []}
            return
        for report in verify_dataset(path):
            dropped = {} if report.accounts is None else {t: dict(a.dropped) for t, a in report.accounts.topics.items()}
            yield {
                "file": str(report.path),
                "status": "ok" if report.clean else "damaged" if report.finished else "unfinished",
                "samples": len(report.ids),
                "messages": report.messages.total(),
                "bytes": report.size,
                "dropped": {topic: reasons for topic, reasons in dropped.items() if reasons},
                "faults": report.told(),
            }
    except ForetouchError as err:
        yield {**empty, "status": "damaged", "faults": [str(err)]}


def _repair(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.recording import repair_dataset

    rows = []
    for path in arguments.paths:
        for report in repair_dataset(path):
            lost = [str(damage.error(report.path)) for damage in report.lost]
            state = "repaired" if report.changed else "was whole"
            if arguments.json:
                original = None if report.original is None else str(report.original)
                counts = {"samples": report.samples, "messages": report.messages}
                print_json(
                    {
                        "input": path,
                        "file": str(report.path),
                        "changed": report.changed,
                        **counts,
                        "original": original,
                        "lost": lost,
                    }
                )
            for line in lost:
                warn(f"{line}: not kept")
            kept = report.original.name if report.original else ""
            rows.append([str(report.path), state, str(report.samples), str(report.messages), kept])
    if not arguments.json:
        print_table("repaired", ["file", "", "samples", "messages", "original"], rows)
    return 0


def _build(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.build import build_store
    from foretouch.learning.split_book import SPLITS_FILE, make_split_book

    book: dict[str, str] = {}

    def attach(samples: Sequence[Any]) -> Mapping[str, str]:
        book[SPLITS_FILE] = make_split_book(samples, arguments.seed)
        return book

    with _progress("building", arguments.json) as advance:
        result = build_store(arguments.sources, arguments.out, attach=attach, progress=advance)
    record = {
        "out": str(arguments.out),
        "samples": len(result.samples),
        "labelled": sum(sample.labelled for sample in result.samples),
        "left_out": dict(result.left_out),
        "sha256": result.sha256,
        **_split_record(book[SPLITS_FILE]),
    }
    _tell("built", record, as_json=arguments.json)
    return 0


def _split_record(text: str) -> dict[str, Any]:
    import json

    book = json.loads(text)
    parts = {kind: [part["name"] for part in parts] for kind, parts in book["splits"].items()}
    return {"seed": book["seed"], "splits": parts, "omitted": book["omitted"]}


def _import(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.importing import BagTopics, import_samples

    topics = BagTopics(
        clouds=arguments.cloud_topic,
        grasps=arguments.grasp_topic,
        executed=arguments.executed_topic,
        tactile=arguments.tactile_topic,
        object=arguments.object,
        fingers=arguments.fingers,
    )
    with _progress("importing", arguments.json) as advance:
        result = import_samples(
            arguments.source, arguments.out, identity=_identity(arguments), topics=topics, progress=advance
        )
    record = {"out": str(arguments.out), "samples": result.samples, "labelled": result.labelled}
    _tell("imported", {**record, "left_out": {k: n for k, n in result.left_out.items() if n}}, as_json=arguments.json)
    return 0


def _identity(arguments: argparse.Namespace) -> Identity | None:
    from foretouch.dataset.recording import Identity

    if not arguments.hand and not arguments.camera:
        return None
    facts = [dict(_pair(text) for text in texts) for texts in (arguments.hand, arguments.camera)]
    return Identity(hand=facts[0], camera=facts[1])


def _export(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.exporting import export_samples

    with _progress("exporting", arguments.json) as advance:
        result = export_samples(arguments.source, arguments.out, arguments.format, advance)
    lost = {name: count for name, count in result.lost.items() if count}
    record = {"out": str(arguments.out), "format": arguments.format, "samples": result.written}
    _tell("exported", {**record, "left_out": dict(result.left_out), "lost": lost}, as_json=arguments.json)
    return 0


def _show(arguments: argparse.Namespace) -> int:
    from foretouch.dataset.samples import open_samples
    from foretouch.report.contact_sheet import save_contact_sheet

    with open_samples(arguments.source) as samples:
        chosen = list(_chosen(samples, arguments))
    if not chosen:
        raise FileError(arguments.source, "holds no sample to show")
    save_contact_sheet(arguments.out, chosen, f"{Path(arguments.source).name}: {len(chosen)} of {len(samples)} samples")
    _tell("drawn", {"out": str(arguments.out), "samples": [sample.id for sample in chosen]}, as_json=arguments.json)
    return 0


def _chosen(samples: SampleSet, arguments: argparse.Namespace) -> Iterator[GraspSample]:
    """Those named by --id, or some spread evenly over the whole."""
    from foretouch.dataset.samples import only_finite

    if arguments.id:
        wanted = set(arguments.id)
        for record in samples.records(discarded=True):
            if record.sample.id in wanted:
                wanted.discard(record.sample.id)
                yield only_finite(record.sample)
        if wanted:
            raise FileError(arguments.source, f"holds no sample {', '.join(sorted(wanted))}")
        return
    count = min(arguments.count, len(samples))
    for k in range(count):
        yield only_finite(samples.record(k * len(samples) // count).sample)


@contextmanager
def _progress(what: str, as_json: bool) -> Iterator[Callable[[], None]]:
    """A count on stderr while something goes on; nothing for a program that reads JSON."""
    if as_json:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn(f"{what}: {{task.completed}} samples"), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=None)
        yield lambda: progress.advance(task)


def _tell(title: str, record: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(record)
        return
    rows = [[name.replace("_", " "), _text(value)] for name, value in record.items() if value not in ({}, [], "")]
    print_table(title, ["", "value"], rows)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {_text(item)}" for name, item in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))


def _facts(facts: Mapping[str, str]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in facts.items())


def _utc(stamp_ns: int) -> str:
    from datetime import UTC, datetime

    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ConfigError(f"{text}: is not NAME=VALUE")
    return name, value


def _fingers(text: str) -> tuple[int, int]:
    """`TH,MF` places for argparse."""
    words = text.split(",")
    if len(words) != 2 or not all(word.isdecimal() and int(word) < 5 for word in words):
        raise argparse.ArgumentTypeError(f"{text!r} is not two places from 0 to 4 with a comma between them")
    return int(words[0]), int(words[1])


def _add_info(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("path", metavar="IN", help="dataset, recording, training store or vision2tactile folder")


def _add_paths(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("paths", metavar="IN", nargs="+", help="dataset or recording; verify takes training stores too")


def _add_build(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sources", metavar="IN", nargs="+", help="datasets, recordings, stores, vision2tactile folders")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="STORE", help="training store; must not exist")
    parser.add_argument("--seed", type=int, default=0, help="of the splits")


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="SRC", help="vision2tactile folders, training store, rosbag2 or MCAP")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DS", help="dataset: made, or added to")
    parser.add_argument("--cloud-topic", default="/foretouch/object_cloud", help="of a bag without samples of ours")
    parser.add_argument("--grasp-topic", default="/foretouch/grasps")
    parser.add_argument("--executed-topic", default="/foretouch/executed_grasp")
    parser.add_argument("--tactile-topic", default="/rh/tactile")
    parser.add_argument("--object", default="unknown", help="label of the object on the table")
    parser.add_argument("--fingers", type=_fingers, default=(4, 1), metavar="TH,MF", help="places of thumb and middle")
    for name in ("hand", "camera"):
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar="NAME=VALUE", help="a fact of its identity"
        )


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="DS", help="dataset, recording, training store or vision2tactile folder")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder to be made")
    parser.add_argument("--format", required=True, choices=["vision2tactile", "npz", "rosbag2"])


def _add_show(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="DS", help="dataset, recording, training store or vision2tactile folder")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="F.png", help="the picture")
    parser.add_argument("-n", "--count", type=int, default=_SHEET_SAMPLES, help="samples, spread over the whole")
    parser.add_argument("--id", action="append", metavar="ID", help="a sample, instead of --count")


_SUMMARIES = {
    "info": "Count what a dataset holds",
    "verify": "Prove that every byte is what was written",
    "repair": "Make whole recordings of unfinished or damaged ones; the originals are kept",
    "build": "Build a training store, splits included",
    "import": "Make a dataset of what others recorded",
    "export": "Write samples in another format",
    "show": "Draw a contact sheet: clouds, contacts and electrode maps",
}
_ARGUMENTS = {
    "info": _add_info,
    "verify": _add_paths,
    "repair": _add_paths,
    "build": _add_build,
    "import": _add_import,
    "export": _add_export,
    "show": _add_show,
}
_ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {
    "info": _info,
    "verify": _verify,
    "repair": _repair,
    "build": _build,
    "import": _import,
    "export": _export,
    "show": _show,
}

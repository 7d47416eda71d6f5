# SPDX-License-Identifier: Apache-2.0
"""What `foretouch dataset` makes or changes: repair, edit, build, import, export."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from foretouch.cli.dataset_text import progress, tell
from foretouch.cli.output import print_json, print_table, warn
from foretouch.errors import ConfigError

if TYPE_CHECKING:
    from foretouch.dataset.recording import Identity, RepairReport

__all__ = ["build", "edit", "export_", "import_", "repair"]


def repair(arguments: argparse.Namespace) -> int:
    """Make recordings whole."""
    from foretouch.dataset.recording import repair_dataset

    rows = []
    for path in arguments.paths:
        for report in repair_dataset(path):
            lost = [str(damage.error(report.path)) for damage in report.lost]
            if arguments.json:
                print_json({"input": path, **_repair_record(report), "lost": lost})
            for line in lost:
                warn(f"{line}: not kept")
            kept = report.original.name if report.original else ""
            state = "repaired" if report.changed else "was whole"
            rows.append([str(report.path), state, str(report.samples), str(report.messages), kept])
    if not arguments.json:
        print_table("repaired", ["file", "", "samples", "messages", "original"], rows)
    return 0


def _repair_record(report: RepairReport) -> dict[str, Any]:
    return {
        "file": str(report.path),
        "changed": report.changed,
        "samples": report.samples,
        "messages": report.messages,
        "original": None if report.original is None else str(report.original),
    }


def edit(arguments: argparse.Namespace) -> int:
    """One edit; without one, the edits that there are."""
    from foretouch.dataset import editing
    from foretouch.dataset.recording import RecordedDataset

    path, ids = arguments.path, arguments.id
    chooses = arguments.relabel is not None or arguments.drop
    if chooses != bool(ids):
        raise ConfigError("--relabel and --drop need --id" if chooses else "--id needs --relabel or --drop")
    record: dict[str, Any] = {}
    if arguments.relabel is not None:
        record["edit"] = editing.relabel(path, ids, arguments.relabel)
    elif arguments.drop:
        record["edit"] = editing.drop(path, ids)
    elif arguments.merge:
        record["edit"] = editing.merge(path, *arguments.merge)
    elif arguments.undo:
        record["undone"] = editing.undo(path)
    with RecordedDataset(path) as dataset:
        edits = dataset.edits.told()
    if arguments.json:
        print_json({**record, "edits": edits})
    else:
        print_table("edits", ["number", "edit"], [text.split(": ", 1) for text in edits])
    return 0


def build(arguments: argparse.Namespace) -> int:
    """A training store, splits included."""
    from foretouch.dataset.build import build_store
    from foretouch.learning.data.splits import SPLITS_FILE, make_splits

    book: dict[str, str] = {}

    def attach(samples: Sequence[Any]) -> Mapping[str, str]:
        book[SPLITS_FILE] = make_splits(samples, arguments.seed)
        return book

    with progress("building", as_json=arguments.json) as advance:
        result = build_store(arguments.sources, arguments.out, attach=attach, progress=advance)
    record = {
        "out": str(arguments.out),
        "samples": len(result.samples),
        "labelled": sum(sample.labelled for sample in result.samples),
        "left_out": dict(result.left_out),
        "sha256": result.sha256,
        **_split_record(book[SPLITS_FILE]),
    }
    tell("built", record, as_json=arguments.json)
    return 0


def _split_record(text: str) -> dict[str, Any]:
    import json

    book = json.loads(text)
    parts = {kind: [part["name"] for part in parts] for kind, parts in book["splits"].items()}
    return {"seed": book["seed"], "splits": parts, "omitted": book["omitted"]}


def import_(arguments: argparse.Namespace) -> int:
    """A dataset of what others recorded."""
    from foretouch.dataset.importing import BagTopics, import_samples
    from foretouch.tactile.messages import TactileConfig

    topics = BagTopics(
        clouds=arguments.cloud_topic,
        grasps=arguments.grasp_topic,
        executed=arguments.executed_topic,
        tactile=arguments.tactile_topic,
        object=arguments.object,
        fingers=arguments.fingers,
        tactile_config=TactileConfig(thumb=arguments.thumb, middle=arguments.middle),
    )
    with progress("importing", as_json=arguments.json) as advance:
        result = import_samples(
            arguments.source, arguments.out, identity=_identity(arguments), topics=topics, progress=advance
        )
    record = {"out": str(arguments.out), "samples": result.samples, "labelled": result.labelled}
    tell("imported", {**record, "left_out": {k: n for k, n in result.left_out.items() if n}}, as_json=arguments.json)
    return 0


def _identity(arguments: argparse.Namespace) -> Identity | None:
    from foretouch.dataset.recording import Identity

    if not arguments.hand and not arguments.camera:
        return None
    facts = [dict(_pair(text) for text in texts) for texts in (arguments.hand, arguments.camera)]
    return Identity(hand=facts[0], camera=facts[1])


def export_(arguments: argparse.Namespace) -> int:
    """Samples in another format."""
    from foretouch.dataset.exporting import export_samples

    with progress("exporting", as_json=arguments.json) as advance:
        result = export_samples(arguments.source, arguments.out, arguments.format, advance)
    lost = {name: count for name, count in result.lost.items() if count}
    record = {"out": str(arguments.out), "format": arguments.format, "samples": result.written}
    tell("exported", {**record, "left_out": dict(result.left_out), "lost": lost}, as_json=arguments.json)
    return 0


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise ConfigError(f"{text}: is not NAME=VALUE")
    return name, value

# SPDX-License-Identifier: Apache-2.0
"""What `foretouch dataset` tells of a dataset and leaves as it is: info, verify, show."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foretouch.cli.dataset_text import counted, tell
from foretouch.cli.output import print_json, print_table, warn
from foretouch.errors import FileError, ForetouchError

if TYPE_CHECKING:
    from foretouch.dataset.info import SampleSetInfo
    from foretouch.dataset.samples import SampleSet
    from foretouch.types import GraspSample

__all__ = ["info", "show", "verify"]


def info(arguments: argparse.Namespace) -> int:
    """Counts and ranges."""
    from foretouch.dataset.info import PAIRING_EDGES_MS, describe

    found = describe(arguments.path)
    if arguments.json:
        edges = [None if edge == float("inf") else edge for edge in PAIRING_EDGES_MS]
        print_json({"path": arguments.path, **vars(found), "pairing_edges_ms": edges})
        return 0
    print_table(arguments.path, ["", "value"], [[name, value] for name, value in _info_rows(found) if value])
    return 0


def _info_rows(found: SampleSetInfo) -> Iterator[tuple[str, str]]:
    from foretouch.dataset.info import PAIRING_EDGES_MS

    named = f"{found.labelled} labelled, {found.tared} with tare, {found.discarded} discarded"
    yield "kind", found.kind
    yield "samples", f"{found.samples} ({named})"
    yield "objects", counted(found.objects)
    yield "outcomes", counted(found.outcomes)
    yield "flags", counted(found.flags)
    yield "time", f"{_utc(found.first_ns)} to {_utc(found.last_ns)}"
    yield "points a cloud", f"{found.points[0]} to {found.points[2]} (median {found.points[1]})"
    yield from ((name, f"{low:g} to {high:g} counts") for name, (low, high) in found.ranges.items())
    yield "hand", _facts(found.hand)
    yield "camera", _facts(found.camera)
    if found.unfinished:
        yield "not finished", f"{', '.join(found.unfinished)}: repair makes them whole"
    spans = zip(PAIRING_EDGES_MS, PAIRING_EDGES_MS[1:], found.pairing_ms, strict=False)
    yield "pairing error", ", ".join(f"{a:g}-{b:g} ms: {n}" for a, b, n in spans if n)
    yield from ((topic, _account(counts)) for topic, counts in found.accounts.items())
    yield from (("edit", text) for text in found.edits)


def _account(counts: Mapping[str, Any]) -> str:
    """Of one topic; what is lost on the way is no part of what was received."""
    dropped = sum(counts["dropped"].values())
    why = f" ({counted(counts['dropped'])})" if dropped else ""
    return f"{counts['received']} = {counts['written']} written + {dropped} dropped{why}; {counts['lost']} lost"


def verify(arguments: argparse.Namespace) -> int:
    """Exit status 1 where something is damaged."""
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
            lost = str(sum(record.get("lost", {}).values()))
            rows.append([str(record["file"]), record["status"], *counts, lost, str(len(record["faults"]))])
    if not arguments.json:
        print_table("verified", ["file", "state", "samples", "messages", "bytes", "lost", "faults"], rows)
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
            accounts = {} if report.accounts is None else report.accounts.to_record()
            yield {
                "file": str(report.path),
                "status": "ok" if report.clean else "damaged" if report.finished else "unfinished",
                "samples": len(report.ids),
                "messages": report.messages.total(),
                "bytes": report.size,
                "dropped": {topic: counts["dropped"] for topic, counts in accounts.items() if counts["dropped"]},
                "lost": {topic: counts["lost"] for topic, counts in accounts.items() if counts["lost"]},
                "faults": report.told(),
            }
    except ForetouchError as err:
        yield {**empty, "status": "damaged", "faults": [str(err)]}


def show(arguments: argparse.Namespace) -> int:
    """A contact sheet."""
    from foretouch.dataset.samples import open_samples
    from foretouch.report.contact_sheet import save_contact_sheet

    with open_samples(arguments.source) as samples:
        chosen = list(_chosen(samples, arguments))
    if not chosen:
        raise FileError(arguments.source, "holds no sample to show")
    save_contact_sheet(arguments.out, chosen, f"{Path(arguments.source).name}: {len(chosen)} of {len(samples)} samples")
    tell("drawn", {"out": str(arguments.out), "samples": [sample.id for sample in chosen]}, as_json=arguments.json)
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


def _facts(facts: Mapping[str, str]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in facts.items())


def _utc(stamp_ns: int) -> str:
    from datetime import UTC, datetime

    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")

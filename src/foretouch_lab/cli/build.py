# SPDX-License-Identifier: Apache-2.0
"""`foretouch dataset build`: a training store with splits from any datasets."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from foretouch.cli.dataset import print_result
from foretouch.cli.inputs import seed_number
from foretouch.cli.output import progress_bar, warn
from foretouch.cli.parser import CommandParser
from foretouch.dataset.formats import open_samples, readable_formats
from foretouch_lab.dataset.store_writer import build_store
from foretouch_lab.learning.data.splits import SPLITS_FILE, make_splits, read_splits


def _warn_of_other_hands(paths: Sequence[str]) -> None:
    """Name the properties in which the hands of the datasets differ, as far as they are known."""
    first, *others = (open_samples(path).identity.hand for path in paths)
    for path, hand in zip(paths[1:], others, strict=True):
        differing = [
            f"{name} {hand[name]}, not {first[name]}"
            for name in sorted(first.keys() & hand.keys())
            if hand[name] != first[name]
        ]
        if differing:
            warn(
                f"{path}: is of another hand than {paths[0]}, whose readings have other levels: {'; '.join(differing)}"
            )


def add_arguments(parser: CommandParser) -> None:
    """Declare the options."""
    parser.add_argument("sources", metavar="IN", nargs="+", help=f"dataset: {readable_formats()}")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="STORE", help="training store to create; must not exist"
    )
    parser.add_argument("--seed", type=seed_number, default=0, help="random seed of the splits")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 0, and a dataset that cannot be read is an error."""
    _warn_of_other_hands(arguments.sources)
    with progress_bar("building", hidden=arguments.json) as advance:
        result = build_store(
            arguments.sources,
            arguments.out,
            attach=lambda samples: {SPLITS_FILE: make_splits(samples, arguments.seed)},
            progress=advance,
        )
    splits, omitted = read_splits(arguments.out)
    record = {
        "out": str(arguments.out),
        "samples": len(result.samples),
        "labelled": sum(sample.labelled for sample in result.samples),
        "tables": result.tables,
        "left_out": dict(result.left_out),
        "renumbered": result.renumbered,
        "sha256": result.sha256,
        "seed": arguments.seed,
        "splits": {kind: [part["name"] for part in parts] for kind, parts in splits.items()},
        "omitted": omitted,
    }
    return print_result("built", record, as_json=arguments.json)

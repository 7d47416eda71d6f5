# SPDX-License-Identifier: Apache-2.0
"""`foretouch segment`: segment the table and the objects of each cloud."""

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import replace_files, require_writable
from foretouch.cli.inputs import READ, add_options, check_single, draw_result, pipeline_config, process_inputs, scene_of
from foretouch.cli.output import print_table
from foretouch.cli.parser import CommandParser
from foretouch.cloud.geometry.limits import check_object
from foretouch.cloud.io.files import npy_bytes
from foretouch.dataset.source import SourceItem
from foretouch.errors import ConfigError, LimitError
from foretouch.pipeline import Pipeline
from foretouch.types import Cloud

_HINT: Final = "; a file of one object goes to `foretouch grasp`"


def add_arguments(parser: CommandParser) -> None:
    """Declare the common inputs and --labels-out."""
    add_options(parser, *READ)
    parser.add_argument(
        "--labels-out",
        metavar="F.npy",
        help="write the labels of a single input: int32 in the shape of the cloud, 0 = none",
    )
    parser.add_argument("--all", action="store_true", help="also list what is background, and why")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a cloud was refused or has no object."""
    if arguments.labels_out:
        if len(arguments.inputs) > 1:
            raise ConfigError(f"--labels-out: requires one input, not {len(arguments.inputs)}")
        require_writable(arguments.labels_out, ".npy")
    check_single(arguments)
    config = pipeline_config(arguments, {"target.mode": "all"})
    pipeline = Pipeline(config.updated({"target.mode": "all", "target.max_objects": 10_000}))  # no target is selected
    process = partial(_segment, arguments=arguments, pipeline=pipeline)
    return process_inputs(arguments, process, partial(_show, everything=arguments.all))


def _segment(item: SourceItem, arguments: argparse.Namespace, pipeline: Pipeline) -> Iterator[dict[str, Any]]:
    scene = scene_of(item, arguments, pipeline)
    if arguments.labels_out:
        replace_files({Path(arguments.labels_out): npy_bytes(scene.labels)})
    draw_result(arguments, scene)
    yield {
        "status": scene.status,
        "reason": scene.reason + (_HINT if _is_one_object(item.cloud, scene.status) else ""),
        "plane": None if scene.table is None else scene.table.coefficients,
        "objects": [
            {
                "id": int(object_.id),  # as in the labels file
                "n_points": object_.n_points,
                "centroid": object_.centroid,
                "bounds": object_.bounds,
                "confidence": object_.confidence,
            }
            for object_ in scene.objects
        ],
        "background": [
            {"reason": part.background, "n_points": part.n_points, "centroid": part.centroid, "bounds": part.bounds}
            for part in scene.background
        ],
        "outline": scene.outline,
        "counts": scene.counts,
        "ms": scene.ms,
        "failed": scene.status != "ok",
    }


def _is_one_object(cloud: Cloud, status: str) -> bool:
    """Return whether a cloud without a table or objects has the size of an object where one can be."""
    if status not in ("no_plane", "no_object", "too_few_points") or cloud.organised:
        return False
    try:
        check_object(cloud.xyz)
    except LimitError:
        return False
    return True


def _show(record: dict[str, Any], *, everything: bool) -> None:
    rows = [
        [
            str(part.get("reason", part.get("id"))),
            str(part["n_points"]),
            " ".join(f"{v:.3f}" for v in part["centroid"]),
            " x ".join(f"{1e3 * v:.0f}" for v in np.ptp(part["bounds"], axis=0)),
            "" if part.get("confidence") is None else f"{part['confidence']:.2f}",
        ]
        for part in (*record["objects"], *(record["background"] if everything else ()))
    ]
    title = f"{record['input']}: {record['status']} {record['reason']}".rstrip() + f" ({record['ms']['total']:.1f} ms)"
    print_table(title, ["object", "points", "centroid [m]", "extent [mm]", "whole"], rows)

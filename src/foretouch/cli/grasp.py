# SPDX-License-Identifier: Apache-2.0
"""`foretouch grasp`: plan two-finger grasps on each object, best first."""

import argparse
from collections.abc import Iterator
from functools import partial
from math import dist
from typing import Any

import numpy as np

from foretouch.cli import inputs
from foretouch.cli.output import print_table
from foretouch.cli.parser import CommandParser
from foretouch.dataset.source import SourceItem
from foretouch.errors import ConfigError
from foretouch.grasp.hand import load_hand
from foretouch.pipeline import Pipeline


def add_arguments(parser: CommandParser) -> None:
    """Declare the common inputs and the settings of the planner."""
    inputs.add_options(parser, *inputs.READ, *inputs.PLANNED, *inputs.CHOSEN)
    tip_help = (
        "size of the gripper's fingertip for grasp.method=original [mm] (default: 25); else set hand.tip_radius_m"
    )
    parser.add_argument("--tip-mm", type=float, metavar="MM", help=tip_help)
    parser.add_argument("--count", type=int, metavar="K", help="maximum number of grasps (default: 1)")
    slide = parser.headings["model and adaptation"].add_mutually_exclusive_group()
    slide_help = "shift the grasp plane along the object's axis by this distance [m]"
    parser.add_argument("--slide-m", group=slide, type=float, default=0.0, metavar="δ", help=slide_help)
    parser.add_argument(
        "--vary",
        group=slide,
        type=inputs.seed_number,
        metavar="SEED",
        help="shift it by a random distance for each cloud",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a cloud was refused or has no grasp."""
    inputs.check_single(arguments)
    changes = {"grasp.tip_mm": arguments.tip_mm, "grasp.count": arguments.count}
    pipeline = Pipeline(inputs.pipeline_config(arguments, changes))
    if arguments.tip_mm is not None and pipeline.config.grasp.method != "original":
        raise ConfigError("--tip-mm: is for --set grasp.method=original; else set hand.tip_radius_m [m]")
    rng = None if arguments.vary is None else np.random.default_rng(arguments.vary)
    return inputs.process_inputs(arguments, partial(_plan, arguments, pipeline, rng), _show)


def _plan(
    arguments: argparse.Namespace, pipeline: Pipeline, rng: np.random.Generator | None, item: SourceItem
) -> Iterator[inputs.Record]:
    targets, scene, selected = inputs.target_objects(item, arguments, pipeline)
    for number, target in enumerate(targets):
        plan = pipeline.plan(target, slide_m=arguments.slide_m, rng=rng)
        if number == 0:
            inputs.draw_result(arguments, scene, plan.grasps)
        yield {
            "object": target.id,
            **({"selected": selected} if selected else {}),
            "status": plan.status,
            "reason": plan.reason,
            "plane": target.plane.coefficients,
            "grasps": plan.grasps.to_dict()["grasps"],
            "initial_points": plan.initial_points,
            "axis": plan.axis,
            "centroid": plan.centroid,
            "counts": plan.counts,
            "ms": plan.ms,
            "failed": not plan.grasps,
        }


def _show(record: dict[str, Any]) -> None:
    rows = [
        [
            str(rank),
            _point(grasp["g1"]),
            _point(grasp["g2"]),
            f"{1e3 * dist(grasp['g1'], grasp['g2']):.0f}",
            f"{grasp['score']:.3f}".replace("nan", "–"),
        ]
        for rank, grasp in enumerate(record["grasps"], 1)
    ]
    print_table(inputs.heading(record), ["rank", "g1 [m]", "g2 [m]", "width [mm]", "score"], rows)
    if hand := next((grasp.get("hand", "") for grasp in record["grasps"]), ""):
        _show_poses(hand, record["grasps"])


def _show_poses(hand: str, grasps: list[dict[str, Any]]) -> None:
    """Print where the tool frame of a hand is at each grasp; nothing for a hand whose description names no frame."""
    config = load_hand(hand).config
    if not config.tool:
        return
    columns = ["rank", "depth [mm]", "position [m]", "quaternion x y z w"]
    if config.joints:
        columns.append("thumb")
    rows = []
    for rank, grasp in enumerate(grasps, 1):
        pose = grasp["pose_of_hand"]
        turn = " ".join(f"{value:.3f}" for value in pose["quaternion_xyzw"])
        row = [str(rank), f"{1e3 * grasp['depth_m']:.0f}", _point(pose["position"]), turn]
        rows.append([*row, grasp["thumb_at"]] if config.joints else row)
    print_table(f"{config.name}: pose of {config.tool}, to which the arm is sent", columns, rows)


def _point(xyz: Any) -> str:
    return " ".join(f"{value:.4f}" for value in xyz)

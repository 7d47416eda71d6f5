# SPDX-License-Identifier: Apache-2.0
"""`foretouch hand check --mesh, --urdf`: the boxes of a description beside the surface of the real hand."""

import argparse
from typing import Any

import numpy as np

from foretouch.cli.output import print_json, print_table
from foretouch.errors import ConfigError
from foretouch.grasp.hand import Hand, load_hand
from foretouch.report.hand_figure import save_surface_figure
from foretouch.types import Float64
from foretouch_lab.simulation.hand_surface import POINTS, mesh_surface, outside, urdf_surfaces

_UNITS = {"m": 1.0, "mm": 0.001}


def run(arguments: argparse.Namespace) -> int:
    """Compare a description, print how far each link lies outside of it, and draw both; the exit status is 0."""
    name = arguments.descriptions[0]
    hand = load_hand(name)
    width = float(hand.widths[0]) if arguments.width is None else arguments.width
    if not hand.parts:
        raise ConfigError(f"{name}: the description has no box to compare")
    at = hand.at(width)
    if arguments.mesh is not None:
        surfaces = mesh_surface(arguments.mesh, _UNITS[arguments.unit])
    else:
        stated = dict(zip((joint.name for joint in hand.config.joints), at.posture.tolist(), strict=True))
        tool = arguments.link or hand.config.tool
        surfaces = urdf_surfaces(arguments.urdf, tool, stated | dict(arguments.joints), arguments.links)
    surfaces = {link: points @ at.tool[:3, :3].T + at.tool[:3, 3] for link, points in surfaces.items()}
    away = {link: outside(points, at.corners) for link, points in surfaces.items()}
    record = {"input": name, "against": str(arguments.mesh or arguments.urdf), "width_m": width}
    record |= {"links": [_link(hand, link, *away[link]) for link in surfaces]}
    record["farthest_mm"] = max(link["farthest_mm"] for link in record["links"])
    if arguments.out is not None:
        shown = {link: points[:POINTS] for link, points in surfaces.items()}
        save_surface_figure(hand, width, shown, {link: one[0][:POINTS] for link, one in away.items()}, arguments.out)
    _print(record, arguments.json)
    return 0


def _link(hand: Hand, link: str, away_m: Float64, nearest: Any) -> dict[str, Any]:
    """Return how far a link lies outside of the boxes, and which box is nearest to its farthest place."""
    farthest, of_surface = int(np.argmax(away_m)), away_m[:POINTS]
    box = int(nearest[farthest])
    return {
        "link": link,
        "outside": round(float((of_surface > 0.0005).mean()), 3),
        "p95_mm": round(1e3 * float(np.quantile(of_surface, 0.95)), 1),
        "farthest_mm": round(1e3 * float(away_m[farthest]), 1),
        "box": hand.names[box],
        "part": hand.parts[box],
    }


def _print(record: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(record)
        return
    rows = [[str(cell) for cell in link.values()] for link in record["links"]]
    title = f"{record['input']} at a width of {1e3 * record['width_m']:g} mm, and the surface of {record['against']}"
    print_table(title, ["link", "outside", "95 % [mm]", "farthest [mm]", "nearest box", "part"], rows)

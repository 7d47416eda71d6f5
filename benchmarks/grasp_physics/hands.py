# SPDX-License-Identifier: Apache-2.0
"""Do hands with bodies take the first grasp? See HANDS.md."""

import argparse
import csv
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.common import add_data, show_tables, write_csv
from benchmarks.grasp_physics.bodies import FORCES_N, Planned, Take, take
from benchmarks.grasp_physics.camera import VIEWS, Seen, see, see_all
from benchmarks.grasp_physics.objects import Item, huddle, read_items
from benchmarks.grasp_physics.simulation import INSIDE, Grip, held
from foretouch.camera.device import ensure_libusb
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import Grasp
from foretouch.types.scene import Object
from foretouch_lab.experiments.shared.tables import grouped

HERE: Final = Path(__file__).parent
FRICTIONS: Final = (0.8, 0.5)
TIPS: Final = "two_tips"  # free tips without a hand
TIP_M: Final = 0.008
CLUTTER: Final = HERE / "clutter.csv"
COLUMNS: Final = ("scene", "view", "hand", "object", "planned", "reached", "held", "clean", "moved", "reason")

Row = dict[str, Any]


def planned_in_world(seen: Seen, grasp: Grasp) -> Planned:
    """Return a grasp with a way in, in the world."""
    assert grasp.way is not None
    ends = seen.camera.to_world(np.stack([grasp.g1, grasp.g2]))
    x = (ends[1] - ends[0]) * (1.0 if grasp.way.thumb_at == "g2" else -1.0)
    x /= np.linalg.norm(x)
    tip, origin = seen.camera.to_world(np.stack([grasp.way.approach, np.zeros(3)]))
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.stack([x, np.cross(tip - origin, x), tip - origin], axis=1), ends.mean(axis=0)
    return Planned(frame, grasp.width_m)


def rows_of(item: Item, hand: str, poses: int) -> Iterator[Row]:
    """Iterate over what became of the first grasp on each image of an object."""
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": hand}))
    for number, view in product(range(poses), VIEWS):
        seen = see(item, number, view)
        targets = pipeline.segment(seen.cloud).targets
        plan = pipeline.plan(targets[0]) if targets else None
        facts = {"object": item.name, "pose": number, "view": view, "hand": hand}
        if plan is None or not len(plan.grasps):
            yield facts | {"planned": False, "reason": "no object found" if plan is None else "no grasp"}
            continue
        planned = planned_in_world(seen, plan.grasps[0])
        ends = seen.camera.to_world(np.stack([plan.grasps[0].g1, plan.grasps[0].g2]))
        exact, rough = (take(item, seen.pose, planned, hand, friction) for friction in FRICTIONS)
        off = take(item, seen.pose, planned, hand, off=2 * number + VIEWS.index(view))
        yield facts | {
            "planned": True,
            **exact._asdict(),
            "tips": held(item, seen.pose, *ends).held,
            "off": off.held,
            "rough": rough.held,
        }


def clutter_rows(items: Sequence[Item], hand: str, scenes: Iterable[int]) -> Iterator[Row]:
    """Iterate over what became of the first grasp on the middle one of three objects close together, in one image each; `TIPS` are free tips."""
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": hand}))
    for number in scenes:
        stand = huddle(items, number)
        view = VIEWS[number % len(VIEWS)]
        seen = see_all(stand, zlib.crc32(b"huddle"), number, view)
        facts = {"scene": number, "view": view, "hand": hand, "object": stand[0][0].name}
        target = wanted(seen, pipeline.segment(seen.cloud).objects)
        plan = None if target is None else pipeline.plan(target)
        if plan is None or not len(plan.grasps):
            yield facts | {"planned": False, "reason": "no object found" if plan is None else "no grasp", "moved": 0}
            continue
        item, pose = stand[0]
        ends = seen.camera.to_world(np.stack([plan.grasps[0].g1, plan.grasps[0].g2]))
        if hand == TIPS:
            tips = Grip(item, TIP_M, FRICTIONS[0], stand[1:])
            verdict = tips.close(pose, *ends)
            taken = Take(verdict.reason != INSIDE, verdict.held, verdict.reason, tips.moved())
        else:
            planned = planned_in_world(seen, plan.grasps[0])
            taken = take(item, pose, planned, hand, FRICTIONS[0], neighbours=tuple(stand[1:]))
        yield facts | {"planned": True, **taken._asdict(), "clean": taken.held and not taken.moved}


def wanted(seen: Seen, targets: Sequence[Object]) -> Object | None:
    """Return the segment with most of its points on the wanted object, within 10 mm of its bounds; None where none has half of them there."""
    low, high = seen.item.at(seen.pose).bounds
    shares = []
    for target in targets:
        points = seen.camera.to_world(target.cloud.finite.astype(np.float64))
        shares.append(float(((points > low - 0.01) & (points < high + 0.01)).all(axis=1).mean()))
    best = int(np.argmax(shares)) if shares else 0
    return targets[best] if shares and shares[best] > 0.5 else None


def clutter_table(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return a line for each hand."""
    lines = []
    for hand, own in grouped(rows, "hand"):
        failed = Counter(row["reason"] for row in own if not row.get("held"))
        count = lambda name: str(sum(bool(row.get(name)) for row in own))  # noqa: E731, B023
        lines.append(
            {
                "hand": hand,
                "scenes": str(len(own)),
                "planned": count("planned"),
                "reached": count("reached"),
                "taken and held": count("held"),
                "held, no neighbour moved": count("clean"),
                "neighbours that moved": str(sum(row["moved"] for row in own)),
                "reasons": ", ".join(f"{number} {reason}" for reason, number in failed.most_common()),
            }
        )
    return lines


def table(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return a line for each hand."""
    lines = []
    for hand, own in grouped(rows, "hand"):
        reached = [row for row in own if row.get("reached")]

        def count(name: str, among: Sequence[Row] = own) -> str:
            number = sum(bool(row.get(name)) for row in among)
            return f"{number} of {len(among)}, {number / max(len(among), 1):.2f}"

        failed = Counter(row["reason"] for row in own if not row.get("held"))
        lines.append(
            {
                "hand, force": f"{hand}, {FORCES_N[hand]:g} N",
                "planned": count("planned"),
                "reached": count("reached"),
                "held of the reached": count("held", reached),
                "**taken and held of all**": count("held"),
                "palm off: held of the reached": count("off", reached),
                f"friction {FRICTIONS[1]:g}: held of all": count("rough"),
                "free tips on the same: held of all": count("tips"),
                "reasons": ", ".join(f"{number} {reason}" for reason, number in failed.most_common()),
            }
        )
    return lines


def by_object(rows: Sequence[Row]) -> list[dict[str, str]]:
    """Return how many grasps each hand takes and holds, by object."""
    return [
        {"object": name}
        | {
            hand: f"{sum(bool(row.get('held')) for row in own)} of {len(own)}"
            for hand, own in grouped(of_object, "hand")
        }
        for name, of_object in grouped(rows, "object")
    ]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--objects", type=Path, help="folder of objects (default: ycb in the folder of recordings)")
    parser.add_argument("--hands", nargs="+", choices=(*FORCES_N, TIPS), default=list(FORCES_N), metavar="HAND")
    parser.add_argument("--poses", type=int, default=4, help="of each object")
    parser.add_argument(
        "--clutter", type=int, metavar="SCENES", help="three objects close together instead, so many scenes"
    )
    parser.add_argument("--first", type=int, default=0, help="number of the first of these scenes")
    parser.add_argument(
        "--rows", type=Path, help="keep the rows of clutter in this CSV, to which those of other calls are added"
    )
    parser.add_argument("--renew", action="store_true", help="write the committed table")
    options = parser.parse_args()
    ensure_libusb()
    items = read_items(options.objects or Path(options.data or "") / "ycb")
    if options.clutter is not None:
        clutter(items, options)
        return
    rows = [
        row for hand in options.hands if hand != TIPS for item in items for row in rows_of(item, hand, options.poses)
    ]
    tables = {"First grasps": table(rows), "Taken and held, by object": by_object(rows)}
    head = (
        f"{len(items)} objects, {options.poses} poses each, two views; friction {FRICTIONS[0]:g} where it is not named."
    )
    show_tables(tables, head, HERE / "HANDS.md" if options.renew else None)


def clutter(items: Sequence[Item], options: argparse.Namespace) -> None:
    """Measure scenes of three objects, keep their rows, and print the table of all that are kept."""
    path = options.rows or CLUTTER
    kept: list[Row] = []
    if path.is_file():
        with path.open(encoding="utf-8", newline="") as file:
            kept = [{name: _read(text) for name, text in row.items()} for row in csv.DictReader(file)]
    done = {(row["hand"], row["scene"]) for row in kept}
    for hand in options.hands:
        for number in range(options.first, options.first + options.clutter):
            if (hand, number) not in done:
                kept += [{name: row.get(name, "") for name in COLUMNS} for row in clutter_rows(items, hand, [number])]
                write_csv(path, kept)
    show_tables({"In clutter": clutter_table(kept)}, f"{len({row['scene'] for row in kept})} scenes.", None)


def _read(text: str) -> Any:
    return {"True": True, "False": False}.get(text, int(text) if text.isdigit() else text)


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""The live table of `foretouch run`: one row a node, and the last prediction. It draws and computes nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from foretouch.ros.monitor_node import NodeView, View
    from foretouch_msgs.msg import Interval, TouchPrediction

__all__ = ["live_panel"]

_LEVELS = {0: "green", 1: "yellow", 2: "red", 3: "dim"}
_MAX_ROWS = 8  # of predictions; a planner's fifty would push the nodes off the screen


def live_panel(view: View, title: str) -> Panel:
    """Everything an operator needs at a glance: what each node does and, where it does nothing, why."""
    answered = ", ".join(f"{count} {name}" for name, count in view.answers.most_common()) or "none yet"
    parts: list[RenderableType] = [_nodes(view.nodes), Text(f"clouds answered: {answered}")]
    if view.reasons:
        parts.append(
            Text("why not: " + "; ".join(f"{text} ({n})" for text, n in view.reasons.most_common(3)), "yellow")
        )
    if view.last is not None and view.last.predictions:
        parts.append(_predictions(view.last.predictions[:_MAX_ROWS]))
    return Panel(Group(*parts), title=title, title_align="left")


def _nodes(nodes: dict[str, NodeView]) -> Table:
    table = Table(expand=True)
    for name in ("node", "state", "rate [Hz]", "received", "used", "dropped", "latency p50 / p95 [ms]", "says"):
        table.add_column(name, justify="left" if name in {"node", "state", "says"} else "right", overflow="fold")
    for name, node in sorted(nodes.items(), key=lambda pair: _order(pair[0])):
        values = node.values
        latency = " / ".join(values.get(f"latency_ms.{p}", "–") for p in ("p50", "p95"))
        drops = [
            f"{value} {key.removeprefix('dropped.')}" for key, value in values.items() if key.startswith("dropped.")
        ]
        table.add_row(
            name.rpartition("/")[2],
            values.get("state", ""),
            values.get("rate_hz", ""),
            values.get("received", ""),
            values.get("used", ""),
            " ".join(drops) or values.get("dropped", ""),
            latency,
            Text(node.message, _LEVELS.get(node.level, "")),
        )
    return table


def _predictions(predictions: list[TouchPrediction]) -> Table:
    table = Table(title="last prediction", title_justify="left", expand=True)
    for name in ("object", "width [mm]", "PDC_TH", "PDC_MF", "E_TH", "E_MF", "model", "flags"):
        table.add_column(name, justify="right" if name not in {"object", "model", "flags"} else "left")
    for one in predictions:
        g1, g2 = one.grasp.g1, one.grasp.g2
        width_mm = 1e3 * ((g1.x - g2.x) ** 2 + (g1.y - g2.y) ** 2 + (g1.z - g2.z) ** 2) ** 0.5
        if one.reason and one.status:
            table.add_row(one.grasp.object_id, f"{width_mm:.0f}", "", "", "", "", one.model, one.reason)
            continue
        table.add_row(
            one.grasp.object_id,
            f"{width_mm:.0f}",
            _value(one.pdc_th),
            _value(one.pdc_mf),
            _span(one.e_th),
            _span(one.e_mf),
            one.model,
            " ".join(one.flags),
        )
    return table


def _value(interval: Interval) -> str:
    if interval.lower != interval.lower:  # NaN: not calibrated
        return f"{interval.value:.0f}"
    return f"{interval.value:.0f} ({interval.lower:.0f}…{interval.upper:.0f})"


def _span(intervals: list[Interval]) -> str:
    values = [one.value for one in intervals]
    return f"{min(values):.0f}…{max(values):.0f}"


def _order(name: str) -> tuple[int, str]:
    """In the order of the data's way."""
    short = name.rpartition("/")[2]
    known = ["camera", "replay", "segmentation", "grasp", "touch_predictor", "markers"]
    return (known.index(short) if short in known else len(known), short)

# SPDX-License-Identifier: Apache-2.0
"""The live table of `foretouch run`: one row per node, and the last prediction. It only draws."""

from __future__ import annotations

from math import dist, isnan
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from foretouch.dataset.pairing import TouchCut
    from foretouch.ros.nodes.monitor import NodeView, View
    from foretouch_msgs.msg import Interval, TouchPrediction


_LEVELS = {0: "green", 1: "yellow", 2: "red", 3: "dim"}
_MODALITIES = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")
_MAX_REASONS = 3
_WIDEST_MM = 1e4
_MAX_ROWS = 8  # of predictions, so that those of a planner do not push the nodes off the screen


def live_panel(view: View, title: str) -> Panel:
    """Draw the state of each node with its problems, the answers so far, and the last prediction."""
    answered = ", ".join(f"{count} {name}" for name, count in view.answers.most_common()) or "none yet"
    parts: list[RenderableType] = [_nodes(view.nodes), *_problems(view.nodes), Text(f"clouds answered: {answered}")]
    parts += [Text(f"  {count} x {reason}", "yellow") for reason, count in view.reasons.most_common(_MAX_REASONS)]
    if view.last is not None and view.last.predictions:
        parts.append(_predictions(view.last.predictions[:_MAX_ROWS], _touches(view.nodes)))
    if view.executed is not None:
        parts.append(_executed(*view.executed))
    return Panel(Group(*parts), title=title, title_align="left")


def _table(title: str | None, *columns: str) -> Table:
    """An empty table of numbers, whose first column holds names."""
    table = Table(title=title, title_justify="left", expand=True, box=SIMPLE_HEAD)
    for name in columns:
        table.add_column(name, justify="left" if name == columns[0] else "right")
    return table


def _nodes(nodes: dict[str, NodeView]) -> Table:
    table = Table(expand=True, box=SIMPLE_HEAD)
    for name in ("node", "state", "Hz", "received", "used", "dropped", "latency ms"):
        table.add_column(name, justify="left" if name in {"node", "state"} else "right", no_wrap=name != "dropped")
    for name, node in sorted(nodes.items(), key=lambda pair: _order(pair[0])):
        values = node.values
        drops = [f"{n} {key.removeprefix('dropped.')}" for key, n in values.items() if key.startswith("dropped.")]
        table.add_row(
            Text(_short(name), _LEVELS.get(node.level, "")),
            values.get("phase" if values.get("state") == "active" and "phase" in values else "state", ""),
            *(values.get(key, "") for key in ("rate_hz", "received", "used")),
            " ".join(drops) or values.get("dropped", ""),
            " / ".join(_rounded(values.get(f"latency_ms.{p}", "–")) for p in ("p50", "p95")),
        )
    return table


def _problems(nodes: dict[str, NodeView]) -> list[Text]:
    """One line for each node with a warning or an error."""
    return [
        Text(f"{_short(name)}: {node.message}", _LEVELS.get(node.level, ""))
        for name, node in nodes.items()
        if node.level
    ]


def _touches(nodes: dict[str, NodeView]) -> int:
    """Number of touches in the memory of the predictor, from its last report."""
    counts = [node.values["touches"] for node in nodes.values() if "touches" in node.values]
    return int(counts[0]) if counts else 0


def _predictions(predictions: list[TouchPrediction], touches: int) -> Table:
    from foretouch.ros.messages.conversions import interval_text, reference_text

    models = " ".join(sorted({one.model for one in predictions if one.model}))
    title = f"last prediction (counts){models and f' by {models}'}"
    table = _table(title, "object", "mm", *_MODALITIES)
    table.add_column("based on", min_width=14, overflow="fold")
    for one in predictions:
        g1, g2 = one.grasp.g1, one.grasp.g2
        width_mm = 1e3 * dist((g1.x, g1.y, g1.z), (g2.x, g2.y, g2.z))
        width = f"{width_mm:.0f}" if width_mm < _WIDEST_MM else "–"  # a refused grasp may be 1e160 m wide
        if one.reason and one.status:
            table.add_row(one.grasp.object_id, width, "", "", "", "", one.reason)
            continue
        table.add_row(
            one.grasp.object_id,
            width,
            interval_text(one.pdc_th),
            interval_text(one.pdc_mf),
            _span(one.e_th),
            _span(one.e_mf),
            Text("\n".join([reference_text(one, touches), *one.flags]), "yellow" if one.flags else ""),
        )
    return table


def _executed(prediction: TouchPrediction, readings: TouchCut) -> Table:
    from foretouch.ros.messages.conversions import interval_text

    table = _table("last grasp executed (counts)", "", *_MODALITIES)
    if not prediction.status:
        pressures = interval_text(prediction.pdc_th), interval_text(prediction.pdc_mf)
        table.add_row("predicted", *pressures, _span(prediction.e_th), _span(prediction.e_mf))
    for name, touch in (("read", readings.touch), ("tare", readings.tare)):
        spans = tuple(f"{e.min():.0f}…{e.max():.0f}" for e in (touch.e_th, touch.e_mf))
        table.add_row(name, f"{touch.pdc_th:.0f}", f"{touch.pdc_mf:.0f}", *spans)
    return table


def _rounded(milliseconds: str) -> str:
    """Without decimals where the number is long."""
    return milliseconds.partition(".")[0] if len(milliseconds) > 5 else milliseconds


def _span(intervals: list[Interval]) -> str:
    """Smallest and largest value of 24 electrodes, and the mean half width if the model is calibrated."""
    values = [one.value for one in intervals]
    half = sum(one.upper - one.lower for one in intervals) / 2.0 / len(intervals)
    span = f"{min(values):.0f}…{max(values):.0f}"
    return span if isnan(half) else f"{span} ± {half:.0f}"  # NaN: not calibrated


def _short(name: str) -> str:
    return name.rpartition("/")[2]


def _order(name: str) -> tuple[int, str]:
    """Sort nodes in the order in which the data passes them."""
    short = _short(name)
    known = ["camera", "replay", "segmentation", "grasp", "touch_predictor", "hand", "markers"]
    return (known.index(short) if short in known else len(known), short)

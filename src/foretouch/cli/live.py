# SPDX-License-Identifier: Apache-2.0
"""The live table of `foretouch run`: one row per node, and the last prediction. It only draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import dist, isnan
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from foretouch.cli.screen import FittedPanel
from foretouch.cli.tables import FittedTable
from foretouch.tactile import MODALITIES

if TYPE_CHECKING:
    from foretouch.dataset.pairing import TouchCut
    from foretouch.ros.nodes.monitor import NodeView, View
    from foretouch_msgs.msg import Interval, TouchPrediction


_LEVELS = {0: "green", 1: "yellow", 2: "red", 3: "dim"}
_MAX_REASONS = 3
_WIDEST_MM = 1e4
_MAX_ROWS = 8  # of a table


def live_panel(view: View, title: str, waiting: str = "") -> FittedPanel:
    """Draw the state of each node with its problems, the answers so far, the last grasp executed and the last prediction.

    Args:
        view: What the graph has reported.
        title: Of the panel.
        waiting: What the first answer waits for.
    """
    answered = ", ".join(f"{count} {name}" for name, count in view.answers.most_common()) or waiting or "none yet"
    parts: list[RenderableType] = [Text(f"clouds answered: {answered}"), _nodes(view.nodes), *_problems(view.nodes)]
    if view.executed is not None:
        parts.append(_executed(*view.executed))
    if view.last is not None and view.last.predictions:
        parts.append(_predictions(view.last.predictions, _touches(view.nodes)))
    parts += [Text(line) for line in _drops(view.nodes)]
    parts += [Text(f"{count} x {reason}", "yellow") for reason, count in view.reasons.most_common(_MAX_REASONS)]
    return FittedPanel(parts, title)


def _table(*columns: str, rows: list[list[str | Text]], title: str = "") -> FittedTable:
    return FittedTable(columns, rows, title=title, live=True, limit=_MAX_ROWS)


def _nodes(nodes: dict[str, NodeView]) -> FittedTable:
    rows: list[list[str | Text]] = []
    for name, node in sorted(nodes.items(), key=lambda pair: _order(pair[0])):
        values = node.values
        dropped = sum(count for _, count in _dropped(values)) or values.get("dropped", "")
        rows.append([
            Text(_short(name), _LEVELS.get(node.level, "")),
            values.get("phase" if values.get("state") == "active" and "phase" in values else "state", ""),
            _rounded(values.get("rate_hz", "")),
            *(values.get(key, "") for key in ("received", "used")),
            str(dropped),
            *(_rounded(values.get(f"latency_ms.{p}", "–")) for p in ("p50", "p95")),
        ])  # fmt: skip
    return _table("node", "state", "Hz", "in", "used", "drops", "p50 ms", "p95 ms", rows=rows)


def _dropped(values: Mapping[str, str]) -> list[tuple[str, int]]:
    """Numbers of dropped messages by reason."""
    return [(key.removeprefix("dropped."), int(n)) for key, n in values.items() if key.startswith("dropped.")]


def _drops(nodes: dict[str, NodeView]) -> list[str]:
    """One line for each node that has dropped messages, with the reasons."""
    reasons = {name: [f"{n} {why}" for why, n in _dropped(node.values) if n] for name, node in nodes.items()}
    return [f"{_short(name)} dropped {', '.join(found)}" for name, found in reasons.items() if found]


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


def _predictions(predictions: Sequence[TouchPrediction], touches: int) -> FittedTable:
    from foretouch.ros.messages.conversions import reference_text

    models = " ".join(sorted({one.model for one in predictions if one.model}))
    rows: list[list[str | Text]] = []
    for one in predictions:
        g1, g2 = one.grasp.g1, one.grasp.g2
        width_mm = 1e3 * dist((g1.x, g1.y, g1.z), (g2.x, g2.y, g2.z))
        width = f"{width_mm:.0f}" if width_mm < _WIDEST_MM else "–"  # a refused grasp may be 1e160 m wide
        if one.reason and one.status:
            rows.append([one.grasp.object_id, width, "", "", "", "", one.reason])
            continue
        flags = [flag.replace("_", " ") for flag in one.flags]
        based = Text("\n".join([reference_text(one, touches), *flags]), "yellow" if flags else "")
        rows.append([one.grasp.object_id, width, *_modalities(one), based])
    title = f"last prediction (counts){models and f' by {models}'}"
    return _table("object", "mm", *MODALITIES, "based on", rows=rows, title=title)


def _modalities(prediction: TouchPrediction) -> list[str]:
    """PDC and electrodes of both fingers, each with its half width."""
    pressures = [_interval(one) for one in (prediction.pdc_th, prediction.pdc_mf)]
    return [*pressures, _span(prediction.e_th), _span(prediction.e_mf)]


def _executed(prediction: TouchPrediction, readings: TouchCut) -> FittedTable:
    rows: list[list[str | Text]] = []
    if not prediction.status:
        rows.append(["predicted", *_modalities(prediction)])
    for name, touch in (("read", readings.touch), ("tare", readings.tare)):
        spans = [f"{e.min():.0f}–{e.max():.0f}" for e in (touch.e_th, touch.e_mf)]
        rows.append([name, f"{touch.pdc_th:.0f}", f"{touch.pdc_mf:.0f}", *spans])
    return _table("", *MODALITIES, rows=rows, title="last grasp executed (counts)")


def _interval(interval: Interval) -> str:
    """Value and half width, without a space before the number, where it would be folded."""
    from foretouch.ros.messages.conversions import interval_text

    return interval_text(interval).replace("± ", "±")


def _rounded(number: str) -> str:
    """With three digits, or as it is where it is no number."""
    try:
        value = float(number)
    except ValueError:
        return number
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}"


def _span(intervals: list[Interval]) -> str:
    """Smallest and largest value of 24 electrodes, and the mean half width if the model is calibrated."""
    values = [one.value for one in intervals]
    half = sum(one.upper - one.lower for one in intervals) / 2.0 / len(intervals)
    span = f"{min(values):.0f}–{max(values):.0f}"
    return span if isnan(half) else f"{span} ±{half:.0f}"  # NaN: not calibrated


def _short(name: str) -> str:
    return name.rpartition("/")[2]


def _order(name: str) -> tuple[int, str]:
    """Sort nodes in the order in which the data passes them."""
    short = _short(name)
    known = ["camera", "replay", "segmentation", "grasp", "touch_predictor", "hand", "markers"]
    return (known.index(short) if short in known else len(known), short)

# SPDX-License-Identifier: Apache-2.0
"""The live table of `foretouch run`: one row per node, and the last prediction. It only draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import dist
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from foretouch.cli.answers import modality_text
from foretouch.cli.screen import make_table
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Sample, Touch

if TYPE_CHECKING:
    from foretouch.ros.nodes.monitor import View
    from foretouch_msgs.msg import TouchPrediction


_SHOWN = 8  # rows of a table
_LONGEST_TITLE = 50  # characters of a title in the frame
_LEVELS = {0: "green", 1: "yellow", 2: "red", 3: "dim"}


def live_panel(view: View, title: str, waiting: str = "") -> Panel:
    """Draw what the graph has reported: nodes, their problems, answers, the last executed grasp and prediction.

    `waiting` says what the first answer waits for.
    """
    answered = ", ".join(f"{count} {name}" for name, count in view.answers.most_common()) or waiting or "none yet"
    parts: list[RenderableType] = [Text(f"clouds answered: {answered}"), _nodes(view.nodes)]
    parts += [
        Text(f"{_short(name)}: {line}", _LEVELS.get(level, ""))
        for name, (level, line, _) in view.nodes.items()
        if level
    ]
    if view.executed is not None:
        parts.append(executed_table(*view.executed, view.sensor))
    if view.last is not None and view.last.predictions:
        parts.append(_predictions(view.last.predictions, view.sensor))
    for name, (_, _, values) in view.nodes.items():
        for what, counts in (("dropped", _dropped(values)), ("refused touches", _counts(values, "touches.refused."))):
            if counts:
                listed = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in counts.items())
                parts.append(Text(f"{_short(name)} {what} in total: {listed}"))
    for kind, count in view.reasons.most_common(3):
        last = view.last_reasons.get(kind, kind)
        parts.append(Text(f"{count} x {'last: ' if count > 1 else ''}{last}", "yellow"))
    return titled(title, parts)


def titled(title: str, parts: Sequence[RenderableType]) -> Panel:
    """Return a panel of some parts, the most important first: a low terminal shows as many lines as it has."""
    if len(title) > _LONGEST_TITLE:  # which rich would cut at the corner
        return Panel(Group(Text(title, "bold", overflow="fold"), *parts))
    return Panel(Group(*parts), title=title, title_align="left")


def _table(*columns: str, rows: list[list[str | Text]], title: str = "") -> Table:
    more = f", the first {_SHOWN} of {len(rows)}" if len(rows) > _SHOWN else ""
    return make_table(columns, rows[:_SHOWN], title + more, live=True)


def _nodes(nodes: Mapping[str, tuple[int, str, dict[str, str]]]) -> Table:
    rows: list[list[str | Text]] = []
    for name, (level, _, values) in sorted(nodes.items(), key=lambda pair: _order(pair[0])):
        dropped = sum(_dropped(values).values()) or values.get("dropped", "")
        rows.append([
            Text(_short(name), _LEVELS.get(level, "")),
            values.get("phase" if values.get("state") == "active" and "phase" in values else "state", ""),
            _rounded(values.get("rate_hz", "")),
            *(values.get(key, "") for key in ("received", "used")),
            str(dropped),
            *(_rounded(values.get(f"latency_ms.{p}", "–")) if "phase" not in values else "–" for p in ("p50", "p95")),
        ])  # fmt: skip
    return _table("node", "state", "Hz", "in", "used", "drops", "p50 ms", "p95 ms", rows=rows)


def _dropped(values: Mapping[str, str]) -> dict[str, int]:
    """Return numbers of dropped messages by reason."""
    return _counts(values, "dropped.")


def _counts(values: Mapping[str, str], prefix: str) -> dict[str, int]:
    """Return the counts above 0 whose names begin with a prefix, by the rest of the name."""
    counts = {key.removeprefix(prefix): int(n) for key, n in values.items() if key.startswith(prefix)}
    return {reason: count for reason, count in counts.items() if count}


def _predictions(predictions: Sequence[TouchPrediction], sensor: Sensor) -> Table:
    from foretouch.ros.messages.conversions import reference_text

    models = " ".join(sorted({prediction.model for prediction in predictions if prediction.model}))
    modalities = TaxelView(sensor).modalities
    rows: list[list[str | Text]] = []
    for prediction in predictions:
        width_mm = 1e3 * dist(*((point.x, point.y, point.z) for point in (prediction.grasp.g1, prediction.grasp.g2)))
        width = f"{width_mm:.0f}" if width_mm < 1e4 else "–"  # a refused grasp may be 1e160 m wide
        if prediction.reason and prediction.status:
            rows.append([prediction.grasp.object_id, width, *[""] * len(modalities), "", prediction.reason])
            continue
        flags = [flag.replace("_", " ") for flag in prediction.flags]
        marked = Text("\n".join(flags) or "–", "yellow" if flags else "")
        rows.append(
            [
                prediction.grasp.object_id,
                width,
                *_modalities(prediction, sensor, modalities),
                reference_text(prediction),
                marked,
            ]
        )
    units = ", ".join(dict.fromkeys(sensor.channels.channel_of[name].unit for name in modalities))
    title = f"last prediction ({units})"
    if models:
        title += f" by {models}"
    if hands := " ".join(sorted({prediction.grasp.hand for prediction in predictions if prediction.grasp.hand})):
        title += f" for {hands}"
    return _table("object", "mm", *modalities, "based on", "flags", rows=rows, title=title)


def _modalities(prediction: TouchPrediction, sensor: Sensor, modalities: Sequence[str]) -> list[str]:
    """Return values of some modalities with their half width."""
    from foretouch.ros.messages.conversions import prediction_from_msg

    decoded = prediction_from_msg(prediction, sensor)
    value, lower, upper = (end.values for end in (decoded.value, decoded.lower, decoded.upper))
    columns = [(sensor.channels.columns([name]), sensor.channels.channel_of[name].text) for name in modalities]
    return [modality_text(value[part], lower[part], upper[part], text) for part, text in columns]


def executed_table(prediction: TouchPrediction | None, sample: Sample, sensor: Sensor | None = None) -> Table:
    """List the values of an executed grasp: as predicted, if they were, with how many were read inside of their intervals, as read, and at rest before; all without a sensor."""
    read = {name: touch for name, touch in (("read", sample.touch), ("tare", sample.tare)) if touch is not None}
    channels = read["read"].channels.channel_of
    modalities = TaxelView(sensor).modalities if sensor else list(channels)
    rows: list[list[str | Text]] = []
    if prediction is not None and not prediction.status:
        rows.append(["predicted", *_modalities(prediction, sensor or BIOTAC_SP, modalities)])
    rows += [
        [name, *(modality_text(touch[key], None, None, channels[key].text) for key in modalities)]
        for name, touch in read.items()
    ]
    title = ""
    if prediction is not None and not prediction.status:
        rows.insert(2, ["inside", *_inside(prediction, read["read"], sensor or BIOTAC_SP, modalities)])
        title = f"the prediction's flags: {', '.join(prediction.flags).replace('_', ' ')}" if prediction.flags else ""
    return _table("last grasp", *modalities, rows=rows, title=title)


def _inside(message: TouchPrediction, read: Touch, sensor: Sensor, modalities: Sequence[str]) -> list[str]:
    """Say for each modality whether it was read inside of its interval, or how many of its values were."""
    from foretouch.ros.messages.conversions import prediction_from_msg

    prediction = prediction_from_msg(message, sensor)
    if not prediction.calibrated:
        return ["–"] * len(modalities)
    inside = (read.values >= prediction.lower.values) & (read.values <= prediction.upper.values)
    parts = [inside[sensor.channels.columns([name])] for name in modalities]
    return [f"{part.sum()} of {part.size}" if part.size > 1 else ("no", "yes")[int(part.all())] for part in parts]


def _rounded(number: str) -> str:
    """Round a text to three digits; one that is no number stays as it is."""
    try:
        value = float(number)
    except ValueError:
        return number
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}"


def _short(name: str) -> str:
    return name.rpartition("/")[2]


def _order(name: str) -> tuple[int, str]:
    """Sort nodes in the order in which the data passes them."""
    short = _short(name)
    known = ["camera", "replay", "perception", "segmentation", "grasp", "touch_predictor", "hand", "markers"]
    return (known.index(short) if short in known else len(known), short)

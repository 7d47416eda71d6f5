# SPDX-License-Identifier: Apache-2.0
"""Write clouds, grasps, predictions and readings as a Rerun recording (`.rrd`).

/scene/cloud, table, objects, candidates        what the camera saw and what was found in it
/scene/hand, thumb, middle_finger               the pose of the hand, and both fingertips at their contacts
/taxels/TH, MF                                  the taxels unrolled, predicted beside read, in one channel
/touch/PDC_TH, PDC_MF, E_TH/01 ... E_MF/24      value, bounds and reading over time, by modality and number of the taxel
/answer                                         the same as text, with flags and reasons
"""

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ForetouchError, MissingDependencyError
from foretouch.files import open_own
from foretouch.grasp.pose import fingertip_rotation
from foretouch.report.taxel_view import TaxelView
from foretouch.tactile.channels import BIOTAC_SP, LAYER_M, skin_axes
from foretouch.tactile.description import Sensor
from foretouch.types import Cloud, Float32, Float64, Grasp, Plane, Touch, TouchPrediction

_SKIN_AXES: Final = skin_axes()  # of the BioTac SP
_COLOURS: Final = ((240, 115, 130), (60, 190, 205))  # at g1, at g2
_DEAD: Final = (128, 128, 128, 90)
_TARGET, _OTHER = (60, 160, 80), (150, 150, 150)
_CANDIDATE: Final = (120, 120, 120)
_TABLE: Final = (120, 128, 140, 255)
_CURVES: Final = {"predicted": "predicted", "lower": "90 % interval", "upper": "90 % interval", "read": "read"}
_BOUND: Final = ((170, 140, 90), 1.5)
_LINES: Final = {"predicted": ((230, 150, 0), 2.5), "lower": _BOUND, "upper": _BOUND, "read": ((90, 140, 255), 3.0)}
_MAX_POINTS: Final = 60_000  # of a cloud; more make a file large and the view no better
_AXIS_M: Final = 0.06
_ALL_CURVES: Final = 64  # taxels of a finger which all get curves; of more, only the one that varies most
_LEAST_SIZE_M: Final = 0.1  # of what is looked at
_TABLE_MARGIN_M: Final = 0.05  # around what was seen


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewStep:
    """One step of the time line: a cloud, what was found in it, and one grasp."""

    name: str  # of the input
    cloud: Cloud | None = None  # as the camera saw it; None if it is not known
    table: Plane | None = None  # in the cloud's frame
    objects: Mapping[str, Cloud] | None = None  # by id; the first is the target
    grasp: Grasp | None = None  # whose touch is predicted or was read
    candidates: Sequence[Grasp] = ()  # the other planned grasps
    prediction: TouchPrediction | None = None  # for `grasp`
    model: str = ""  # that predicted
    read: Touch | None = None  # of the executed grasp
    tare: Touch | None = None  # reading without contact
    stamp_ns: int = 0  # time of the cloud [ns]; 0 if it is not known
    reason: str = ""  # why there is no prediction


def write_view(path: Path, steps: Iterable[ViewStep], title: str, sensor: Sensor | None = None) -> int:
    """Write a Rerun recording (`.rrd`) with a layout, which appears when it is complete; returns the number of steps.

    The sensor of all touches is the BioTac SP unless given. Each step is written before the next one is asked for. A `ForetouchError` if there is none, the file cannot be written,
    or Rerun is not installed.
    """
    try:
        import rerun
    except ImportError as err:
        raise MissingDependencyError("Rerun is not installed: pip install 'foretouch[view]'") from err
    part = path.with_name(f"{path.name}.part")
    os.close(open_own(part, os.O_WRONLY))
    try:
        recording = rerun.RecordingStream("foretouch")
        recording.save(part)
        recording.send_recording_name(title)
        written = _Writer(rerun, recording, TaxelView(sensor or BIOTAC_SP)).write(steps)
        recording.flush()
        recording.disconnect()
        if not written:
            raise ForetouchError(f"{title}: there is nothing to show")
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return written


class _Writer:
    """Writes clouds one by one, and at the end, in columns, what is small or needs all steps."""

    def __init__(self, rerun: Any, recording: Any, view: TaxelView) -> None:
        self._view = view
        self._names = view.sensor.channels.fingers
        self._rr = rerun
        self._to = recording
        self._steps: list[ViewStep] = []  # without their clouds
        self._present: set[str] = set()
        self._eye: tuple[Float64, float] | None = None  # what to look at first, and its size [m]

    def write(self, steps: Iterable[ViewStep]) -> int:
        rr = self._rr
        self._to.set_log_time_enabled(False)
        self._to.log("/scene", rr.ViewCoordinates.RDF, static=True)
        for number, step in enumerate(steps):
            self._to.set_time("step", sequence=number)
            if step.stamp_ns > 0:
                self._to.set_time("time", timestamp=np.datetime64(step.stamp_ns, "ns"))
            else:
                self._to.disable_timeline("time")
            self._scene(step)
            self._steps.append(replace(step, cloud=None, objects=None))
        if self._steps:
            texts, kinds = [_text(step, self._view) for step in self._steps], ["text/markdown"] * len(self._steps)
            self._send("/answer", rr.TextDocument.columns(text=texts, media_type=kinds))
            self._hands()
            self._taxels()
            layout = _layout(self._view, [self._curves(k) for k in range(len(self._names))], self._eye)
            self._to.send_blueprint(layout, make_active=True, make_default=True)
        return len(self._steps)

    def _send(self, path: str, columns: Any, steps: Sequence[int] | None = None) -> None:
        """Write one row for each of the steps (all, if None are named)."""
        rr = self._rr
        numbers = range(len(self._steps)) if steps is None else steps
        times = [rr.TimeColumn("step", sequence=numbers)]
        stamps = [self._steps[k].stamp_ns for k in numbers]
        if min(stamps) > 0:
            times.append(rr.TimeColumn("time", timestamp=np.array(stamps, "datetime64[ns]")))
        self._to.send_columns(path, times, columns)

    def _log(self, path: str, content: Any) -> None:
        """Write what is at a path from this step on; None clears it."""
        if content is not None:
            self._present.add(path)
            self._to.log(path, content)
        elif path in self._present:
            self._present.remove(path)
            self._to.log(path, self._rr.Clear(recursive=True))

    def _scene(self, step: ViewStep) -> None:
        rr = self._rr
        points, colours = _points(step.cloud)
        if self._eye is None and len(points):
            self._eye = _point_of_interest(step, points)
        self._log("/scene/cloud", rr.Points3D(points, colors=colours, radii=0.0008) if len(points) else None)
        self._log("/scene/objects", self._boxes(step.objects) if step.objects else None)
        table = None
        if step.table is not None and len(points):
            corners = _table_corners(step.table, points)
            table = rr.Mesh3D(vertex_positions=corners, triangle_indices=[(0, 1, 2), (0, 2, 3)], albedo_factor=_TABLE)
        self._log("/scene/table", table)
        lines = [[one.g1, one.g2] for one in step.candidates]
        self._log("/scene/candidates", rr.LineStrips3D(lines, colors=_CANDIDATE, radii=0.0004) if lines else None)

    def _boxes(self, objects: Mapping[str, Cloud]) -> Any:
        bounds = [(one.xyz.min(axis=0), one.xyz.max(axis=0)) for one in objects.values()]
        return self._rr.Boxes3D(
            centers=[(low + high) / 2.0 for low, high in bounds],
            half_sizes=[(high - low) / 2.0 for low, high in bounds],
            colors=[_OTHER if k else _TARGET for k in range(len(bounds))],
            labels=[f"object {name}" for name in objects],
            show_labels=len(bounds) > 1,
        )

    def _column(self, path: str, kind: Any, rows: Sequence[Mapping[str, Any] | None], **style: Any) -> None:
        """Write what is at a path in each step, nothing where it is None, in one style."""
        known = [row for row in rows if row is not None]
        columns = {name: list(chain.from_iterable(row[name] for row in known)) for name in known[0]}
        sizes = [0 if row is None else len(next(iter(row.values()))) for row in rows]
        self._send(path, kind.columns(**columns).partition(sizes))
        self._to.log(path, kind.from_fields(**style), static=True)

    def _hands(self) -> None:
        """The pose of the hand, and both fingertips with their skin at the contacts."""
        rr, grasps = self._rr, [step.grasp for step in self._steps]
        found = [k for k, grasp in enumerate(grasps) if grasp is not None]
        if not found:
            return
        self._poses("/scene/hand", found, [(one.midpoint, one.rotation) for one in grasps if one is not None])
        shown = [_AXIS_M * (grasp is not None) for grasp in grasps]
        self._send("/scene/hand", rr.TransformAxes3D.columns(axis_length=shown))
        lines = [
            None if one is None else {"strips": [(np.stack([one.g1, one.g2]) - one.midpoint) @ one.rotation]}
            for one in grasps
        ]
        self._column("/scene/hand/line", rr.LineStrips3D, lines, radii=0.0006)
        for k, finger in enumerate(self._view.fingers):
            path, colour = _path(finger), _COLOURS[k]
            depth = _SKIN_AXES[2] if self._has_skin else 0.0  # of the surface below the origin
            ends = [_fingertip_pose(one, (one.g1, one.g2)[k], depth) for one in grasps if one is not None]
            self._poses(path, found, ends)
            if self._has_skin:
                skin = [None if one is None else {"half_sizes": [_SKIN_AXES]} for one in grasps]
                self._column(f"{path}/skin", rr.Ellipsoids3D, skin, colors=colour, line_radii=0.0001)
            lowest = [None if one is None else {"positions": [[0.0, 0.0, -depth]]} for one in grasps]
            self._column(f"{path}/contact", rr.Points3D, lowest, colors=colour, radii=0.002, labels=[finger])

    @property
    def _has_skin(self) -> bool:
        return self._view.sensor.is_biotac

    def _on_finger(self) -> Float64:
        """(N, 3) taxels in the frame of a fingertip [m], where they are drawn: on the skin, else on the surface of the pad."""
        layout = self._view.sensor.layout
        if self._has_skin:
            return layout.positions + LAYER_M * layout.normals
        placed = layout.positions @ layout.to_fingertip.T
        return np.asarray(placed - [placed[:, 0].mean(), 0.0, placed[:, 2].min()], np.float64)

    def _poses(self, path: str, steps: Sequence[int], poses: Sequence[tuple[Float64, Float64]]) -> None:
        origins, rotations = zip(*poses, strict=True)
        self._send(path, self._rr.Transform3D.columns(translation=origins, mat3x3=rotations), steps)

    def _taxels(self) -> None:
        """Taxels of all steps, coloured by one scale for each finger, predicted as read."""
        from matplotlib import colormaps

        rr, steps, view = self._rr, self._steps, self._view
        touches = {
            "predicted": [None if one.prediction is None else one.prediction.value for one in steps],
            "read": [one.read for one in steps],
        }
        shown = [one for one in steps if one.read is not None or one.prediction is not None]
        tared = all(view.has_rest(one.tare) for one in shown)
        colours = colormaps["plasma" if tared else "viridis"]
        on_finger, layout = self._on_finger(), view.sensor.layout
        flat = 1e3 * layout.unrolled * [1.0, -1.0]  # [mm], y down
        low_x, low_y = flat.min(axis=0)
        aside, above = (
            np.array([np.ptp(flat[:, 0]) + 8.0, 0.0]),
            np.array([low_x + np.ptp(flat[:, 0]) / 2.0, low_y - 3.0]),
        )
        radius = min(1.0, 10.0 / math.sqrt(view.sensor.size))  # [mm]
        for k, (name, finger) in enumerate(zip(self._names, view.fingers, strict=True)):
            levels = {
                what: [
                    None if touch is None else view.levels(touch.values, step.tare if tared else None, k)
                    for touch, step in zip(column, steps, strict=True)
                ]
                for what, column in touches.items()
                if any(touch is not None for touch in column)
            }
            if not levels:
                continue
            dead = ~view.sensor.valid[k]
            known = [one[~dead] for column in levels.values() for one in column if one is not None]
            low, high = np.nanpercentile(known, [1, 99])
            span = max(high - low, view.channel.resolution)
            for what, column in levels.items():
                path, place = f"/taxels/{name}/{what}", aside * (what == "read")
                heading = rr.Points2D([above + place], radii=0.01, labels=[what], colors=_CANDIDATE)
                self._to.log(f"{path}_title", heading, static=True)
                rows: list[dict[str, Any] | None] = []
                for one in column:
                    if one is None:
                        rows.append(None)
                        continue
                    shade = colours(np.clip((np.nan_to_num(one) - low) / span, 0.0, 1.0), bytes=True)
                    shade[dead | np.isnan(one)] = _DEAD
                    labels = [view.channel.text(x) for x in one]
                    rows.append({"positions": flat + place, "colors": shade, "labels": labels})
                self._column(path, rr.Points2D, rows, radii=radius, show_labels=False)
                if what == "predicted":
                    spheres = [one and {"positions": on_finger, "colors": one["colors"]} for one in rows]
                    self._column(f"{_path(finger)}/taxels", rr.Points3D, spheres, radii=0.0012 * radius)

    def _curves(self, finger: int) -> int:
        """All values of a finger over time; returns the number, from 1, of the taxel that varies most in the shown channel."""
        sensor, name = self._view.sensor, self._names[finger]
        rows = np.full((len(self._steps), len(_CURVES), sensor.channels.size), np.nan)
        for number, step in enumerate(self._steps):
            one = step.prediction
            touches = (None, None, None) if one is None else (one.value, one.lower, one.upper)
            for k, touch in enumerate((*touches, step.read)):
                if touch is not None:
                    rows[number, k] = touch.values
        lively = _lively(rows[:, :, self._view.columns(finger)])
        scalars = zip(sensor.scalar_channels, sensor.scalar_columns[finger], strict=True)
        paths = {f"{channel.name}_{name}": column for channel, column in scalars}
        for k in range(sensor.size) if sensor.size <= _ALL_CURVES else (lively,):
            for channel, column in zip(sensor.taxel_channels, sensor.taxel_columns[finger, k], strict=True):
                paths[f"{channel.name}_{name}/{k + 1:02d}"] = column
        for k, (what, label) in enumerate(_CURVES.items()):
            known = np.flatnonzero(np.isfinite(rows[:, k]).any(axis=1)).tolist()
            style = self._style(what, label)
            for path, column in paths.items() if known else ():
                self._to.log(f"/touch/{path}/{what}", style, static=True)
                self._send(f"/touch/{path}/{what}", self._rr.Scalars.columns(scalars=rows[known, k, column]), known)
        return lively + 1

    def _style(self, what: str, label: str) -> Any:
        colour, width = _LINES[what]
        if what == "read" or len(self._steps) == 1:  # a line of one point is not drawn
            return self._rr.SeriesPoints(colors=colour, names=label, markers="circle", marker_sizes=width)
        return self._rr.SeriesLines(colors=colour, widths=width, names=label)


def _lively(rows: Float64) -> int:
    """Which of (steps, curves, N) values varies most over the steps: what was read, else what was predicted."""
    for k in (3, 0):
        seen = rows[np.isfinite(rows[:, k]).any(axis=1), k]
        if len(seen) > 1:
            return int(np.argmax(np.ma.masked_invalid(seen).std(axis=0).filled(0.0)))
    return 0


def _fingertip_pose(grasp: Grasp, contact: Float64, depth_m: float) -> tuple[Float64, Float64]:
    """Origin (3,) [m] and rotation (3, 3) of a fingertip whose surface, so far below its origin, meets a contact."""
    rotation = fingertip_rotation(grasp, contact)
    return contact + rotation @ [0.0, 0.0, depth_m], rotation


def _table_corners(table: Plane, points: Float32) -> Float64:
    """(4, 3) float64 [m]: corners of the part of the table under and around (N, 3) points."""
    u = np.cross(table.normal, np.eye(3)[np.argmin(np.abs(table.normal))])
    u /= np.linalg.norm(u)
    v = np.cross(table.normal, u)
    base = -table.offset * table.normal
    places = (points - base) @ np.column_stack([u, v])
    (u0, v0), (u1, v1) = places.min(axis=0) - _TABLE_MARGIN_M, places.max(axis=0) + _TABLE_MARGIN_M
    return np.array([base + a * u + b * v for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))])


def _path(finger: str) -> str:
    return f"/scene/{finger.replace(' ', '_')}"


def _point_of_interest(step: ViewStep, points: Float32) -> tuple[Float64, float]:
    """What to look at, the grasp or else the middle of the cloud, and its size [m]."""
    if step.grasp is not None:
        return step.grasp.midpoint, max(step.grasp.width_m, _LEAST_SIZE_M)
    low, high = np.percentile(points, [5.0, 95.0], axis=0)
    return (low + high) / 2.0, max(float(np.linalg.norm(high - low)), _LEAST_SIZE_M)


def _points(cloud: Cloud | None) -> tuple[Float32, Any]:
    """(N, 3) float32 points [m] with depth, thinned evenly, and their colours: the camera's, else by depth."""
    if cloud is None:
        return np.empty((0, 3), np.float32), None
    points = cloud.xyz.reshape(-1, 3)
    kept = np.flatnonzero(np.isfinite(points).all(axis=1))
    kept = kept[:: max(1, -(-len(kept) // _MAX_POINTS))]
    points = points[kept].astype(np.float32, copy=False)
    if cloud.rgb is not None or not len(points):
        return points, None if cloud.rgb is None else cloud.rgb.reshape(-1, 3)[kept]
    from matplotlib import colormaps

    near, far = np.percentile(points[:, 2], [1.0, 99.0])
    return points, colormaps["cividis_r"](np.clip((points[:, 2] - near) / max(far - near, 1e-3), 0.0, 1.0), bytes=True)


def _text(step: ViewStep, view: TaxelView) -> str:
    """The answer in Markdown."""
    one, value = step.prediction, None if step.prediction is None else step.prediction.value
    lines = [f"**{step.name}**", ""]
    if step.grasp is not None:
        lines += [f"grasp {1e3 * step.grasp.width_m:.0f} mm wide, {len(step.candidates)} other candidates", ""]
    if one is not None and value is not None:
        flags = f", **{', '.join(one.flags)}**" if one.flags else ""
        lines += [f"predicted by {step.model or 'an unnamed model'}, adapted to: {one.reference}{flags}", ""]
    else:
        reason = step.reason or (one.reason if one is not None else "")
        lines += [f"not predicted: {reason}" if reason else "not predicted", ""]
    if (value is None and step.read is None) or not view.sensor.scalar_channels:
        return "\n".join(lines)
    units = dict.fromkeys(channel.unit for channel in view.sensor.scalar_channels)
    lines += [f"| {', '.join(units)} | predicted | read |", "|---|---|---|"]
    for k, finger in enumerate(view.fingers):
        for channel, column in zip(view.sensor.scalar_channels, view.sensor.scalar_columns[k], strict=True):
            cells = ["–" if touch is None else channel.text(touch.values[column]) for touch in (value, step.read)]
            if one is not None and one.lower is not None and one.upper is not None:
                low, high = (channel.text(touch.values[column]) for touch in (one.lower, one.upper))
                cells[0] += f" ({low} to {high})"
            lines.append(f"| {channel.name} of the {finger} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _layout(view: TaxelView, lively: Sequence[int], eye: tuple[Float64, float] | None) -> Any:
    """The scene with the answer, beside the scalars, the liveliest taxel and all taxels of each finger."""
    import rerun.blueprint as rrb

    columns = []
    for number, (name, finger, k) in enumerate(zip(view.sensor.channels.fingers, view.fingers, lively, strict=True)):
        curves = [(f"{one.name}_{name}", one.name, one) for one in view.sensor.scalar_channels]
        curves.append((f"{view.channel.name}_{name}/{k:02d}", f"{view.channel.name} of taxel {k}", view.channel))
        columns.append(
            rrb.Vertical(
                *(
                    rrb.TimeSeriesView(
                        origin=f"/touch/{path}",
                        name=f"{finger}: {what} [{one.unit}]",
                        plot_legend=rrb.PlotLegend(visible=number == 0 and place == 0),
                    )
                    for place, (path, what, one) in enumerate(curves)
                ),
                rrb.Spatial2DView(origin=f"/taxels/{name}", name=f"{finger}: {view.channel.name} of all taxels"),
            )
        )
    controls = None
    if eye is not None:
        target, size = eye
        position = target + size * np.array([-1.0, -1.3, -1.9])  # from the camera's side, from above and the left
        controls = rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, -1.0, 0.0))
    answer = rrb.TextDocumentView(origin="/answer", name="answer")
    scene = rrb.Spatial3DView(origin="/scene", name="scene", eye_controls=controls, line_grid=False)
    left = answer if eye is None else rrb.Vertical(scene, answer, row_shares=[3, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, *columns, column_shares=[1 if eye is None else 2, 1, 1]),
        rrb.TimePanel(state="collapsed", timeline="step", fps=5.0, play_state="paused"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )

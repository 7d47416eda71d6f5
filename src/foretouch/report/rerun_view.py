# SPDX-License-Identifier: Apache-2.0
"""Write clouds, grasps, predictions and readings as a Rerun recording (`.rrd`).

/scene/cloud, table, objects, candidates        what the camera saw and what was found in it
/scene/hand, thumb, middle_finger               the pose of the hand, and both fingertips at their contacts
/electrodes/TH, MF                              the electrodes unrolled from the core, predicted beside read
/touch/PDC_TH, PDC_MF, E_TH/01 ... E_MF/24      value, bounds and reading over time [counts]
/answer                                         the same as text, with flags and reasons
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.checked_files import open_own
from foretouch.errors import ForetouchError, MissingDependencyError
from foretouch.grasp.pose import fingertip_rotation
from foretouch.report.panels import electrode_levels, finger_parts
from foretouch.simulation.contact.pad import PadConfig
from foretouch.tactile import ELECTRODES, electrode_normals, electrode_positions
from foretouch.tactile.channels import FINGER_NAMES
from foretouch.types import Cloud, Float32, Float64, Grasp, Plane, Touch, TouchPrediction

_PAD: Final = PadConfig()
_COLOURS: Final = {"TH": (240, 115, 130), "MF": (60, 190, 205)}
_TARGET, _OTHER = (60, 160, 80), (150, 150, 150)
_CANDIDATE: Final = (120, 120, 120)
_TABLE: Final = (120, 128, 140, 255)
_CURVES: Final = {"predicted": "predicted", "lower": "90 % interval", "upper": "90 % interval", "read": "read"}
_BOUND: Final = ((170, 140, 90), 1.5)
_LINES: Final = {"predicted": ((230, 150, 0), 2.5), "lower": _BOUND, "upper": _BOUND, "read": ((90, 140, 255), 3.0)}
_MAX_POINTS: Final = 60_000  # of a cloud; more make a file large and the view no better
_AXIS_M: Final = 0.06
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
    read: Touch | None = None  # of the executed grasp [counts]
    tare: Touch | None = None  # reading without contact [counts]
    stamp_ns: int = 0  # time of the cloud [ns]; 0 if it is not known
    reason: str = ""  # why there is no prediction


def write_view(path: Path, steps: Iterable[ViewStep], title: str) -> int:
    """Write a Rerun recording (`.rrd`) with a layout, which appears when it is complete; returns the number of steps.

    Each step is written before the next one is asked for. A `ForetouchError` if there is none, the file cannot be written,
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
        written = _Writer(rerun, recording).write(steps)
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

    def __init__(self, rerun: Any, recording: Any) -> None:
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
            texts, kinds = [_text(step) for step in self._steps], ["text/markdown"] * len(self._steps)
            self._send("/answer", rr.TextDocument.columns(text=texts, media_type=kinds))
            self._hands()
            self._electrodes()
            layout = _layout([self._curves(name) for name in FINGER_NAMES], self._eye)
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
        for name, finger in FINGER_NAMES.items():
            path, colour = _path(finger), _COLOURS[name]
            ends = [_fingertip_pose(one, one.g1 if name == "TH" else one.g2) for one in grasps if one is not None]
            self._poses(path, found, ends)
            skin = [None if one is None else {"half_sizes": [_PAD.skin_axes]} for one in grasps]
            self._column(f"{path}/skin", rr.Ellipsoids3D, skin, colors=colour, line_radii=0.0001)
            lowest = [None if one is None else {"positions": [[0.0, 0.0, -_PAD.skin_axes[2]]]} for one in grasps]
            self._column(f"{path}/contact", rr.Points3D, lowest, colors=colour, radii=0.002, labels=[finger])

    def _poses(self, path: str, steps: Sequence[int], poses: Sequence[tuple[Float64, Float64]]) -> None:
        origins, rotations = zip(*poses, strict=True)
        self._send(path, self._rr.Transform3D.columns(translation=origins, mat3x3=rotations), steps)

    def _electrodes(self) -> None:
        """Electrodes of all steps, coloured by one scale for each finger, predicted as read."""
        from matplotlib import colormaps

        rr, steps = self._rr, self._steps
        touches = {
            "predicted": [None if one.prediction is None else one.prediction.value for one in steps],
            "read": [one.read for one in steps],
        }
        tared = all(one.tare is not None for one in steps if one.read is not None or one.prediction is not None)
        colours = colormaps["plasma" if tared else "viridis"]
        on_skin = electrode_positions() + _PAD.layer_m * electrode_normals()
        along, across, depth = 1e3 * electrode_positions().T
        flat = np.column_stack([0.15 * np.degrees(np.arctan2(across, -depth)), -along])  # [mm]; the core's radius is 8
        for name, finger in FINGER_NAMES.items():
            levels = {
                what: [
                    None if touch is None else electrode_levels(touch, step.tare if tared else None, name)
                    for touch, step in zip(column, steps, strict=True)
                ]
                for what, column in touches.items()
                if any(touch is not None for touch in column)
            }
            if not levels:
                continue
            low, high = np.percentile([one for column in levels.values() for one in column if one is not None], [1, 99])
            for what, column in levels.items():
                path, place = f"/electrodes/{name}/{what}", np.array([28.0 * (what == "read"), 0.0])
                heading = rr.Points2D([place - [0.0, 15.0]], radii=0.01, labels=[what], colors=_CANDIDATE)
                self._to.log(f"{path}_title", heading, static=True)
                shades = [
                    None if one is None else colours(np.clip((one - low) / max(high - low, 1.0), 0.0, 1.0), bytes=True)
                    for one in column
                ]
                rows = [
                    one
                    if one is None
                    else {"positions": flat + place, "colors": shade, "labels": [f"{x:.0f}" for x in one]}
                    for one, shade in zip(column, shades, strict=True)
                ]
                self._column(path, rr.Points2D, rows, radii=1.0, show_labels=False)
                if what == "predicted":
                    spheres = [one if one is None else {"positions": on_skin, "colors": one} for one in shades]
                    self._column(f"{_path(finger)}/electrodes", rr.Points3D, spheres, radii=0.0012)

    def _curves(self, name: str) -> int:
        """Pressure and all electrodes of a finger over time; returns the electrode that varies most."""
        rows = np.full((len(self._steps), len(_CURVES), 1 + ELECTRODES), np.nan)
        for number, step in enumerate(self._steps):
            one = step.prediction
            touches = (None, None, None) if one is None else (one.value, one.lower, one.upper)
            for k, touch in enumerate((*touches, step.read)):
                if touch is not None:
                    rows[number, k] = np.hstack(finger_parts(touch, name))
        for k, (what, label) in enumerate(_CURVES.items()):
            known = np.flatnonzero(np.isfinite(rows[:, k, 0])).tolist()
            style = self._style(what, label)
            for column in range(1 + ELECTRODES) if known else ():
                path = f"/touch/E_{name}/{column:02d}/{what}" if column else f"/touch/PDC_{name}/{what}"
                self._to.log(path, style, static=True)
                self._send(path, self._rr.Scalars.columns(scalars=rows[known, k, column]), known)
        for k in (3, 0):  # what was read, else what was predicted
            seen = rows[np.isfinite(rows[:, k, 0]), k, 1:]
            if len(seen) > 1:
                return int(np.argmax(seen.std(axis=0))) + 1
        return 1

    def _style(self, what: str, label: str) -> Any:
        colour, width = _LINES[what]
        if what == "read" or len(self._steps) == 1:  # a line of one point is not drawn
            return self._rr.SeriesPoints(colors=colour, names=label, markers="circle", marker_sizes=width)
        return self._rr.SeriesLines(colors=colour, widths=width, names=label)


def _fingertip_pose(grasp: Grasp, contact: Float64) -> tuple[Float64, Float64]:
    """Origin (3,) [m] and rotation (3, 3) of a fingertip whose skin meets a contact in the middle of its pad."""
    rotation = fingertip_rotation(grasp, contact)
    return contact + rotation @ [0.0, 0.0, _PAD.skin_axes[2]], rotation


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


def _text(step: ViewStep) -> str:
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
    if value is None and step.read is None:
        return "\n".join(lines)
    lines += ["| counts | predicted | read |", "|---|---|---|"]
    for name, finger in FINGER_NAMES.items():
        cells = ["–" if touch is None else f"{finger_parts(touch, name)[0]:.0f}" for touch in (value, step.read)]
        if one is not None and one.lower is not None and one.upper is not None:
            low, high = (finger_parts(touch, name)[0] for touch in (one.lower, one.upper))
            cells[0] += f" ({low:.0f} to {high:.0f})"
        lines.append(f"| PDC of the {finger} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _layout(electrodes: Sequence[int], eye: tuple[Float64, float] | None) -> Any:
    """The scene with the answer, beside pressure, one electrode and all electrodes of each finger."""
    import rerun.blueprint as rrb

    columns = [
        rrb.Vertical(
            *(
                rrb.TimeSeriesView(origin=f"/touch/{path}", name=f"{finger}: {what} [counts]", plot_legend=legend)
                for path, what, legend in (
                    (f"PDC_{name}", "pressure PDC", rrb.PlotLegend(visible=name == "TH")),
                    (f"E_{name}/{k:02d}", f"electrode {k}", rrb.PlotLegend(visible=False)),
                )
            ),
            rrb.Spatial2DView(origin=f"/electrodes/{name}", name=f"{finger}: electrodes"),
        )
        for (name, finger), k in zip(FINGER_NAMES.items(), electrodes, strict=True)
    ]
    controls = None
    if eye is not None:
        target, size = eye
        position = target + size * np.array([-1.0, -1.3, -1.9])  # from the camera's side, from above and the left
        controls = rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, -1.0, 0.0))
    scene = rrb.Vertical(
        rrb.Spatial3DView(origin="/scene", name="scene", eye_controls=controls, line_grid=False),
        rrb.TextDocumentView(origin="/answer", name="answer"),
        row_shares=[3, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, *columns, column_shares=[2, 1, 1]),
        rrb.TimePanel(state="collapsed", timeline="step", fps=5.0, play_state="paused"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )

# SPDX-License-Identifier: Apache-2.0
"""Write clouds, grasps, predictions and readings as a Rerun recording (`.rrd`), and show it in a window or draw it to a picture.

/image, objects, hand, grasp                    the photograph, or the depth as a relief, with outlines, hand and contacts
/scene/cloud, table, objects, candidates        what the camera saw and what was found in it
/scene/hand, thumb, middle_finger               the pose of the hand, and both fingertips at their contacts
/taxels/TH, MF                                  the taxels unrolled, predicted beside read, in one channel
/touch/PDC_TH, PDC_MF, E_TH, E_MF               value, bounds and reading over time; of taxels the mean of the shown channel
/answer                                         the same as text, with flags and reasons

Rerun is started with its usage statistics turned off, in its own configuration folder, and listens on 127.0.0.1 alone.
"""

import math
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.base.files import open_own, part_of, read_bytes, replace_files, require_replaceable, system_errors
from foretouch.errors import FileError, ForetouchError, MissingDependencyError
from foretouch.grasp.pose import fingertip_rotation
from foretouch.report.camera_figure import outlines_of, photograph, pixels_of
from foretouch.report.finger_figure import level_colours
from foretouch.report.hand_figure import COLOURS, hand_lines
from foretouch.report.panels import OBJECT_COLOURS, SKIN
from foretouch.tactile.channels import BIOTAC_SP, LAYER_M, skin_axes
from foretouch.tactile.description import Sensor
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Cloud, Float32, Float64, Grasp, Int32, Plane, Prediction, Touch

_COLOURS: Final = ((240, 115, 130), (60, 190, 205))  # at g1, at g2
_LEAST_FREE: Final = 100_000_000  # bytes of a disk, of which no step takes more
_DEAD: Final = (128, 128, 128, 90)
_TARGET, _OTHER = (60, 160, 80), (150, 150, 150)
_CANDIDATE: Final = (120, 120, 120)
_TABLE: Final = (120, 128, 140, 255)
_BOUND: Final = ("90 % interval", (170, 140, 90), 1.5)
_CURVES: Final = {
    "predicted": ("predicted", (230, 150, 0), 2.5),
    "lower": _BOUND,
    "upper": _BOUND,
    "read": ("read", (90, 140, 255), 3.0),
}  # label, colour and width
_MAX_POINTS: Final = 60_000  # of a cloud; more make a file large and the view no better
_SHOWN: Final = (
    "/image",
    "/scene/cloud",
    "/scene/objects",
    "/scene/table",
    "/scene/candidates",
    "/scene/outline",
    "/taxels",
)  # in some steps
_AXIS_M: Final = 0.06
_EYE_M: Final = 0.27  # from which the scene is seen at first
_JPEG: Final = 85  # quality of images
_TABLE_MARGIN_M: Final = 0.05  # around what was seen
_SCREENSHOT_S: Final = 120.0
_POLL_S: Final = 0.1
_NO_GRAPHICS: Final = ("No graphics adapter", "Failed to get render context")  # what Rerun prints without a driver


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewStep:
    """One step of the time line: a cloud, what was found in it, and one grasp."""

    name: str  # of the input
    cloud: Cloud | None = None  # as the camera saw it; None if it is not known
    table: Plane | None = None  # in the cloud's frame
    outline: Float64 | None = None  # (n, 3) [m], convex outline of the table; None or empty if it is not known
    objects: Mapping[str, Cloud] | None = None  # by id; the first is the target
    labels: Int32 | None = None  # (H, W) the id of each pixel's object, 0 for none, of an organised cloud
    grasp: Grasp | None = None  # whose touch is predicted or was read
    candidates: Sequence[Grasp] = ()  # the other planned grasps
    prediction: Prediction | None = None  # for `grasp`
    model: str = ""  # that predicted
    read: Touch | None = None  # of the executed grasp
    tare: Touch | None = None  # reading without contact
    stamp_ns: int = 0  # time of the cloud [ns]; 0 if it is not known
    reason: str = ""  # why there is no prediction

    @property
    def value(self) -> Touch | None:
        """The predicted touch, if there is one."""
        return self.prediction.value if self.prediction is not None and self.prediction.ok else None


def write_view(path: Path, steps: Iterable[ViewStep], title: str, sensor: Sensor = BIOTAC_SP) -> int:
    """Write a Rerun recording (`.rrd`) with a layout, which appears when it is complete; returns the number of steps.

    All touches are of one sensor. Each step is written before the next one is asked for. A `ForetouchError` if there is no step, the
    file cannot be written, or Rerun is not installed.
    """
    try:
        import rerun
    except ImportError as err:
        raise MissingDependencyError("Rerun is not installed: pip install 'foretouch[view]'") from err
    require_replaceable(path)
    part = part_of(path)
    os.close(open_own(part, os.O_WRONLY))
    try:
        recording = rerun.RecordingStream("foretouch")
        recording.save(part)
        recording.send_recording_name(title)
        written = _Writer(rerun, recording, TaxelView(sensor)).write(_with_room(path, steps))
        recording.flush()
        recording.disconnect()
        if not written:
            raise ForetouchError(f"{title}: there is nothing to show")
        part.replace(path)
    except RuntimeError as err:  # of Rerun's writer
        raise FileError(path, f"cannot be written, is the disk full? {' '.join(str(err).split())}") from err
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return written


def _with_room(path: Path, steps: Iterable[ViewStep]) -> Iterator[ViewStep]:
    """Iterate over steps while the disk has room for one; Rerun's writer may wait for ever at a full one."""
    for step in steps:
        with system_errors(path):
            free = shutil.disk_usage(path.parent).free
        if free < _LEAST_FREE:
            raise FileError(
                path, f"cannot be written: {free // 10**6} MB of the disk are free, {_LEAST_FREE // 10**6} are needed"
            )
        yield step


class _Writer:
    """Writes steps one by one, and at the end the taxels of all, whose scale of colours needs all of them."""

    def __init__(self, rerun: Any, recording: Any, view: TaxelView) -> None:
        self._rr = rerun
        self._to = recording
        self._view = view
        self._steps: list[ViewStep] = []  # without their clouds
        self._seen = self._pictured = False  # whether any step has a cloud, and an image
        self._skin = skin_axes() if view.sensor.is_biotac else None  # semi-axes [m]

    def write(self, steps: Iterable[ViewStep]) -> int:
        rr = self._rr
        self._to.set_log_time_enabled(False)
        self._to.log("/scene", rr.ViewCoordinates.RDF, static=True)
        for number, step in enumerate(steps):
            self._begin(number, step)
            fingers = list(map(_path, self._view.fingers))
            moved = [f"{finger}/taxels" for finger in fingers] if step.grasp else ["/scene/hand", *fingers]
            for path in (*_SHOWN, *moved):  # of the step before; a pose that is cleared and set at once is lost
                self._to.log(path, rr.Clear(recursive=True))
            self._image(step)
            self._scene(step)
            if step.grasp is not None:
                self._hand(step.grasp)
            self._curves(step)
            self._to.log("/answer", rr.TextDocument(_text(step, self._view), media_type="text/markdown"))
            self._steps.append(replace(step, cloud=None, objects=None, labels=None))
        if self._steps:
            self._taxels()
            self._styles()
            self._to.send_blueprint(
                _layout(self._view, self._steps[0], with_scene=self._seen, with_image=self._pictured),
                make_active=True,
                make_default=True,
            )
        return len(self._steps)

    def _begin(self, number: int, step: ViewStep) -> None:
        self._to.set_time("step", sequence=number)
        if step.stamp_ns > 0:
            self._to.set_time("time", timestamp=np.datetime64(step.stamp_ns, "ns"))
        else:
            self._to.disable_timeline("time")

    def _image(self, step: ViewStep) -> None:
        """Write what the camera sees, with the objects in the colours of pictures, the hand and the contacts over it."""
        rr, cloud = self._rr, step.cloud
        if cloud is None or not cloud.organised:
            return
        self._pictured = True
        self._to.log("/image", rr.Image(photograph(cloud)).compress(jpeg_quality=_JPEG))
        if step.labels is not None and step.objects:
            names = sorted(step.objects, key=int)
            found = [(k, line) for k, name in enumerate(names) for line in outlines_of(step.labels == int(name))]
            colours = [OBJECT_COLOURS[k % len(OBJECT_COLOURS)] for k, _ in found]
            self._to.log("/image/objects", rr.LineStrips2D([line for _, line in found], colors=_rgb(colours)))
            middles = [np.median(np.argwhere(step.labels == int(name)), axis=0)[::-1] for name in names]
            self._to.log("/image/objects/ids", rr.Points2D(middles, labels=names, radii=0.5))
        if step.grasp is not None:
            for part, edges in hand_lines(step.grasp).items():
                lines = rr.LineStrips2D(pixels_of(cloud, edges), colors=_rgb([COLOURS[part]]), radii=0.5)
                self._to.log(f"/image/hand/{part}", lines)
            ends = pixels_of(cloud, np.stack([step.grasp.g1, step.grasp.g2]))
            self._to.log("/image/grasp/line", rr.LineStrips2D([ends], colors=(255, 255, 255)))
            self._to.log("/image/grasp", rr.Points2D(ends, colors=_COLOURS, radii=4.0))

    def _scene(self, step: ViewStep) -> None:
        rr = self._rr
        points, colours = _points(step.cloud)
        if len(points):
            self._seen = True
            self._to.log("/scene/cloud", rr.Points3D(points, colors=colours, radii=0.0008))
        if step.objects:
            self._to.log("/scene/objects", self._boxes(step.objects))
        if step.table is not None and len(points):
            corners = step.outline
            if corners is None or not len(corners):
                corners = _table_corners(step.table, points)
            faces = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
            table = rr.Mesh3D(vertex_positions=corners, triangle_indices=faces, albedo_factor=_TABLE)
            self._to.log("/scene/table", table)
        if step.candidates:
            lines = [[candidate.g1, candidate.g2] for candidate in step.candidates]
            self._to.log("/scene/candidates", rr.LineStrips3D(lines, colors=_CANDIDATE, radii=0.0004))

    def _boxes(self, objects: Mapping[str, Cloud]) -> Any:
        bounds = [(object_.xyz.min(axis=0), object_.xyz.max(axis=0)) for object_ in objects.values()]
        return self._rr.Boxes3D(
            centers=[(low + high) / 2.0 for low, high in bounds],
            half_sizes=[(high - low) / 2.0 for low, high in bounds],
            colors=[_OTHER if k else _TARGET for k in range(len(bounds))],
            labels=[f"object {name}" for name in objects],
            show_labels=len(bounds) > 1,
        )

    def _hand(self, grasp: Grasp) -> None:
        """Write the pose of the hand, and both fingertips with their skin at the contacts."""
        rr = self._rr
        self._to.log("/scene/hand", rr.Transform3D(translation=grasp.midpoint, mat3x3=grasp.rotation))
        self._to.log("/scene/hand", rr.TransformAxes3D(_AXIS_M))
        for part, edges in hand_lines(grasp).items():
            self._to.log(f"/scene/outline/{part}", rr.LineStrips3D(edges, colors=_rgb([COLOURS[part]]), radii=0.0008))
        ends = (np.stack([grasp.g1, grasp.g2]) - grasp.midpoint) @ grasp.rotation
        self._to.log("/scene/hand/line", rr.LineStrips3D([ends], radii=0.0006))
        depth = 0.0 if self._skin is None else self._skin[2]  # of the surface below the origin
        for finger, contact, colour in zip(self._view.fingers, (grasp.g1, grasp.g2), _COLOURS, strict=False):
            rotation, path = fingertip_rotation(grasp, contact), _path(finger)
            origin = contact + rotation @ [0.0, 0.0, depth]
            self._to.log(path, rr.Transform3D(translation=origin, mat3x3=rotation))
            if self._skin is not None:
                skin = rr.Ellipsoids3D(half_sizes=[self._skin], colors=colour, line_radii=0.0001)
                self._to.log(f"{path}/skin", skin)
            point = rr.Points3D([[0.0, 0.0, -depth]], colors=colour, radii=0.002, labels=[finger])
            self._to.log(f"{path}/contact", point)

    def _curves(self, step: ViewStep) -> None:
        prediction = step.prediction
        values = (None, None, None) if prediction is None else (prediction.value, prediction.lower, prediction.upper)
        for path, columns in self._paths().items():
            for what, touch in zip(_CURVES, (*values, step.read), strict=True):
                known = None if touch is None else touch.values[columns][np.isfinite(touch.values[columns])]
                if known is not None and known.size:
                    self._to.log(f"/touch/{path}/{what}", self._rr.Scalars(known.mean()))

    def _paths(self) -> dict[str, Any]:
        """Return columns of a touch by the path of the curve of their mean: each scalar, and the valid taxels of the shown channel."""
        sensor, paths = self._view.sensor, {}
        for k, name in enumerate(sensor.channels.fingers):
            for channel, column in zip(sensor.scalar_channels, sensor.scalar_columns[k], strict=True):
                paths[f"{channel.name}_{name}"] = np.array([column])
            paths[f"{self._view.channel.name}_{name}"] = self._view.columns(k)[sensor.valid[k]]
        return paths

    def _styles(self) -> None:
        rr = self._rr
        for path in self._paths():
            for what, (label, colour, width) in _CURVES.items():
                style = rr.SeriesLines(colors=colour, widths=width, names=label)
                if what == "read" or len(self._steps) == 1:  # a line of one point is not drawn
                    style = rr.SeriesPoints(colors=colour, names=label, markers="circle", marker_sizes=width)
                self._to.log(f"/touch/{path}/{what}", style, static=True)

    def _taxels(self) -> None:
        """Write the taxels of all steps, coloured by one scale, predicted as read: changes from rest where all steps have one."""
        from matplotlib import colormaps

        view = self._view
        rr, layout = self._rr, view.sensor.layout
        tared = all(view.has_rest(step.tare) for step in self._steps if step.read or step.prediction)
        flat = 1e3 * layout.unrolled * [1.0, -1.0]  # [mm], y down
        beside = np.array([np.ptp(flat[:, 0]) + 8.0, 0.0])  # of what was read
        radius = min(1.0, 10.0 / math.sqrt(view.sensor.size))  # [mm]
        if self._skin is not None:
            placed = layout.positions + LAYER_M * layout.normals
        else:
            placed = layout.positions @ layout.to_fingertip.T
            placed = placed - [placed[:, 0].mean(), 0.0, placed[:, 2].min()]
        shown = range(len(view.sensor.channels.fingers[: len(_COLOURS)]))
        rows = [
            (finger, number, what, view.levels(touch.values, step.tare if tared else None, finger))
            for finger in shown
            for number, step in enumerate(self._steps)
            for what, touch in (("predicted", step.value), ("read", step.read))
            if touch is not None
        ]
        known = [levels[view.sensor.valid[finger]] for finger, _, _, levels in rows]
        palette, low, high = level_colours(view, np.concatenate([[], *known]), tared=tared)
        colours = colormaps[palette]
        span = max(high - low, view.channel.resolution)
        for finger in shown:
            name, dead = view.sensor.channels.fingers[finger], ~view.sensor.valid[finger]
            for number, what, levels in (row[1:] for row in rows if row[0] == finger):
                self._begin(number, self._steps[number])
                shades = colours(np.clip((np.nan_to_num(levels) - low) / span, 0.0, 1.0), bytes=True)
                shades[dead | np.isnan(levels)] = _DEAD
                places, texts = flat + beside * (what == "read"), [view.channel.text(level) for level in levels]
                drawn = rr.Points2D(places, colors=shades, radii=radius, labels=texts, show_labels=False)
                self._to.log(f"/taxels/{name}/{what}", drawn)
                if what == "predicted":
                    on_finger = rr.Points3D(placed, colors=shades, radii=0.0012 * radius)
                    self._to.log(f"{_path(view.fingers[finger])}/taxels", on_finger)
                above = [[places[:, 0].mean(), places[:, 1].min() - 3.0]]
                heading = rr.Points2D(above, radii=0.01, labels=[what], colors=(255, 255, 255))
                self._to.log(f"/taxels/{name}/{what}_title", heading, static=True)


def _rgb(colours: Sequence[str]) -> list[tuple[int, ...]]:
    """Return colours such as `#ff8000` as numbers."""
    return [tuple(bytes.fromhex(colour[1:])) for colour in colours]


def _table_corners(table: Plane, points: Float32) -> Float64:
    """Return (4, 3) float64 [m]: corners of the part of the table under and around (N, 3) points."""
    u = np.cross(table.normal, np.eye(3)[np.argmin(np.abs(table.normal))])
    u /= np.linalg.norm(u)
    v = np.cross(table.normal, u)
    base = -table.offset * table.normal
    places = (points - base) @ np.column_stack([u, v])
    (u0, v0), (u1, v1) = places.min(axis=0) - _TABLE_MARGIN_M, places.max(axis=0) + _TABLE_MARGIN_M
    return np.array([base + a * u + b * v for a, b in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))])


def _path(finger: str) -> str:
    return f"/scene/{finger.replace(' ', '_')}"


def _points(cloud: Cloud | None) -> tuple[Float32, Any]:
    """Return (N, 3) float32 points [m] with depth, thinned evenly, and their colours: the camera's, else by depth."""
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
    """Return the answer in Markdown."""
    prediction, value = step.prediction, step.value
    lines = [f"**{step.name}**"]
    if step.grasp is not None:
        lines.append(f"grasp {1e3 * step.grasp.width_m:.0f} mm wide, {len(step.candidates)} other candidates")
    if prediction is not None and value is not None:
        flags = f", **{', '.join(prediction.flags)}**" if prediction.flags else ""
        lines.append(f"predicted by {step.model or 'an unnamed model'}, adapted to: {prediction.reference}{flags}")
    else:
        reason = step.reason or (prediction.reason if prediction is not None else "")
        lines.append(f"not predicted: {reason}" if reason else "not predicted")
    for k, finger in enumerate(view.fingers if view.sensor.scalar_channels else ()):
        for what, touch in (("predicted", value), ("read", step.read)):
            if touch is not None:
                lines.append(f"{finger} {what}: {view.scalars(k, touch, prediction if what == 'predicted' else None)}")
    return "\n\n".join(lines)


def _eye(step: ViewStep) -> Any:
    """Return where the scene is seen from: across the closing line, with the table below; None without a table or a grasp."""
    import rerun.blueprint as rrb

    if step.table is None or step.grasp is None:
        return None
    up = step.table.towards_camera.normal
    beside = np.cross(up, step.grasp.g1 - step.grasp.g2)
    beside = beside / max(float(np.linalg.norm(beside)), 1e-9)
    place = step.grasp.midpoint + _EYE_M * (0.8 * beside + 0.6 * up)
    return rrb.EyeControls3D(position=place, look_target=step.grasp.midpoint, eye_up=up)


def _layout(view: TaxelView, first: ViewStep, *, with_scene: bool, with_image: bool) -> Any:
    """Return the image and the scene with the answer, beside the curves and the taxels of each finger."""
    import rerun.blueprint as rrb

    columns = []
    for number, (name, finger) in enumerate(zip(view.sensor.channels.fingers, view.fingers, strict=True)):
        curves = [
            rrb.TimeSeriesView(
                origin=f"/touch/{channel.name}_{name}",
                name=f"{finger}: {'mean ' if channel is view.channel else ''}{channel.name} [{channel.unit}]",
                plot_legend=rrb.PlotLegend(visible=number == 0 and place == 0),
            )
            for place, channel in enumerate((*view.sensor.scalar_channels, view.channel))
        ]
        title = f"{finger}: {view.channel.name} of taxels"
        taxels = rrb.Spatial2DView(origin=f"/taxels/{name}", name=title, background=_rgb([SKIN])[0])
        columns.append(rrb.Vertical(*curves, taxels))
    answer = rrb.TextDocumentView(origin="/answer", name="answer")
    scene = rrb.Spatial3DView(origin="/scene", name="scene", line_grid=False, eye_controls=_eye(first))
    views = [rrb.Spatial2DView(origin="/image", name="camera")] * with_image + [scene] * with_scene
    left = rrb.Vertical(*views, answer, row_shares=[*[3] * len(views), 2])
    return rrb.Blueprint(
        rrb.Horizontal(left, *columns, column_shares=[1 + with_scene, *[1] * len(columns)]),
        rrb.TimePanel(state="collapsed", timeline="step", fps=5.0, play_state="paused"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )


def save_screenshot(recording: Path, path: Path) -> None:
    """Draw the first step of a Rerun recording to a PNG, without a window.

    A `ForetouchError` if the file cannot be written, Rerun draws nothing, or it or a graphics driver (Vulkan) is absent.
    """
    with _viewer_environment() as environment, tempfile.TemporaryDirectory(prefix="foretouch-view-") as folder:
        printed, drawn = Path(folder) / "printed.txt", Path(folder) / "drawn.png"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = int(free.getsockname()[1])
        command = [*_viewer(port), "--headless", "--window-size", "1200x760", recording]
        with os.fdopen(open_own(printed, os.O_WRONLY), "wb") as output:
            viewer = subprocess.Popen(command, env=environment, stdout=output, stderr=output)  # noqa: S603  Rerun's own
        try:
            _draw(viewer, port, drawn)
        finally:
            viewer.kill()
            viewer.wait()
        if not drawn.is_file():
            said = read_bytes(printed).decode("utf-8", "replace")
            if any(text in said for text in _NO_GRAPHICS):
                raise MissingDependencyError(
                    "--screenshot: Rerun finds no graphics driver (Vulkan): apt install libvulkan1 mesa-vulkan-drivers"
                )
            raise ForetouchError(f"--screenshot: Rerun has drawn nothing within {_SCREENSHOT_S:.0f} s")
        replace_files({path: read_bytes(drawn)})


def _draw(viewer: subprocess.Popen[bytes], port: int, path: Path) -> None:
    """Wait until a viewer has loaded its recording, and let it draw; without a file if it ended or took too long."""
    from rerun.experimental import ViewerClient

    end = time.monotonic() + _SCREENSHOT_S
    client: ViewerClient | None = None
    while viewer.poll() is None and time.monotonic() < end:
        with suppress(RuntimeError, ConnectionError, ValueError):  # until it answers
            client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            state = client.get_state()
            if state.active_recording is not None and state.recordings[0].timelines and not state.loading:
                client.set_time("step", sequence=0, play_state="paused")
                time.sleep(5.0)  # until all is drawn, and the viewer's note at its start is gone
                client.save_screenshot(str(path))
                return
        time.sleep(_POLL_S)


def open_viewer(recording: Path) -> None:
    """Show a Rerun recording in a window, and wait until it is closed.

    A `ForetouchError` if Rerun is not installed, or the viewer ends with an error, as it does without a display.
    """
    with _viewer_environment() as environment:
        done = subprocess.run(  # noqa: S603  Rerun's own viewer
            [*_viewer(), recording], env=environment, stderr=subprocess.PIPE, text=True, errors="replace", check=False
        )
    if done.returncode:
        cause = next(iter(done.stderr.strip().splitlines()), "no message")
        raise ForetouchError(f"Rerun cannot open a window ({cause}): write a file with --save F.rrd instead")


def _viewer(port: int | None = None) -> list[str | Path]:
    """Return the command that starts Rerun's viewer, which else would listen on all addresses."""
    module = find_spec("rerun_cli")
    if module is None or module.origin is None:
        raise MissingDependencyError("Rerun is not installed: pip install 'foretouch[view]'")
    return [Path(module.origin).with_name("rerun"), "--bind", "127.0.0.1", "--port", str(port or "auto")]


@contextmanager
def _viewer_environment() -> Iterator[dict[str, str]]:
    """Set variables with which Rerun sends no usage statistics; the settings of the user stay as they are."""
    with tempfile.TemporaryDirectory(prefix="foretouch-rerun-") as folder:
        environment = {**os.environ, "XDG_CONFIG_HOME": folder, "XDG_DATA_HOME": folder, "RERUN_APP_ONLY": "true"}
        done = subprocess.run(  # noqa: S603  Rerun's own viewer
            [_viewer()[0], "analytics", "disable"], env=environment, capture_output=True, check=False, timeout=30.0
        )
        if done.returncode:
            raise ForetouchError("Rerun cannot turn its usage statistics off, so it is not started")
        yield environment

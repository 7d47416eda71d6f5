# SPDX-License-Identifier: Apache-2.0
"""The unrolled fingertip: the one drawing of predicted and read taxels in all pictures; and the taxels of a described sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.report.panels import (
    FAINT,
    FINGER_COLOURS,
    INK,
    PAGE_INCH,
    SKIN,
    SMALL_PT,
    TEXT_PT,
    Axes,
    finger_colour,
    new_figure,
    save,
)
from foretouch.tactile.channels import finger_label
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Bool, Float64, Prediction, Touch

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import FigureBase
from pathlib import Path

from foretouch.tactile.description import Sensor

_DISC: Final = 0.38  # radius, of the distance between neighbours
_RING: Final = 0.32  # width of the widest ring, of the same
_BEYOND: Final = 2.0  # percent of the levels
_SQUARE: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
_PAD: Final = 0.7  # of the skin beyond the taxels, of the same
_CIRCLE: Final = np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)])
_NUMBERED: Final = 200  # taxels of which each can have its index beside it


class FingerScale:
    """One scale of colours and of rings, for all fingers of a page.

    A taxel is a disc on the finger's skin, whose colour is its level: pale at rest, purple as by pressing, orange the other way. The
    grey ring around a predicted one is as wide as its 90 % interval. A square is around one that was read outside of its interval, a
    hollow one is dead. The colours end where 2 % of the levels lie beyond.

    Args:
        view: The sensor.
        levels: (N,) levels of the taxels of each finger that is drawn.
        halves: (N,) half widths of their intervals, of those that have some.
        tared: Whether levels are changes from rest.
    """

    def __init__(
        self, view: TaxelView, levels: Sequence[Float64], halves: Sequence[Float64] = (), *, tared: bool
    ) -> None:
        from scipy.spatial import cKDTree

        self.view, self.tared = view, tared
        known = np.concatenate([[], *levels])
        colours, low, high = level_colours(view, known, tared=tared)
        self.colours: dict[str, Any] = {"cmap": colours, "clim": (low, high)}
        self.widest = max((float(half.max()) for half in halves if half.size), default=0.0)
        self.marks: set[str] = set()  # which marks were drawn
        self._places = 1e3 * view.sensor.layout.unrolled  # [mm]
        self._pitch = float(np.median(cKDTree(self._places).query(self._places, 2)[0][:, 1]))
        self._skin = _skin_around(self._places, self._pitch)

    def draw(
        self, axes: Axes, finger: int, levels: Float64, *, half: Float64 | None = None, outside: Bool | None = None
    ) -> None:
        """Draw one fingertip as its skin is seen from outside, unrolled, with the tip up.

        Args:
            axes: Where to draw.
            finger: Index of the finger.
            levels: (N,) level of each taxel.
            half: (N,) half widths of their intervals; None for none.
            outside: (N,) taxels that get a square around them; None for none.
        """
        self.draw_skin(axes, finger)
        valid = self.view.sensor.valid[finger]
        radius = _DISC * self._pitch
        if half is not None and self.widest > 0.0:
            ring = radius + _RING * self._pitch * half[valid] / self.widest
            self._discs(axes, self._places[valid], ring, facecolors=FAINT)
        discs = self._discs(axes, self._places[valid], radius, edgecolors=INK, cmap=self.colours["cmap"])
        discs.set_array(levels[valid])
        discs.set_clim(*self.colours["clim"])
        if not valid.all():
            self.marks.add("hollow: dead")
            self._discs(axes, self._places[~valid], radius, facecolors="none", edgecolors=INK)
        if outside is not None and (outside & valid).any():
            self.marks.add("square: read outside of the predicted interval")
            for place in self._places[outside & valid]:
                axes.plot(*(place + 1.5 * radius * _SQUARE).T, color=INK, linewidth=1.5)

    def draw_skin(self, axes: Axes, finger: int) -> None:
        """Draw one fingertip without its taxels."""
        axes.fill(*self._skin.T, facecolor=SKIN, linewidth=0.0)
        axes.plot(*self._skin.T, color=finger_colour(finger), linewidth=2.0)  # open where the finger goes on
        axes.set(aspect="equal", anchor="N")
        axes.set_axis_off()
        axes.margins(0.03)

    @staticmethod
    def _discs(axes: Axes, places: Float64, radius: Any, **style: Any) -> Any:
        """Draw circles of a radius [mm] each."""
        from matplotlib.collections import EllipseCollection

        across = np.broadcast_to(2.0 * np.asarray(radius), len(places))
        discs = EllipseCollection(across, across, np.zeros(len(places)), units="xy", offsets=places,
                                  offset_transform=axes.transData, linewidths=0.6, **style)  # fmt: skip
        return axes.add_collection(discs)

    def add_bar(self, figure: FigureBase, axes: Any, **options: Any) -> None:
        """Add the scale of colours below axes, with what the marks mean; after the fingers were drawn."""
        from matplotlib.cm import ScalarMappable

        scale: ScalarMappable = ScalarMappable(cmap=self.colours["cmap"])
        scale.set_clim(*self.colours["clim"])
        bar = figure.colorbar(scale, ax=axes, orientation="horizontal", extend="both", **options)
        bar.outline.set_linewidth(0.5)
        bar.ax.tick_params(labelsize=SMALL_PT)
        bar.ax.locator_params(nbins=6)
        bar.set_label(self.label(), fontsize=SMALL_PT)

    def label(self) -> str:
        """Return what stands at the scale of colours."""
        unit = f" {self.view.channel.unit}" if self.view.channel.unit else ""
        widest = self.view.channel.text(self.widest)
        ring = [f"grey ring: 90 % interval, the widest ±{widest}{unit}"] if self.widest > 0.0 else []
        scalars = [f"{channel.name}: the whole finger" for channel in self.view.sensor.scalar_channels]
        names = [", ".join([f"{self.view.channel.name}: each taxel", *scalars])] if scalars else []
        marks = "; ".join([*ring, *sorted(self.marks)])
        return "\n".join(filter(None, (self.view.label(from_rest=self.tared), *names, marks)))


def level_colours(view: TaxelView, known: Float64, *, tared: bool) -> tuple[str, float, float]:
    """Return the palette of levels, and the levels of its ends: pale at rest where they are changes, else dark where contact is strong."""
    colours = "magma_r" if view.channel.contact > 0 else "magma"
    if not known.size:
        return ("PuOr", -1.0, 1.0) if tared else (colours, 0.0, 1.0)
    if tared:
        high = float(np.nanpercentile(np.abs(known), 100.0 - _BEYOND))
        return "PuOr", -high, high
    low, high = map(float, np.nanpercentile(known, [_BEYOND, 100.0 - _BEYOND]))
    return colours, low, high


def _skin_around(places: Float64, pitch: float) -> Float64:
    """Return (K, 2) the outline of a fingertip around taxels (N, 2), with a round tip, from the left of its lower end to the right [mm]."""
    from scipy.spatial import ConvexHull

    low, high = places.min(axis=0) - _PAD * pitch, places.max(axis=0) + _PAD * pitch
    middle, half = (low[0] + high[0]) / 2.0, (high[0] - low[0]) / 2.0
    tip = [middle, high[1] - 0.6 * half] + _CIRCLE[_CIRCLE[:, 1] >= 0.0] * [half, 0.8 * half]
    end = [[middle + side * 0.96 * half, low[1] - 0.05 * half] for side in (-1.0, 1.0)]
    points = np.concatenate([(places[:, None] + pitch * _PAD * _CIRCLE).reshape(-1, 2), tip, end])
    outline = points[ConvexHull(points).vertices]  # counter-clockwise
    first = int(np.lexsort((outline[:, 0], outline[:, 1].round(6)))[0])
    ordered: Float64 = np.roll(outline, -first - 1, axis=0)[::-1]
    return ordered


def finger_levels(
    view: TaxelView, prediction: Prediction, rest: Touch | None, finger: int
) -> tuple[Float64, Float64 | None]:
    """Return (N,) predicted levels of a finger's taxels, and half widths of their intervals; None without."""
    levels: Float64 = view.levels(prediction.value.values, rest, finger)
    if not prediction.calibrated:
        return levels, None
    columns = view.columns(finger)
    return levels, (prediction.upper.values[columns] - prediction.lower.values[columns]) / 2.0


def title_finger(axes: Axes, scale: FingerScale, finger: int, scalars: str, what: str = "") -> None:
    """Write above a finger what is shown, if it is said here, which finger it is, and its scalars."""
    name = scale.view.fingers[finger]
    title = f"{name}\n{scalars}".rstrip()
    axes.set_title(title, color=finger_colour(finger), fontsize=SMALL_PT, pad=3.0)
    if what:
        axes.annotate(what, (0.5, 1.0), (0.0, 3.0 + (1.5 * title.count("\n") + 1.6) * SMALL_PT), "axes fraction", "offset points", color=INK,
                      fontsize=TEXT_PT, fontweight="bold", ha="center", va="bottom")  # fmt: skip


def _draw_flat(axes: Axes, sensor: Sensor, finger: str, dead: list[int]) -> None:
    """Draw the taxels with their indices as they are seen from outside, dead ones hollow."""
    places, facing = 1e3 * sensor.layout.positions, sensor.layout.normals.mean(axis=0)
    depth = int(np.abs(facing).argmax())
    right, up = (axis for axis in range(3) if axis != depth)
    hollow = np.isin(np.arange(len(places)), dead)
    axes.scatter(places[~hollow, right], places[~hollow, up], color=FINGER_COLOURS[1])
    axes.scatter(places[hollow, right], places[hollow, up], facecolors="none", edgecolors="grey")
    for index, place in enumerate(places if len(places) <= _NUMBERED else ()):
        axes.annotate(
            str(index), (place[right], place[up]), xytext=(4, 4), textcoords="offset points", fontsize=SMALL_PT
        )
    flat, along = places[:, [right, up]], sensor.layout.unrolled[:, 1]
    way = (flat - flat.mean(axis=0)).T @ (along - along.mean())  # to the tip
    way = way / max(float(np.abs(way).max()), 1e-12)
    title = f"{finger} from outside; hollow: dead" if finger else "from outside"
    axes.set(aspect="equal")
    axes.set_xlabel(f"{'xyz'[right]} [mm]", fontsize=SMALL_PT)
    axes.set_ylabel(f"{'xyz'[up]} [mm]", fontsize=SMALL_PT)
    axes.set_title(title, fontsize=TEXT_PT)
    axes.tick_params(labelsize=SMALL_PT)
    axes.margins(0.1)
    if (facing[depth] < 0.0) != (depth == 1):  # x and z are seen from -y
        axes.invert_xaxis()
        way = way * [-1.0, 1.0]
    arrow = {"arrowstyle": "-|>", "color": INK, "lw": 1.5}
    axes.annotate("", 0.5 + 0.49 * way, 0.5 + 0.36 * way, "axes fraction", "axes fraction", arrowprops=arrow)
    axes.annotate("tip", 0.5 + 0.33 * way, xycoords="axes fraction", fontsize=TEXT_PT, ha="center", va="center")


def save_sensor_figure(sensor: Sensor, path: Path) -> Path:
    """Draw the taxels with their indices from outside, and their normals in space; returns the path, errors as `save`.

    Dead taxels are hollow; each finger that has some is drawn on its own.
    """
    config = sensor.config
    places = 1e3 * sensor.layout.positions
    normals = sensor.layout.normals
    dead = {finger.name: list(finger.dead) for finger in config.fingers if finger.dead} or {"": []}
    panels = len(dead) + 1
    figure = new_figure(PAGE_INCH / 2.0 * panels, 4.2)
    figure.set_layout_engine("none")  # axes in space have no room for it
    space = figure.add_subplot(1, panels, panels, projection="3d")
    for number, (finger, indices) in enumerate(dead.items(), 1):
        _draw_flat(figure.add_subplot(1, panels, number), sensor, finger, indices)
    length = max(float(np.ptp(places, axis=0).max()), 1.0) / 8.0  # of a normal [mm]
    space.scatter(*places.T, color=FINGER_COLOURS[1])
    space.scatter(*(places + length * normals).T, s=0.0)  # so that the axes reach there
    space.quiver(*places.T, *normals.T, length=length, color="grey")
    space.locator_params(nbins=4)
    space.locator_params(axis="z", nbins=2)
    for set_label, axis in ((space.set_xlabel, "x"), (space.set_ylabel, "y"), (space.set_zlabel, "z")):
        set_label(f"{axis} [mm]", fontsize=SMALL_PT)
    space.set_title("outward normals", fontsize=TEXT_PT)
    space.tick_params(labelsize=SMALL_PT)
    space.set_box_aspect(np.ptp([space.get_xlim(), space.get_ylim(), space.get_zlim()], axis=1), zoom=0.98)
    values = ", ".join(f"{value.name} [{value.unit}]" for value in config.values)
    fingers = ", ".join(finger_label(finger.name) for finger in config.fingers)
    figure.suptitle(f"{config.name} on {fingers}: each of its {sensor.size} taxels reads {values}", fontsize=TEXT_PT)
    return save(figure, path)

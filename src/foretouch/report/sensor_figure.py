# SPDX-License-Identifier: Apache-2.0
"""A picture of the taxels of a described sensor, with their normals."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from foretouch.report.panels import new_figure, save
from foretouch.tactile.description import Sensor

_NUMBERED: Final = 200  # taxels of which each can have its index beside it


def _draw_flat(axes: Axes, sensor: Sensor, finger: str, dead: list[int]) -> None:
    """Draw the taxels with their indices as they are seen from outside, dead ones hollow."""
    places, facing = 1e3 * sensor.layout.positions, sensor.layout.normals.mean(axis=0)
    depth = int(np.abs(facing).argmax())
    right, up = (axis for axis in range(3) if axis != depth)
    hollow = np.isin(np.arange(len(places)), dead)
    axes.scatter(places[~hollow, right], places[~hollow, up])
    axes.scatter(places[hollow, right], places[hollow, up], facecolors="none", edgecolors="grey")
    for index, place in enumerate(places if len(places) <= _NUMBERED else ()):
        axes.annotate(str(index), (place[right], place[up]), xytext=(4, 4), textcoords="offset points", fontsize=8)
    title = f"{finger} from outside; hollow: dead" if finger else "from outside"
    axes.set(title=title, xlabel=f"{'xyz'[right]} [mm]", ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    axes.margins(0.1)
    if (facing[depth] < 0.0) != (depth == 1):  # x and z are seen from -y
        axes.invert_xaxis()


def save_sensor_figure(sensor: Sensor, path: Path) -> Path:
    """Draw the taxels with their indices from outside, and their normals in space; returns the path, errors as `save`.

    Dead taxels are hollow; each finger that has some is drawn on its own.
    """
    config = sensor.config
    places = 1e3 * sensor.layout.positions
    normals = sensor.layout.normals
    dead = {finger.name: list(finger.dead) for finger in config.fingers if finger.dead} or {"": []}
    panels = len(dead) + 1
    figure = new_figure(5.5 * panels, 5.5)
    space = figure.add_subplot(1, panels, panels, projection="3d")
    for number, (finger, indices) in enumerate(dead.items(), 1):
        _draw_flat(figure.add_subplot(1, panels, number), sensor, finger, indices)
    length = max(float(np.ptp(places, axis=0).max()), 1.0) / 8.0  # of a normal [mm]
    space.scatter(*places.T)
    space.scatter(*(places + length * normals).T, s=0.0)  # so that the axes reach there
    space.quiver(*places.T, *normals.T, length=length, color="grey")
    space.locator_params(axis="z", nbins=3)
    space.set(title="outward normals", xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    space.set_box_aspect(np.ptp([space.get_xlim(), space.get_ylim(), space.get_zlim()], axis=1), zoom=0.75)
    values = ", ".join(f"{value.name} [{value.unit}]" for value in config.values)
    fingers = ", ".join(finger.name for finger in config.fingers)
    figure.suptitle(f"{config.name}: {sensor.size} taxels with {values}, on {fingers}")
    return save(figure, path)

# SPDX-License-Identifier: Apache-2.0
"""A picture of the taxels of a described sensor, with their normals."""

from pathlib import Path
from typing import Final

import numpy as np

from foretouch.report.panels import new_figure, save
from foretouch.tactile.description import Sensor

_NUMBERED: Final = 200  # taxels of which each can have its index beside it


def save_sensor_figure(sensor: Sensor, path: Path) -> Path:
    """Draw the taxels with their indices from outside, and their normals in space; returns the path, errors as `save`."""
    config, places, normals = sensor.config, 1e3 * sensor.layout.positions, sensor.layout.normals
    figure = new_figure(11.0, 5.5)
    flat, space = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    facing = normals.mean(axis=0)
    depth = int(np.abs(facing).argmax())
    right, up = (axis for axis in range(3) if axis != depth)
    flat.scatter(places[:, right], places[:, up])
    for index, place in enumerate(places if len(places) <= _NUMBERED else ()):
        flat.annotate(str(index), (place[right], place[up]), xytext=(4, 4), textcoords="offset points", fontsize=8)
    flat.set(title="from outside", xlabel=f"{'xyz'[right]} [mm]", ylabel=f"{'xyz'[up]} [mm]", aspect="equal")
    flat.margins(0.1)
    if (facing[depth] < 0.0) != (depth == 1):  # x and z are seen from -y
        flat.invert_xaxis()
    length = max(float(np.ptp(places, axis=0).max()), 1.0) / 8.0  # of a normal [mm]
    space.scatter(*places.T)
    space.scatter(*(places + length * normals).T, s=0.0)  # so that the axes reach there
    space.quiver(*places.T, *normals.T, length=length, color="grey")
    space.locator_params(axis="z", nbins=3)
    space.set(title="outward normals", xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    space.set_box_aspect(np.ptp([space.get_xlim(), space.get_ylim(), space.get_zlim()], axis=1), zoom=0.75)
    values = ", ".join(f"{one.name} [{one.unit}]" for one in config.values)
    fingers = ", ".join(finger.name for finger in config.fingers)
    figure.suptitle(f"{config.name}: {sensor.size} taxels with {values}, on {fingers}")
    return save(figure, path)

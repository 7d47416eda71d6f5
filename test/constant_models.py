# SPDX-License-Identifier: Apache-2.0
"""Models of any described sensor that predict the same for every grasp: how a prediction travels does not depend on it."""

from typing import Any

import numpy as np

from foretouch.models.predictor import Estimate
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import Ranges
from foretouch.tactile.description import Sensor, packaged_sensor, sensor_of, with_sensor


class ConstantEstimator:
    """Predicts some values for every grasp, and that all are in distribution."""

    def __init__(self, sensor: Sensor, values: np.ndarray) -> None:
        self.ranges = Ranges.of_sensor(sensor.channels)
        self._values = values

    def estimate(self, _cloud: Any, grasps: Any, _table: Any = None) -> Estimate:
        return Estimate(np.tile(self._values, (len(grasps), 1)), np.ones(len(grasps), np.bool_))


def constant_model(sensor: Sensor, values: np.ndarray, calibration: Any = None) -> TouchModel:
    """A model whose card names the sensor."""
    card = with_sensor({"name": "constant", "sha256": "0" * 64}, sensor)
    return TouchModel(ConstantEstimator(sensor, values), card, calibration)


def sensor_with_dead(name: str, *dead: int) -> Sensor:
    """A packaged description with dead taxels on its first grasping finger."""
    stated = packaged_sensor(name).to_mapping()
    first = packaged_sensor(name).channels.fingers[0]
    fingers = [{**one, "dead": list(dead)} if one["name"] == first else one for one in stated["fingers"]]
    return sensor_of({**stated, "fingers": fingers}, name)


def counted(sensor: Sensor) -> np.ndarray:
    """(D,) values that are all different, within the range of each channel."""
    low, high = sensor.channels.low, sensor.channels.high
    return low + (high - low) * (np.arange(sensor.channels.size) + 1.0) / (sensor.channels.size + 2.0)

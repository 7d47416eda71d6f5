# SPDX-License-Identifier: Apache-2.0
"""Makes the decoder of a type of tactile messages."""

from collections.abc import Callable

from foretouch.errors import ConfigError
from foretouch.tactile.messages import biotac, described
from foretouch.tactile.messages.table import TactileConfig, TactileReader

#: By message type; a sensor with a description needs none.
READERS: dict[str, Callable[[TactileConfig], TactileReader]] = {
    "foretouch_msgs/BiotacAll": biotac.make_reader,
    "sr_robot_msgs/BiotacAll": biotac.make_reader,
    "std_msgs/String": biotac.make_reader,
    "tactile_msgs/TactileState": biotac.make_reader,
}


def make_reader(config: TactileConfig) -> TactileReader:
    """Make the decoder for the settings.

    Raises:
        ConfigError: If the type or the sensor has no finger of that name, both are the same, or the description is faulty.
    """
    thumb, middle = config.fingers
    if thumb == middle:
        raise ConfigError(f"middle: {middle!r} is the thumb already")
    return described.make_reader(config) if config.sensor else READERS[config.type](config)

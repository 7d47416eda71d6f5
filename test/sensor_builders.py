# SPDX-License-Identifier: Apache-2.0
"""A small sensor, and messages of XELA's server made and read by rosbags, as from a bag or from DDS."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SMALL: dict[str, Any] = {
    "name": "small",
    "fingers": [{"name": "left", "field": "pads[0]"}, {"name": "right", "field": "pads[1]"}],
    "array": {"rows": 2, "cols": 3, "size": [0.004, 0.002]},
    "values": [{"name": "p", "field": "pressures", "unit": "Pa"}],
    "source": {"type": "lab_msgs/Pads"},
}
TAXELS = "index,x,y,z,nx,ny,nz\n1,0.001,0,0,0,0,1\n0,0,0,0,0,0.6,0.8\n"

XELA_TYPES = {
    "xela_server_ros2/msg/Taxel": "uint16 x\nuint16 y\nuint16 z\n",
    "xela_server_ros2/msg/Forces": "float32 x\nfloat32 y\nfloat32 z\n",
    "xela_server_ros2/msg/SensorFull": "uint32 message\nfloat64 time\nstring model\nuint8 sensor_pos\nxela_server_ros2/Taxel[] taxels\n"
    "xela_server_ros2/Forces[] forces\n",
    "xela_server_ros2/msg/SensStream": "xela_server_ros2/SensorFull[] sensors\n",
}  # as xela_server_ros2 defines them


def write_sensor(folder: Path, changes: dict[str, Any] | None = None, taxels: str = TAXELS) -> Path:
    """The small sensor with changed settings, None for one that is left out; `taxels.csv` lies beside it."""
    mapping = {key: value for key, value in {**SMALL, **(changes or {})}.items() if value is not None}
    (folder / "taxels.csv").write_text(taxels, encoding="utf-8")
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def sens_stream(
    counts: np.ndarray, positions: tuple[int, ...] = (1, 2), time_s: float = 1_700_000_000.25, kinds: Any = None
) -> Any:
    """A `SensStream` of (sensors, taxels, 3) uint16 counts, made of `kinds`: classes by name, by default plain objects."""
    make = kinds or dict.fromkeys(("Taxel", "SensorFull", "SensStream"), SimpleNamespace)
    taxels = [[make["Taxel"](**dict(zip("xyz", map(int, one), strict=True))) for one in own] for own in counts]
    sensors = [
        make["SensorFull"](message=7, time=time_s, model="uSPa44", sensor_pos=position, taxels=own, forces=[])
        for position, own in zip(positions, taxels, strict=True)
    ]
    return make["SensStream"](sensors=sensors)


def xela_message(counts: np.ndarray, positions: tuple[int, ...] = (1, 2), time_s: float = 1_700_000_000.25) -> Any:
    """A `SensStream` after a trip through its serialised bytes; counts (sensors, taxels, 3) uint16."""
    store = get_typestore(Stores.ROS2_KILTED)
    for name, text in XELA_TYPES.items():
        store.register(get_types_from_msg(text, name))
    name = "xela_server_ros2/msg/SensStream"
    return store.deserialize_cdr(store.serialize_cdr(sens_stream(counts, positions, time_s), name), name)


XELA_REST = 30_000 + 10 * np.arange(96).reshape(2, 16, 3)
"""Counts of two sensors with 16 taxels at rest."""


def xela_counts(level: int) -> np.ndarray:
    """In contact: z rises by `level`, and x of the second sensor by half as much."""
    found = XELA_REST.copy()
    found[..., 2] += level
    found[1, :, 0] += level // 2
    return found


def xela_stream(change: Callable[[np.ndarray], np.ndarray] = np.asarray) -> Callable[[int, int], tuple[str, Any]]:
    """Type and content of a message by its time [ns] and level, for `write_topics`, with changed counts."""

    def message(at_ns: int, level: int) -> tuple[str, Any]:
        return "xela_server_ros2/msg/SensStream", sens_stream(change(xela_counts(level)), (1, 2), at_ns * 1e-9)

    return message

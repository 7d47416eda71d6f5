# SPDX-License-Identifier: Apache-2.0
"""A small sensor, and messages of XELA's server made and read by rosbags, as from a bag or from DDS."""

from pathlib import Path
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

_XELA = {
    "Taxel": "uint16 x\nuint16 y\nuint16 z\n",
    "Forces": "float32 x\nfloat32 y\nfloat32 z\n",
    "SensorFull": "uint32 message\nfloat64 time\nstring model\nuint8 sensor_pos\nxela_server_ros2/Taxel[] taxels\n"
    "xela_server_ros2/Forces[] forces\n",
    "SensStream": "xela_server_ros2/SensorFull[] sensors\n",
}  # as xela_server_ros2 defines them


def write_sensor(folder: Path, changes: dict[str, Any] | None = None, taxels: str = TAXELS) -> Path:
    """The small sensor with changed settings, None for one that is left out; `taxels.csv` lies beside it."""
    mapping = {key: value for key, value in {**SMALL, **(changes or {})}.items() if value is not None}
    (folder / "taxels.csv").write_text(taxels)
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def xela_message(counts: np.ndarray, positions: tuple[int, ...] = (1, 2), time_s: float = 1_700_000_000.25) -> Any:
    """A `SensStream` after a trip through its serialised bytes; counts (sensors, taxels, 3) uint16."""
    store = get_typestore(Stores.ROS2_KILTED)
    for name, text in _XELA.items():
        store.register(get_types_from_msg(text, f"xela_server_ros2/msg/{name}"))
    kinds = {name: store.types[f"xela_server_ros2/msg/{name}"] for name in _XELA}
    sensors = [
        kinds["SensorFull"](7, time_s, "uSPa44", position, [kinds["Taxel"](*map(int, one)) for one in own], [])
        for position, own in zip(positions, counts, strict=True)
    ]
    name = "xela_server_ros2/msg/SensStream"
    return store.deserialize_cdr(store.serialize_cdr(kinds["SensStream"](sensors), name), name)

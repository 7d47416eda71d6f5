# SPDX-License-Identifier: Apache-2.0
"""Write the grasps of imanlab/tactile_prediction_flat_dataset (no licence stated) to a dataset: pick and move with two XELA uSkin.

    python examples/import_xela_uskin.py tactile_prediction_flat_dataset grasps

A folder is a grasp, of tables with a row for each reading, in some one more. Stamps follow from the rate that it states, in UTC.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

import foretouch as ft


def grasps(source: Path) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each grasp."""
    for folder in sorted(source.glob("*/data_sample_*")):
        about = pd.read_csv(folder / "meta_data.csv").iloc[0]
        robot, marker = (pd.read_csv(folder / f"{name}.csv") for name in ("robot_state", "marker"))
        pads = {f"S{k}": pd.read_csv(folder / f"xela_sensor{k}.csv")[: len(robot)] for k in (1, 2)}
        axes = {f"{a.upper()}_{name}": [f"txl{k}_{a}" for k in range(1, 17)] for a in "xyz" for name in pads}
        others = pd.concat([robot, marker[: len(robot)]], axis=1)
        others = dict(others.filter(regex="^(position|velocity)_panda|^ee_state_position_|^marker.*position"))
        yield {"object": f"object_{about.object_name}", "id": folder.name.removeprefix("data_sample_"), "rest": 20,
               "values": {key: pads[key[2:]][columns] for key, columns in axes.items()}, "others": others,
               "rate_hz": float(about.frequency_hz), "start_s": pd.Timestamp(about.start_time).timestamp(),
               "outcome": not about.dropped, "note": f"{folder.relative_to(source)}/xela_sensor1.csv, row 1"}  # fmt: skip


source, out = map(Path, sys.argv[1:])
print(ft.write(out, grasps(source), "xela_uskin_4x4_raw"))

# SPDX-License-Identifier: Apache-2.0
"""Write the grasps of OSU-RAD-Lab/Tactile_Grasp_Dataset (no licence stated) to a dataset: seven taxels on each of two fingers.

    python examples/import_osu_grasps.py Tactile_Grasp_Dataset grasps

A folder is a grasp, named by its start in unix time. The first 60 readings are at rest, as in the code of its authors.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

import foretouch as ft


def grasps(source: Path) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each grasp."""
    for file in sorted(source.glob("Data/*/*/*/*/*/*/*/gripper_tactor_tactor_data.csv")):
        _, shape, size, stiffness, *_, start = file.relative_to(source).parts[:-1]
        table = pd.read_csv(file)
        values = {f"T_{name}": table[[f"{name}{k}" for k in range(7)]] for name in "LR"}
        label = file.with_name("grasp_outcome.txt")
        outcome = {"SUCCESS": True, "FAILURE": False}[label.read_text().strip()] if label.exists() else None
        yield {"object": f"{shape} {size} {stiffness}", "id": start, "values": values, "stamps_s": table["time_s"], "rest": 60,
               "start_s": float(start), "outcome": outcome, "note": f"{file.relative_to(source)}, row 1"}  # fmt: skip


source, out = map(Path, sys.argv[1:])
print(ft.write(out, grasps(source), Path(__file__).parent / "sensors/osu_gripper_7.yaml"))

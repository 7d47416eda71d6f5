# SPDX-License-Identifier: Apache-2.0
"""Write the grasps of clear-nus/icub_grasp_dataset (Harold Soh 2012, free with its copyright note) to a dataset.

    python examples/import_icub_fingertips.py icub_grasp_dataset grasps

A file is a grasp of five fingertips of 12 taxels. A reading has 7 lines: 9 encoders, the largest change of each finger, then
the taxels of each finger. No stamps are stated: 10 Hz is nominal. The hand is open in the first two readings.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import foretouch as ft


def grasps(source: Path) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each grasp."""
    for file in sorted(source.glob("iCubGraspDataset/*.txt")):
        name, _, number = file.stem.rpartition("_")
        rows = np.array(file.read_text().split("\n", 1)[1].split(), float).reshape(-1, 74)
        taxels = rows[:, 14:].reshape(-1, 5, 12)
        values = {f"C_{finger}": taxels[:, k] for k, finger in enumerate(["TH", "FF", "MF", "RF", "LF"])}
        others = {f"f{k}": rows[:, k] for k in range(14)}
        yield {"object": name, "id": number, "values": values, "others": others, "rate_hz": 10.0, "rest": 2,
               "note": f"{file.relative_to(source)}, row 1"}  # fmt: skip


source, out = map(Path, sys.argv[1:])
print(ft.write(out, grasps(source), "icub_fingertip"))

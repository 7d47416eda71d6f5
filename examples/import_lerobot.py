# SPDX-License-Identifier: Apache-2.0
"""Write the episodes of a LeRobot dataset (v3.0) with features of taxels to a dataset: an episode is a grasp, its task the object.

    python examples/import_lerobot.py DATASET grasps

The names of the features are those of a Shadow Hand with BioTac SP; change `NAMES` and the sensor for others.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import foretouch as ft

NAMES = {"PDC_TH": "thumb.pdc", "E_TH": "thumb.electrode", "PDC_MF": "middle_finger", "E_MF": "middle_finger.electrode"}


def grasps(source: Path) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each episode."""
    for file in sorted(source.glob("data/chunk-*/file-*.parquet")):
        for number, table in pd.read_parquet(file, dtype_backend="pyarrow").groupby("episode_index"):
            read = {key: np.array(table[f"observation.tactile.{name}"].tolist()) for key, name in NAMES.items()}
            values = {key: part.reshape(len(table), -1)[:, : 24 if key[0] == "E" else 1] for key, part in read.items()}
            name = {"object": f"task_{table.task_index.iloc[0]}", "id": f"episode_{number}"}
            yield {**name, "values": values, "stamps_ns": table.stamp_ns}


source, out = map(Path, sys.argv[1:])
print(ft.write(out, grasps(source), "biotac_sp"))

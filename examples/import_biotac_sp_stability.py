# SPDX-License-Identifier: Apache-2.0
"""Write the grasps of 3dperceptionlab/biotacsp-stability-set-v2 (MIT licence) to a dataset: 5,831 of three BioTac SP, stable or slip.

    python examples/import_biotac_sp_stability.py biotacsp-stability-set-v2 grasps

A row is a grasp: one reading before the lift, without a stamp and without a pressure.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

import foretouch as ft


def grasps(source: Path) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each grasp."""
    for file in sorted(source.glob("*.csv")):
        table = pd.read_csv(file)
        values = {key: table.filter(regex=f"^{key[2:].lower()}_biotac_").to_numpy() for key in ("E_TH", "E_MF", "E_FF")}
        for k, row in enumerate(table.itertuples()):
            reading = {key: part[k] for key, part in values.items()}
            place = f"{file.name}, row {k + 1}"
            yield {"object": row.object, "values": reading, "outcome": not row.slipped, "note": place}


source, out = map(Path, sys.argv[1:])
print(ft.write(out, grasps(source), Path(__file__).parent / "sensors/biotac_sp_electrodes.yaml"))

# SPDX-License-Identifier: Apache-2.0
"""Write the levels of the default model to the package, from the results of `foretouch tradeoff model --preset full`.

A level's errors are compared with those of the model by modality, on blocks of time and on objects left out; its
intervals are widened by the larger ratio. Levels that another one beats in skill without being slower are left out by
`KEPT`, which was chosen from the picture of that area.
"""

import argparse
import json
from pathlib import Path

from benchmarks.common import ROOT
from foretouch.models import load_model
from foretouch.tactile import MODALITIES
from foretouch_lab.experiments.framework.manifest import read_results

KEPT = ("10 trees", "no surroundings")
TARGET = ROOT / "src/foretouch/models/levels.json"


def entry(row: dict, base: dict) -> dict:
    """Skill and widening of a level."""
    keys = [[f"{split}_rmse_{name}" for split in ("time", "object")] for name in MODALITIES]
    widen = [round(max(1.0, *(row[key] / base[key] for key in both)), 4) for both in keys]
    return {"skill": row["time"], "low": row["time_low"], "high": row["time_high"], "widen": widen}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="tradeoff.csv of the area `model`")
    rows = {row["variant"]: row for row in read_results(parser.parse_args().results)}
    model = load_model()
    base = rows[model.name]
    levels = {name: entry(rows[name], base) for name in (model.name, *KEPT)}
    for name, one in levels.items():
        print(f"{name:30} skill {one['skill']:.3f}  intervals times {one['widen']}")
    content = {model.sha256: {"name": model.name, "levels": levels}}
    TARGET.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(TARGET)


if __name__ == "__main__":
    main()

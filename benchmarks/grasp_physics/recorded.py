# SPDX-License-Identifier: Apache-2.0
"""What does the method of grasping change in the predictions? Both methods on the recorded clouds; docs/concepts.md has the table."""

import argparse
from collections import Counter
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from benchmarks.common import add_data, print_rows
from foretouch.cloud.io.files import read_cloud
from foretouch.grasp.config import GraspMethod
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.tactile import MODALITIES
from foretouch.types import TouchPrediction, assumed_table

METHODS: Final = get_args(GraspMethod)
UNFAMILIAR: Final = "unfamiliar"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--model", default="default", help="name or path of the touch model")
    parser.add_argument("--every", type=int, default=1, help="use each k-th cloud")
    options = parser.parse_args()
    paths = sorted(Path(options.data).glob("vision2tactile/*/*/cloud-object.pcd"))[:: options.every]
    pipelines = {m: Pipeline(PipelineConfig().updated({"grasp.method": m, "model": options.model})) for m in METHODS}
    found: dict[str, list[TouchPrediction | None]] = {method: [] for method in METHODS}
    statuses: dict[str, Counter[str]] = {method: Counter() for method in METHODS}
    for path in paths:
        cloud = read_cloud(path)
        target = FoundObject("1", cloud, assumed_table(cloud))
        for method, pipeline in pipelines.items():
            plan = pipeline.plan(target)
            answers = pipeline.predict(target, plan.grasps)
            found[method].append(answers[0] if plan.grasps and answers[0].value is not None else None)
            statuses[method][plan.status] += 1
    print_rows([_of_method(method, found[method], statuses[method]) for method in METHODS])
    print()
    print_rows(_differences(found))


def _of_method(method: str, answers: list[TouchPrediction | None], statuses: Counter[str]) -> dict[str, Any]:
    """Widths of the grasps, and flags of the predictions."""
    there = [one for one in answers if one is not None]
    widths = [1e3 * float(np.linalg.norm(one.grasp.g1 - one.grasp.g2)) for one in there]
    low, middle, high, most = np.quantile(widths, [0.05, 0.5, 0.95, 1.0])
    return {
        "method": method,
        "statuses": ", ".join(f"{name} {count}" for name, count in statuses.items()),
        "unfamiliar": float(np.mean([UNFAMILIAR in one.flags for one in there])),
        "width 5 %": low,
        "50 %": middle,
        "95 %": high,
        "most [mm]": most,
    }


def _differences(found: dict[str, list[TouchPrediction | None]]) -> list[dict[str, Any]]:
    """By modality: how far the predictions of both methods are apart."""
    rows = []
    for name in MODALITIES:
        counts, halves = [], []
        for one, other in zip(*found.values(), strict=True):
            if one is None or other is None or one.value is None or other.value is None:
                continue
            difference = np.abs(one.value[name] - other.value[name])
            counts.append(difference.mean())
            if one.upper is not None and one.lower is not None:
                halves.append((2.0 * difference / (one.upper[name] - one.lower[name])).mean())
        middle, high = np.quantile(counts, [0.5, 0.95])
        row = {"difference": name, "clouds": len(counts), "50 % [counts]": middle, "95 % [counts]": high}
        rows.append(row | {"50 % [half widths]": np.quantile(halves, 0.5), "95 %": np.quantile(halves, 0.95)})
    return rows


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: Apache-2.0
"""`foretouch predict`: what the fingertips would read for each grasp on each object."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from foretouch.cli.inputs import (
    Record,
    add_input_arguments,
    add_plan_arguments,
    answer_each,
    found_objects,
    grasp_record,
    pipeline_config,
    six_numbers,
)
from foretouch.cli.output import print_table
from foretouch.errors import GraspError

if TYPE_CHECKING:
    from foretouch.dataset.source import SourceItem
    from foretouch.pipeline import FoundObject, Pipeline
    from foretouch.types import Grasp, TouchPrediction

__all__ = ["add_arguments", "run"]

_MODALITIES = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The common inputs, --grasp and --model."""
    add_input_arguments(parser)
    add_plan_arguments(parser)
    parser.add_argument(
        "--grasp",
        type=six_numbers,
        action="append",
        metavar="x1,y1,z1,x2,y2,z2",
        help="contacts [m] (default: GeoGrasp's, or the sample's own)",
    )
    parser.add_argument("--model", help="name of a shipped model, or path of a checkpoint")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cloud or a grasp was refused."""
    from foretouch.pipeline import Pipeline

    changes = {"model": arguments.model} if arguments.model else {}
    pipeline = Pipeline(pipeline_config(arguments, changes))
    model = {"name": pipeline.model.name, "sha256": pipeline.model.sha256}

    def answer(item: SourceItem) -> Iterator[Record]:
        for target in found_objects(item, arguments, pipeline):
            began = time.perf_counter()
            grasps, reason = _grasps(item, target, arguments, pipeline)
            planned = time.perf_counter()
            predictions = pipeline.predict(target, grasps)
            ms = {"grasp": (planned - began) * 1e3, "touch": (time.perf_counter() - planned) * 1e3}
            refused = [one.reason for one in predictions if one.status != "ok"]
            yield {
                **({"sample": item.sample.id} if item.sample is not None else {}),
                "object": target.id,
                "status": "refused" if refused else "ok",
                "reason": "; ".join(refused) or reason,
                "predictions": [prediction_record(one) for one in predictions],
                "model": model,
                "ms": {**ms, "total": sum(ms.values())},
                "failed": not predictions or bool(refused),
            }

    return answer_each(arguments, answer, _show)


def prediction_record(prediction: TouchPrediction) -> Record:
    """One prediction as JSON holds it; values and bounds in counts, bounds null where there is no calibration."""
    columns = {
        "value": prediction.value,
        "lower": prediction.lower,
        "upper": prediction.upper,
    }
    record: Record = {"grasp": grasp_record(prediction.grasp)}
    for name in _MODALITIES:
        record[name] = {key: None if touch is None else getattr(touch, name.lower()) for key, touch in columns.items()}
    return record | {
        "reference": prediction.reference,
        "flags": list(prediction.flags),
        "status": prediction.status,
        "reason": prediction.reason,
    }


def _grasps(
    item: SourceItem, target: FoundObject, arguments: argparse.Namespace, pipeline: Pipeline
) -> tuple[list[Grasp], str]:
    """The grasps to predict for, with a remark: those given, the sample's own, or GeoGrasp's."""
    import numpy as np

    if arguments.grasp:
        pairs = np.array(arguments.grasp, dtype=np.float64).reshape(-1, 2, 3)
        return [pipeline.grasp_between(target, g1, g2) for g1, g2 in pairs], ""
    if item.sample is not None:
        return [item.sample.grasp], ""
    plan = pipeline.plan(target)
    if not plan.grasps:
        raise GraspError(f"{plan.status}: {plan.reason}")
    return list(plan.grasps), plan.reason


def _show(record: dict[str, Any]) -> None:
    rows = []
    for one in record["predictions"]:
        electrodes = [one[name]["value"] for name in ("E_TH", "E_MF")]
        spans = ["refused" if e is None else f"{min(e):.0f}…{max(e):.0f}" for e in electrodes]
        pressures = [one[name]["value"] for name in ("PDC_TH", "PDC_MF")]
        texts = ["refused" if p is None else f"{p:.0f}" for p in pressures]
        rows.append(
            [
                " ".join(f"{v:.3f}" for v in (*one["grasp"]["g1"], *one["grasp"]["g2"])),
                *texts,
                *spans,
                " ".join(one["flags"]),
            ]
        )
    title = f"{record['input']} object {record['object']}: {record['status']} {record['reason']} ({record['model']['name']})"
    print_table(title, ["g1 g2 [m]", "PDC_TH", "PDC_MF", "E_TH", "E_MF", "flags"], rows)

# SPDX-License-Identifier: Apache-2.0
"""`foretouch predict`: predict the tactile readings of each grasp on each object."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from foretouch.cli.adaptation import add_adaptation_arguments, read_adaptation
from foretouch.cli.inputs import (
    Record,
    add_input_arguments,
    add_plan_arguments,
    grasp_record,
    pipeline_config,
    process_inputs,
    six_numbers,
    target_objects,
)
from foretouch.cli.output import print_table
from foretouch.errors import ConfigError, GraspError

if TYPE_CHECKING:
    from foretouch.dataset.source import SourceItem
    from foretouch.pipeline import FoundObject, Pipeline
    from foretouch.types import Grasp, TouchPrediction


_MODALITIES = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The common inputs, --grasp, --model, --tare and --touched."""
    add_input_arguments(parser)
    add_plan_arguments(parser)
    parser.add_argument(
        "--grasp",
        type=six_numbers,
        action="append",
        metavar="x1,y1,z1,x2,y2,z2",
        help="contacts [m] (default: the sample's own, or those that GeoGrasp plans)",
    )
    parser.add_argument("--model", help="name of a model, or path of its card, weights or run folder")
    add_adaptation_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cloud or a grasp was refused."""
    from foretouch.pipeline import Pipeline

    changes = {"model": arguments.model} if arguments.model else {}
    pipeline = Pipeline(pipeline_config(arguments, changes))
    model = {"name": pipeline.model.name, "sha256": pipeline.model.sha256}
    adaptation = read_adaptation(arguments, pipeline.model)

    def answer(item: SourceItem) -> Iterator[Record]:
        targets = target_objects(item, arguments, pipeline)
        if adaptation.touched and len(targets) > 1:
            raise ConfigError(
                f"--touched: the cloud holds {len(targets)} objects and the touches are of one; select it with --target"
            )
        for target in targets:
            began = time.perf_counter()
            grasps, reason = _grasps(item, target, arguments, pipeline)
            planned = time.perf_counter()
            predictions = adaptation.predict(pipeline, target, grasps, item.sample)
            ms = {"grasp": (planned - began) * 1e3, "touch": (time.perf_counter() - planned) * 1e3}
            refused = [one.reason for one in predictions if one.status != "ok"]
            yield {
                **({"sample": item.sample.id} if item.sample is not None else {}),
                "object": target.id,
                "status": "refused" if refused else "ok",
                "reason": "; ".join(refused) or reason,
                "predictions": [prediction_record(one) for one in predictions],
                "model": model,
                "touched": len(adaptation.touches_for(item.sample)),
                "ms": {**ms, "total": sum(ms.values())},
                "failed": not predictions or bool(refused),
            }

    return process_inputs(arguments, answer, _show)


def prediction_record(prediction: TouchPrediction) -> Record:
    """One prediction for JSON: values and bounds in counts, bounds null without a calibration."""
    columns = {"value": prediction.value, "lower": prediction.lower, "upper": prediction.upper}
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
    """The grasps to predict, and a remark: from --grasp, else the sample's own, else planned by GeoGrasp."""
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
    rows = [
        [
            "\n".join(" ".join(f"{v:.3f}" for v in one["grasp"][name]) for name in ("g1", "g2")),
            *(_text(one[name]) for name in _MODALITIES),
            "\n".join(
                [f"touches {record['touched']}" if (one["reference"] == "touches") else one["reference"], *one["flags"]]
            ),
        ]
        for one in record["predictions"]
    ]
    title = f"{record['input']} object {record['object']}: {record['status']} {record['reason']} ({record['model']['name']})"
    print_table(title, ["g1, g2 [m]", *_MODALITIES, "adapted to"], rows)


def _text(modality: Record) -> str:
    """Value and half width; for 24 electrodes, the smallest and the largest value and the mean half width."""
    import numpy as np

    if modality["value"] is None:
        return "refused"
    value = np.atleast_1d(modality["value"])
    text = f"{value.min():.0f}…{value.max():.0f}" if value.size > 1 else f"{value[0]:.0f}"
    if modality["lower"] is None:
        return text
    return f"{text} ±{np.mean(np.subtract(modality['upper'], modality['lower'])) / 2.0:.0f}"  # no space: it wraps there

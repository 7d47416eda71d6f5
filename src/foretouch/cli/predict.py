# SPDX-License-Identifier: Apache-2.0
"""`foretouch predict`: predict the tactile readings of each grasp on each object.

`--tare`, `--touched` and `--history` adapt the predictions to a reading without contact, to touches of the same object,
and to earlier readings of the same hand. `--prequential` replays datasets in order of time instead, each sample
predicted from all readings before it.
"""

import argparse
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from foretouch.cli import inputs
from foretouch.cli.adaptation import Adaptation, others, read_adaptation, read_samples
from foretouch.cli.answers import contacts_text, modality_text
from foretouch.cli.output import print_json, print_table, print_text
from foretouch.cli.parser import CommandParser
from foretouch.dataset.source import SourceItem
from foretouch.doors import FUNCTIONS
from foretouch.errors import ConfigError, GraspError
from foretouch.grasp import GraspPlan
from foretouch.models.predictor import UNFAMILIAR_CURE
from foretouch.models.registry import load_model
from foretouch.models.touch_model import SIMILAR_TOUCHES, TouchModel
from foretouch.pipeline import Pipeline
from foretouch.stream import Stream
from foretouch.tactile import BIOTAC
from foretouch.types import Grasp, Prediction, Reference, Touch
from foretouch.types.channels import Channels
from foretouch.types.predictions import evidence_text
from foretouch.types.scene import Object


def add_arguments(parser: CommandParser) -> None:
    """Declare the common inputs, --grasp, --model, --tare and --touched."""
    inputs.add_options(parser, *inputs.READ, *inputs.PLANNED, *inputs.CHOSEN)
    parser.add_argument(
        "--grasp",
        type=partial(inputs.numbers, count=6),
        action="append",
        metavar="x1,y1,z1,x2,y2,z2",
        help="contacts [m] (default: the sample's own, or planned ones)",
    )
    inputs.add_options(parser, "--model", "--predictor", *inputs.ADAPTED)
    parser.add_argument(
        "--prequential",
        action="store_true",
        help="of inputs that are datasets, predict the samples in order of time, each from all readings before it, of any object",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a cloud or a grasp was refused."""
    inputs.check_single(arguments)
    if arguments.prequential:
        return _run_prequential(arguments)
    if arguments.grasp and arguments.hand:
        raise ConfigError("--grasp, --hand: a hand is for planned grasps; leave one out")
    defaults = {} if arguments.touched else {"target.mode": "all"}  # touches are of one object
    config = inputs.pipeline_config(arguments, defaults=defaults)
    pipeline = Pipeline(config)
    adaptation = read_adaptation(arguments, pipeline.model)
    streams: list[Stream] = []  # of the recordings, one after the other

    def answer(item: SourceItem) -> Iterator[inputs.Record]:
        if item.place == 0:
            streams.append(Stream(config))
        return _answer(arguments, pipeline, adaptation, item, None if item.place is None else streams[-1])

    flags: set[str] = set()
    status = inputs.process_inputs(
        arguments, answer, partial(_show, channels=pipeline.model.sensor.channels, flags=flags)
    )
    if "unfamiliar" in flags:
        print_text(UNFAMILIAR_CURE)
    return status


def _answer(
    arguments: argparse.Namespace, pipeline: Pipeline, adaptation: Adaptation, item: SourceItem, stream: Stream | None
) -> Iterator[inputs.Record]:
    """Iterate over predictions for each object of an input; of a recording as the next cloud of its stream."""
    targets, scene, selected = inputs.target_objects(item, arguments, pipeline, stream)
    if adaptation.touched and len(targets) > 1:
        raise ConfigError(
            f"--touched: the cloud holds {len(targets)} objects and the touches are of one; select it with --target"
        )
    began = time.perf_counter()
    plans = [None] * len(targets) if stream is None or arguments.grasp else stream.plan(targets)
    for number, (target, plan) in enumerate(zip(targets, plans, strict=True)):
        try:
            grasps, reason = _grasps(item, target, arguments, pipeline, plan)
        except GraspError as err:
            if len(targets) == 1:
                raise
            grasps, reason = [], str(err)
        planned = time.perf_counter()
        predictions = adaptation.predict(pipeline, target, grasps, item.sample)
        ms = {"grasp": (planned - began) * 1e3, "touch": (time.perf_counter() - planned) * 1e3}
        refused = predictions.reason[~predictions.ok].tolist()
        if number == 0:
            model = pipeline.model
            inputs.draw_result(arguments, scene, predictions.grasps, predictions, rest=model.rest, sensor=model.sensor)
        yield {
            **({"sample": item.sample.id} if item.sample is not None else {}),
            "object": target.id,
            **({"selected": selected} if selected else {}),
            "status": "ok" if predictions and not refused else "refused",
            "reason": "; ".join(refused) or reason,
            "predictions": predictions.to_dict()["predictions"],
            "model": _named(pipeline.model),
            "touched": len(others(adaptation.touched, item.sample)),
            "ms": {**ms, "total": sum(ms.values())},
            "failed": not predictions or bool(refused),
        }
        began = time.perf_counter()


def _run_prequential(arguments: argparse.Namespace) -> int:
    """Print the prediction of each sample, in order of time."""
    replay_model = FUNCTIONS.load("replay", "--prequential")
    unused = {*inputs.READ, *inputs.PLANNED, *inputs.CHOSEN, "--tare", "--touched", "--grasp"} - {"inputs"}
    for option in sorted(unused):
        if getattr(arguments, option.removeprefix("--").replace("-", "_")):
            raise ConfigError(f"{option}: cannot be combined with --prequential")

    model = load_model(arguments.model or "default", arguments.predictor)
    channels = model.sensor.channels
    history = [earlier for earlier in read_samples(arguments.history, channels) if earlier.touch is not None]
    done = replay_model(model, read_samples(arguments.inputs, channels), history)
    for k in np.flatnonzero(done.scored):
        sample, level = done.samples[k], done.played.levels[k]
        counts, half = done.played.counts[k], done.played.half[k]
        value, lower, upper = (Touch(end, channels) for end in (counts, counts - half, counts + half))
        outside, known = bool(model.ranges.outside(counts).any()), done.recording.is_known(int(k))
        flagged = {"out_of_range": outside, "unfamiliar": not known, SIMILAR_TOUCHES: level.similar}
        flags = tuple(flag for flag, applies in flagged.items() if applies)
        evidence = level.evidence
        reference: Reference = "touches" if evidence.touches else "history" if evidence.readings else "none"
        predicted = Prediction.of(
            sample.grasp, value, lower, upper, reference=reference, flags=flags, evidence=evidence
        )
        record = {
            "input": sample.id,
            "sample": sample.id,
            "object": sample.object,
            "status": "ok",
            "reason": "",
            "predictions": [predicted.to_dict()],
            "model": _named(model),
            "touched": evidence.touches,
            "history": evidence.readings,
            "history_age_s": evidence.reading_age_s,
            "restarted": list(done.played.restarted[k]),
        }
        (print_json if arguments.json else partial(_show, channels=channels, flags=set()))(record)
    return 0


def _grasps(
    item: SourceItem, target: Object, arguments: argparse.Namespace, pipeline: Pipeline, plan: GraspPlan | None
) -> tuple[list[Grasp], str]:
    """Return the grasps to predict, and a remark: from --grasp, else the sample's own, else planned, maybe before."""
    if arguments.grasp:
        pairs = np.array(arguments.grasp, dtype=np.float64).reshape(-1, 2, 3)
        return [pipeline.grasp_between(target, g1, g2) for g1, g2 in pairs], ""
    if item.sample is not None:
        if arguments.hand:
            raise ConfigError("--hand: is for planned grasps, and a sample has its own")
        return [item.sample.grasp], ""
    plan = plan or pipeline.plan(target)
    if not plan.grasps:
        raise GraspError(f"{plan.status}: {plan.reason}")
    return list(plan.grasps), plan.reason


def _named(model: TouchModel) -> inputs.Record:
    """Return the model for a record, with its sensor unless it is the BioTac SP."""
    channels = model.sensor.channels
    sensor = {} if channels == BIOTAC else {"sensor": channels.sensor, "sensor_sha256": channels.sha256}
    dead = {"dead_taxels": model.sensor.dead} if model.sensor.dead else {}  # of which predictions are not valid
    return {"name": model.name, "sha256": model.sha256, **sensor, **dead}


def _show(record: dict[str, Any], *, channels: Channels, flags: set[str]) -> None:
    """Print the predictions of a record as a table, and add their flags to `flags`."""
    rows, contacts = [], []
    for number, prediction in enumerate(record["predictions"], 1):
        flags.update(prediction["flags"])
        evidence = prediction["evidence"]
        reference = evidence_text(prediction["reference"], evidence["touches"], evidence["readings"])
        contacts.append(f"\ngrasp {number}: {contacts_text(prediction['grasp'])}")
        rows.append([
            str(number),
            *(modality_text(**prediction[name], text=channel.text) for name, channel in channels.channel_of.items()),
            reference,
            "\n".join(flag.replace("_", " ") for flag in prediction["flags"]) or "–",
        ])  # fmt: skip
    title = inputs.heading(record, f" by {record['model']['name']}")
    print_table(title + "".join(contacts), ["#", *channels.modalities, "based on", "flags"], rows)

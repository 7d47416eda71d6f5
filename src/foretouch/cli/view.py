# SPDX-License-Identifier: Apache-2.0
"""`foretouch view`: show clouds, grasps, predicted touch and readings in Rerun."""

import argparse
import itertools
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.cli import inputs
from foretouch.cli.adaptation import Adaptation, read_adaptation
from foretouch.cli.answers import ANSWER_SUFFIXES, answer_key, prediction_from_record, read_answers
from foretouch.cli.output import progress_bar, warn
from foretouch.cloud.io.files import CLOUD_SUFFIXES
from foretouch.dataset.record import DISCARDED, SampleRecord, readings
from foretouch.dataset.samples import has_points, is_sample_set, open_samples, sensor_of_samples
from foretouch.dataset.source import SourceItem, open_source
from foretouch.errors import ForetouchError
from foretouch.files import require_existing, require_writable
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.report.rerun_view import ViewStep, write_view
from foretouch.report.rerun_viewer import open_viewer, save_screenshot
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import require_same
from foretouch.types import Cloud, Grasp, GraspSample, Touch


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "path",
        metavar="PATH",
        help="a cloud, a folder of clouds, a dataset, a recording, or the answers of `predict --json` or `run --json` (.json, .jsonl)",
    )
    parser.add_argument(
        "--data", metavar="PATH", help="clouds and readings to show with answers: what they were given for"
    )
    parser.add_argument("--save", type=Path, metavar="F.rrd", help="write a file for Rerun instead of opening a window")
    parser.add_argument("--screenshot", type=Path, metavar="F.png", help="draw a picture instead of opening a window")
    parser.add_argument(
        "--count",
        type=inputs.positive_number,
        metavar="N",
        help="show the first N clouds, samples or answers (default: all)",
    )
    inputs.add_options(parser, "--topic", "--config", "--set", "--model", *inputs.PLANNED, *inputs.ADAPTED)


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a cloud could not be read."""
    path = require_existing(arguments.path)
    for out, suffix in ((arguments.save, ".rrd"), (arguments.screenshot, ".png")):
        if out is not None:
            require_writable(out, suffix)
    steps = _Steps(arguments)
    with tempfile.TemporaryDirectory(prefix="foretouch-view-") as folder:
        file = arguments.save or Path(folder) / "view.rrd"
        with progress_bar("reading", arguments.count) as advance:
            counted = (step for step in itertools.islice(steps, arguments.count) if advance() is None)
            write_view(file, counted, f"foretouch view {path}", steps.sensor)
        if arguments.screenshot:
            save_screenshot(file, arguments.screenshot)
        if not (arguments.save or arguments.screenshot):
            open_viewer(file)
    for written in filter(None, (arguments.save, arguments.screenshot)):
        warn(f"wrote {written}")
    return int(steps.failed)


class _Steps:
    """Makes the steps of the view, whose inputs are as those of `predict`."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.failed = False  # whether an input could not be read
        self._arguments = arguments
        self._pipeline = Pipeline(inputs.pipeline_config(arguments, defaults={"grasp.count": 10}))
        self._adaptation: Adaptation
        # Of answers, what they were given for.
        data = arguments.data if self._are_answers else arguments.path
        samples = data is not None and arguments.topic is None and is_sample_set(data)
        opened = open_samples(data, unfinished=True) if samples else None
        self._without_camera = opened is not None and len(opened) > 0 and not has_points(opened.record(0).sample)
        found = None if opened is None else sensor_of_samples(opened) if self._without_camera else opened.sensor
        unnamed = self._are_answers and arguments.model is None
        self.sensor = found or (BIOTAC_SP if unnamed else self._pipeline.model.sensor)

    @property
    def _are_answers(self) -> bool:
        path = Path(self._arguments.path)
        return path.suffix in ANSWER_SUFFIXES and path.is_file()

    def __iter__(self) -> Iterator[ViewStep]:
        path = self._arguments.path
        yield from self._of_answers(Path(path)) if self._are_answers else self._of_source(path)

    def _of_source(self, path: str) -> Iterator[ViewStep]:
        """A step for each cloud or sample, with the touch that the model predicts now; without a camera, for each reading."""
        if self._without_camera:
            yield from self._of_readings(path)
            return
        require_same(self._pipeline.model.sensor.channels, self.sensor.channels, f"model {self._pipeline.model.name}")
        self._adaptation = read_adaptation(self._arguments, self._pipeline.model)
        if self._arguments.topic is None and is_sample_set(path):
            yield from self._of_samples(path)
            return
        source = open_source(path, topic=self._arguments.topic)
        for item in source:
            try:
                yield self._of_cloud(item, stamped=source.kind == "recording")
            except ForetouchError as err:
                self._refuse(item.name, err)

    def _of_samples(self, path: str) -> Iterator[ViewStep]:
        """The samples of a dataset that the operator has not discarded."""
        samples = open_samples(path, unfinished=True)
        for k in range(len(samples)):
            try:
                record = samples.record(k)
                if DISCARDED not in record.flags:
                    yield self._of_sample(record)
            except ForetouchError as err:
                self._refuse(samples.name(k), err)

    def _of_readings(self, path: str) -> Iterator[ViewStep]:
        """The readings of all samples, with what became of their grasp."""
        samples = open_samples(path, unfinished=True)
        for record in samples.records():
            series, tare, name = readings(record), record.sample.tare, f"{record.sample.id}: {record.outcome}"
            for stamp, counts in () if series is None else zip(series.stamps_ns.tolist(), series.counts, strict=True):
                read = Touch(counts.astype(np.float64), samples.sensor.channels)
                yield ViewStep(name=name, stamp_ns=stamp, read=read, tare=tare, reason="recorded without a camera")

    def _of_answers(self, path: Path) -> Iterator[ViewStep]:
        """A step for each answer, in their order where no clouds are given, else in the order of these."""
        records, data = read_answers(path), self._arguments.data
        if data is None:
            for record in records:
                own = Path(str(record.get("input", "")))
                there = own.suffix.lower() in CLOUD_SUFFIXES and own.is_file()
                yield self._of_answer(record, next(iter(open_source(own))) if there else None)
            return
        by_key: dict[str | int, list[dict[str, Any]]] = {}
        for record in records:
            by_key.setdefault(answer_key(record), []).append(record)
        for item in open_source(data, topic=self._arguments.topic):
            try:
                keys = (item.name, item.sample.id if item.sample is not None else item.cloud.stamp_ns)
            except ForetouchError as err:
                self._refuse(item.name, err)
                continue
            for record in itertools.chain.from_iterable(by_key.pop(key, []) for key in keys):
                yield self._of_answer(record, item)
        if by_key:
            warn(f"{path}: {sum(map(len, by_key.values()))} answers belong to nothing in {data}")
            self.failed = True

    def _refuse(self, name: str, err: ForetouchError) -> None:
        self.failed = True
        warn(inputs.error_line(name, err))

    def _of_cloud(self, item: SourceItem, *, stamped: bool) -> ViewStep:
        found = self._found(item.cloud)
        target = found.pop("target")
        shown = {"name": item.name, "stamp_ns": item.cloud.stamp_ns if stamped else 0, **found}
        if target is None:
            return ViewStep(**shown)
        plan = self._pipeline.plan(target)
        if not plan.grasps:
            return ViewStep(**shown, reason=f"{plan.status}: {plan.reason}")
        return ViewStep(**shown, **self._predicted(target, plan.grasps[0], None), candidates=plan.grasps[1:])

    def _of_sample(self, record: SampleRecord) -> ViewStep:
        sample = record.sample
        target = inputs.only_object(sample.cloud, self._arguments)
        predicted = self._predicted(target, sample.grasp, sample)
        return ViewStep(name=sample.id, **self._read(sample), **predicted, candidates=record.candidates)

    def _predicted(self, target: FoundObject, grasp: Grasp, sample: GraspSample | None) -> dict[str, Any]:
        (prediction,) = self._adaptation.predict(self._pipeline, target, [grasp], sample)
        return {"grasp": prediction.grasp, "prediction": prediction, "model": self._pipeline.model.name}

    def _read(self, sample: GraspSample) -> dict[str, Any]:
        """Cloud, table, readings and time of a sample."""
        return {
            "cloud": sample.cloud,
            "table": inputs.only_object(sample.cloud, self._arguments).plane,
            "stamp_ns": sample.stamp_ns,
            "read": sample.touch,
            "tare": sample.tare,
        }

    def _found(self, cloud: Cloud) -> dict[str, Any]:
        """Table, objects and target of a cloud, as `predict` finds them; the target is first."""
        if inputs.holds_one_object(cloud, self._arguments):
            target = inputs.only_object(cloud, self._arguments)
            return {"cloud": cloud, "table": target.plane, "target": target}
        scene = self._pipeline.segment(cloud)
        objects = {one.id: one.cloud for one in scene.targets[:1]}
        objects |= {str(one.id): one.cloud for one in scene.segmentation.objects if str(one.id) not in objects}
        found = {"cloud": cloud, "table": scene.segmentation.plane, "objects": objects}
        refused = {"target": None, "reason": f"{scene.status}: {scene.reason}"}
        return found | ({"target": scene.targets[0]} if scene.targets else refused)

    def _of_answer(self, record: Mapping[str, Any], item: SourceItem | None) -> ViewStep:
        shown: dict[str, Any] = {
            "name": str(record.get("sample") or record.get("input") or record.get("stamp_ns", "")),
            "stamp_ns": int(record.get("stamp_ns") or 0),
            "model": str(model.get("name", "")) if isinstance(model := record.get("model"), dict) else "",
        }
        try:
            if item is not None:
                shown |= self._found(item.cloud) if item.sample is None else self._read(item.sample)
            predictions = [prediction_from_record(one, self.sensor.channels) for one in record.get("predictions", ())]
        except ForetouchError as err:
            self._refuse(shown["name"], err)
            predictions = []
        shown["reason"] = str(record.get("reason", ""))
        shown.pop("target", None)
        if predictions:
            shown |= {"grasp": predictions[0].grasp, "prediction": predictions[0]}
            shown["candidates"] = [one.grasp for one in predictions[1:]]
        return ViewStep(**shown)

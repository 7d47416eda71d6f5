# SPDX-License-Identifier: Apache-2.0
"""A simulated working day through the live graph: three objects, and a restart in the middle.

    python examples/simulated_day.py OUT [--each-s 60] [--pause-s 20]

A simulated camera and hand show and grasp the objects of `config/scenes/campaign_day.yaml` one after the other, while the
level of the fingertips drifts. In the middle, the process of the graph ends and another one starts; all that it knows is
the file of the hand (parameters `hand` and `history_folder`). OUT then holds that file, `day.csv` and its picture
`day.png`: of one electrode the readings and the predictions before them, and the two parts that the predictor
separates, the state of the sensor and the part of the object.

160 s of the day pass in each second. The model is therefore the default one with time constants of drift that are shorter
by this factor. Tares are not used: the rest level of the model was estimated without any, and is not that of simulated
fingertips.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch import reading
from foretouch.camera.config import ScheduleConfig
from foretouch.errors import FileError
from foretouch.models import load_model
from foretouch.models.contact.estimator import save_contact
from foretouch.models.touch_model import History, TouchModel
from foretouch.report.panels import FAINT, FINGER_COLOURS, INK, PAGE_INCH, SMALL_PT, TEXT_PT, new_figure, save_small
from foretouch.ros.graph import Graph
from foretouch.ros.nodes.camera import DEPTH_TOPIC
from foretouch.tactile import BIOTAC
from foretouch.tactile.messages.table import TactileConfig
from foretouch.types import stamp_ns
from foretouch_lab.simulation.execution import SimulatedHand
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.world import object_index

SCENE: Final = Path(__file__).parents[1] / "config" / "scenes" / "campaign_day.yaml"
HAND: Final = "day"
SPEED: Final = 160.0  # time of the day over that of the clock: eight hours in three minutes
ELECTRODE: Final = 10  # of the middle finger, from 1
VALUE: Final = BIOTAC.columns(["E_MF"])[ELECTRODE - 1]
DEVIATIONS: Final = 1.645  # of 90 %
POLL_S: Final = 0.1
REMAPPED: Final = ["--ros-args", "-r", f"perception:depth/image:={DEPTH_TOPIC}"]
SLOW: Final = {"camera.fps": 3, "camera.silence_s": 20.0}

Row = Mapping[str, Any]


def write_scene(out: Path) -> SceneConfig:
    """The scene of this day, also as a file: each object lies at one place until the next comes."""
    scene = load_scene(SCENE)
    assert scene.campaign is not None  # noqa: S101  it is a campaign's
    scene = scene.replace(campaign=scene.campaign.replace(grasps=1, live_speed=SPEED))
    (out / "scene.yaml").write_text(json.dumps(scene.to_mapping()), encoding="utf-8")
    return scene


def write_model(out: Path) -> Path:
    """The default model with a tracker for whom time passes faster; the path of its card."""
    model = load_model()
    calibration = model.calibration
    assert calibration is not None  # noqa: S101  the released ones have it
    tracker = calibration.tracker_parameters
    times = {name: getattr(tracker, name) / SPEED for name in ("slow_time_s", "fast_time_s")}
    quicker = replace(calibration, tracker=replace(tracker, **times))
    errors = {name: model.card["calibration"][name] for name in ("level", "regimes", "rest")}
    facts = {name: model.card[name] for name in ("summary", "config", "data", "split", "skill", "baselines", "limits")}
    return save_contact(out / "model", model.name, model.predictor, facts, (quicker, errors))


def nodes_of(schedule: ScheduleConfig, out: Path, model: Path) -> dict[str, dict[str, Any]]:
    """Parameters of each node, as `foretouch run --source SCENE` sets them, and the file of the hand."""
    shown = {f"scene.{name}": value for name, value in schedule.to_mapping().items()}
    nodes: dict[str, dict[str, Any]] = {}
    nodes["perception"] = {
        "model": str(model),
        "use_tare": False,
        "same_object_m": 0.005,
        "hand_name": HAND,
        "history_folder": str(out),
    }
    return nodes | {"hand": shown, "camera": {"source": "scene", **SLOW, **shown}}


class Log:
    """Rows of `day.csv`.

    Args:
        schedule: Which object is on the table at a time.
        scene: The scene.
        model: Of the predictor.
    """

    def __init__(self, schedule: ScheduleConfig, scene: SceneConfig, model: TouchModel) -> None:
        self.rows: list[Row] = []
        self._schedule, self._scene, self._model = schedule, scene, model
        self._seen: Any = None
        self._readings = -1

    def add(self, kind: str, at_ns: int, value: float, half: float = 0.0, **evidence: int) -> None:
        """One row: a value and its 90 % interval."""
        slot = self._schedule.slot(at_ns)
        name = self._scene.objects[object_index(self._scene, slot)].name
        row = {
            "kind": kind,
            "second": round((at_ns - self._schedule.origin_ns) / 1e9, 2),
            "visit": slot,
            "object": name,
        }
        numbers = {"value": round(value, 1), "low": round(value - half, 1), "high": round(value + half, 1)}
        self.rows.append({**row, **numbers, "touches": None, "readings": None, **evidence})

    def add_answer(self, message: Any) -> None:
        """A message of `touch`: the prediction of the best grasp."""
        for prediction in message.predictions[:1]:
            value, low, high = (float(end[1, ELECTRODE - 1]) for end in reading(prediction)["E"])
            at_ns = stamp_ns(message.header.stamp)
            self.add(
                "prediction", at_ns, value, (high - low) / 2.0, touches=prediction.touches, readings=prediction.readings
            )

    def add_executed(self, executed: Any) -> None:
        """The last executed grasp, if it is another than before."""
        if executed is not None and executed is not self._seen:
            self._seen = executed
            message, cut = executed
            self.add("reading", stamp_ns(message.header.stamp), float(cut.touch.values[VALUE]))

    def add_history(self, path: Path) -> None:
        """Both parts of the level from the file of the hand, if there are new readings."""
        try:
            history = History.load(path, self._model)
        except FileError:  # nothing was read yet
            return
        readings = history.tracker.evidence(0).readings
        if readings != self._readings:
            self._readings = readings
            for kind, (value, deviation) in parts_of(history).items():
                self.add(kind, time.time_ns(), value, DEVIATIONS * deviation, readings=readings)


def rest_level(schedule: ScheduleConfig, scene: SceneConfig, model: TouchModel, seconds: float) -> list[Row]:
    """What the electrode reads without contact, above its mean, twice a second."""
    log, hand = Log(schedule, scene, model), SimulatedHand(scene)
    times = np.arange(0.0, seconds, 0.5)
    counts = [hand.rest(20, elapsed_s=float(second))[:, 1, ELECTRODE].mean() for second in times]
    for second, count in zip(times, counts, strict=True):
        log.add("rest", schedule.origin_ns + round(1e9 * second), float(count - np.mean(counts)))
    return log.rows


def parts_of(history: History) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the state of the sensor and of the object's part, of one value [counts]."""
    tensors, basis = history.tracker.to_tensors(), history.tracker.parameters.basis[VALUE]
    found = {}
    for kind, parts in (("state", slice(0, 2)), ("object", slice(2, 3))):
        mean = tensors["mean"][parts].sum(axis=0)
        variance = tensors["covariance"][parts, parts].sum(axis=(0, 1))
        found[kind] = float(basis @ mean), float(np.sqrt(basis**2 @ variance))
    return found


def run_graph(out: Path, schedule: ScheduleConfig, card: Path, end_s: float) -> list[Row]:
    """Run the graph until a time (`time.time`), then stop it."""
    log, path = Log(schedule, load_scene(schedule.path), load_model(card)), out / f"{HAND}.safetensors"
    with Graph(
        nodes_of(schedule, out, card), monitor={"hand": TactileConfig(), "on_touch": log.add_answer}, arguments=REMAPPED
    ) as graph:
        graph.require_active()
        while time.time() < end_s:
            time.sleep(POLL_S)
            view = graph.monitor.view()
            log.add_executed(view.executed)
            if view.answers:
                log.add_history(path)
    log.add_history(path)
    return log.rows


def draw(rows: Sequence[Row], path: Path) -> Path:
    """Draw `day.png` from the rows of `day.csv`."""
    figure = new_figure(PAGE_INCH, 6.0)
    grid = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.2, 1.2])
    predictions = _of(rows, "prediction")
    pause = _longest_pause(predictions)
    restart = tuple(_hours(pause))
    titles = (
        f"electrode {ELECTRODE} of the middle finger: predicted (line, band: 90 % interval), then read (dots)",
        "estimated level of the sensor, kept from object to object; dashed: its true drift, which lies in the band",
        "estimated part of the object: begins at 0 with each new object (vertical lines), and is kept over the restart",
    )
    for axes, title, kind, colour in zip(
        grid, titles, ("prediction", "state", "object"), (FINGER_COLOURS[1], FINGER_COLOURS[3], FINGER_COLOURS[2]), strict=True
    ):  # fmt: skip
        _draw_visits(axes, predictions, named=axes is grid[0])
        axes.axvspan(*restart, color=FAINT)
        for later in (False, True):
            part = [row for row in _begun(rows, kind) if (row["second"] > pause[0]) == later]
            _draw_band(axes, part, colour, stepped=kind != "prediction")
        axes.set_title(title, loc="left", fontsize=TEXT_PT, pad=16 if axes is grid[0] else 5)
        axes.set_ylabel("counts", fontsize=SMALL_PT)
        axes.tick_params(labelsize=SMALL_PT)
    seconds, counts = _xy(_of(rows, "reading"))
    grid[0].plot(_hours(seconds), counts, "o", color=INK, markersize=3.5)
    seconds, counts = _xy(_of(rows, "rest"))
    level = float(np.mean(_xy(_of(rows, "state"))[1][3:]))
    grid[1].plot(_hours(seconds), np.array(counts) + level, "--", color=INK, linewidth=1.2)
    style = {"rotation": 90, "ha": "center", "va": "center", "fontsize": TEXT_PT, "color": INK}
    grid[0].text(sum(restart) / 2.0, 0.5, "software restarted", transform=grid[0].get_xaxis_transform(), **style)
    grid[-1].set_xlabel("time of the simulated day [h]", fontsize=SMALL_PT)
    grid[0].set_xlim(0.0, _hours(max(row["second"] for row in predictions)))
    return save_small(figure, path)


def _of(rows: Sequence[Row], kind: str) -> list[Row]:
    return [row for row in rows if row["kind"] == kind]


def _begun(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return the rows of a kind; the part of an object begins with each visit as it began before the first reading of the day."""
    own, predictions = _of(rows, kind), _of(rows, "prediction")
    if kind != "object":
        return own
    for visit in sorted({row["visit"] for row in predictions})[1:]:
        start = min(row["second"] for row in predictions if row["visit"] == visit)
        touched = [row for row in predictions if row["visit"] == visit and row["touches"]]
        first = min((row["second"] for row in touched), default=math.inf)
        own = [row for row in own if not start <= row["second"] < first] + [{**own[0], "second": start}]
    return sorted(own, key=itemgetter("second"))


def _xy(rows: Sequence[Row]) -> tuple[list[float], list[float]]:
    return [row["second"] for row in rows], [row["value"] for row in rows]


def _hours(seconds: Any) -> Any:
    return np.asarray(seconds) * SPEED / 3600.0


def _draw_band(axes: Any, rows: Sequence[Row], colour: str, *, stepped: bool) -> None:
    seconds, values = _xy(rows)
    low, high = ([row[key] for row in rows] for key in ("low", "high"))
    style = {"step": "post"} if stepped else {}
    axes.fill_between(_hours(seconds), low, high, color=colour, alpha=0.25, linewidth=0.0, **style)
    axes.plot(_hours(seconds), values, color=colour, drawstyle="steps-post" if stepped else "default")


def _longest_pause(rows: Sequence[Row]) -> tuple[float, float]:
    """Between the two answers that are farthest apart [s]."""
    seconds = np.array([row["second"] for row in rows])
    k = int(np.argmax(np.diff(seconds)))
    return float(seconds[k]), float(seconds[k + 1])


def _draw_visits(axes: Any, rows: Sequence[Row], *, named: bool) -> None:
    """Lines where the object is changed, and the names of the objects."""
    visits = sorted({row["visit"] for row in rows})
    starts = [min(row["second"] for row in rows if row["visit"] == visit) for visit in visits]
    for visit, start, end in zip(visits, starts, [*starts[1:], rows[-1]["second"]], strict=True):
        name = next(row["object"] for row in rows if row["visit"] == visit)
        if visit != visits[0]:
            axes.axvline(_hours(start), color="0.2", linewidth=1.0)
        if named:
            axes.text(
                _hours((start + end) / 2),
                1.02,
                f"object: {name}",
                transform=axes.get_xaxis_transform(),
                ha="center",
                fontsize=TEXT_PT,
            )


def main() -> int:
    """Run the day, then write table and picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder to create")
    parser.add_argument("--each-s", type=float, default=60.0, help="time of each object on the table [s]")
    parser.add_argument("--pause-s", type=float, default=20.0, help="time that the graph is stopped [s]")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True)
    scene, card = write_scene(out), write_model(out)
    schedule = ScheduleConfig(
        path=str((out / "scene.yaml").resolve()), dwell_s=arguments.each_s, origin_ns=time.time_ns()
    )
    began, seconds = schedule.origin_ns / 1e9, 3.0 * arguments.each_s
    stop, start = (seconds - arguments.pause_s) / 2.0, (seconds + arguments.pause_s) / 2.0
    rows = []
    for first, last in ((0.0, stop), (start, seconds)):
        time.sleep(max(0.0, began + first - time.time()))
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            rows += process.submit(run_graph, out, schedule, card, began + last).result()
    rows += rest_level(schedule, scene, load_model(card), seconds)
    with (out / "day.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print(draw(rows, out / "day.png"))
    return 0


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Answers that plain subscribers get which start before and during a replay (see README.md)."""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
SOURCES = HERE.parents[1] / "src"
RANGES = ("LOCALHOST", "SUBNET")
LOADS = {"idle": 0, "loaded": 1}  # busy processes for each core
STARTS = {"1 s before": -1.0, "0.2 s after": 0.2, "2 s after": 2.0}
DURABILITIES = ("volatile", "transient local")
LAST = 10  # answers that a late joiner gets
PATIENCE_S = 150.0
IDLE_S = 5.0  # without an answer
REST_S = 1.0  # after the last answer
NODES = "import sys; from foretouch.ros.executables import perception; sys.exit(perception())"
QUEUES = """/**:
  ros__parameters:
    queue_depth: 100
    qos_overrides: {/foretouch/points: {subscription: {depth: 100}}}
"""  # so that a slow machine drops no cloud
COLUMNS = ("label", "command", "range", "load", "start", "durability", "runs", "good", "clouds", "least_answered",
           "least_received", "missed", "least_of_earlier", "match_s_p50", "match_s_max")  # fmt: skip


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="runs of each range and load")
    parser.add_argument("--clouds", type=int, default=50)
    parser.add_argument("--rate", type=float, default=10.0, help="clouds per second [Hz]")
    parser.add_argument("--ranges", nargs="*", choices=RANGES, default=RANGES)
    parser.add_argument("--loads", nargs="*", choices=tuple(LOADS), default=tuple(LOADS))
    parser.add_argument(
        "--command", choices=["replay", "run"], default="replay", help="foretouch replay beside a graph, or run"
    )
    parser.add_argument("--label", default="now", help="name of these rows in the results; such rows are replaced")
    parser.add_argument("--source", type=Path, default=SOURCES, help="folder `src` of the nodes, such as of a release")
    parser.add_argument("--out", type=Path, default=HERE / "results.csv")
    parser.add_argument("--verbose", action="store_true", help="print each subscription of each run")
    return parser.parse_args()


class Child:
    """A process that prints JSON lines."""

    def __init__(self, *command: str, environ: dict[str, str]) -> None:
        self.started = time.time_ns()
        self.lines: list[dict[str, Any]] = []
        self._changed = threading.Condition()
        self._process = subprocess.Popen(
            command, env=environ, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def wait_for(self, since: int, **wanted: Any) -> dict[str, Any]:
        """The first line with these values and a time after `since` [ns]."""
        with self._changed:
            found = self._changed.wait_for(lambda: list(self.having(since, **wanted)), PATIENCE_S)
        if not found:
            raise SystemExit(f"nothing with {wanted} came in {PATIENCE_S:g} s")
        return found[0]

    def having(self, since: int, **wanted: Any) -> Iterator[dict[str, Any]]:
        """Lines with these values and a time after `since` [ns]."""
        return (one for one in self.lines if one.get("at", 0) > since and wanted.items() <= one.items())

    def end(self) -> None:
        """End its input and interrupt it, then end it by force."""
        if self._process.poll() is None and self._process.stdin is not None:
            self._process.stdin.close()
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._thread.join(5.0)

    def _read(self) -> None:
        for line in self._process.stdout or ():
            if line.startswith("{"):
                with self._changed:
                    self.lines.append(json.loads(line))
                    self._changed.notify_all()


@dataclass(frozen=True)
class Outcome:
    """What one subscription got of the answers to one replay."""

    clouds: int  # played
    answered: int  # of them
    match_s: float  # from the start of its process to its match; infinite without
    received: int  # answers
    missed: int  # answers published after its match, or after the first one it got, that it did not get
    earlier: int  # answers published before the first one arrived
    of_earlier: int  # of these, those that it got

    def is_good(self, start: str, durability: str) -> bool:
        """Whether the subscription got all that it should."""
        if start == "1 s before":
            return self.received == self.answered == self.clouds
        late = min(LAST, self.earlier) if durability == "transient local" else 0
        return not self.missed and self.of_earlier >= late


def outcome(child: Child, durability: str, published: dict[int, int], clouds: int) -> Outcome:
    """Compare what a subscription got with the times of publication of all answers by stamp [ns]."""
    lines = [line for line in child.lines if line.get("answer") == durability and line["stamp"] in published]
    got = {line["stamp"] for line in lines}
    matched = min((line["at"] for line in child.lines if line.get("matched") == durability), default=None)
    if matched is None:
        return Outcome(clouds, len(published), math.inf, 0, 0, len(published), 0)
    first = min([matched, *(published[stamp] for stamp in got)])
    arrived = min((line["arrived"] for line in lines), default=time.time_ns())
    return Outcome(
        clouds,
        len(published),
        (matched - child.started) * 1e-9,
        received=len(got),
        missed=sum(at > first and stamp not in got for stamp, at in published.items()),
        earlier=sum(at < arrived for at in published.values()),
        of_earlier=sum(at < arrived and stamp in got for stamp, at in published.items()),
    )


class Cell:
    """One range and load: the graph, and a subscriber that is there from the beginning."""

    def __init__(self, options: argparse.Namespace, clouds: Path, discovery: str, stack: ExitStack) -> None:
        self._options, self._clouds, self._stack = options, clouds, stack
        self._parameters = clouds.with_suffix(".yaml")
        self._parameters.write_text(QUEUES, encoding="utf-8")
        self._plain = {name: value for name, value in os.environ.items() if "PROFILES_FILE" not in name}
        self._plain["ROS_AUTOMATIC_DISCOVERY_RANGE"] = discovery
        self._ours = {**self._plain, "PYTHONPATH": str(options.source)}
        self._watcher = self._subscriber()
        if options.command == "replay":
            given = ("--ros-args", "--params-file", str(self._parameters))
            self._start(sys.executable, "-c", NODES, *given, environ=self._ours)
            self._watcher.wait_for(0, matched="volatile")
            time.sleep(5.0)

    def run(self) -> dict[tuple[str, str], Outcome]:
        """Play once; gives the outcome of each subscription by start and durability."""
        options, began = self._options, time.time_ns()
        children = {"1 s before": self._subscriber()}
        time.sleep(-STARTS["1 s before"])
        words = ["replay", str(self._clouds), "--restamp"]
        if options.command == "run":
            words = ["run", "--source", str(self._clouds), "--params", str(self._parameters)]
        command = [sys.executable, "-m", "foretouch.cli.main", *words, "--rate", str(options.rate), "--json"]
        source = self._start(*command, environ=self._ours)
        playing = self._watcher.wait_for(began, replay="playing")["at"] * 1e-9
        for start, delay in STARTS.items():
            if delay > 0.0:
                time.sleep(max(playing + delay - time.time(), 0.0))
                children[start] = self._subscriber()
        self._watcher.wait_for(began, replay="finished")
        self._wait_for_answers(began)
        for child in (*children.values(), source):
            child.end()
        published = {line["stamp"]: line["at"] for line in self._watcher.having(began, answer="volatile")}
        return {
            (start, durability): outcome(child, durability, published, options.clouds)
            for start, child in children.items()
            for durability in DURABILITIES
        }

    def _wait_for_answers(self, since: int) -> None:
        """Wait until every cloud is answered, or no answer has come for a while."""
        count, last = 0, time.monotonic()
        while count < self._options.clouds and time.monotonic() - last < IDLE_S:
            time.sleep(0.1)
            answers = len(list(self._watcher.having(since, answer="volatile")))
            if answers > count:
                count, last = answers, time.monotonic()
        time.sleep(REST_S)

    def _start(self, *command: str, environ: dict[str, str]) -> Child:
        child = Child(*command, environ=environ)
        self._stack.callback(child.end)
        return child

    def _subscriber(self) -> Child:
        return self._start(sys.executable, str(HERE / "subscriber.py"), environ=self._plain)


def busy(count: int, stack: ExitStack) -> None:
    """Start processes that compute all the time."""
    for _ in range(count):
        child = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        stack.callback(child.kill)


def write_clouds(folder: Path, count: int) -> None:
    """Write a small scene several times."""
    from foretouch.cloud.io.files import write_cloud
    from foretouch.simulation.depth_scene import random_scene

    cloud = random_scene(np.random.default_rng(0), width=212, height=120, n_objects=1).render().cloud()
    for number in range(count):
        write_cloud(folder / f"{number:03d}.npz", cloud)


def row(options: argparse.Namespace, where: tuple[str, ...], outcomes: list[Outcome]) -> dict[str, Any]:
    """A row of the results: all runs of one subscription."""
    matches = [one.match_s for one in outcomes]
    values = (
        *(options.label, options.command, *where),
        len(outcomes),
        sum(one.is_good(*where[2:]) for one in outcomes),
        options.clouds,
        min(one.answered for one in outcomes),
        min(one.received for one in outcomes),
        sum(one.missed for one in outcomes),
        min(one.of_earlier for one in outcomes),
        f"{statistics.median(matches):.2f}",
        f"{max(matches):.2f}",
    )
    return dict(zip(COLUMNS, values, strict=True))


def save(path: Path, rows: list[dict[str, Any]]) -> None:
    """Replace the rows of the same label, command, range and load."""
    keys = COLUMNS[:6]
    fresh = {tuple(str(one[key]) for key in keys) for one in rows}
    old = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            old = [one for one in csv.DictReader(file) if tuple(one[key] for key in keys) not in fresh]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows([*old, *rows])


def main() -> int:
    """Return exit status 1 if a subscription did not get all that it should."""
    options, rows = arguments(), []
    with tempfile.TemporaryDirectory() as folder:
        clouds = Path(folder) / "clouds"
        clouds.mkdir()
        write_clouds(clouds, options.clouds)
        for discovery in options.ranges:
            for load in options.loads:
                with ExitStack() as stack:
                    busy(LOADS[load] * (os.cpu_count() or 1), stack)
                    cell = Cell(options, clouds, discovery, stack)
                    runs = [cell.run() for _ in range(options.runs)]
                for start, durability in runs[0]:
                    outcomes = [one[start, durability] for one in runs]
                    rows.append(row(options, (discovery, load, start, durability), outcomes))
                    print(*rows[-1].values(), sep=", ", flush=True)
                    if options.verbose:
                        print(*outcomes, sep="\n", flush=True)
                save(options.out, rows)
    return int(any(one["good"] < one["runs"] for one in rows))


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Runs the graph in separate processes, breaks one thing after the other, and accounts for every cloud (see README.md)."""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from accounting import Outage, account, slope_per_hour
from observer import Observer

NAMESPACE = "/foretouch"
DOMAIN = 91
PERCEPTION = ("segmentation", "grasp", "touch_predictor")
NODES = (*PERCEPTION, "hand", "recorder", "camera")
SCENE = Path(__file__).parents[2] / "config" / "scenes" / "clean.yaml"
START_S = 90.0  # that a process may take until it is active, on a busy computer
RECOVERY_S = 2.0  # the limit
PATIENCE_S = 20.0  # that is waited for a recovery
WARM_UP_S = 90.0  # of a process: the recorder keeps the clouds of the last minute
STALL_S = 6.0  # longer than `silence_s`, so that diagnostics must name it
TMPFS_MB = 64
PAGE = os.sysconf("SC_PAGE_SIZE")
COLUMNS = ("t_s", "disturbance", "lasted_s", "recovery_s", "answer_gap_s", "note")


@dataclass
class Disturbance:
    """One disturbance as it happened."""

    name: str
    start_s: float
    end_s: float = 0.0  # the cause is gone: the process is active, the topic flows, the space is free
    recovered_s: float | None = None  # the first sign of normal work after that
    note: str = ""


@dataclass
class Memory:
    """Resident memory of one process."""

    node: str
    began_s: float
    times_s: list[float] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)


class Soak:
    """The graph, and what is done to it.

    Args:
        folder: For recordings.
        rate_hz: Clouds per second.
    """

    def __init__(self, folder: Path, rate_hz: int) -> None:
        self.folder = folder
        self.rate_hz = rate_hz
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.memory: list[Memory] = []
        self.outages: list[Outage] = []
        self.unexpected: list[str] = []  # processes that ended by themselves
        self.origin_ns = time.time_ns()
        self.sessions = 0
        self.observer = Observer(NAMESPACE)
        self._sampling = threading.Event()

    # Processes.

    def parameters(self, name: str) -> dict[str, Any]:
        """Parameters of a node."""
        scene = {"scene.path": SCENE, "scene.origin_ns": self.origin_ns}
        known: dict[str, dict[str, Any]] = {
            "camera": {
                "source": "scene",
                "camera.fps": self.rate_hz,
                "camera.timeouts.stall_s": 5.0,
                "camera.timeouts.reopen_s": 20.0,
                **scene,
            },
            "hand": scene,
            "recorder": {
                "folder": self.folder,
                "record": "main",
                "fallback_folder": self.folder / "fallback",
                "writing.min_free_mb": 0.0,  # so that the disk is written to until it refuses
            },
        }
        return {"diagnostics_period_s": 0.25, **known.get(name, {})}

    def spawn(self, name: str) -> subprocess.Popen[bytes]:
        """Start an executable."""
        code = f"import sys; from foretouch.ros.executables import {name}; sys.exit({name}())"
        given = [word for key, value in self.parameters(name).items() for word in ("-p", f"{key}:={value}")]
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-c", code, "--ros-args", *given], stdout=log, stderr=subprocess.STDOUT
            )

    def start(self, name: str) -> bool:
        """Start a node and wait until it reports that it is active."""
        before = self.observer.publishers(name)
        self.processes[name] = self.spawn(name)
        self.memory.append(Memory(name, time.monotonic()))
        return self.observer.wait(lambda: self.observer.active(name, before), START_S)

    def sample(self, period_s: float = 1.0) -> None:
        """Read the memory of all processes until the end, in a thread."""
        while not self._sampling.wait(period_s):
            for name, process in list(self.processes.items()):
                rows = [one for one in self.memory if one.node == name]
                try:
                    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
                except (OSError, IndexError):
                    continue
                if rows and pages:  # a process that has just ended has none
                    rows[-1].times_s.append(time.monotonic())
                    rows[-1].megabytes.append(pages * PAGE / 1e6)

    def watch(self) -> None:
        """Note processes that ended by themselves, and start them again."""
        for name, process in list(self.processes.items()):
            status = process.poll()
            if status is not None:
                self.unexpected.append(f"{name}: exit status {status}")
                self.start(name)

    def close(self) -> None:
        """End all processes."""
        self._sampling.set()
        for process in self.processes.values():
            process.send_signal(signal.SIGINT)
        for name, process in self.processes.items():
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                self.unexpected.append(f"{name}: did not end within 15 s of SIGINT")
                process.kill()
                process.wait()

    # Disturbances. Each returns when its cause is gone, with a note.

    def kill(self, name: str) -> str:
        """SIGKILL, and start again."""
        began = time.monotonic()
        self.processes[name].kill()
        self.processes[name].wait()
        active = self.start(name)
        self.outages.append(Outage(name, "killed", began, time.monotonic()))
        return f"active {time.monotonic() - began:.1f} s after SIGKILL" if active else "NOT ACTIVE AGAIN"

    def cycle(self, name: str, transitions: tuple[str, ...]) -> str:
        """Go through transitions of the lifecycle."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        began = time.monotonic()
        refused = []
        for label in transitions:
            number = getattr(Transition, f"TRANSITION_{label.upper()}")
            request = ChangeState.Request(transition=Transition(id=number))
            answer = self.observer.call(ChangeState, f"{NAMESPACE}/{name}/change_state", request)
            if answer is None or not answer.success:
                refused.append(label)
            if label in ("deactivate", "cleanup"):
                time.sleep(1.0)
        self.outages.append(Outage(name, "inactive", began, time.monotonic()))
        return f"REFUSED: {', '.join(refused)}" if refused else ""

    def stall(self, name: str) -> str:
        """SIGSTOP, and SIGCONT some seconds later."""
        began = time.monotonic()
        self.processes[name].send_signal(signal.SIGSTOP)
        time.sleep(STALL_S)
        self.processes[name].send_signal(signal.SIGCONT)
        self.outages.append(Outage(name, "stopped", began, time.monotonic()))
        return ""

    def jump(self, name: str, seconds: float) -> str:
        """Let the clock of a sensor jump, and back some seconds later."""
        for skew in (seconds, 0.0):
            if not self.set_parameter(name, "faults.skew_s", skew):
                return "REFUSED"
            if skew:
                time.sleep(5.0)
        return ""

    def set_parameter(self, node: str, name: str, value: float) -> bool:
        """Change a parameter of a node."""
        from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
        from rcl_interfaces.srv import SetParameters

        given = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=given)])
        answer = self.observer.call(SetParameters, f"{NAMESPACE}/{node}/set_parameters", request)
        return answer is not None and answer.results[0].successful

    def record(self, path: Path | str) -> str:
        """Begin a recording; gives the error."""
        from foretouch_msgs.srv import StartRecording

        answer = self.observer.call(
            StartRecording, f"{NAMESPACE}/start_recording", StartRecording.Request(path=str(path), object="can")
        )
        if answer is None or not answer.success:
            return "no answer" if answer is None else str(answer.message)
        seen = self.observer.seen
        shown = self.observer.wait(lambda: seen.recorder.recording and seen.recorder.path == answer.path, PATIENCE_S)
        return "" if shown else "recorder_status does not show it"

    def finish(self) -> str:
        """End a recording; gives the error."""
        from foretouch_msgs.srv import StopRecording

        answer = self.observer.call(StopRecording, f"{NAMESPACE}/stop_recording", StopRecording.Request())
        return "no answer" if answer is None else str(answer.message)

    def resume(self) -> str:
        """Record into a new dataset on the disk."""
        self.sessions += 1
        return self.record(f"main-{self.sessions}")

    def named(self, began: float) -> str:
        """How soon the recorder has reported the end of its recording, and how."""
        seen = self.observer.seen
        ended = self.observer.wait(lambda: seen.recorder is not None and not seen.recorder.recording, 10.0)
        if not ended:
            return "NOT NOTICED"
        return f"reported after {time.monotonic() - began:.1f} s: {seen.recorder.reason}"

    def fill_disk(self) -> str:
        """Record onto a small disk and fill it to the last byte."""
        disk = self.folder / "small"
        disk.mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={TMPFS_MB}m", "tmpfs", disk], check=True)
        try:
            self.finish()
            if error := self.record(disk / "set"):
                return f"NOT STARTED: {error}"
            time.sleep(2.0)
            ballast, began = disk / "ballast", time.monotonic()
            with ballast.open("wb", buffering=0) as file:
                try:
                    while True:
                        file.write(bytes(65536))
                except OSError:
                    pass
            note = self.named(began)
            ballast.unlink()
            return f"{note}; {verified(disk / 'set')}" + self.resume()
        finally:
            subprocess.run(["umount", "-l", disk], check=False)

    def remove_folder(self) -> str:
        """Remove the dataset that is being recorded."""
        self.finish()
        if error := self.resume():
            return f"NOT STARTED: {error}"
        time.sleep(2.0)
        began = time.monotonic()
        shutil.rmtree(self.folder / f"main-{self.sessions}")
        note = self.named(began)
        return note + self.resume()

    def second_graph(self) -> str:
        """A second graph in the same namespace for some seconds."""
        before = {name: self.observer.publishers(name) for name in PERCEPTION}
        began = time.monotonic()
        other = self.spawn("perception")
        try:
            self.observer.wait(lambda: all(self.observer.active(n, before[n]) for n in PERCEPTION), START_S)
            time.sleep(6.0)
        finally:
            other.send_signal(signal.SIGINT)
            other.wait(15.0)
        with self.observer.lock:
            told = {f"{name}: {text}" for at, name, text in self.observer.seen.warnings if at >= began}
        return "diagnostics: " + ("; ".join(sorted(told)) or "NOTHING")

    # The course of the soak.

    def works(self, name: str) -> Callable[[], bool]:
        """A condition that holds once the part of the graph that a disturbance concerns works again."""
        seen, since = self.observer.seen, time.monotonic()
        if "hand" in name:
            return lambda: seen.tactile_s > since
        if "recorder" in name or "disk" in name or "folder" in name:
            used = 0 if seen.recorder is None else seen.recorder.used
            return lambda: seen.recorder is not None and seen.recorder.recording and seen.recorder.used != used
        return lambda: bool(seen.answers) and seen.answers[-1] > since

    def disturb(self, name: str, action: Callable[[], str]) -> Disturbance:
        """Disturb, and wait until the graph works again."""
        done = Disturbance(name, time.monotonic())
        done.note = action()
        done.end_s = time.monotonic()
        if self.observer.wait(self.works(name), PATIENCE_S):
            done.recovered_s = time.monotonic()
        return done


def disturbances(soak: Soak, *, every: bool) -> list[tuple[str, Callable[[], str]]]:
    """What is done, in order; the short form does one thing of each kind.

    Processes are killed at the beginning only, so that the memory of the others can be watched for a long time.
    """
    pause, reload = ("deactivate", "activate"), ("deactivate", "cleanup", "configure", "activate")
    kills = [(f"kill {name}", lambda name=name: soak.kill(name)) for name in NODES]
    cycles = [
        (f"{what} {name}", lambda name=name, steps=steps: soak.cycle(name, steps))
        for name in NODES
        for what, steps in (("deactivate", pause), ("clean up", reload))
    ]
    stalls = [(f"stall {name}", lambda name=name: soak.stall(name)) for name in ("camera", "hand", *PERCEPTION)]
    jumps = [
        (f"clock of {name} {skew:+.0f} s", lambda name=name, skew=skew: soak.jump(name, skew))
        for name in ("hand", "camera")
        for skew in (-5.0837, 3599.0837)
    ]
    disk = [("disk full", soak.fill_disk), ("folder removed", soak.remove_folder)]
    second = [("second graph", soak.second_graph)]
    if every:
        rest = [*cycles, *stalls, *jumps, *disk, *second]
        mixed = [one for k in range(4) for one in rest[k::4]]
        return [*kills, *mixed, *mixed]
    return [kills[2], cycles[0], disk[0], stalls[0], second[0], cycles[3], jumps[0], disk[1], jumps[3], kills[4]]


def run(soak: Soak, minutes: float) -> tuple[list[Disturbance], float]:
    """Start the graph, disturb it at equal intervals, and end with some quiet seconds; gives the time of the start."""
    for name in NODES:
        if not soak.start(name):
            raise SystemExit(f"{name} does not become active; see {soak.folder / name}.log")
    seen = soak.observer.seen
    if not soak.observer.wait(lambda: bool(seen.answers), START_S):
        raise SystemExit("the first cloud is not answered")
    threading.Thread(target=soak.sample, daemon=True).start()
    origin = time.monotonic()
    plan = disturbances(soak, every=minutes >= 10)
    quiet_s = min(60.0, minutes * 6.0)
    interval_s = (minutes * 60.0 - 2 * quiet_s) / len(plan)
    done = []
    time.sleep(quiet_s)
    for number, (name, action) in enumerate(plan):
        if time.monotonic() - origin > minutes * 60.0 - quiet_s:
            print(f"{len(plan) - number} disturbances were left out: time is over", flush=True)
            break
        soak.watch()
        one = soak.disturb(name, action)
        done.append(one)
        print("  ".join(map(str, row_of(one, origin, seen.answers).values())), flush=True)
        time.sleep(max(0.0, origin + quiet_s + (number + 1) * interval_s - time.monotonic()))
    time.sleep(max(0.0, origin + minutes * 60.0 - time.monotonic()))
    soak.watch()
    soak.cycle("camera", ("deactivate",))
    time.sleep(4.0)  # what is in work is answered, and counted once more
    return done, origin


def row_of(one: Disturbance, origin: float, answers: list[float]) -> dict[str, Any]:
    """A row of `disturbances.csv`."""
    end = one.recovered_s or one.end_s
    times = [t for t in answers if one.start_s - 2.0 <= t <= end + 2.0]
    gap = max((b - a for a, b in pairwise(times)), default=float("nan"))
    recovery = "none" if one.recovered_s is None else f"{one.recovered_s - one.end_s:.2f}"
    values = (
        f"{one.start_s - origin:.1f}",
        one.name,
        f"{one.end_s - one.start_s:.1f}",
        recovery,
        f"{gap:.2f}",
        one.note,
    )
    return dict(zip(COLUMNS, values, strict=True))


def verified(path: Path) -> str:
    """Verify a dataset after repair; gives its recordings, samples and faults as text."""
    from foretouch.dataset.recording import repair_dataset, verify_dataset

    repair_dataset(path)
    reports = verify_dataset(path)
    faults = [line for report in reports for line in report.fault_lines()]
    text = f"{len(reports)} recordings, {sum(len(report.ids) for report in reports)} samples, {len(faults)} faults"
    return f"{text}: NOT CLEAN: {faults[0]}" if faults else text


def slopes(memory: list[Memory]) -> list[dict[str, Any]]:
    """Memory of the last process of each node, if it lived long enough."""
    rows = []
    for one in {one.node: one for one in memory}.values():
        kept = [k for k, t in enumerate(one.times_s) if t >= one.began_s + WARM_UP_S]
        if len(kept) < 60:
            continue
        times, values = [one.times_s[k] for k in kept], [one.megabytes[k] for k in kept]
        rows.append(
            {
                "process": one.node,
                "watched_s": round(times[-1] - times[0]),
                "first_mb": round(values[0], 1),
                "last_mb": round(values[-1], 1),
                "greatest_mb": round(max(values), 1),
                "slope_mb_per_h": round(slope_per_hour(times, values), 2),
            }
        )
    return rows


def timeline(soak: Soak, origin: float, minutes: float) -> list[dict[str, Any]]:
    """Clouds and answers per second and the memory of each process, over time."""
    step = 1.0 if minutes < 10 else 5.0
    seen, rows = soak.observer.seen, []
    played, answered = (
        Counter(int((t - origin) // step) for t in times) for times in (seen.clouds.values(), seen.answers)
    )
    for k in range(int(minutes * 60.0 / step)):
        row: dict[str, Any] = {
            "t_s": (k + 1) * step,
            "played_per_s": played[k] / step,
            "answered_per_s": answered[k] / step,
        }
        for name in NODES:
            values = [
                mb
                for one in soak.memory
                if one.node == name
                for t, mb in zip(one.times_s, one.megabytes, strict=True)
                if k <= (t - origin) / step < k + 1
            ]
            row[f"{name}_mb"] = f"{values[-1]:.1f}" if values else ""
        rows.append(row)
    return rows


def quiet_figures(seen: Any, done: list[Disturbance]) -> dict[str, float]:
    """What the computer manages without a disturbance, since it may be shared: gaps between answers, and latency."""
    busy = [(one.start_s - 1.0, (one.recovered_s or one.end_s) + 3.0) for one in done]
    answers = sorted(seen.answered_at.values())
    gaps = [b - a for a, b in pairwise(answers) if not any(a <= end and b >= start for start, end in busy)]
    latency = sorted(
        at - seen.clouds[stamp]
        for stamp, at in seen.answered_at.items()
        if stamp in seen.clouds and not any(start <= at <= end for start, end in busy)
    )
    if not gaps or not latency:
        return {}
    return {
        "longest gap between answers, undisturbed [s]": round(max(gaps), 2),
        "latency p50, undisturbed [s]": round(latency[len(latency) // 2], 3),
        "latency p95, undisturbed [s]": round(latency[len(latency) * 95 // 100], 3),
        "latency max, undisturbed [s]": round(latency[-1], 3),
    }


def summary(
    soak: Soak, done: list[Disturbance], origin: float, datasets: dict[str, str]
) -> tuple[list[dict[str, Any]], bool]:
    """The figures, and whether all limits were kept."""
    seen = soak.observer.seen
    fates, unexplained = account(seen.clouds, seen.stamps, soak.outages, seen.drops)
    errors = Counter(
        f"{name}: {key}"
        for (name, _), report in seen.reports.items()
        for key in report.values
        if key.startswith("internal_errors.")
    )
    recoveries = [one.recovered_s - one.end_s for one in done if one.recovered_s is not None]
    late = [one.name for one in done if one.recovered_s is None or one.recovered_s - one.end_s > RECOVERY_S]
    strayed = [f"dataset {name}: {text}" for name, text in datasets.items() if "NOT " in text]
    strayed += [one.name for one in done if any(word in one.note for word in ("NOT ", "REFUSED"))]
    figures: dict[str, Any] = {
        "clouds played": len(seen.clouds),
        "clouds with a repeated stamp": seen.repeated,
        **dict(sorted(fates.items())),
        "unexplained": len(unexplained),
        "further answers to an answered cloud": seen.answered_again,
        **{f"answers {name}": count for name, count in sorted(seen.statuses.items())},
        "answers that are not finite": seen.not_finite,
        "internal errors": sum(errors.values()),
        "processes that ended by themselves": len(soak.unexpected),
        "disturbances": len(done),
        "recovered within 2 s": len(done) - len(late),
        **{f"dataset {name}, repaired": text for name, text in datasets.items()},
        **quiet_figures(seen, done),
        "load of the computer, processes per core": round(os.getloadavg()[2] / (os.cpu_count() or 1), 1),
        "longest recovery [s]": round(max(recoveries, default=float("nan")), 2),
        "median recovery [s]": round(sorted(recoveries)[len(recoveries) // 2], 2) if recoveries else "",
    }
    for stamp, node in unexplained:
        print(f"  unexplained at {node}: cloud {stamp}, {seen.clouds[stamp] - origin:.1f} s after the start")
    for text in (
        *soak.unexpected,
        *errors,
        *(f"no recovery within 2 s: {n}" for n in late),
        *(f"failed: {n}" for n in strayed),
    ):
        print(f"  {text}")
    bad = bool(unexplained or seen.not_finite or errors or soak.unexpected or late or strayed)
    return [{"figure": name, "value": value} for name, value in figures.items()], not bad


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a table."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["nothing"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    """Soak; the exit status is 1 if a limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0, help="30 is the long form (default: 2)")
    parser.add_argument("--rate", type=int, default=5, help="clouds per second (default: 5)")
    parser.add_argument("--out", type=Path, default=Path("soak"), help="folder of the results (default: soak)")
    options = parser.parse_args()
    if os.geteuid() == 0 and "FORETOUCH_SOAK" not in os.environ:  # mounts of its own
        os.environ["FORETOUCH_SOAK"] = "1"
        os.execvp("unshare", ["unshare", "-m", sys.executable, *sys.argv])
    if os.geteuid() != 0:
        raise SystemExit("chaos.py: requires root, for the small disk that it fills (unshare -m, mount -t tmpfs)")
    os.environ.update(ROS_DOMAIN_ID=str(DOMAIN), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="foretouch-soak-") as name:
        soak = Soak(Path(name), options.rate)
        try:
            done, origin = run(soak, options.minutes)
        finally:
            soak.close()
            for log in Path(name).glob("*.log"):
                shutil.copy(log, options.out)
        found = {str(p.parent.relative_to(name)): p.parent for p in Path(name).rglob("session-0001.mcap")}
        figures, kept = summary(soak, done, origin, {key: verified(path) for key, path in sorted(found.items())})
        write_csv(options.out / "summary.csv", figures)
        write_csv(options.out / "memory.csv", slopes(soak.memory))
        write_csv(options.out / "disturbances.csv", [row_of(one, origin, soak.observer.seen.answers) for one in done])
        write_csv(options.out / "timeline.csv", timeline(soak, origin, options.minutes))
    for row in [*figures, *slopes(soak.memory)]:
        print("  ".join(map(str, row.values())))
    subprocess.run([sys.executable, Path(__file__).with_name("plot.py"), options.out], check=True)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())

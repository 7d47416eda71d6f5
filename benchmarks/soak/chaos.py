# SPDX-License-Identifier: Apache-2.0
"""Runs the graph in separate processes, breaks one thing after the other, and accounts for every cloud (see README.md)."""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import ROOT, write_csv
from benchmarks.ros import NAMESPACE, end, prepare_domain, spawn
from benchmarks.soak.accounting import Outage, account
from benchmarks.soak.observer import DOMAIN, Observer

NODES = ("perception", "hand", "recorder", "camera")
START_S = 90.0  # that a process may take until it is active, on a busy computer
RECOVERY_S = 2.0  # the limit
PATIENCE_S = 20.0  # that is waited for a recovery
WARM_UP_S = 600.0  # of a process, at most a third of the run: the recorder keeps the clouds of the last minute
STALL_S = 6.0  # longer than `silence_s`, so that diagnostics must name it
TMPFS_MB = 64


def memory_row(node: str, sizes: Sequence[tuple[float, float]], warm_up_s: float) -> dict[str, Any] | None:
    """Return a row of `memory.csv` from times [s] and sizes [MB] of a process, if it lived long enough."""
    kept = np.array([size for size in sizes if size[0] >= sizes[0][0] + warm_up_s])
    if len(kept) < 60:
        return None
    times, values = kept.T
    slope = np.polyfit(times / 3600.0, values, 1)[0]
    sizes_mb = {"first_mb": values[0], "last_mb": values[-1], "greatest_mb": values.max(), "slope_mb_per_h": slope}
    return {"process": node, "watched_s": round(times[-1] - times[0])} | {k: round(v, 2) for k, v in sizes_mb.items()}


class Soak:
    """The graph, which records into a folder, and what is done to it."""

    def __init__(self, folder: Path) -> None:
        scene = {"scene.path": ROOT / "config" / "scenes" / "clean.yaml", "scene.origin_ns": time.time_ns()}
        patience = {"camera.silence_s": 20.0}
        self._parameters: dict[str, dict[str, Any]] = {
            "camera": {"source": "scene", "camera.fps": 5, **patience, **scene},
            "hand": scene,
            "recorder": {"folder": folder, "record": "main", "writing.min_free_mb": 0.0},  # written to until it refuses
        }
        self.folder = folder
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.memory: dict[str, list[tuple[float, float]]] = {}  # of the latest process of each node: time [s], [MB]
        self.outages: list[Outage] = []
        self.unexpected: list[str] = []  # processes that ended by themselves
        self.seen = Observer()
        self._sessions = 0

    # Processes.

    def start(self, name: str) -> bool:
        """Start a node and wait until it reports that it is active."""
        before = self.seen.processes(name)
        looks = {"input": "points"} if name == "perception" else {}
        parameters = {"diagnostics_period_s": 0.25, **looks, **self._parameters.get(name, {})}
        self.processes[name] = spawn((name,), parameters, self.folder / f"{name}.log")
        self.memory[name] = []
        return self.seen.wait(lambda: self.seen.active(name, before), START_S)

    def watch(self, until_s: float) -> None:
        """Until then, read the memory of all processes once a second, and note those that ended by themselves.

        It is what is resident without the pages that they share: each reads the 64 MB of shared memory into which another
        writes its messages, page by page, which counts as resident.
        """
        while time.monotonic() < until_s:
            for name, process in self.processes.items():
                if (status := process.poll()) is not None:
                    self.unexpected.append(f"{name}: exit status {status}")
                    self.start(name)
                lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
                sizes = [int(line.split()[1]) for line in lines if line.startswith(("RssAnon:", "RssFile:"))]
                if sizes:  # a process that has just ended has none
                    self.memory[name].append((time.monotonic(), sum(sizes) * 1024 / 1e6))
            time.sleep(1.0)

    def close(self) -> None:
        """End all processes, and leave the graph."""
        for process in self.processes.values():
            process.terminate()
        ended = {name: end(process, 15.0) for name, process in self.processes.items()}
        self.unexpected += [f"{name}: did not end within 15 s of SIGTERM" for name, done in ended.items() if not done]
        self.seen.leave()

    # Disturbances. Each returns when its cause is gone, with a note.

    def kill(self, name: str) -> str:
        """SIGKILL, and start again."""
        began = time.monotonic()
        self.processes[name].kill()
        self.processes[name].wait()
        active = self.start(name)
        self.outages.append(Outage(name, "killed", began, time.monotonic()))
        return f"active {time.monotonic() - began:.1f} s after SIGKILL" if active else "NOT ACTIVE AGAIN"

    def cycle(self, name: str, *transitions: str) -> str:
        """Go through transitions of the lifecycle."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        began, refused = time.monotonic(), []
        for label in transitions:
            request = ChangeState.Request(transition=Transition(id=getattr(Transition, f"TRANSITION_{label.upper()}")))
            answer = self.seen.call(ChangeState, f"{NAMESPACE}/{name}/change_state", request)
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

    def jump(self, seconds: float) -> str:
        """Let the clock of the hand jump, and back some seconds later."""
        for skew in (seconds, 0.0):
            answer = self.seen.set_parameter("hand", "faults.skew_s", skew)
            if answer is None or not answer.successful:
                return "REFUSED"
            time.sleep(5.0 if skew else 0.0)
        return ""

    def record_anew(self, path: Path | None = None) -> str:
        """End the recording and begin another one, by default in a new dataset on the disk; gives the error."""
        from foretouch_msgs.srv import StartRecording, StopRecording

        seen = self.seen
        seen.call(StopRecording, f"{NAMESPACE}/stop_recording", StopRecording.Request())
        self._sessions += path is None
        request = StartRecording.Request(path=str(path or f"main-{self._sessions}"), object="can")
        answer = seen.call(StartRecording, f"{NAMESPACE}/start_recording", request)
        if answer is None or not answer.success:
            return "no answer" if answer is None else str(answer.message)
        shown = seen.wait(lambda: seen.recorder.recording and seen.recorder.path == answer.path, PATIENCE_S)
        return "" if shown else "recorder_status does not show it"

    def reported(self, began: float) -> str:
        """Return how soon the recorder has reported the end of its recording, and how."""
        if not self.seen.wait(lambda: self.seen.recorder is not None and not self.seen.recorder.recording, 10.0):
            return "NOT NOTICED"
        return f"reported after {time.monotonic() - began:.1f} s: {self.seen.recorder.reason}"

    def fill_disk(self) -> str:
        """Record onto a small disk and fill it to the last byte."""
        disk = self.folder / "small"
        disk.mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={TMPFS_MB}m", "tmpfs", disk], check=True)
        try:
            if error := self.record_anew(disk / "set"):
                return f"NOT STARTED: {error}"
            time.sleep(2.0)
            ballast, began = disk / "ballast", time.monotonic()
            with ballast.open("wb", buffering=0) as file:
                try:
                    while True:
                        file.write(bytes(65536))
                except OSError:
                    pass
            note = self.reported(began)
            ballast.unlink()
            return f"{note}; {verified(disk / 'set')}" + self.record_anew()
        finally:
            subprocess.run(["umount", "-l", disk], check=False)

    def remove_folder(self) -> str:
        """Remove the dataset that is being recorded."""
        if error := self.record_anew():
            return f"NOT STARTED: {error}"
        time.sleep(2.0)
        began = time.monotonic()
        shutil.rmtree(self.folder / f"main-{self._sessions}")
        return self.reported(began) + self.record_anew()

    # The course of the soak.

    def works(self, name: str) -> Callable[[], bool]:
        """Return a condition that holds once the part of the graph that a disturbance concerns works again."""
        seen, since = self.seen, time.monotonic()
        if "hand" in name:
            return lambda: seen.tactile_s > since
        if "recorder" in name or "disk" in name or "folder" in name:
            used = 0 if seen.recorder is None else seen.recorder.used
            return lambda: seen.recorder is not None and seen.recorder.recording and seen.recorder.used != used
        return lambda: bool(seen.answers) and seen.answers[-1] > since

    def disturb(self, name: str, action: Callable[[], str], origin: float) -> dict[str, Any]:
        """Disturb, wait until the graph works again, and return a row of `disturbances.csv`.

        Recovery is the time from when the cause is gone (the process is active, the topic flows, the space is free) to the first sign of normal work.
        """
        start_s = time.monotonic()
        note, end_s = action(), time.monotonic()
        recovered = self.seen.wait(self.works(name), PATIENCE_S)
        recovery = f"{time.monotonic() - end_s:.2f}" if recovered else "none"
        times = {"t_s": f"{start_s - origin:.1f}", "disturbance": name, "lasted_s": f"{end_s - start_s:.1f}"}
        return {**times, "recovery_s": recovery, "note": note}


def disturbances(soak: Soak, *, every: bool) -> list[tuple[str, Callable[[], str]]]:
    """Return what is done, in order; the short form does one thing of each kind.

    Processes are killed at the beginning only, so that the memory of the others can be watched for a long time.
    """
    kills = [(f"kill {name}", partial(soak.kill, name)) for name in NODES]
    cycles = [
        (f"{what} {name}", partial(soak.cycle, name, *steps))
        for name in NODES
        for what, steps in (
            ("deactivate", ("deactivate", "activate")),
            ("clean up", ("deactivate", "cleanup", "configure", "activate")),
        )
    ]
    stalls = [(f"stall {name}", partial(soak.stall, name)) for name in ("camera", "hand", "perception")]
    jumps = [(f"clock of hand {skew:+.0f} s", partial(soak.jump, skew)) for skew in (-5.0837, 3599.0837)]
    disk = [("disk full", soak.fill_disk), ("folder removed", soak.remove_folder)]
    if every:
        rest = [*cycles, *stalls, *jumps, *disk]
        mixed = [disturbance for k in range(4) for disturbance in rest[k::4]]
        return [*kills, *mixed, *mixed]
    return [kills[0], cycles[0], disk[0], stalls[0], cycles[1], jumps[0], disk[1], jumps[1], kills[2]]


def run(soak: Soak, minutes: float, *, quiet: bool) -> tuple[list[dict[str, Any]], float]:
    """Start the graph, disturb it at equal intervals unless `quiet`, and end with some quiet seconds; gives the time of the start."""
    began = time.monotonic()
    for name in NODES:
        if not soak.start(name):
            raise SystemExit(f"{name} does not become active; see {soak.folder / name}.log")
    if not soak.seen.wait(lambda: bool(soak.seen.answers), START_S):
        raise SystemExit("the first cloud is not answered")
    soak.outages.append(Outage("perception", "not yet connected", began, time.monotonic()))
    origin = time.monotonic()
    plan = [] if quiet else disturbances(soak, every=minutes >= 10)
    quiet_s = min(60.0, minutes * 6.0)
    interval_s = (minutes * 60.0 - 2 * quiet_s) / max(len(plan), 1)
    done = []
    soak.watch(origin + quiet_s)
    for number, (name, action) in enumerate(plan):
        if time.monotonic() - origin > minutes * 60.0 - quiet_s:
            print(f"{len(plan) - number} disturbances were left out: time is over", flush=True)
            break
        done.append(soak.disturb(name, action, origin))
        print("  ".join(done[-1].values()), flush=True)
        soak.watch(origin + quiet_s + (number + 1) * interval_s)
    soak.watch(origin + minutes * 60.0)
    soak.cycle("camera", "deactivate")
    time.sleep(4.0)  # what is in work is answered, and counted once more
    return done, origin


def verified(path: Path) -> str:
    """Verify a dataset after repair; gives its recordings, samples and faults as text."""
    from foretouch.dataset.recordings.repair import repair_dataset
    from foretouch.dataset.recordings.verify import verify_dataset

    repair_dataset(path)
    reports = verify_dataset(path)
    faults = [line for report in reports for line in report.fault_lines()]
    text = f"{len(reports)} recordings, {sum(len(report.ids) for report in reports)} samples, {len(faults)} faults"
    return f"{text}: NOT CLEAN: {faults[0]}" if faults else text


def latency_rows(seen: Observer, origin: float, minutes: float) -> list[dict[str, Any]]:
    """Return the latency of the answers in each tenth of the time."""
    latencies_ms: dict[int, list[float]] = {}
    for stamp, at in seen.answered_at.items():
        if stamp in seen.clouds:
            latencies_ms.setdefault(int((at - origin) / (6.0 * minutes)), []).append(1e3 * (at - seen.clouds[stamp]))
    return [
        {"from_min": round(tenth * minutes / 10.0, 1), "answers": len(values)}
        | {f"p{q}_ms": round(float(np.percentile(values, q)), 1) for q in (50, 95, 99)}
        for tenth, values in sorted(latencies_ms.items())
    ]


def summary(
    soak: Soak, done: Sequence[Mapping[str, Any]], origin: float, datasets: Mapping[str, str]
) -> dict[str, Any]:
    """Return the figures; what breaks a limit is printed, and `limits broken` counts it."""
    seen = soak.seen
    fates, unexplained = account(seen.clouds, seen.stamps, soak.outages, seen.drops)
    reported = [(name, key) for (name, _), report in seen.reports.items() for key in report.values]
    errors = [f"{name}: {key}" for name, key in reported if "internal_errors." in key]
    recoveries = [PATIENCE_S if row["recovery_s"] == "none" else float(row["recovery_s"]) for row in done]
    late = [row["disturbance"] for row, recovery in zip(done, recoveries, strict=True) if recovery > RECOVERY_S]
    broken = [
        *(
            f"unexplained at {node}: {seen.clouds[stamp] - origin:.1f} s after the start, followed by "
            f"{sum(other > stamp for other in seen.clouds)} clouds"
            for stamp, node in unexplained
        ),
        *["an answer is not finite"] * seen.not_finite,
        *soak.unexpected,
        *errors,
        *(f"no recovery within {RECOVERY_S:g} s: {name}" for name in late),
        *(f"dataset {name}: {text}" for name, text in datasets.items() if "NOT " in text),
        *(f"failed: {row['disturbance']}" for row in done if "NOT " in row["note"] or "REFUSED" in row["note"]),
    ]
    print("".join(f"  {text}\n" for text in broken), end="")
    return {
        "limits broken": len(broken),
        "clouds played": len(seen.clouds),
        "clouds with a repeated stamp": seen.repeated,
        **dict(sorted(fates.items())),
        "unexplained": len(unexplained),
        **{f"answers {name}": count for name, count in sorted(seen.statuses.items())},
        "answers that are not finite": seen.not_finite,
        "internal errors": len(errors),
        "processes that ended by themselves": len(soak.unexpected),
        "disturbances": len(done),
        "recovered within 2 s": len(done) - len(late),
        **{f"dataset {name}, repaired": text for name, text in datasets.items()},
        "load of the computer, processes per core": round(os.getloadavg()[2] / (os.cpu_count() or 1), 1),
        "longest recovery [s]": max(recoveries, default=0.0),
        "median recovery [s]": round(float(np.median(recoveries or [0.0])), 2),
    }


def main() -> int:
    """Soak; the exit status is 1 if a limit was not kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0, help="30 is the long form (default: 2)")
    parser.add_argument("--quiet", action="store_true", help="disturb nothing")
    parser.add_argument("--out", type=Path, default=Path("soak"), help="folder of the results (default: soak)")
    options = parser.parse_args()
    if os.geteuid() != 0:
        raise SystemExit("chaos.py: requires root, for the small disk that it fills (unshare -m, mount -t tmpfs)")
    if "FORETOUCH_SOAK" not in os.environ:  # mounts of its own
        os.environ["FORETOUCH_SOAK"] = "1"
        os.execvp("unshare", ["unshare", "-m", sys.executable, "-m", "benchmarks.soak.chaos", *sys.argv[1:]])
    prepare_domain(DOMAIN)
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="foretouch-soak-") as name:
        soak = Soak(Path(name))
        try:
            done, origin = run(soak, options.minutes, quiet=options.quiet)
        finally:
            soak.close()
            for log in Path(name).glob("*.log"):
                shutil.copy(log, options.out)
        folders = {str(p.parent.relative_to(name)): p.parent for p in Path(name).rglob("session-0001.mcap")}
        figures = summary(soak, done, origin, {key: verified(path) for key, path in sorted(folders.items())})
    warm_up_s = min(WARM_UP_S, 20.0 * options.minutes)
    memory = [row for name, sizes in soak.memory.items() if (row := memory_row(name, sizes, warm_up_s))]
    tables = {
        "summary": [{"figure": key, "value": value} for key, value in figures.items()],
        "memory": memory,
        "disturbances": done,
        "latency": latency_rows(soak.seen, origin, options.minutes),
    }
    for key, rows in tables.items():
        write_csv(options.out / f"{key}.csv", rows or [{"nothing": ""}])
    for row in (*tables["summary"], *memory, *tables["latency"]):
        print("  ".join(map(str, row.values())))
    return int(figures["limits broken"] > 0)


if __name__ == "__main__":
    sys.exit(main())

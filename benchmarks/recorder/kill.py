# SPDX-License-Identifier: Apache-2.0
"""Kills a recorder with SIGKILL at random instants, and counts acknowledged and lost samples (see README.md).

python benchmarks/recorder/kill.py [--rounds 100] [--seed 0] [--json]
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings import writer as writer_module
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, Sample

IDENTITY = Identity(hand={"name": "campaign"}, camera={"name": "campaign"})
POINTS = 5000
LONGEST_S = 0.6
ROUNDS_A_DATASET = 5
TOPIC = "/rh/tactile"


def made_sample(number: int, points: int = POINTS) -> Sample:
    """Return a sample whose content is determined by its number."""
    rng = np.random.default_rng(number)
    xyz = rng.normal(size=(points, 3)).astype(np.float32)
    rgb = rng.integers(0, 256, (points, 3), dtype=np.uint8)
    touch = biotac_touch(rng.integers(100, 3000, 50).astype(float))
    grasp = Grasp(xyz[0].astype(float), xyz[1].astype(float), np.eye(3), float(number), str(number))
    return Sample("", "ball", Cloud(xyz, rgb, "camera", number), grasp, touch, None, number)


def contents(folder: Path) -> dict[str, int]:
    """Return the id and number of every sample; -1 if its content differs from that of its number."""
    if not (folder / "manifest.json").exists():
        return {}
    result = {}
    for sample in RecordedDataset(folder):
        number = int(sample.grasp.score)
        same = np.array_equal(sample.cloud.xyz, made_sample(number).cloud.xyz)
        result[sample.id] = number if same else -1
    return result


def record_forever(folder: Path) -> None:
    """Record until killed; runs in the child process."""
    rng = np.random.default_rng()
    message = b"\0\1\0\0" + bytes(300)
    writer_module.CHUNK_S, writer_module.COUNTS_S = 0.01, 0.1
    config = RecordingConfig(fsync_samples=1)
    number = max(contents(folder).values(), default=0)
    os.write(1, b"ready\n")
    while True:
        with RecordingWriter(folder, IDENTITY, config) as writer:
            writer.add_topic(TOPIC, "foretouch_msgs/msg/BiotacAll")
            for _ in range(int(rng.integers(1, 30))):
                for k in range(5):
                    writer.receive(TOPIC)
                    writer.write(TOPIC, message, time.time_ns() + k)
                number += 1
                given = writer.append(made_sample(number))
                os.write(1, f"{given} {number}\n".encode())


def kill_once(number: int, folder: Path, delay_s: float) -> dict[str, Any]:
    """Start the recorder, kill it after a while, repair, verify and compare.

    Every second kill waits for the first sample, so that the kill hits appending, not only starting, on a busy machine too.
    """
    known = set(contents(folder))
    command = [sys.executable, __file__, "--child", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        if process.stdout.readline() != b"ready\n":
            raise SystemExit("the recorder did not start")
        first = process.stdout.readline() if number % 2 else b""
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        output = (first + process.stdout.read()).decode()
    printed = [line.split() for line in output.splitlines() if line.count(" ") == 1]
    acknowledged = {given: int(content) for given, content in printed}
    repairs = repair_dataset(folder) if folder.exists() and (folder / "manifest.json").exists() else []
    clean = all(report.clean for report in verify_dataset(folder)) if repairs else not acknowledged
    there = contents(folder)
    return {
        "number": number,
        "acknowledged": len(acknowledged),
        "found": len(there.keys() - known),
        "lost": len((acknowledged.keys() | known) - there.keys()),
        "wrong": sum(there.get(given, content) != content for given, content in acknowledged.items()),
        "not_clean": int(not clean),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        record_forever(arguments.child)
    rng, rounds = np.random.default_rng(arguments.seed), []
    with tempfile.TemporaryDirectory(prefix="foretouch-kill-") as root:
        for number in range(arguments.rounds):
            folder = Path(root) / "dataset"
            if number % ROUNDS_A_DATASET == 0:  # several kills hit one dataset, which each recorder resumes
                shutil.rmtree(folder, ignore_errors=True)
            rounds.append(kill_once(number, folder, float(rng.uniform(0.0, LONGEST_S))))
            if not arguments.json:
                print(", ".join(f"{name} {value}" for name, value in rounds[-1].items()), flush=True)
    total = {name: sum(round_[name] for round_ in rounds) for name in ("acknowledged", "lost", "wrong", "not_clean")}
    total = {"kills": len(rounds), **total}
    text = ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in total.items())
    print(json.dumps({**total, "rounds": rounds}) if arguments.json else text)
    return int(total["lost"] + total["wrong"] + total["not_clean"] > 0)


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Structured fuzzing of every reader of files: each case is one small valid file with a few changes.

Files are read in a child process that serves many cases, so that a crash by a signal is detected, named and its file kept.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SECONDS = 1.0  # of CPU time that a reader may take
PATIENCE_S = 20.0  # of wall time until the child is killed
START_S = 180.0  # more for the first file, since the child starts and imports
MEMORY = 2_000_000_000  # bytes that the child may map beyond what its imports take
LINE = 3000  # characters of the longest refusal
COLUMNS = ("kind", "cases", "refused", "read", "changed in silence", "uncaught", "signal", "slow", "slowest_ms")
EXACT = ("store", "recording")  # what is read must be what was written
_NUMBERS = (
    b"0",
    b"-1",
    b"1",
    b"2147483647",
    b"4294967296",
    b"1e10",
    b"nan",
    b"inf",
    b"1e400",
    b"9" * 4400,
    b"",
    b"true",
)
_WORDS = (b"null", b"[]", b"{}", b"*a", b"&a", b"!!int x", b"2026-13-45", b"\0", b"\xff", b"[" * 300, b'"\\ud800"')


# --- what is read -----------------------------------------------------------------------------------------------


def cloud_digest(path: Path) -> str:
    """Read a cloud."""
    from foretouch.cloud.io.files import read_cloud

    cloud = read_cloud(path)
    return hashlib.sha256(cloud.xyz.tobytes()).hexdigest()


def samples_digest(path: Path) -> str:
    """Read every sample of a dataset; the digest of all their values in order."""
    from foretouch.dataset.samples import open_samples
    from foretouch.dataset.store import sample_digest

    digest = hashlib.sha256()
    with open_samples(path) as samples:
        for record in samples.records(discarded=True):
            digest.update(sample_digest(record.sample))
            digest.update(repr((record.outcome, record.flags, record.contact_ns)).encode())
    return digest.hexdigest()


def model_digest(path: Path) -> str:
    """Load a touch model and predict one grasp, which must be finite or refused."""
    from foretouch.models.registry import load_model
    from foretouch.types import Cloud, Grasp

    model = load_model(path)
    xyz = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32) * 0.03 + np.float32([0, 0, 0.5])
    grasp = Grasp(np.array([0.03, 0, 0.5]), np.array([-0.03, 0, 0.5]), np.eye(3))
    prediction = model.predict(Cloud(xyz), [grasp])[0]
    values = None if prediction.value is None else prediction.value.vector()
    if values is not None and not np.isfinite(values).all():
        raise ArithmeticError("the prediction is not finite")
    return repr(values)


def settings_digest(path: Path) -> str:
    """Read pipeline settings."""
    from foretouch.config import load_yaml
    from foretouch.pipeline import PipelineConfig

    return repr(PipelineConfig.from_mapping(load_yaml(path), str(path)))


def card_digest(path: Path) -> str:
    """Read the card of a model."""
    from foretouch.models.card import read_card

    return repr(read_card(path))


def bag_digest(path: Path) -> str:
    """Read every message of a recording with the parsers of rosbags."""
    from foretouch.dataset.bag import Recording

    digest = hashlib.sha256()
    with Recording(path) as recording:
        for message in recording.messages():
            digest.update(message.data)
    return digest.hexdigest()


# --- changes -----------------------------------------------------------------------------------------------------


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes of a file."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.5 else 1):
        data = _changed(data, rng)
    return bytes(data)


def _changed(data: bytearray, rng: np.random.Generator) -> bytearray:
    size = len(data)
    at = int(rng.integers(0, size + 1))
    if rng.random() < 0.3:
        at = min(at, int(rng.integers(0, 512)))  # headers decide most
    length = int(rng.integers(1, 1 + min(64, max(size, 1))))
    way = int(rng.integers(0, 9))
    if way == 0 and size:  # a flipped bit
        data[min(at, size - 1)] ^= 1 << int(rng.integers(0, 8))
    elif way == 1:  # another byte
        data[at : at + 1] = rng.bytes(1)
    elif way == 2:  # an integer of 1 to 8 bytes
        width = int(rng.choice([1, 2, 4, 8]))
        at -= at % width if rng.random() < 0.7 else 0
        values = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1, int(rng.integers(0, 2**32)))
        value = int(rng.choice(np.array(values, object))) % 256**width
        data[at : at + width] = value.to_bytes(width, "little")[: max(size - at, 0)]
    elif way == 3:  # truncated
        del data[at:]
    elif way == 4:  # duplicated
        data[at:at] = data[at : at + length * 16]
    elif way == 5:  # inserted
        data[at:at] = rng.bytes(length)
    elif way == 6:  # removed
        del data[at : at + length]
    else:  # another number or word in a text
        pattern = rb"-?\d+(\.\d+)?" if way == 7 else rb"[A-Za-z_]+"
        found = list(re.finditer(pattern, bytes(data[:20_000])))
        if found:
            match = found[int(rng.integers(0, len(found)))]
            choices = _NUMBERS if way == 7 else _NUMBERS + _WORDS
            data[match.start() : match.end()] = choices[int(rng.integers(0, len(choices)))]
    return data


# --- what is changed --------------------------------------------------------------------------------------------


@dataclass
class Kind:
    """One kind of file.

    Attributes:
        make: Writes a valid file, or a folder of files, below a folder; returns the path that is read.
        read: Reads it.
        changed: Glob patterns, in the folder, of the files that are changed.
        after: Called with the folder after a change, such as to write the new hash of a changed file.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], str]
    changed: tuple[str, ...] = ("*",)
    after: Callable[[Path], None] = lambda _: None


def _cloud(suffix: str, text: Callable[[bytes], bytes] | None = None) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from foretouch.cloud.io.files import write_cloud
        from foretouch.types import Cloud

        rng = np.random.default_rng(1)
        path = folder / f"cloud{suffix}"
        rgb = rng.integers(0, 255, (4, 6, 3), np.uint8) if text is None else None
        write_cloud(path, Cloud(rng.random((4, 6, 3), np.float32), rgb, "camera", 7))
        if text is not None:
            path.write_bytes(text(path.read_bytes()))
        return path

    return make


def _ascii_pcd(content: bytes) -> bytes:
    head, _, body = content.partition(b"DATA binary\n")
    rows = np.frombuffer(body, "<f4").reshape(-1, 3)
    return head + b"DATA ascii\n" + "".join(f"{x} {y} {z}\n" for x, y, z in rows).encode()


def _compressed_pcd(folder: Path) -> Path:
    """By Open3D; the coordinates are rounded and repeated, so that the data refer back to themselves."""
    from foretouch.libusb import ensure_libusb

    ensure_libusb()
    import open3d

    xyz = np.tile(np.random.default_rng(1).random((12, 3)).round(1), (3, 1))
    path = folder / "cloud.pcd"
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz))
    open3d.io.write_point_cloud(str(path), points, compressed=True)
    return path


def _ascii_ply(content: bytes) -> bytes:
    head, _, body = content.partition(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(-1, 3)
    text = "".join(f"{x} {y} {z}\n" for x, y, z in rows).encode()
    return head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + text


def _builders() -> None:
    sys.path.insert(0, str(Path(__file__).parents[2] / "test"))


def _store(folder: Path) -> Path:
    _builders()
    from recording_builders import record

    from foretouch.dataset.store_writer import StoreWriter

    with StoreWriter(folder / "store", {"scene": "x"}) as writer:
        for k in range(5):
            sample = record(k, points=6, labelled=k != 3).sample
            writer.write(type(sample)(**{**sample.__dict__, "id": f"ball/{k}"}))
        writer.attach("splits.json", json.dumps({"schema_version": 1, "splits": {}}))
    return folder / "store"


def _reseal(folder: Path) -> None:
    from foretouch.dataset.manifest import sealed
    from foretouch.dataset.store import SEAL

    path = folder / "store" / "manifest.json"
    manifest = json.loads(path.read_text())
    for part in [*manifest["shards"], *manifest["files"]]:
        part["sha256"] = hashlib.sha256((folder / "store" / part["file"]).read_bytes()).hexdigest()
    path.write_text(sealed(manifest, SEAL))


def _recording(folder: Path) -> Path:
    _builders()
    from recording_builders import write_dataset

    write_dataset(folder / "recording", 3, points=6)
    return folder / "recording"


def _bag(folder: Path) -> Path:
    return next(_recording(folder).glob("*.mcap"))


def _vision2tactile(folder: Path) -> Path:
    _builders()
    from recording_builders import record

    from foretouch.cloud.io.files import write_cloud

    sample = folder / "can" / "1500000000"
    sample.mkdir(parents=True)
    write_cloud(sample / "cloud-object.pcd", record(0, points=30).sample.cloud)
    (sample / "best-grasp.txt").write_text("0.1,0.2,0.3,-0.1,0.25,0.31")
    (sample / "tactile.tac").write_text("," + ",".join(str(k) for k in range(1000, 1058)))
    return folder / "can"


def _model(folder: Path) -> Path:
    _builders()
    from calibrated_models import save_calibrated_contact

    return Path(save_calibrated_contact(folder))


def _rehash(folder: Path) -> None:
    path = folder / "contact.json"
    card = json.loads(path.read_text())
    card["sha256"] = hashlib.sha256((folder / "contact.safetensors").read_bytes()).hexdigest()
    trust = (folder / "contact.trust.safetensors").read_bytes()
    card["calibration"]["sha256"] = hashlib.sha256(trust).hexdigest()
    path.write_text(json.dumps(card))


def _settings(folder: Path) -> Path:
    import yaml

    from foretouch.pipeline import PipelineConfig

    path = folder / "settings.yaml"
    path.write_text("# settings\n" + yaml.safe_dump(PipelineConfig().to_mapping()))
    return path


KINDS: dict[str, Kind] = {
    "pcd": Kind(_cloud(".pcd"), cloud_digest),
    "pcd ascii": Kind(_cloud(".pcd", _ascii_pcd), cloud_digest),
    "ply": Kind(_cloud(".ply"), cloud_digest),
    "ply ascii": Kind(_cloud(".ply", _ascii_ply), cloud_digest),
    "npz": Kind(_cloud(".npz"), cloud_digest),
    "npy": Kind(_cloud(".npy"), cloud_digest),
    "store": Kind(_store, samples_digest, ("store/*",)),
    "store resealed": Kind(_store, samples_digest, ("store/*.arrow",), _reseal),
    "recording": Kind(_recording, samples_digest, ("recording/manifest.json", "recording/*.mcap")),
    "bag": Kind(_bag, bag_digest, ("recording/*.mcap",)),
    "vision2tactile": Kind(_vision2tactile, samples_digest, ("can/*/*",)),
    "model": Kind(_model, model_digest),
    "model rehashed": Kind(_model, model_digest, ("*.safetensors",), _rehash),
    "card": Kind(_model, card_digest, ("*.json",)),
    "yaml": Kind(_settings, settings_digest),
    "pcd compressed": Kind(_compressed_pcd, cloud_digest),  # last, since a case's seed holds the number of its kind
}


# --- the child --------------------------------------------------------------------------------------------------


def serve() -> None:
    """Read the cases that standard input names, and answer each with a line of JSON."""
    import gc
    import warnings

    from foretouch.errors import ForetouchError

    warnings.simplefilter("ignore")
    answers = sys.stdout
    sys.stdout = sys.stderr
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MEMORY, mapped + MEMORY))
    for line in sys.stdin:
        kind, path = json.loads(line)
        began = time.process_time()
        answer: dict[str, Any]
        try:
            answer = {"outcome": "read", "detail": KINDS[kind].read(Path(path))}
        except ForetouchError as err:
            text = str(err)
            clear = "\n" not in text and len(text) < LINE
            answer = {"outcome": "refused" if clear else "uncaught", "detail": text if clear else f"unclear: {text}"}
        except BaseException as err:  # noqa: BLE001 - whatever is not ForetouchError is what is searched for
            answer = {"outcome": "uncaught", "detail": f"{type(err).__name__}: {err} at {_place(err)}"}
        answer["seconds"] = time.process_time() - began
        print(json.dumps(answer), file=answers, flush=True)
        if kind in ("store", "bag"):
            gc.collect()


def _place(err: BaseException) -> str:
    trace = err.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"


@dataclass
class Child:
    """A process that reads; started again after it ended."""

    process: subprocess.Popen[str] | None = field(default=None)

    def read(self, kind: str, path: Path) -> dict[str, Any]:
        """The child's answer; a crash or a hang of it is an answer too."""
        patience_s = PATIENCE_S
        if self.process is None:
            patience_s += START_S
            self.process = subprocess.Popen(
                [sys.executable, __file__, "--serve"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(json.dumps([kind, str(path)]) + "\n")
            self.process.stdin.flush()
            line = self._line(patience_s)
        except (BrokenPipeError, TimeoutError) as err:
            line = ""
            if isinstance(err, TimeoutError):
                self.close()
                return {"outcome": "slow", "detail": "killed", "seconds": PATIENCE_S}
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        status = self.process.wait()
        self.process = None
        return {"outcome": "signal", "detail": f"exit status {status}", "seconds": 0.0}

    def _line(self, patience_s: float) -> str:
        import select

        assert self.process is not None
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], patience_s)[0]:
            raise TimeoutError
        return self.process.stdout.readline()

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


# --- the parent -------------------------------------------------------------------------------------------------


def run(kind: str, cases: int, seed: int, keep: Path | None = None) -> tuple[dict[str, Any], list[str]]:
    """Read some changed files of one kind.

    Returns:
        A row of `results.csv`, and a line for each fault.
    """
    counts: Counter[str] = Counter()
    faults: list[str] = []
    slowest = 0.0
    child = Child()
    with tempfile.TemporaryDirectory(prefix="foretouch-fuzz-") as name:
        folder = Path(name)
        path = KINDS[kind].make(folder)
        files = sorted(p for pattern in KINDS[kind].changed for p in folder.glob(pattern) if p.is_file())
        files = [file for file in files if file.name != ".lock"]
        before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
        original = child.read(kind, path)
        if original["outcome"] != "read":
            raise SystemExit(f"{kind}: the valid file is not read: {original['detail']}")
        for number, rng in _generators(kind, cases, seed):
            file = files[int(rng.integers(0, len(files)))]
            file.write_bytes(mutated(before[file], rng))
            KINDS[kind].after(folder)
            answer = child.read(kind, path)
            outcome = answer["outcome"]
            slowest = max(slowest, answer["seconds"])
            if outcome == "read" and kind in EXACT and answer["detail"] != original["detail"]:
                outcome = "changed in silence"
            if outcome in ("read", "refused") and answer["seconds"] > SECONDS:
                outcome = "slow"
            counts[outcome] += 1
            if outcome not in ("read", "refused"):
                faults.append(f"{kind} {seed} {number} {file.name}: {outcome}: {answer['detail'][:300]}")
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    shutil.copy(file, keep / f"{kind.replace(' ', '-')}-{seed}-{number}-{file.name}")
            for changed, content in before.items():
                if changed == file or (changed.suffix == ".json" and KINDS[kind].changed != ("*",)):
                    changed.write_bytes(content)
    child.close()
    row = {"kind": kind, "cases": cases, **{name: counts[name] for name in COLUMNS[2:-1]}}
    return {**row, "slowest_ms": round(slowest * 1e3, 1)}, faults


def _generators(kind: str, cases: int, seed: int) -> Iterator[tuple[int, np.random.Generator]]:
    for number in range(cases):
        yield number, np.random.default_rng([seed, list(KINDS).index(kind), number])


def write_table(path: Path, rows: list[dict[str, object]]) -> None:
    """Write rows of `COLUMNS` as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    """Run all kinds; the exit status is 1 if a case broke a rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300, help="changed files in all (default 300)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append", help="only this kind; may be repeated")
    parser.add_argument("--keep", type=Path, help="folder for the files that break a rule")
    parser.add_argument("--out", type=Path, help="write the table as CSV")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return 0
    kinds = arguments.kind or list(KINDS)
    rows = []
    failed = False
    print("  ".join(COLUMNS))
    for kind in kinds:
        row, faults = run(kind, -(-arguments.cases // len(kinds)), arguments.seed, arguments.keep)
        rows.append(row)
        print("  ".join(str(row[name]) for name in COLUMNS), flush=True)
        for fault in faults:
            print(f"  {fault}", flush=True)
        failed |= bool(faults)
    if arguments.out:
        write_table(arguments.out, rows)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())

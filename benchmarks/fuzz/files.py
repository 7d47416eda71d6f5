# SPDX-License-Identifier: Apache-2.0
"""Structured fuzzing of every reader of files: each case is one small valid file with a few changes."""

import hashlib
import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.fuzz.driver import Case, Kind, main
from benchmarks.recorder.kill import IDENTITY, made_sample
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import load_yaml
from foretouch.dataset.bag import Recording
from foretouch.dataset.files import sealed
from foretouch.dataset.record import HOLD, REST, SampleRecord, TouchSeries
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import open_samples
from foretouch.dataset.store import SEAL, sample_digest
from foretouch.models.card import read_card
from foretouch.models.contact.cheaper import fewer_trees
from foretouch.models.contact.estimator import save_contact
from foretouch.models.registry import load_model
from foretouch.pipeline import PipelineConfig
from foretouch.types import Cloud, Grasp
from foretouch_lab.dataset.store_writer import StoreWriter

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


# What is read.


def cloud_digest(path: Path) -> str:
    """Read a cloud."""
    return hashlib.sha256(read_cloud(path).xyz.tobytes()).hexdigest()


def samples_digest(path: Path) -> str:
    """Read every sample of a dataset; the digest of all their values in order."""
    digest = hashlib.sha256()
    samples = open_samples(path)
    for record in samples.records(discarded=True):
        digest.update(sample_digest(record.sample))
        digest.update(repr((record.outcome, record.flags, record.contact_ns)).encode())
    return digest.hexdigest()


def model_digest(path: Path) -> str:
    """Load a touch model and predict one grasp, which must be finite or refused."""
    model = load_model(path)
    xyz = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32) * 0.03 + np.float32([0, 0, 0.5])
    grasp = Grasp(np.array([0.03, 0, 0.5]), np.array([-0.03, 0, 0.5]), np.eye(3))
    prediction = model.predict(Cloud(xyz), [grasp])[0]
    values = None if prediction.value is None else prediction.value.values
    if values is not None and not np.isfinite(values).all():
        raise ArithmeticError("the prediction is not finite")
    return repr(values)


def bag_digest(path: Path) -> str:
    """Read every message of a recording with the parsers of rosbags."""
    digest = hashlib.sha256()
    with Recording(path) as recording:
        for message in recording.messages():
            digest.update(message.data)
    return digest.hexdigest()


# Changes.


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


# Files.


def _kind(
    make: Callable[[Path], Path],
    read: Callable[[Path], object],
    changed: tuple[str, ...] = ("*",),
    reseal: Callable[[Path], None] | None = None,
    exact: bool = False,
) -> Kind:
    """One kind of file.

    Args:
        make: Writes a valid file, or a folder of files, into a folder; returns the path that is read.
        read: Reads it.
        changed: Glob patterns, in the folder, of the files of which one is changed.
        reseal: Called with the folder after a change, such as to write the new hash of a changed file.
        exact: Whether what is read must be what was written.
    """

    def prepare(folder: Path) -> Case:
        path = make(folder)
        before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
        found = (file for pattern in changed for file in folder.glob(pattern))
        files = sorted(file for file in found if file in before and file.name != ".lock")
        original = read(path)

        def case(rng: np.random.Generator) -> str:
            for file, content in before.items():  # after the last case
                if not file.exists() or file.read_bytes() != content:
                    file.write_bytes(content)
            file = files[int(rng.integers(0, len(files)))]
            file.write_bytes(mutated(before[file], rng))
            if reseal is not None:
                reseal(folder)
            return "changed in silence" if read(path) != original and exact else "read"

        return case

    return Kind(prepare)


def _cloud(suffix: str, text: Callable[[bytes], bytes] | None = None) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        rng = np.random.default_rng(1)
        path = folder / f"cloud{suffix}"
        rgb = rng.integers(0, 255, (4, 6, 3), np.uint8) if text is None else None
        write_cloud(path, Cloud(rng.random((4, 6, 3), np.float32), rgb, "camera", 7))
        if text is not None:
            path.write_bytes(text(path.read_bytes()))
        return path

    return make


def _rows(body: bytes) -> bytes:
    return "".join(f"{x} {y} {z}\n" for x, y, z in np.frombuffer(body, "<f4").reshape(-1, 3)).encode()


def _ascii_pcd(content: bytes) -> bytes:
    head, _, body = content.partition(b"DATA binary\n")
    return head + b"DATA ascii\n" + _rows(body)


def _ascii_ply(content: bytes) -> bytes:
    head, _, body = content.partition(b"end_header\n")
    return head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + _rows(body)


def _compressed_pcd(folder: Path) -> Path:
    """By Open3D; the coordinates are rounded and repeated, so that the data refer back to themselves."""
    from foretouch.camera.libusb import ensure_libusb

    ensure_libusb()
    import open3d

    xyz = np.tile(np.random.default_rng(1).random((12, 3)).round(1), (3, 1))
    path = folder / "cloud.pcd"
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz))
    open3d.io.write_point_cloud(str(path), points, compressed=True)
    return path


def _record(number: int) -> SampleRecord:
    """A record with every field set, but for the fourth, which has no touch."""
    sample = made_sample(number, 6)
    if number == 3:
        return SampleRecord(sample=sample)
    counts = np.random.default_rng(number).integers(0, 4096, (4, 50)).astype(np.float32)
    stamps = sample.stamp_ns + np.arange(4, dtype=np.int64) * 10
    series = TouchSeries(stamps, counts, np.array([REST, REST, HOLD, HOLD], np.uint8), {"TDC_MF": counts[:, 0]})
    return SampleRecord(
        sample=replace(sample, tare=sample.touch, extra={"TDC_TH": 2100.5}),
        candidates=(replace(sample.grasp, id="other", score=float("nan")),),
        outcome="success",
        note="a note",
        series=series,
        contact_ns=int(stamps[2]),
        detector="PDC slope",
        flags=("arrival_stamped",),
    )


def _store(folder: Path) -> Path:
    with StoreWriter(folder / "store", {"scene": "x"}) as writer:
        for k in range(5):
            writer.write(replace(_record(k).sample, id=f"ball/{k}"))
        writer.attach("splits.json", json.dumps({"schema_version": 1, "splits": {}}))
    return folder / "store"


def _reseal(folder: Path) -> None:
    path = folder / "store" / "manifest.json"
    manifest = json.loads(path.read_text())
    for part in [*manifest["shards"], *manifest["files"]]:
        part["sha256"] = hashlib.sha256((folder / "store" / part["file"]).read_bytes()).hexdigest()
    path.write_text(sealed(manifest, SEAL))


def _recording(folder: Path) -> Path:
    quick = RecordingConfig(fsync_samples=0, fsync_s=0.0, min_free_mb=0.0)
    with RecordingWriter(folder / "recording", IDENTITY, quick) as writer:
        writer.add_topic("/rh/tactile", "foretouch_msgs/msg/BiotacAll")
        for number in range(3):
            for k in range(2):
                writer.receive("/rh/tactile")
                writer.write("/rh/tactile", b"\0\1\0\0" + bytes(200), 1000 * number + k)
            writer.append(_record(number))
    return folder / "recording"


def _vision2tactile(folder: Path) -> Path:
    sample = folder / "can" / "1500000000"
    sample.mkdir(parents=True)
    write_cloud(sample / "cloud-object.pcd", made_sample(0, 30).cloud)
    (sample / "best-grasp.txt").write_text("0.1,0.2,0.3,-0.1,0.25,0.31")
    (sample / "tactile.tac").write_text("," + ",".join(str(k) for k in range(1000, 1058)))
    return folder / "can"


def _model(folder: Path) -> Path:
    """The default model with two trees a forest."""
    model = load_model()
    facts = {name: model.card["calibration"][name] for name in ("level", "regimes")}
    estimator = fewer_trees(model.estimator, 2)
    return save_contact(folder, "contact", estimator, {"summary": "two trees"}, (model.calibration, facts))


def _rehash(folder: Path) -> None:
    path = folder / "contact.json"
    card = json.loads(path.read_text())
    card["sha256"] = hashlib.sha256((folder / "contact.safetensors").read_bytes()).hexdigest()
    trust = (folder / "contact.trust.safetensors").read_bytes()
    card["calibration"]["sha256"] = hashlib.sha256(trust).hexdigest()
    path.write_text(json.dumps(card))


def _settings(folder: Path) -> Path:
    path = folder / "settings.yaml"
    path.write_text("# settings\n" + yaml.safe_dump(PipelineConfig().to_mapping()))
    return path


KINDS = {
    "pcd": _kind(_cloud(".pcd"), cloud_digest),
    "pcd ascii": _kind(_cloud(".pcd", _ascii_pcd), cloud_digest),
    "ply": _kind(_cloud(".ply"), cloud_digest),
    "ply ascii": _kind(_cloud(".ply", _ascii_ply), cloud_digest),
    "npz": _kind(_cloud(".npz"), cloud_digest),
    "npy": _kind(_cloud(".npy"), cloud_digest),
    "store": _kind(_store, samples_digest, ("store/*",), exact=True),
    "store resealed": _kind(_store, samples_digest, ("store/*.arrow",), _reseal),
    "recording": _kind(_recording, samples_digest, ("recording/manifest.json", "recording/*.mcap"), exact=True),
    "bag": _kind(lambda folder: next(_recording(folder).glob("*.mcap")), bag_digest, ("recording/*.mcap",)),
    "vision2tactile": _kind(_vision2tactile, samples_digest, ("can/*/*",)),
    "model": _kind(_model, model_digest),
    "model rehashed": _kind(_model, model_digest, ("*.safetensors",), _rehash),
    "card": _kind(_model, read_card, ("*.json",)),
    "yaml": _kind(_settings, lambda path: PipelineConfig.from_mapping(load_yaml(path), str(path))),
    "pcd compressed": _kind(_compressed_pcd, cloud_digest),  # last, since a case's seed holds the number of its kind
}


if __name__ == "__main__":
    sys.exit(main("benchmarks.fuzz.files", __doc__, KINDS, 300))

# SPDX-License-Identifier: Apache-2.0
"""Structured fuzzing of every reader of files: small valid files with a few changes, damaged or consistent and wrong.

A change is one of bytes, of a value or type in a file whose format and hashes stay intact, or of what is there: a link, a
FIFO, a folder, another file. A file outside of the folder must stay as it is.
"""

import hashlib
import json
import shutil
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from benchmarks.fuzz.changes import mutated, replaced, replaced_folder, retype
from benchmarks.fuzz.driver import Case, Kind, main
from benchmarks.recorder.kill import IDENTITY, made_sample
from foretouch.cli.answers import prediction_from_record, read_answers
from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import load_yaml
from foretouch.dataset.bag import Recording
from foretouch.dataset.editing import drop, undo
from foretouch.dataset.files import sealed
from foretouch.dataset.importing import import_samples
from foretouch.dataset.record import HOLD, REST, SampleRecord, TouchSeries
from foretouch.dataset.recording.folder import list_sessions
from foretouch.dataset.recording.repair import repair_dataset
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import export_samples, open_samples
from foretouch.dataset.store import SEAL, sample_digest
from foretouch.errors import ForetouchError
from foretouch.models.card import read_card
from foretouch.models.contact.estimator import fewer_trees, save_contact
from foretouch.models.hand_history import HandHistory, HistoryFile
from foretouch.models.registry import load_model
from foretouch.pipeline import PipelineConfig
from foretouch.tactile.description import load_sensor, packaged_sensor, sensor_files
from foretouch.tactile.messages.described import SensorReader
from foretouch.types import Cloud, Grasp, Touch
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.experiments.framework.manifest import open_folder, read_results
from foretouch_lab.learning.data.dataset import load_dataset
from foretouch_lab.learning.data.splits import read_splits
from foretouch_lab.learning.training.run_folder import RunFolder, read_state, write_state
from foretouch_lab.simulation.objects.mesh import read_mesh_file

QUICK = RecordingConfig(fsync_samples=0, fsync_s=0.0, min_free_mb=0.0)
SENSOR = packaged_sensor("shadow_mst")  # with a file of taxels
MESH = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
GRASP = {"g1": [0, 0, 1], "g2": [0, 0.1, 1], "rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "score": 1.0}
ENDS = {name: dict.fromkeys(("value", "lower", "upper"), 1.0) for name in ("PDC_TH", "PDC_MF")} | {
    name: dict.fromkeys(("value", "lower", "upper"), [1.0] * 24) for name in ("E_TH", "E_MF")
}
PREDICTION = {"grasp": GRASP, **ENDS, "status": "ok", "reason": "", "reference": "none", "flags": []}
ANSWER = {"sample": "a/1", "predictions": [PREDICTION]}
SPLITS = {
    "schema_version": 1,
    "splits": {"random": [{"name": "a", "train": ["x"], "test": ["y"]}]},
    "omitted": {"time": "few"},
}
FOUND: dict[str, Any] = {"experiment": "x", "settings": {}, "data": {"sha256": "0"}}
SETTINGS: dict[str, Any] = {"a": {"b": 1}, "c": [1, 2]}
NOT_POSSIBLE = (ValueError, AttributeError, IndexError, TypeError, OverflowError, struct.error)
"""What a change raises that a file does not allow."""


def _kind(
    make: Callable[[Path], Path], read: Callable[[Path], object], weight: float = 1.0, exact: tuple[str, ...] = ()
) -> Kind:
    """One kind of file.

    Args:
        make: Writes a valid file, or a folder of files, into a folder; returns the path that is read.
        read: Reads it.
        weight: See `Kind`.
        exact: Suffixes of the files after whose damage what is read must be what was written.
    """

    def prepare(folder: Path) -> Case:
        home, victim = folder / "files", folder / "victim"
        home.mkdir()
        path = make(home)
        contents = {file: file.read_bytes() for file in sorted(home.rglob("*")) if file.is_file()}
        original = read(path)

        def case(rng: np.random.Generator) -> str:
            _restore(home, contents)
            victim.unlink(missing_ok=True)
            victim.write_text("precious")
            files = [file for file in contents if file.name != ".lock"]
            file, other = (files[int(rng.integers(len(files)))] for _ in range(2))
            way, damaged = rng.random(), False
            if way < 0.5:
                file.write_bytes(mutated(contents[file], rng))
                damaged = way < 0.35
            else:
                with suppress(*NOT_POSSIBLE):
                    _put_another(file, contents[other], victim, home, way, rng)
            if not damaged:
                _reseal(home)
            try:
                same = read(path) == original
            finally:
                if victim.read_text() != "precious":
                    raise AssertionError(f"{file.name}: the file outside was changed")
            return "read" if same or not damaged or file.suffix not in exact else "changed in silence"

        return case

    return Kind(prepare, weight)


def _restore(home: Path, contents: dict[Path, bytes]) -> None:
    shutil.rmtree(home)
    for file, content in contents.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)


def _put_another(file: Path, other: bytes, victim: Path, home: Path, way: float, rng: np.random.Generator) -> None:
    if way < 0.75:
        retype(file, rng)
    elif way < 0.78:
        file.with_name(f"{file.name}.part").symlink_to(victim)  # as a temporary file that was left over
    elif way < 0.83 and file.parent != home:
        replaced_folder(file.parent, rng)
    else:
        replaced(file, other, victim, rng)


def _reseal(folder: Path) -> None:
    """Write the hashes of all files as they are, if all are files, as a damaged writer would."""
    if any(path.is_symlink() or not (path.is_file() or path.is_dir()) for path in folder.rglob("*")):
        return
    with suppress(Exception):
        list_sessions(folder / "recording")
    for path in folder.rglob("*.json"):
        with suppress(Exception):
            content, beside = json.loads(path.read_text()), path.parent
            if path.name == "manifest.json":
                for part in [*content.get("shards", []), *content.get("files", [])]:
                    part["sha256"] = hashlib.sha256((beside / part["file"]).read_bytes()).hexdigest()
                path.write_text(sealed(content, SEAL if "shards" in content else "sha256"))
            elif path.name == "contact.json":
                for part, name in ((content, "contact"), (content["calibration"], "contact.trust")):
                    part["sha256"] = hashlib.sha256((beside / f"{name}.safetensors").read_bytes()).hexdigest()
                path.write_text(json.dumps(content))


# --- clouds ------------------------------------------------------------------------------------------------------


def cloud_digest(path: Path) -> str:
    """Read a cloud."""
    return hashlib.sha256(read_cloud(path).xyz.tobytes()).hexdigest()


def _cloud(suffix: str, *, text: bool = False) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        rng, path = np.random.default_rng(1), folder / f"cloud{suffix}"
        xyz, rgb = rng.random((4, 6, 3), np.float32), rng.integers(0, 255, (4, 6, 3), np.uint8)
        write_cloud(path, Cloud(xyz, None if text else rgb, "camera", 7))
        if text:
            end = b"DATA binary\n" if suffix == ".pcd" else b"end_header\n"
            head = path.read_bytes().partition(end)[0] + end
            rows = "".join(f"{x} {y} {z}\n" for x, y, z in xyz.reshape(-1, 3))
            path.write_bytes(
                head.replace(b"binary_little_endian", b"ascii").replace(b"DATA binary", b"DATA ascii") + rows.encode()
            )
        return path

    return make


def _compressed_pcd(folder: Path) -> Path:
    """By Open3D; the coordinates are rounded and repeated, so that the data refer back to themselves."""
    from foretouch.camera.device import ensure_libusb

    ensure_libusb()
    import open3d

    xyz = np.tile(np.random.default_rng(1).random((12, 3)).round(1), (3, 1))
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz))
    open3d.io.write_point_cloud(str(folder / "cloud.pcd"), points, compressed=True)
    return folder / "cloud.pcd"


# --- samples -----------------------------------------------------------------------------------------------------


def samples_digest(path: Path) -> str:
    """Read every sample of a dataset; the digest of all their values in order."""
    digest = hashlib.sha256()
    for record in open_samples(path).records(discarded=True):
        digest.update(sample_digest(record.sample))
        digest.update(repr((record.outcome, record.flags, record.contact_ns)).encode())
    return digest.hexdigest()


def _record(number: int, *, described: bool = False) -> SampleRecord:
    """A record with every field set, but for the fourth of a BioTac, which has no touch."""
    rng, sample = np.random.default_rng(number), made_sample(number, 6)
    if number == 3 and not described:
        return SampleRecord(sample=sample)
    if described:
        channels = SENSOR.channels
        sample = replace(sample, touch=Touch(rng.uniform(0.0, 500.0, channels.size), channels))
    else:
        sample = replace(sample, tare=sample.touch, extra={"TDC_TH": 2100.5})
    assert sample.touch is not None
    counts = np.tile(sample.touch.values, (4, 1)).astype(np.float32)
    names = [f"T_{finger}" for finger in SENSOR.channels.fingers] if described else ["TDC_MF"]
    stamps = sample.stamp_ns + np.arange(4, dtype=np.int64) * 10
    phases = np.array([REST, REST, HOLD, HOLD], np.uint8)
    return SampleRecord(
        sample=sample,
        candidates=(replace(sample.grasp, id="other", score=float("nan")),),
        outcome="success",
        note="a note",
        series=TouchSeries(stamps, counts, phases, dict.fromkeys(names, counts[:, 0])),
        contact_ns=int(stamps[2]),
        detector="" if described else "PDC slope",
        flags=("arrival_stamped",),
    )


def _recording(folder: Path) -> Path:
    with RecordingWriter(folder / "recording", IDENTITY, QUICK) as writer:
        writer.add_topic("/rh/tactile", "foretouch_msgs/msg/BiotacAll")
        for number in range(3):
            for k in range(2):
                writer.receive("/rh/tactile")
                writer.write("/rh/tactile", b"\0\1\0\0" + bytes(200), 1000 * number + k)
            writer.append(_record(number))
    drop(folder / "recording", ["ball/000001"])
    return folder / "recording"


def _described_recording(folder: Path) -> Path:
    """Two sessions and an edit."""
    for session in range(2):
        with RecordingWriter(folder / "recording", IDENTITY, QUICK, sensor=SENSOR) as writer:
            for k in range(2):
                writer.append(_record(2 * session + k, described=True))
    drop(folder / "recording", ["ball/000001"])
    return folder / "recording"


def _use(*others: Callable[[Path], object]) -> Callable[[Path], str]:
    """Read a dataset, and do with it what may refuse it."""

    def read(path: Path) -> str:
        found = samples_digest(path)
        for other in (*others, verify_dataset, lambda path: drop(path, ["ball/000002"]), repair_dataset):
            with suppress(ForetouchError):
                other(path)
        samples_digest(path)
        return found

    return read


def _append(path: Path) -> None:
    with RecordingWriter(path, IDENTITY, QUICK, sensor=SENSOR) as writer:
        writer.append(_record(0, described=True))


def _bag_digest(path: Path) -> str:
    """Read every message of a recording with the parsers of rosbags."""
    digest = hashlib.sha256()
    with Recording(path) as recording:
        for message in recording.messages():
            digest.update(message.data)
    return digest.hexdigest()


def _store(folder: Path, *, described: bool = False) -> Path:
    with StoreWriter(folder / "store", {"scene": "x"}, **({"sensor": SENSOR} if described else {})) as writer:
        for k in range(5):
            writer.write(replace(_record(k, described=described).sample, id=f"ball/{k}"))
        writer.attach("splits.json", json.dumps({"schema_version": 1, "splits": {}}))
    return folder / "store"


def _load_store(path: Path) -> None:
    for sample in load_dataset(path).samples:
        assert np.isfinite(sample.cloud.xyz).all()


def _vision2tactile(folder: Path) -> Path:
    sample = folder / "can" / "1500000000"
    sample.mkdir(parents=True)
    write_cloud(sample / "cloud-object.pcd", made_sample(0, 30).cloud)
    (sample / "best-grasp.txt").write_text("0.1,0.2,0.3,-0.1,0.25,0.31")
    (sample / "tactile.tac").write_text("," + ",".join(str(k) for k in range(1000, 1058)))
    return folder / "can"


def _lerobot(folder: Path) -> Path:
    export_samples(_described_recording(folder), folder / "lerobot", "lerobot")
    shutil.rmtree(folder / "recording")
    return folder / "lerobot"


def _import(path: Path) -> None:
    out = path.parents[1] / "imported"
    shutil.rmtree(out, ignore_errors=True)
    try:
        import_samples(path, out)
    except ForetouchError:
        assert not out.exists(), "half an import was left"
        raise
    verify_dataset(out)


# --- models, settings and results ----------------------------------------------------------------------------------


def _model(folder: Path) -> Path:
    """The default model with two trees a forest."""
    model = load_model()
    facts = {name: model.card["calibration"][name] for name in ("level", "regimes")}
    estimator = fewer_trees(model.estimator, 2)
    return save_contact(folder, "contact", estimator, {"summary": "two trees"}, (model.calibration, facts))


def _predict(path: Path) -> str:
    """Load a touch model and predict one grasp, which must be finite or refused."""
    read_card(path)
    xyz = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32) * 0.03 + np.float32([0, 0, 0.5])
    grasp = Grasp(np.array([0.03, 0, 0.5]), np.array([-0.03, 0, 0.5]), np.eye(3))
    prediction = load_model(path).predict(Cloud(xyz), [grasp])[0]
    values = None if prediction.value is None else prediction.value.values
    if values is not None and not np.isfinite(values).all():
        raise ArithmeticError("the prediction is not finite")
    return repr(values)


def _history(folder: Path) -> Path:
    file = HistoryFile(folder / "history" / "right.safetensors", "right")
    file.write(HandHistory(load_model()))
    file.close()
    return folder / "history" / "right.safetensors"


def _read_history(path: Path) -> None:
    file = HistoryFile(path, "right")
    try:
        file.write(file.read(load_model()) or HandHistory(load_model()))
    finally:
        file.close()


def _run(folder: Path) -> Path:
    run = RunFolder(folder / "run")
    run.open(SETTINGS, resume=False)
    write_state(folder / "run" / "state.safetensors", {"x": torch.zeros(3)}, {"epoch": 1, "best": {}})
    run.log({"epoch": 0})
    return folder / "run"


def _read_run(path: Path) -> None:
    run = RunFolder(path)
    run.open(SETTINGS, resume=True)
    run.keep_log(1)
    run.log({"epoch": 1})
    read_state(path / "state.safetensors")
    write_state(path / "state.safetensors", {"x": torch.zeros(3)}, {})


def _sweep(folder: Path) -> Path:
    manifest = open_folder(folder / "sweep", FOUND)
    (folder / "sweep" / "manifest.json").write_text(json.dumps(manifest))
    (folder / "sweep" / "results.csv").write_text("a,b\n1,x\n")
    return folder / "sweep"


def _read_sweep(path: Path) -> None:
    open_folder(path, FOUND)
    read_results(path / "results.csv")


def _sensor(folder: Path) -> Path:
    for file in sensor_files()["biotac_sp"].parent.glob("biotac_sp.*"):
        shutil.copy(file, folder)
    return folder / "biotac_sp.yaml"


def _read_sensor(path: Path) -> None:
    sensor = load_sensor(path)
    SensorReader(sensor)
    assert np.isfinite(sensor.layout.positions).all(), sensor.sha256


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_text(text)
        return folder / name

    return make


def _read_answers(path: Path) -> None:
    for record in read_answers(path):
        for one in record.get("predictions", []):
            prediction_from_record(one)


KINDS = {
    **{suffix: _kind(_cloud(f".{suffix}"), cloud_digest) for suffix in ("pcd", "ply", "npz", "npy")},
    **{f"{suffix} ascii": _kind(_cloud(f".{suffix}", text=True), cloud_digest) for suffix in ("pcd", "ply")},
    "pcd compressed": _kind(_compressed_pcd, cloud_digest),
    "recording": _kind(_recording, _use(), exact=(".json", ".mcap")),
    "recording of a described sensor": _kind(
        _described_recording, _use(_append, undo), exact=(".json", ".mcap"), weight=0.5
    ),
    "bag": _kind(lambda folder: next(_recording(folder).glob("*.mcap")), _bag_digest),
    "store": _kind(_store, samples_digest, exact=(".json", ".arrow")),
    "store of a described sensor": _kind(lambda folder: _store(folder, described=True), _load_store),
    "vision2tactile": _kind(_vision2tactile, samples_digest),
    "lerobot": _kind(_lerobot, _import, 0.3),
    "model": _kind(_model, _predict, 0.5),
    "history": _kind(_history, _read_history, 0.5),
    "settings": _kind(
        _text("settings.yaml", "# settings\n" + yaml.safe_dump(PipelineConfig().to_mapping())),
        lambda path: PipelineConfig.from_mapping(load_yaml(path), str(path)),
    ),
    "sensor": _kind(_sensor, _read_sensor),
    "run": _kind(_run, _read_run),
    "experiment": _kind(_sweep, _read_sweep),
    "splits": _kind(_text("splits.json", json.dumps(SPLITS)), read_splits, 0.5),
    "answers": _kind(_text("answers.json", json.dumps(ANSWER)), _read_answers, 0.5),
    "mesh": _kind(_text("mesh.ply", MESH), lambda path: read_mesh_file(str(path)), 0.02),
}


if __name__ == "__main__":
    sys.exit(main("benchmarks.fuzz.files", __doc__.splitlines()[0], KINDS, 300))

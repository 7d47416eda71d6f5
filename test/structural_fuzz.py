# SPDX-License-Identifier: Apache-2.0
"""Files that are consistent and wrong: links, FIFOs and folders for files, other types with right hashes, files exchanged.

    PYTHONPATH=src:test:. python -m structural_fuzz --cases 50000 --out structure.csv

The driver of `benchmarks/fuzz` runs the cases and judges them; a file outside of the folder must stay as it is.
"""

import hashlib
import io
import json
import os
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import torch
import yaml
from experiment_samples import make_samples
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from other_sensor import readings
from safetensors.numpy import load, save

from benchmarks.fuzz import files
from benchmarks.fuzz.driver import Case, Kind, main
from foretouch import __version__
from foretouch.cli.answers import prediction_from_record, read_answers
from foretouch.dataset.editing import drop, undo
from foretouch.dataset.files import sealed
from foretouch.dataset.importing import import_samples
from foretouch.dataset.record import HOLD, REST, SampleRecord, TouchSeries
from foretouch.dataset.recording.chain import list_sessions
from foretouch.dataset.recording.repair import repair_dataset
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import export_samples
from foretouch.dataset.store import SEAL
from foretouch.errors import ForetouchError
from foretouch.models.hand_history import HandHistory, HistoryFile
from foretouch.models.registry import load_model
from foretouch.tactile.description import load_sensor, packaged_sensor, sensor_files
from foretouch.tactile.messages.described import SensorReader
from foretouch_lab.dataset import chunks
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.experiments.framework.manifest import open_folder, read_results
from foretouch_lab.learning.data.dataset import load_dataset
from foretouch_lab.learning.data.splits import read_splits
from foretouch_lab.learning.training.run_folder import RunFolder, read_state, write_state
from foretouch_lab.ray_cluster import _call
from foretouch_lab.simulation.objects.mesh import read_mesh_file

VALUES = (
    None, True, 0, -1, 2**63, 10**400, 0.5, 1e308, float("inf"), float("nan"), "", "x", "../..", "a\x1b[2J\n", "é" * 500,
    [], [[]], ["x"], {}, {"": None}, [0] * 1000,
)  # fmt: skip
PLY = """ply
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
INTERVAL = {"value": 1.0, "lower": 0.0, "upper": 2.0}
ELECTRODES = {name: [1.0] * 24 for name in INTERVAL}
GRASP = {"g1": [0, 0, 1], "g2": [0, 0.1, 1], "rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1], "score": 1.0}
PREDICTION = {"grasp": GRASP, "PDC_TH": INTERVAL, "PDC_MF": INTERVAL, "E_TH": ELECTRODES, "E_MF": ELECTRODES}
ANSWER = {
    "sample": "a/1",
    "predictions": [{**PREDICTION, "status": "ok", "reason": "", "reference": "none", "flags": []}],
}
PART = {"name": "a", "train": ["x"], "test": ["y"]}
SPLITS = {"schema_version": 1, "splits": {"random": [PART]}, "omitted": {"time": "few"}}
TEXTS = ("", "../..", "a\x1b[2J\n", "é" * 500)
SETTINGS: dict[str, Any] = {"a": {"b": 1}, "c": [1, 2]}
OTHER_DIGITS = str.maketrans("012345678", "123456789")
SENSOR = packaged_sensor("shadow_mst")  # with a file of taxels
QUICK = RecordingConfig(fsync_samples=0, fsync_s=0.0, min_free_mb=0.0)


def retyped(value: Any, rng: np.random.Generator) -> Any:
    """A document with another value in one place."""
    inner = (
        list(value.items() if isinstance(value, dict) else enumerate(value)) if isinstance(value, dict | list) else []
    )
    if not inner or rng.random() < 0.2:
        return VALUES[int(rng.integers(len(VALUES)))]
    key, one = inner[int(rng.integers(len(inner)))]
    changed = value.copy()
    changed[key] = retyped(one, rng)
    return changed


def retype(file: Path, rng: np.random.Generator) -> None:
    """Change a type or value inside of a file, whose format stays intact."""
    if file.suffix == ".json":
        file.write_text(json.dumps(retyped(json.loads(file.read_text()), rng)))
    elif file.suffix == ".jsonl":
        lines = [json.loads(line) for line in file.read_text().splitlines()]
        number = int(rng.integers(len(lines)))
        lines[number], digest, text = retyped(lines[number], rng), "", ""
        for line in lines:
            body = {key: one for key, one in line.items() if key != "sha256"} if isinstance(line, dict) else line
            digest = hashlib.sha256((digest + json.dumps(body, sort_keys=True)).encode()).hexdigest()
            text += json.dumps({**body, "sha256": digest} if isinstance(body, dict) else body) + "\n"
        file.write_text(text)
    elif file.suffix == ".yaml":
        file.write_text(yaml.safe_dump(retyped(yaml.safe_load(file.read_text()), rng)))
    elif file.suffix == ".safetensors":
        tensors = load(file.read_bytes())
        name = list(tensors)[int(rng.integers(len(tensors)))]
        choices = (
            tensors[name][..., None], tensors[name].astype(np.int64), np.full(tensors[name].shape, -1), np.float64(np.inf),
            np.full(tensors[name].shape, 2**62), tensors[name][:0] if tensors[name].ndim else np.zeros(0),
        )  # fmt: skip
        tensors[name] = np.asarray(choices[int(rng.integers(len(choices)))])
        tensors.pop("sha256", None)
        seal = np.frombuffer(hashlib.sha256(save(tensors)).digest(), np.uint8)
        file.write_bytes(save({**tensors, "sha256": seal} if file.parent.name == "history" else tensors))
    elif file.suffix == ".npz":
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            content = io.BytesIO()
            np.save(content, np.zeros((int(3e6 ** rng.random()), 3)))
            archive.writestr("xyz.npy", content.getvalue())
    elif file.suffix == ".arrow":
        _retype_arrow(file, rng)
    elif file.suffix == ".mcap":
        _retype_mcap(file, rng)
    elif file.suffix in (".ply", ".csv"):
        between = " " if file.suffix == ".ply" else ","
        words = file.read_text().split(between)
        words[int(rng.integers(len(words)))] = str(_pick(VALUES, rng))
        file.write_text(between.join(words))
    else:
        file.write_bytes(file.read_bytes()[::-1])


def _pick(values: Any, rng: np.random.Generator) -> Any:
    return values[int(rng.integers(len(values)))]


def _retype_arrow(file: Path, rng: np.random.Generator) -> None:
    """Nulls, values or a type in place of others in a column; other columns or rows; a compressed file."""
    table = pa.ipc.open_file(pa.py_buffer(file.read_bytes())).read_all()
    number, value = int(rng.integers(table.num_columns)), _pick(VALUES, rng)
    field, rows = table.field(number), table.column(number).to_pylist()
    inner = [value] * len(rows[0]) if isinstance(rows[0], list) else value
    ways: tuple[Callable[[], Any], ...] = (
        lambda: table.set_column(number, field, pa.nulls(len(rows), field.type)),
        lambda: table.set_column(number, field, pa.array([None, *rows[1:]], field.type)),
        lambda: table.set_column(number, field, pa.array([inner, *rows[1:]], field.type)),
        lambda: table.set_column(number, field, pa.array([rows[0][:-1], *rows[1:]], field.type)),
        lambda: table.set_column(number, field.name, pa.array([value] * len(rows))),
        lambda: table.remove_column(number),
        lambda: table.append_column(field, table.column(number)),
        lambda: pa.concat_tables([table.slice(1), table.slice(0, 1)]),
        lambda: pa.concat_tables([table, table]),
        lambda: table.slice(0, 0),
        lambda: table,
    )
    changed = _pick(ways, rng)()
    packing = _pick((None, "zstd", "lz4"), rng) if changed is table else None
    with pa.ipc.new_file(str(file), changed.schema, options=pa.ipc.IpcWriteOptions(compression=packing)) as writer:
        writer.write_table(changed)


def _retype_mcap(file: Path, rng: np.random.Generator) -> None:
    """Other data, times, names and types in one record, or a message that unpacks to much more; listed as a session."""
    found = StreamReader(io.BytesIO(file.read_bytes())).records
    records: list[Any] = [one for one in found if isinstance(one, Schema | Channel | Message | Metadata)]
    one, text, other = _pick(records, rng), _pick(TEXTS, rng), rng.random() < 0.5
    if isinstance(one, Message) and other:
        one.log_time = one.publish_time = _pick((0, 1, 2**63, 2**64 - 1), rng)
    elif isinstance(one, Message):
        messages = [message for message in records if isinstance(message, Message)]
        one.data = _pick((b"", bytes(int(6e7 ** rng.random())), rng.bytes(60), _pick(messages, rng).data), rng)
    elif isinstance(one, Metadata) and other:
        name = _pick(list(one.metadata), rng)
        with suppress(ValueError):
            one.metadata[name] = json.dumps(retyped(json.loads(one.metadata[name]), rng))
    elif isinstance(one, Channel):
        one.topic, one.metadata = (text, one.metadata) if other else (one.topic, {"offered_qos_profiles": "[["})
    elif isinstance(one, Schema) and other:
        one.data = rng.bytes(20)
    else:
        one.name = text
    _write_mcap(file, records, _pick((CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD), rng))
    with suppress(Exception):
        list_sessions(file.parent)


def _write_mcap(file: Path, records: list[Any], packing: CompressionType) -> None:
    writer = Writer(str(file), compression=packing)
    writer.start("ros2")
    schemas, channels = {0: 0}, {}
    for one in records:
        if isinstance(one, Schema) and one.id not in schemas:
            schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
        elif isinstance(one, Channel) and one.id not in channels:
            schema, encoding = schemas[one.schema_id], one.message_encoding
            channels[one.id] = writer.register_channel(one.topic, encoding, schema, one.metadata)
        elif isinstance(one, Message):
            writer.add_message(channels[one.channel_id], one.log_time, one.data, one.publish_time, one.sequence)
        elif isinstance(one, Metadata):
            writer.add_metadata(one.name, one.metadata)
    writer.finish()


def replaced(file: Path, all_files: list[Path], victim: Path, rng: np.random.Generator) -> None:
    """Put something else in the place of a file."""
    content, other = file.read_bytes(), all_files[int(rng.integers(len(all_files)))].read_bytes()
    file.unlink()
    ways: tuple[Callable[[], object], ...] = (
        lambda: None,
        lambda: file.symlink_to(victim),
        lambda: file.symlink_to("absent"),
        lambda: file.symlink_to(file.name),
        lambda: file.symlink_to("/dev/zero"),
        lambda: os.link(victim, file),
        lambda: os.mkfifo(file),
        file.mkdir,
        lambda: file.write_bytes(b""),
        lambda: file.write_bytes(bytes(len(content))),
        lambda: file.write_bytes(other),
        lambda: (file.write_bytes(content), os.truncate(file, 100_000_000)),
        lambda: (file.write_bytes(content), file.with_name(file.name.translate(OTHER_DIGITS)).write_bytes(content)),
    )
    _pick(ways, rng)()


def replaced_folder(folder: Path, rng: np.random.Generator) -> None:
    """Put something else in the place of a folder."""
    moved = folder.with_name("moved")
    folder.rename(moved)
    ways: tuple[Callable[[], object], ...] = (
        lambda: None,
        lambda: folder.symlink_to(moved.name),
        lambda: folder.symlink_to(folder.name),
        lambda: folder.write_text("x"),
        lambda: os.mkfifo(folder),
        folder.mkdir,
    )
    _pick(ways, rng)()


def _reseal(folder: Path) -> None:
    """Write the hashes of all files as they are, if all are files."""
    if any(path.is_symlink() or not (path.is_file() or path.is_dir()) for path in folder.rglob("*")):
        return
    for manifest in folder.rglob("manifest.json"):
        with suppress(Exception):
            content = json.loads(manifest.read_text())
            for part in [*content.get("shards", []), *content.get("files", [])]:
                part["sha256"] = hashlib.sha256((manifest.parent / part["file"]).read_bytes()).hexdigest()
            manifest.write_text(sealed(content, SEAL if "shards" in content else "sha256"))
    with suppress(Exception):
        files._rehash(folder)


def _kind(make: Callable[[Path], Path], read: Callable[[Path], object], weight: float = 1.0) -> Kind:
    def prepare(folder: Path) -> Case:
        path = make(folder / "files")
        names = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*") if file.is_file()}
        victim = folder / "victim"

        def case(rng: np.random.Generator) -> str:
            shutil.rmtree(folder / "files")
            for name, content in names.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(content)
            victim.unlink(missing_ok=True)
            victim.write_text("precious")
            all_files = [folder / name for name in sorted(names)]
            file = all_files[int(rng.integers(len(all_files)))]
            left_over = file.with_name(f"{file.name}.part")
            with suppress(
                ValueError, AttributeError, IndexError, TypeError, OverflowError, struct.error
            ):  # it cannot be changed in this way
                if rng.random() < 0.5:
                    retype(file, rng)
                elif rng.random() < 0.1:
                    left_over.symlink_to(victim)
                elif rng.random() < 0.2 and file.parent != folder / "files":
                    replaced_folder(file.parent, rng)
                else:
                    replaced(file, all_files, victim, rng)
            _reseal(folder / "files")
            try:
                read(path)
            finally:
                if victim.read_text() != "precious":
                    raise AssertionError(f"{file.name}: the file outside was changed")
            return "read"

        return case

    return Kind(prepare, weight)


def _dataset(folder: Path) -> Path:
    folder.mkdir()
    path = files._recording(folder)
    drop(path, ["ball/000001"])
    return path


def _read_dataset(path: Path) -> None:
    for use in (verify_dataset, files.samples_digest, lambda path: drop(path, ["ball/000002"]), repair_dataset):
        with suppress(ForetouchError):
            use(path)
    files.samples_digest(path)


def _described_record(number: int) -> SampleRecord:
    sample = readings(make_samples(1, 4), SENSOR.channels)[number]
    assert sample.touch is not None
    stamps = sample.stamp_ns + np.arange(2, dtype=np.int64) * 10
    counts = np.tile(sample.touch.values, (2, 1)).astype(np.float32)
    others = {f"T_{finger}": counts[:, 0] for finger in SENSOR.channels.fingers}
    return SampleRecord(sample=sample, series=TouchSeries(stamps, counts, np.array([REST, HOLD], np.uint8), others))


def _described_dataset(folder: Path) -> Path:
    """Two sessions and an edit."""
    for session in range(2):
        with RecordingWriter(folder / "recording", files.IDENTITY, QUICK, sensor=SENSOR) as writer:
            for k in range(2):
                writer.append(_described_record(2 * session + k))
    drop(folder / "recording", ["campbells/0"])
    return folder / "recording"


def _read_described_dataset(path: Path) -> None:
    with suppress(ForetouchError), RecordingWriter(path, files.IDENTITY, QUICK, sensor=SENSOR) as writer:
        writer.append(_described_record(0))
    with suppress(ForetouchError):
        undo(path)
    _read_dataset(path)


def _described_store(folder: Path) -> Path:
    with StoreWriter(folder / "store", sensor=SENSOR) as writer:
        for k in range(4):
            writer.write(_described_record(k).sample)
    return folder / "store"


def _load_store(path: Path) -> None:
    for sample in load_dataset(path).samples:
        assert np.isfinite(sample.cloud.xyz).all()


def _lerobot(folder: Path) -> Path:
    export_samples(_described_dataset(folder), folder / "lerobot", "lerobot")
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


def _make_chunk(slots: range, write: Callable[[Any], None]) -> dict[str, int]:
    for slot in slots:
        write(_described_record(slot).sample)
    return {"discarded": 0}


def _chunks(folder: Path) -> Path:
    chunks.CHUNK_SAMPLES = 2  # type: ignore[misc]
    chunks.ray_results = lambda function, items, *_: ((item, *_call(function, item, __version__)) for item in items)
    _read_chunks(folder / "out.chunks")
    return folder / "out.chunks"


def _read_chunks(path: Path) -> None:
    stores = chunks.made_in_chunks(path, {"scene": "x"}, 4, _make_chunk, "", 1, sensor=SENSOR)
    assert sum(len(list(store)) for store in stores) == 4


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


def _history(folder: Path) -> Path:
    path = folder / "history" / "right.safetensors"
    file = HistoryFile(path, "right")
    file.write(HandHistory(load_model()))
    file.close()
    return path


def _read_history(path: Path) -> None:
    file = HistoryFile(path, "right")
    try:
        file.write(file.read(load_model()) or HandHistory(load_model()))
    finally:
        file.close()


def _experiment(folder: Path) -> Path:
    manifest = open_folder(folder / "sweep", {"experiment": "x", "settings": {}, "data": {"sha256": "0"}})
    (folder / "sweep" / "manifest.json").write_text(json.dumps(manifest))
    (folder / "sweep" / "results.csv").write_text("a,b\n1,x\n")
    return folder / "sweep"


def _read_experiment(path: Path) -> None:
    open_folder(path, {"experiment": "x", "settings": {}, "data": {"sha256": "0"}})
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

    return _in(make)


def _mesh(folder: Path) -> Path:
    path = _text("mesh.ply", PLY)(folder)
    read_mesh_file(str(path))  # imports the reader before the memory is limited
    return path


def _read_answers(path: Path) -> None:
    for record in read_answers(path):
        for one in record.get("predictions", []):
            prediction_from_record(one)


def _in(make: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        folder.mkdir()
        return make(folder)

    return made


KINDS = {
    "dataset": _kind(_dataset, _read_dataset),
    "store": _kind(_in(files._store), files.samples_digest),
    "bag": _kind(_in(lambda folder: next(files._recording(folder).glob("*.mcap"))), files.bag_digest),
    "vision2tactile": _kind(_in(files._vision2tactile), files.samples_digest),
    "model": _kind(_in(files._model), files.model_digest),
    "settings": _kind(_in(files._settings), lambda path: files.PipelineConfig.from_mapping(files.load_yaml(path))),
    "npz": _kind(_in(files._cloud(".npz")), files.cloud_digest),
    "run": _kind(_run, _read_run),
    "history": _kind(_history, _read_history),
    "experiment": _kind(_experiment, _read_experiment),
    "sensor": _kind(_in(_sensor), _read_sensor),
    "dataset of a described sensor": _kind(_in(_described_dataset), _read_described_dataset),
    "store of a described sensor": _kind(_in(_described_store), _load_store),
    "lerobot": _kind(_in(_lerobot), _import),
    "chunks": _kind(_in(_chunks), _read_chunks),
    "splits": _kind(_text("splits.json", json.dumps(SPLITS)), read_splits, 0.5),
    "answers": _kind(_text("answers.json", json.dumps(ANSWER)), _read_answers, 0.5),
    "mesh": _kind(_mesh, lambda path: read_mesh_file(str(path)), 0.02),
}


if __name__ == "__main__":
    sys.exit(main("structural_fuzz", __doc__.splitlines()[0], KINDS, 300))

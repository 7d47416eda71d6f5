# SPDX-License-Identifier: Apache-2.0
"""Every kind of file that is read: what writes a small valid one, and what reads it. `test_fuzz.py` changes them."""

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from calibrated_models import save_calibrated_contact
from corpus.changes import Draw, damaged, replaced, retyped
from experiment_samples import make_samples
from hypothesis import strategies as st
from other_sensor import USKIN, readings, write_readings
from recording_builders import IDENTITY, QUICK, record, write_dataset, write_sample

from foretouch.cloud.io.files import read_cloud, write_cloud
from foretouch.config import load_yaml
from foretouch.dataset.files import sealed
from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.importing import import_samples
from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.editing import drop, undo
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import only_finite
from foretouch.dataset.store import SEAL, sample_digest
from foretouch.errors import ForetouchError
from foretouch.models.history_keeper import HistoryFile
from foretouch.models.registry import load_model
from foretouch.models.touch_model import History
from foretouch.pipeline import PipelineConfig
from foretouch.tactile.description import load_sensor, sensor_files
from foretouch.tactile.messages.described import SensorReader
from foretouch.types import Cloud, Grasp
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.experiments.framework.manifest import open_folder, read_results
from foretouch_lab.learning.data.dataset import load_dataset
from foretouch_lab.learning.data.splits import read_splits
from foretouch_lab.learning.training.run_folder import RunFolder, read_state, write_state
from foretouch_lab.simulation.objects.mesh import read_mesh_file

SPLITS = {"random": [{"name": "a", "train": ["x"], "test": ["y"]}]}
SWEEP: dict[str, Any] = {"experiment": "x", "settings": {}, "data": {"sha256": "0"}}
RUN: dict[str, Any] = {"a": {"b": 1}, "c": [1, 2]}


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes:
        make: Writes a valid file, or a folder of files, into a folder; returns the path that is read.
        read: Reads it.
        weight: Share of the cases, relative to other kinds: few where a case takes long.
        exact: Suffixes of the files after whose damage what is read must be what was written.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    weight: float = 1.0
    exact: tuple[str, ...] = ()


class Changed:
    """A valid file of a kind in a folder, which is changed anew for each case; a file beside it must stay as it is."""

    def __init__(self, kind: Kind, folder: Path) -> None:
        self._kind, self._home, self._victim = kind, folder / "files", folder / "victim"
        self._home.mkdir()
        self._path = kind.make(self._home)
        self._contents = {path: path.read_bytes() for path in sorted(self._home.rglob("*")) if path.is_file()}
        self._original = kind.read(self._path)

    def change(self, draw: Draw) -> Callable[[], None]:
        """Change one file; what is returned reads it."""
        shutil.rmtree(self._home)
        for path, content in self._contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        self._victim.unlink(missing_ok=True)
        self._victim.write_text("precious")
        files = [path for path in self._contents if path.name != ".lock"]
        file, other = draw(st.sampled_from(files)), draw(st.sampled_from(files))
        way = draw(st.sampled_from(("damage", "damage with its hashes", "a value", "another file", "another folder")))
        if way.startswith("damage"):
            file.write_bytes(damaged(draw, self._contents[file]))
        elif way == "a value":
            _retype(draw, file)
        else:
            parent = way == "another folder" and file.parent != self._home
            replaced(draw, file.parent if parent else file, self._contents[other], self._victim)
        if way != "damage":
            _reseal(self._home)
        return lambda: self._read(must_be_same=way == "damage" and file.suffix in self._kind.exact)

    def _read(self, *, must_be_same: bool) -> None:
        try:
            same = self._kind.read(self._path) == self._original
        finally:
            assert self._victim.read_text() == "precious", "a file outside was changed"
        assert same or not must_be_same, "changed in silence"


def _retype(draw: Draw, file: Path) -> None:
    """Another value in a document whose format stays intact; in other files, another word."""
    if file.suffix in (".json", ".yaml"):
        load, dump = (json.loads, json.dumps) if file.suffix == ".json" else (yaml.safe_load, yaml.safe_dump)
        with suppress(ValueError, yaml.YAMLError):  # a value that the format does not allow
            file.write_text(dump(retyped(draw, load(file.read_text()))))
    else:
        file.write_bytes(damaged(draw, file.read_bytes()))


def _reseal(folder: Path) -> None:
    """Write the hashes of all files as they are, if all are files, as a damaged writer would."""
    if any(path.is_symlink() or not (path.is_file() or path.is_dir()) for path in folder.rglob("*")):
        return
    for path in folder.rglob("*.json"):
        with suppress(Exception):
            content, beside = json.loads(path.read_text()), path.parent
            if path.name == "manifest.json":
                for part in [*content.get("shards", []), *content.get("files", [])]:
                    part["sha256"] = hashlib.sha256((beside / part["file"]).read_bytes()).hexdigest()
                path.write_text(sealed(content, SEAL if "shards" in content else "sha256"))
            elif path.name == "contact.json":
                for part, name in ((content, "weights"), (content["calibration"], "weights")):
                    part["sha256"] = hashlib.sha256((beside / part[name]).read_bytes()).hexdigest()
                path.write_text(json.dumps(content))


def _digest(path: Path) -> str:
    return hashlib.sha256(read_cloud(path).xyz.tobytes()).hexdigest()


def _cloud(suffix: str, *, text: bool = False) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        rng, path = np.random.default_rng(1), folder / f"cloud{suffix}"
        xyz, rgb = rng.random((4, 6, 3), np.float32), rng.integers(0, 255, (4, 6, 3), np.uint8)
        write_cloud(path, Cloud(xyz, None if text else rgb, "camera", 7))
        if text:
            end = b"DATA binary\n" if suffix == ".pcd" else b"end_header\n"
            head = path.read_bytes().partition(end)[0] + end
            head = head.replace(b"binary_little_endian", b"ascii").replace(b"DATA binary", b"DATA ascii")
            path.write_bytes(head + "".join(f"{x} {y} {z}\n" for x, y, z in xyz.reshape(-1, 3)).encode())
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


def _samples(path: Path) -> str:
    """The digest of all values of every sample of a dataset, in order."""
    digest = hashlib.sha256()
    for one in open_samples(path).with_discarded():
        digest.update(sample_digest(one))
        digest.update(repr((one.outcome, one.flags, one.contact_ns)).encode())
    return digest.hexdigest()


def _recording(folder: Path) -> Path:
    write_dataset(folder / "recording", 3, points=6)
    drop(folder / "recording", ["ball/000001"])
    return folder / "recording"


def _described_recording(folder: Path) -> Path:
    """Two sessions and an edit."""
    for session in range(2):
        with RecordingWriter(folder / "recording", IDENTITY, QUICK, sensor=USKIN) as writer:
            for sample in readings(make_samples(1, 2, session), USKIN.channels, session):
                writer.append(replace(sample, id="", object="ball"))
    drop(folder / "recording", ["ball/000001"])
    return folder / "recording"


def _use(*others: Callable[[Path], object]) -> Callable[[Path], str]:
    """Read a dataset, and do with it what may refuse it."""

    def read(path: Path) -> str:
        found = _samples(path)
        for other in (*others, verify_dataset, lambda path: drop(path, ["ball/000002"]), repair_dataset):
            with suppress(ForetouchError):
                other(path)
        _samples(path)
        return found

    return read


def _bag(path: Path) -> str:
    digest = hashlib.sha256()
    with Recording(path) as recording:
        for message in recording.messages():
            digest.update(message.data)
    return digest.hexdigest()


def _store(folder: Path) -> Path:
    with StoreWriter(folder / "store", {"scene": "x"}) as writer:
        for k in range(5):
            writer.write(replace(only_finite(record(k)), id=f"ball/{k}"))
        writer.attach("splits.json", json.dumps({"schema_version": 1, "splits": {}}))
    return folder / "store"


def _load_store(path: Path) -> None:
    assert all(np.isfinite(sample.cloud.xyz).all() for sample in load_dataset(path).samples)


def _vision2tactile(folder: Path) -> Path:
    write_sample(folder / "can" / "1500000000", np.random.default_rng(0))
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


def _predict(path: Path) -> str:
    """Load a touch model and predict one grasp, which must be finite or refused."""
    xyz = np.random.default_rng(0).normal(size=(300, 3)).astype(np.float32) * 0.03 + np.float32([0, 0, 0.5])
    grasp = Grasp(np.array([0.03, 0, 0.5]), np.array([-0.03, 0, 0.5]), np.eye(3))
    prediction = load_model(path).predict(Cloud(xyz), [grasp])[0]
    values = prediction.value.values if prediction.ok else None
    assert values is None or np.isfinite(values).all()
    return repr(values)


def _history(folder: Path) -> Path:
    path = folder / "history" / "right.safetensors"
    _read_history(path)
    return path


def _read_history(path: Path) -> None:
    file = HistoryFile(path, "right")
    try:
        file.write(file.read(load_model()) or History(load_model()))
    finally:
        file.close()


def _run(folder: Path) -> Path:
    import torch

    run = RunFolder(folder / "run")
    run.open(RUN, resume=False)
    write_state(folder / "run" / "state.safetensors", {"x": torch.zeros(3)}, {"epoch": 1, "log": [{"epoch": 0}]})
    return folder / "run"


def _read_run(path: Path) -> None:
    run = RunFolder(path)
    run.open(RUN, resume=True)
    write_state(path / "state.safetensors", *read_state(path / "state.safetensors"))


def _sweep(folder: Path) -> Path:
    manifest = open_folder(folder / "sweep", SWEEP)
    (folder / "sweep" / "manifest.json").write_text(json.dumps(manifest))
    (folder / "sweep" / "results.csv").write_text("a,b\n1,x\n")
    return folder / "sweep"


def _read_sweep(path: Path) -> None:
    open_folder(path, SWEEP)
    read_results(path / "results.csv")


def _sensor(folder: Path) -> Path:
    for file in sensor_files()["biotac_sp"].parent.glob("biotac_sp.*"):
        shutil.copy(file, folder)
    return folder / "biotac_sp.yaml"


def _read_sensor(path: Path) -> None:
    sensor = load_sensor(path)
    SensorReader(sensor)
    assert np.isfinite(sensor.layout.positions).all()


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_text(text)
        return folder / name

    return make


def _mesh(folder: Path) -> Path:
    import trimesh

    trimesh.creation.box().export(folder / "mesh.ply", encoding="ascii")
    return folder / "mesh.ply"


_STORED, _RECORDED = (".json", ".arrow"), (".json", ".mcap")
_SETTINGS = "# settings\n" + yaml.safe_dump(PipelineConfig().to_mapping())

KINDS = {
    **{suffix: Kind(_cloud(f".{suffix}"), _digest) for suffix in ("pcd", "ply", "npz", "npy")},
    **{f"{suffix} ascii": Kind(_cloud(f".{suffix}", text=True), _digest) for suffix in ("pcd", "ply")},
    "pcd compressed": Kind(_compressed_pcd, _digest),
    "recording": Kind(_recording, _use(), exact=_RECORDED),
    "recording of a described sensor": Kind(_described_recording, _use(undo), 0.5, _RECORDED),
    "bag": Kind(lambda folder: next(_recording(folder).glob("*.mcap")), _bag),
    "store": Kind(_store, _samples, exact=_STORED),
    "store of a described sensor": Kind(lambda folder: write_readings(folder / "store", each=2), _load_store),
    "vision2tactile": Kind(_vision2tactile, _samples),
    "lerobot": Kind(_lerobot, _import, 0.3),
    "model": Kind(lambda folder: Path(save_calibrated_contact(folder)), _predict, 0.5),
    "history": Kind(_history, _read_history, 0.5),
    "settings": Kind(_text("a.yaml", _SETTINGS), lambda path: PipelineConfig.from_mapping(load_yaml(path), str(path))),
    "sensor": Kind(_sensor, _read_sensor),
    "run": Kind(_run, _read_run),
    "experiment": Kind(_sweep, _read_sweep),
    "splits": Kind(_text("a.json", json.dumps({"schema_version": 1, "splits": SPLITS})), read_splits, 0.5),
    "mesh": Kind(_mesh, lambda path: read_mesh_file(str(path)), 0.02),
}

# SPDX-License-Identifier: Apache-2.0
"""The training store: what is written is read, and nothing that was changed."""

import hashlib
import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from every_case import every_case, every_refusal
from recording_builders import assert_same_sample, record

from foretouch.dataset import store as store_module
from foretouch.dataset.files import sealed
from foretouch.dataset.store import MANIFEST, SEAL, Store, content_sha256, is_store
from foretouch.errors import DatasetError, FileError
from foretouch.tactile import BIOTAC, TOUCH_SIZE, biotac_touch
from foretouch.types import Cloud, Sample
from foretouch_lab.dataset.store_writer import StoreWriter


def sample(k: int, points: int = 40, *, labelled: bool = True, colour: bool = False) -> Sample:
    made = record(k, "can", points)
    cloud = made.cloud if colour else replace(made.cloud, rgb=None)
    rotation = np.linalg.qr(np.random.default_rng(k).standard_normal((3, 3)))[0]
    grasp = replace(made.grasp, rotation=rotation, score=math.nan if k == 1 else float(k))
    return replace(made, id=f"can/{k}", cloud=cloud, grasp=grasp, touch=made.touch if labelled else None)


def write(path: Path, samples: list[Sample]) -> StoreWriter:
    with StoreWriter(path, {"scene": "x"}) as writer:
        for one in samples:
            writer.write(one)
    return writer


def reseal(path: Path) -> None:
    """Write the hashes of the files as they are into the manifest, as a damaged writer would."""
    manifest = json.loads((path / MANIFEST).read_text())
    for shard in manifest["shards"]:
        shard["sha256"] = hashlib.sha256((path / shard["file"]).read_bytes()).hexdigest()
    (path / MANIFEST).write_text(sealed(manifest, SEAL))


def test_what_was_written_is_read_bit_for_bit(tmp_path: Path) -> None:
    samples = [sample(k, 10 + k, labelled=k % 3 > 0, colour=k % 2 > 0) for k in range(150)]
    writer = write(tmp_path / "ds", samples)
    store = Store(tmp_path / "ds")
    assert len(store) == 150
    assert store.sha256 == writer.sha256
    for k in (149, 0, 1, 63, 64, 65, 127, 128, -150):
        assert_same_sample(store[k], samples[k])
        assert (store[k].id, store[k].cloud.frame_id) == (samples[k].id, samples[k].cloud.frame_id)
    assert [s.id for s in store] == [s.id for s in samples]
    assert [s.id for s in store[3:5]] == ["can/3", "can/4"]
    assert content_sha256(store) == store.sha256
    assert store.manifest["about"] == {"scene": "x"}


def test_more_than_one_shard_none_and_a_hash_of_the_content(tmp_path: Path) -> None:
    samples = [sample(k, 3) for k in range(1100)]
    first = write(tmp_path / "ds", samples)
    store = Store(tmp_path / "ds")
    assert [shard["samples"] for shard in store.manifest["shards"]] == [1024, 76]
    assert [store[k].id for k in (1023, 1024)] == ["can/1023", "can/1024"]
    assert content_sha256(store) == store.sha256
    write(tmp_path / "empty", [])
    store = Store(tmp_path / "empty")
    assert (len(store), is_store(store.path), is_store(tmp_path)) == (0, True, False)
    with pytest.raises(IndexError, match="sample 0 of 0"):
        store[0]
    again = write(tmp_path / "again", samples)
    other = write(tmp_path / "other", [*samples[:-1], replace(samples[-1], extra={"force_th_n": 0.0})])
    assert first.sha256 == again.sha256 != other.sha256


_UNSET = biotac_touch(np.full(TOUCH_SIZE, np.nan))


def test_bad_samples_are_refused_by_name(tmp_path: Path) -> None:
    good = sample(0)
    organised = replace(good, cloud=Cloud(np.zeros((2, 2, 3), np.float32)))
    unfinished = replace(good, cloud=Cloud(np.full((2, 3), np.nan, np.float32)))
    with StoreWriter(tmp_path / "ds") as writer:
        writer.write(good)
        for bad, message in (
            (organised, "can/0: the cloud is organised"),
            (unfinished, "can/0: the cloud is organised or not finite"),
            (replace(good, extra={"force": math.inf}), "can/0: extra.force: inf"),
            (replace(good, tare=_UNSET), "can/0: tare: holds a value that is not finite"),
            (good, "can/0: the store .* holds this id already"),
        ):
            with pytest.raises(DatasetError, match=message):
                writer.write(bad)
        for name in ("manifest.json", "../x", "a/b", "shard-00000.arrow/x"):
            with pytest.raises(DatasetError, match="is taken, or not the name of a file"):
                writer.attach(name, "")
    assert len(Store(tmp_path / "ds")) == 1


def test_files_that_disagree_with_the_manifest_are_never_used(tmp_path: Path) -> None:
    with StoreWriter(tmp_path / "ds", {"scene": "x"}) as writer:
        for k in range(3):
            writer.write(sample(k))
        writer.attach("splits.json", "{}")
    cloud = np.ascontiguousarray(sample(1).cloud.xyz).tobytes()[:16]
    label, changed_label = sample(1).touch.values[:1].tobytes(), np.float64(999.0).tobytes()

    def check(name: str, change: Callable[[bytes], bytes], rule: str, resealed: bool = False) -> None:
        file = tmp_path / "ds" / name
        good, manifest = file.read_bytes(), (tmp_path / "ds" / MANIFEST).read_bytes()
        file.write_bytes(change(good))
        if resealed:
            reseal(tmp_path / "ds")
        try:
            with pytest.raises(FileError, match=rf"{name}: {rule}"):
                Store(tmp_path / "ds")
        finally:
            file.write_bytes(good)
            (tmp_path / "ds" / MANIFEST).write_bytes(manifest)

    shard = "shard-00000.arrow"
    cases = [
        (shard, lambda data: data.replace(cloud, cloud[::-1]), "sha256 is .* the file was changed"),
        (shard, lambda data: data.replace(label, changed_label), "sha256 is"),
        (shard, lambda data: data[: len(data) // 2], "sha256 is"),
        (shard, lambda data: data[: len(data) // 2], "cannot be read", True),
        (shard, lambda _: _other_columns(), "schema: has other columns", True),
        ("splits.json", lambda _: b"[]", "sha256 is"),
        (MANIFEST, lambda data: data.replace(b'"x"', b'"y"'), "seal: damaged: the text does not match its checksum"),
    ]
    every_case(cases, check)
    Store(tmp_path / "ds")


def _other_columns() -> bytes:
    table, sink = pa.record_batch({"id": ["a", "b", "c"]}), pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema) as out:
        out.write_batch(table)
    return sink.getvalue().to_pybytes()


def test_a_manifest_or_an_offset_that_breaks_a_rule_is_refused_though_the_hashes_agree(tmp_path: Path) -> None:
    write(tmp_path / "ds", [sample(k) for k in range(3)])
    file = tmp_path / "ds" / MANIFEST
    good = json.loads(file.read_text())

    def read(change: dict[str, object]) -> None:
        file.write_text(sealed(good | change, SEAL))
        Store(tmp_path / "ds")

    cases = (
        ("format: is not foretouch-store", {"format": "other"}),
        ("samples: holds 3 samples, not 4", {"samples": 4}),
        ("samples: '3' is not a whole number", {"samples": "3"}),
        (r"about: \[\] is not a mapping", {"about": []}),
        ("shards: 5 is not a list", {"shards": 5}),
        (r"files\[0\].sha256: is missing", {"files": [{"file": "x"}]}),
        ("file: '../x' is not the name of a file in the store", {"files": [{"file": "../x", "sha256": ""}]}),
        ("holds 3 samples, the manifest declares 2", {"shards": [good["shards"][0] | {"samples": 2}]}),
    )
    every_refusal(FileError, cases, read)
    write(tmp_path / "shards", [sample(k) for k in range(5)])
    shard = tmp_path / "shards" / "shard-00000.arrow"
    content = shard.read_bytes()
    start = content.index(np.arange(0, 6 * 120, 120, dtype=np.int32).tobytes())  # of xyz: 40 points a sample
    for value in (-1, 1, 2**31 - 1, -(2**31), 10**6):
        shard.write_bytes(content[: start + 8] + np.int32(value).tobytes() + content[start + 12 :])
        reseal(tmp_path / "shards")
        with pytest.raises(FileError, match=r"shard-00000.arrow: batch 0: "):
            Store(tmp_path / "shards")


def test_a_shard_that_is_changed_truncated_or_taken_away_after_it_was_opened_is_named(tmp_path: Path) -> None:
    write(tmp_path / "ds", [sample(k) for k in range(400)])
    shard = tmp_path / "ds" / "shard-00000.arrow"
    good, store = shard.read_bytes(), Store(tmp_path / "ds")

    def check(_: str, change: Callable[[], object], rule: str) -> None:
        change()
        with pytest.raises(FileError, match=rf"shard-00000.arrow: {rule}"):
            [store[k].cloud.xyz.sum() for k in range(400)]
        shard.write_bytes(good)

    flipped = good.replace(np.ascontiguousarray(sample(390).cloud.xyz).tobytes()[:16], bytes(16))
    cases = (
        ("truncated", lambda: shard.write_bytes(good[: len(good) // 2]), "was changed after it was opened"),
        ("emptied", lambda: shard.write_bytes(b""), "was changed after it was opened"),
        ("changed", lambda: shard.write_bytes(flipped), "was changed after it was opened"),
        ("removed", shard.unlink, "No such file"),
    )
    every_case(cases, check)


def test_nulls_and_compressed_batches_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "ds", [sample(k) for k in range(3)])
    shard = tmp_path / "ds" / "shard-00000.arrow"
    rows = pa.ipc.open_file(shard).read_all().to_pylist()

    def check(_: str, change: dict[str, object], rule: str, compression: str | None = None) -> None:
        with pa.OSFile(str(shard), "wb") as sink:
            options = pa.ipc.IpcWriteOptions(compression=compression)
            with pa.ipc.new_file(sink, store_module.schema_of(BIOTAC), options=options) as out:
                out.write_batch(
                    pa.RecordBatch.from_pylist([*rows[:2], rows[2] | change], schema=store_module.schema_of(BIOTAC))
                )
        reseal(tmp_path / "ds")
        with pytest.raises(FileError, match=rf"shard-00000.arrow: batch 0: {rule}"):
            Store(tmp_path / "ds")

    cases = [(f"{name} null", {name: None}, f"{name}: is null") for name in ("id", "stamp_ns", "extra", "xyz", "g1")]
    cases += [(f"{name} of nulls", {name: [None] * 50}, f"{name}: is null") for name in ("touch", "tare")]
    cases += [("xyz of nulls", {"xyz": [None] * 3}, "xyz: is null")]
    cases += [(kind, {"xyz": [0.0] * 3_000}, "is compressed", kind) for kind in ("zstd", "lz4")]
    every_case(cases, check)


def test_a_compressed_batch_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    write(tmp_path / "ds", [sample(0)])
    shard, schema = tmp_path / "ds" / "shard-00000.arrow", store_module.schema_of(BIOTAC)
    row = pa.ipc.open_file(shard).read_all().to_pylist()[0]
    batch, offsets = pa.RecordBatch.from_pylist([row], schema=schema), pa.array([0, 30_000_000], pa.int32())
    for name, kind in (("xyz", np.float32), ("rgb", np.uint8)):
        column = pa.ListArray.from_arrays(offsets, pa.array(np.zeros(30_000_000, kind)))
        batch = batch.set_column(schema.get_field_index(name), name, column)
    with pa.ipc.new_file(shard, schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as out:
        out.write_batch(batch)
    reseal(tmp_path / "ds")
    assert shard.stat().st_size < 100_000
    program = """
import sys, pyarrow
from foretouch.dataset.store import Store
from foretouch.errors import FileError
try:
    Store(sys.argv[1])
except FileError as err:
    print(err)
print(pyarrow.default_memory_pool().max_memory())
"""
    command = [sys.executable, "-c", program, str(tmp_path / "ds")]
    refusal, peak = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert refusal.endswith("shard-00000.arrow: batch 0: is compressed")
    assert int(peak) < 1_000_000

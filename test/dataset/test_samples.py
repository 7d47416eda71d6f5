# SPDX-License-Identifier: Apache-2.0
"""One open dataset, several readers: threads, forked and spawned processes read what one reader reads, in every format."""

import hashlib
import multiprocessing
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from recording_builders import IDENTITY, QUICK, record, write_dataset
from torch.utils.data import DataLoader

import foretouch as ft
from foretouch.dataset.formats import export_samples, open_samples
from foretouch.dataset.recordings.sample_codec import encode_sample
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.dataset.samples import SampleSet
from foretouch.dataset.source import open_source
from foretouch.errors import DatasetError, FileError
from foretouch.types import DISCARDED, Sample
from foretouch_lab.dataset.store_writer import build_store

COUNT = 12
ORDER = [*range(COUNT), *range(COUNT)[::-1]] * 3


def digest(sample: Sample) -> str:
    """A hash over every bit of a sample."""
    return hashlib.sha256(encode_sample(sample, IDENTITY)).hexdigest()


class Reading:
    """Reads samples of a set in a pool, to which it is sent with each task."""

    def __init__(self, samples: SampleSet) -> None:
        self.samples = samples

    def __call__(self, number: int) -> str:
        return digest(self.samples.read(number))


def write_compressed(source: Path, path: Path) -> None:
    """The messages of a recording in compressed chunks of several samples, as another tool writes them."""
    with source.open("rb") as file, path.open("wb") as out:
        reader, writer = make_reader(file), Writer(out, chunk_size=100_000, compression=CompressionType.ZSTD)
        writer.start("ros2", "foretouch of another tool")
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            times = message.log_time, message.publish_time
            writer.add_message(channels[channel.id], times[0], message.data, times[1], message.sequence)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        writer.finish()


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same samples in every format that can be read, and in an MCAP file of compressed chunks."""
    folder = tmp_path_factory.mktemp("formats")
    source = folder / "recording"
    write_dataset(source, COUNT, points=2000)
    build_store([source], folder / "store")
    for kind in ("vision2tactile", "lerobot", "npz"):
        export_samples(source, folder / kind, kind)
    compressed = folder / "compressed.mcap"
    write_compressed(source / "session-0001.mcap", compressed)
    return {
        name: folder / name for name in ("recording", "store", "vision2tactile", "lerobot", "npz", "compressed.mcap")
    }


@pytest.fixture(params=["recording", "store", "vision2tactile", "lerobot", "npz", "compressed.mcap"])
def dataset(request: Any, datasets: dict[str, Path]) -> Path:
    return datasets[request.param]


def test_threads_and_forked_processes_read_what_one_reader_reads(dataset: Path) -> None:
    samples = ft.open(dataset)
    alone = [digest(samples.read(k)) for k in ORDER]
    assert len({*alone}) == COUNT
    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(Reading(samples), ORDER)) == alone
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(Reading(samples), ORDER[:48], chunksize=1).get(60) == alone[:48]
        pool.close()  # so that they end by themselves: they inherit the handlers of signals that ROS leaves behind
        pool.join()


def test_iterators_of_one_set_do_not_disturb_each_other(dataset: Path) -> None:
    samples = ft.open(dataset)
    alone = [digest(sample) for sample in samples]
    assert [(digest(one), digest(other)) for one, other in zip(samples, samples, strict=True)] == [
        *zip(alone, alone, strict=True)
    ]
    with ThreadPoolExecutor(2) as threads:
        assert [*threads.map(lambda _: [digest(sample) for sample in samples], range(2))] == [alone, alone]


def test_every_set_and_part_is_pickled_and_reads_the_same_samples(dataset: Path) -> None:
    samples = ft.open(dataset)
    parts = {
        "set": samples,
        "part of a part": samples.subset(range(2, 10)).subset([5, 0, 1]),
        "filter": samples.filter(lambda sample: sample.stamp_ns % 2_000_000_000 == 0),
        "split": samples.split("random")[0][0],
    }

    def check(part: SampleSet) -> None:
        again = pickle.loads(pickle.dumps(part))
        assert [digest(sample) for sample in again] == [digest(sample) for sample in part]
        assert (again.sensor.sha256, again.identity, again.kind, again.message_counts()) == (
            part.sensor.sha256, part.identity, part.kind, part.message_counts(),
        )  # fmt: skip
        assert again.name(0) == part.name(0)

    every_case(parts, check)


def test_a_set_is_a_map_style_dataset_of_pytorch(datasets: dict[str, Path]) -> None:
    samples = ft.open(datasets["recording"]).subset([4, 2, 7])
    assert [digest(samples[k]) for k in (0, -1)] == [digest(samples.read(k)) for k in (0, 2)]
    assert [sample.id for sample in samples] == [samples[np.int64(k)].id for k in range(len(samples))]
    assert [sample.id for sample in samples[1:]] == [samples[k].id for k in (1, 2)]
    with pytest.raises(IndexError, match="there is no sample 3, 0 to 2"):
        samples[3]
    loader: Any = DataLoader(samples, batch_size=2, num_workers=1, collate_fn=list)
    batches = [[digest(sample) for sample in batch] for batch in loader]
    assert batches == [[digest(samples[0]), digest(samples[1])], [digest(samples[2])]]


@pytest.mark.slow
def test_spawned_processes_read_what_one_reader_reads(datasets: dict[str, Path]) -> None:
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for path in datasets.values():
            samples = ft.open(path)
            part = samples.subset(range(COUNT)[::-1])
            sent = pool.map_async(part.read, range(COUNT), chunksize=1).get(120)
            assert [digest(sample) for sample in sent] == [digest(sample) for sample in part]


def test_a_set_that_was_opened_by_a_relative_path_is_read_in_any_folder(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(dataset.parent)
    samples = ft.open(dataset.name)
    before = [digest(sample) for sample in samples]
    monkeypatch.chdir(tmp_path)
    assert [digest(sample) for sample in samples] == before
    assert [digest(sample) for sample in pickle.loads(pickle.dumps(samples))] == before


def test_a_dataset_that_changes_while_it_is_open_is_read_as_it_was_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "ds"
    write_dataset(path, 3)
    samples = open_samples(path)
    pickled, before = pickle.dumps(samples), [digest(sample) for sample in samples]
    with RecordingWriter(path, IDENTITY, QUICK) as writer:
        writer.append(record(9))
    for extended in (samples, pickle.loads(pickled)):
        assert [digest(sample) for sample in extended] == before
    shutil.rmtree(path)
    assert [digest(sample) for sample in samples] == before  # its files are open
    with pytest.raises(FileError, match=r"session-0001\.mcap: No such file or directory"):
        pickle.loads(pickled)
    write_dataset(path, 4)
    with pytest.raises(FileError, match=r"session-0001\.mcap: was changed after it was opened: open it again"):
        pickle.loads(pickled)
    build_store([path], tmp_path / "store")
    store = pickle.dumps(open_samples(tmp_path / "store"))
    shutil.rmtree(tmp_path / "store")
    write_dataset(tmp_path / "other", 3, points=31)
    build_store([tmp_path / "other"], tmp_path / "store")
    with pytest.raises(FileError, match="store: was changed after it was opened: open it again"):
        pickle.loads(store)


def test_parts_are_chosen_by_numbers_or_a_mask_and_others_are_refused(tmp_path: Path) -> None:
    write_dataset(tmp_path / "ds", 3)
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.append(replace(record(5), flags=(DISCARDED,)))
    samples = open_samples(tmp_path / "ds")
    ids = [sample.id for sample in samples.with_discarded()]
    chosen: list[tuple[Any, list[int]]] = [
        ([2, 0], [2, 0]), (range(1, 3), [1, 2]), ({1}, [1]), ((k for k in (0, 1)), [0, 1]), ([], []),
        (np.array([True, False, True, False]), [0, 2]), ([False, True, False, True], [1, 3]),
    ]  # fmt: skip
    for numbers, expected in chosen:
        assert [sample.id for sample in samples.subset(numbers).with_discarded()] == [ids[k] for k in expected]
    assert len(samples.filter(lambda sample: DISCARDED in sample.flags)) == 1
    for wrong in ([4], [-1], [0.5], ["a"], None, 1, [True], [10**400], [[0]]):
        with pytest.raises(DatasetError, match=r"not the number.* of (a )?samples?"):
            samples.subset(wrong)  # type: ignore[arg-type]


def test_a_source_of_a_dataset_or_of_files_is_pickled(datasets: dict[str, Path]) -> None:
    for path in (datasets["recording"], datasets["npz"]):
        source = open_source(path)
        again: Any = pickle.loads(pickle.dumps(source))
        assert [digest(item.sample) for item in again] == [digest(item.sample) for item in source]

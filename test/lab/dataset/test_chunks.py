# SPDX-License-Identifier: Apache-2.0
"""Samples made in chunks: equal to those of one process, continued after a loss, refused by name."""

import os
import shutil
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from chunk_makers import make
from every_case import every_case
from recording_builders import write_dataset
from sim_builders import scene

from foretouch.cli.main import main
from foretouch.dataset.store import Store, content_sha256
from foretouch.errors import DatasetError, FileError, SimulationError
from foretouch_lab.dataset import chunks
from foretouch_lab.dataset.chunks import made_in_chunks
from foretouch_lab.simulation.simulate import Simulation


@pytest.fixture
def trace(tmp_path) -> Path:
    folder = tmp_path / "trace"
    folder.mkdir()
    return folder


@pytest.fixture
def here(monkeypatch) -> None:
    """Chunks of four samples, made in this process."""

    def results(function, items, *_):
        for item in items:
            try:
                yield item, function(item), ""
            except SimulationError as err:
                yield item, None, str(err)

    monkeypatch.setattr(chunks, "CHUNK_SAMPLES", 4)
    monkeypatch.setattr(chunks, "ray_results", results)


def begun(trace: Path) -> dict[int, int]:
    """How often each chunk was begun, by its first slot."""
    return Counter(int(path.name.split(".")[0]) for path in trace.iterdir())


def test_chunks_hold_readings_of_the_sensor_of_the_scene(here, tmp_path) -> None:
    simulation = Simulation(scene(fingers={"sensor": "xela_uskin_4x4"}))
    made = list(simulation.samples_on_ray(6, tmp_path / "ds.chunks", "", 1))
    for sample, other in zip(made, simulation.samples(6), strict=True):
        np.testing.assert_array_equal(sample.touch.values, other.touch.values)
    assert Store(tmp_path / "ds.chunks" / "chunk-00001").sensor.config.name == "xela_uskin_4x4"


def test_missing_and_damaged_chunks_are_made_again_and_no_others(here, tmp_path, trace) -> None:
    folder, plan = tmp_path / "ds.chunks", {"samples": 10, "scene": "a"}
    whole = [*made_in_chunks(folder, plan, 10, partial(make, trace, 0.0, -1), "", 1)]
    samples = [sample for store in whole for sample in store]
    assert [len(store) for store in whole] == [4, 4, 2]
    assert whole[2].manifest["about"] == {"first": 8, "mean": 8.5, "chunk": 2}
    assert begun(trace) == {0: 1, 4: 1, 8: 1}
    shutil.rmtree(folder / "chunk-00000")
    shard = folder / "chunk-00001" / "shard-00000.arrow"
    shard.write_bytes(shard.read_bytes()[:-100])
    there = []
    again = made_in_chunks(folder, plan, 10, partial(make, trace, 0.0, -1), "", 1, there.append)
    assert content_sha256(sample for store in again for sample in store) == content_sha256(samples)
    assert begun(trace) == {0: 2, 4: 2, 8: 1}
    assert sorted(there) == [2, 4, 4]
    with pytest.raises(FileError, match=r"plan\.json: is of other samples \(scene\); remove .*ds\.chunks"):
        next(made_in_chunks(folder, plan | {"scene": "b"}, 10, partial(make, trace, 0.0, -1), "", 1))
    stores = made_in_chunks(folder, plan, 10, partial(make, trace, 0.0, -1), "", 1)
    next(stores)
    shutil.rmtree(folder / "chunk-00001")
    with pytest.raises(FileError, match="chunk-00001"):
        next(stores)


def test_a_chunk_in_the_place_of_another_is_made_again_and_what_is_no_folder_is_refused(here, tmp_path, trace) -> None:
    folder, first = tmp_path / "ds.chunks", tmp_path / "ds.chunks" / "chunk-00000"
    maker = partial(make, trace, 0.0, -1)
    wanted = [sample.id for store in made_in_chunks(folder, {}, 8, maker, "", 1) for sample in store]
    first.rename(tmp_path / "x")
    (folder / "chunk-00001").rename(first)
    (tmp_path / "x").rename(folder / "chunk-00001")
    assert [sample.id for store in made_in_chunks(folder, {}, 8, maker, "", 1) for sample in store] == wanted

    def refused(put) -> None:
        shutil.rmtree(first) if first.is_dir() and not first.is_symlink() else first.unlink()
        put()
        with pytest.raises(FileError, match="chunk-00000: is a link or no folder"):
            next(made_in_chunks(folder, {}, 8, maker, "", 1))

    ways = {
        "fifo": lambda: os.mkfifo(first),
        "file": lambda: first.write_text("x"),
        "link": lambda: first.symlink_to("chunk-00001"),
        "broken link": lambda: first.symlink_to("absent"),
    }
    every_case(ways, refused)


def test_no_folder_of_the_user_is_removed_with_the_chunks_and_no_fifo_is_waited_for(here, tmp_path, capsys) -> None:
    write_dataset(tmp_path / "a", 2, points=20)
    (tmp_path / "one.chunks").mkdir()
    (tmp_path / "one.chunks" / "notes.txt").write_text("precious")
    assert main(["dataset", "build", str(tmp_path / "a"), "--json", "-o", str(tmp_path / "one")]) == 0
    assert (tmp_path / "one.chunks" / "notes.txt").read_text() == "precious"
    os.mkfifo(tmp_path / ".two.part")
    assert main(["dataset", "build", str(tmp_path / "a"), "--json", "-o", str(tmp_path / "two")]) == 1
    assert "two: cannot be written, by way of .two.part: File exists" in capsys.readouterr().err


def test_a_chunk_that_cannot_be_made_is_named_and_the_others_are_kept(here, tmp_path, trace) -> None:
    folder = tmp_path / "ds.chunks"
    with pytest.raises(DatasetError, match=r"1 of 3 chunks could not be made; chunk 1: slot 5: is broken"):
        next(made_in_chunks(folder, {}, 10, partial(make, trace, 0.0, 5), "", 1))
    assert sorted(path.name for path in folder.iterdir()) == ["chunk-00000", "chunk-00002", "plan.json"]
    assert len([*made_in_chunks(folder, {}, 10, partial(make, trace, 0.0, -1), "", 1)]) == 3
    assert begun(trace) == {0: 1, 4: 2, 8: 1}
    shutil.rmtree(folder)
    with pytest.raises(DatasetError, match=r"does not see .*ds\.chunks, which all nodes must share"):
        chunks._make_chunk(folder, partial(make, trace, 0.0, -1), (0, range(4)))


def test_simulated_in_chunks_is_as_simulated_in_one_process(here, tmp_path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("objects: [{name: can, shape: can, size_m: [0.07, 0.07, 0.1], pose: {rest: side}}]\n")
    words = ["simulate", str(scene), "-n", "6", "--no-sheet", "--workers", "1", "-o"]
    assert main([*words, str(tmp_path / "one")]) == 0
    assert main([*words, str(tmp_path / "many"), "--address", "local"]) == 0
    assert Store(tmp_path / "one").manifest == Store(tmp_path / "many").manifest
    assert not (tmp_path / "many.chunks").exists()


@pytest.mark.slow
@pytest.mark.timeout(600)  # starting nodes and processes takes a minute or two on a busy machine
def test_a_lost_node_costs_its_chunks_alone(tmp_path, trace, ray_cluster, monkeypatch) -> None:
    monkeypatch.setattr(chunks, "CHUNK_SAMPLES", 8)
    lost, _ = ray_cluster.add_node(num_cpus=1), ray_cluster.add_node(num_cpus=1)
    made = []

    def report(count: int) -> None:
        made.append(count)
        if len(made) == 3:
            ray_cluster.remove_node(lost, allow_graceful=False)

    maker = partial(make, trace, 1.0, -1)
    stores = made_in_chunks(tmp_path / "ds.chunks", {}, 96, maker, ray_cluster.address, 1, report)
    found = content_sha256(sample for store in stores for sample in store)
    starts = begun(trace)
    assert sorted(starts) == [*range(0, 96, 8)]
    assert sum(starts.values()) <= 12 + 2  # what the lost node ran, and what was handed to it
    alone = made_in_chunks(tmp_path / "alone.chunks", {}, 96, partial(make, trace, 0.0, -1), "local", 1)
    assert content_sha256(sample for store in alone for sample in store) == found

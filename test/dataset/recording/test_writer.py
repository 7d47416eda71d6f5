# SPDX-License-Identifier: Apache-2.0
"""A session from its start to its end, and everything that can go wrong with the disk."""

import errno
import json
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_builders import (
    IDENTITY,
    MESSAGE,
    QUICK,
    TACTILE,
    TACTILE_TYPE,
    assert_same_sample,
    fail_writes,
    record,
    write_dataset,
)

from foretouch.dataset.recording import (
    SAMPLE_TOPIC,
    Identity,
    MessageCounts,
    RecordedDataset,
    RecordingConfig,
    RecordingWriter,
    repair_dataset,
    verify_dataset,
)
from foretouch.errors import DatasetError, FileError


def ids(path: Path) -> list[str]:
    with RecordedDataset(path) as dataset:
        return [stored.record.sample.id for stored in dataset]


def assert_clean(path: Path) -> None:
    assert [fault for report in verify_dataset(path) for fault in report.fault_lines()] == []


def test_what_is_appended_is_read_back(tmp_path: Path) -> None:
    write_dataset(tmp_path / "ds", 5)
    with RecordedDataset(tmp_path / "ds") as dataset:
        assert len(dataset) == 5
        for number, stored in enumerate(dataset):
            assert_same_sample(stored.record.sample, record(number).sample)
            assert stored.identity == IDENTITY
    assert ids(tmp_path / "ds") == [f"ball/{n:06d}" for n in range(1, 6)]
    assert_clean(tmp_path / "ds")


def test_a_resumed_dataset_goes_on_with_its_ids(tmp_path: Path) -> None:
    write_dataset(tmp_path / "ds", 3)
    write_dataset(tmp_path / "ds", 2, name="sponge")
    assert ids(tmp_path / "ds")[3:] == ["sponge/000004", "sponge/000005"]
    assert [file.name for file in sorted((tmp_path / "ds").glob("*.mcap"))] == [
        "session-0001.mcap",
        "session-0002.mcap",
    ]
    assert_clean(tmp_path / "ds")


def test_ids_go_on_after_a_session_that_was_cut_off(tmp_path: Path) -> None:
    file = write_dataset(tmp_path / "ds", 3)
    file.write_bytes(file.read_bytes()[:-2000])
    known = len(ids(tmp_path / "ds"))
    write_dataset(tmp_path / "ds", 1)
    assert ids(tmp_path / "ds")[-1] == f"ball/{known + 1:06d}"


def test_ids_of_a_source_are_kept_and_given_once(tmp_path: Path) -> None:
    made = record(0)
    named = replace(made, sample=replace(made.sample, id="ball/1562239078"))
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        assert writer.append(named) == "ball/1562239078"
        with pytest.raises(DatasetError, match="id ball/1562239078 is taken"):
            writer.append(named)
        assert writer.append(record(1)) == "ball/000001"
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer, pytest.raises(DatasetError, match="is taken"):
        writer.append(named)
    assert_clean(tmp_path / "ds")


def test_another_hand_and_camera_are_refused_by_name(tmp_path: Path) -> None:
    write_dataset(tmp_path / "ds", 1)
    other = Identity(hand={**IDENTITY.hand, "serial": "9"}, camera={"name": "D435"})
    with pytest.raises(FileError) as caught:
        RecordingWriter(tmp_path / "ds", other)
    for difference in (
        "hand.serial: 1234 there, 9 here",
        "camera.name: D415 there, D435 here",
        "camera.serial: 777 there, absent",
    ):
        assert difference in str(caught.value)
    assert len(list((tmp_path / "ds").glob("*.mcap"))) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema_version": 2}, "schema_version: 2 is not 1: it was written by a newer foretouch"),
        ({"schema_version": 0}, "schema_version: 0 is not 1"),
        ({"hand": {"name": "x"}}, "damaged"),
        ({"hand": 5}, "damaged"),
    ],
)
def test_a_manifest_of_another_kind_is_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    write_dataset(tmp_path / "ds", 1)
    manifest = tmp_path / "ds" / "manifest.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), **change}, indent=2) + "\n")
    with pytest.raises(FileError, match=message):
        RecordingWriter(tmp_path / "ds", IDENTITY)
    with pytest.raises(FileError, match=message):
        verify_dataset(tmp_path / "ds")


def test_another_minor_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dataset(tmp_path / "ds", 1)
    monkeypatch.setattr("foretouch.dataset.recording.folder.__version__", "99.7.0")
    with pytest.raises(FileError, match=r"foretouch: [\d.]+ there, 99\.7\.0 here"):
        RecordingWriter(tmp_path / "ds", IDENTITY)


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(b"x")
    with pytest.raises(FileError, match="exists and is no recorded dataset"):
        RecordingWriter(tmp_path, IDENTITY)
    assert [p.name for p in tmp_path.iterdir()] == ["photo.png"]


def test_two_recorders_are_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK):
        with pytest.raises(FileError, match=f"process {os.getpid()} is writing this dataset"):
            RecordingWriter(tmp_path / "ds", IDENTITY)
        with pytest.raises(FileError, match="is writing this dataset"):
            repair_dataset(tmp_path / "ds")
    RecordingWriter(tmp_path / "ds", IDENTITY, QUICK).close()


def test_every_message_is_accounted_for(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.receive(TACTILE, 10)
        for k in range(6):
            writer.write(TACTILE, MESSAGE, k)
        writer.drop(TACTILE, "queue full", 3)
        writer.append(record(0))
        assert writer.counts.topics[TACTILE].pending == 1
    account = writer.counts.topics[TACTILE]
    assert (account.received, account.written) == (10, 6)
    assert account.dropped == {"queue full": 3, "not written when the session ended": 1}
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.counts is not None
    assert report.counts.topics == writer.counts.topics
    assert report.messages == {TACTILE: 6, SAMPLE_TOPIC: 1}


def test_losses_stand_beside_the_sum_and_outlive_a_repair(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.lose(TACTILE, 3)
        writer.lose(TACTILE, 2)  # a count in all, which never goes back
        writer.receive(TACTILE)
        writer.write(TACTILE, MESSAGE, 0)
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.clean
    assert report.counts is not None
    account = report.counts.topics[TACTILE]
    assert (account.received, account.written, account.lost) == (1, 1, 3)
    writer.file.write_bytes(writer.file.read_bytes()[:-20])
    repair_dataset(tmp_path / "ds")
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.clean
    assert report.counts is not None
    assert report.counts.topics[TACTILE].lost == 3


def test_counts_that_cannot_be_read_are_refused() -> None:
    for text in ('{"received": "many"}', '{"received": 7, "written": 5, "dropped": {}}', "[]", "{"):
        with pytest.raises(DatasetError, match="holds no counts"):
            MessageCounts.from_mapping({TACTILE: text})


@pytest.mark.parametrize("full", [False, True])
def test_what_its_owner_still_holds_is_booked_in_the_file_however_the_session_ends(tmp_path: Path, full: bool) -> None:
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    writer.add_topic(TACTILE, TACTILE_TYPE)

    def book() -> None:
        writer.receive(TACTILE, 4)
        writer.drop(TACTILE, "session ended", 4)

    writer.before_end = book
    writer.receive(TACTILE)
    writer.write(TACTILE, MESSAGE, 0)
    if full:
        writer.config = replace(QUICK, min_free_mb=1e9)
        with pytest.raises(FileError, match="disk almost full"):
            writer.flush()
    writer.close()
    (report,) = verify_dataset(tmp_path / "ds")
    assert report.clean
    assert report.counts is not None
    account = report.counts.topics[TACTILE]
    assert account == writer.counts.topics[TACTILE]
    assert account.received == 5
    assert account.dropped == ({"session ended": 4, "disk full": 1} if full else {"session ended": 4})


def test_a_disk_that_fails_at_the_start_is_named_and_lets_go_of_the_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail_writes(monkeypatch, 2, errno.ENOSPC)  # magic and header, then the metadata
    with pytest.raises(FileError, match=r"session-0001.mcap: No space left on device \(errno 28\)"):
        RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    monkeypatch.undo()
    RecordingWriter(tmp_path / "ds", IDENTITY, QUICK).close()


def test_accounts_that_do_not_add_up_are_a_fault(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.write(TACTILE, MESSAGE, 0)  # never received
    (report,) = verify_dataset(tmp_path / "ds")
    assert any("received 0 is not written 1" in fault for fault in report.fault_lines())


def test_a_topic_must_be_declared_and_keeps_its_type(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        with pytest.raises(DatasetError, match="/a was not declared"):
            writer.write("/a", MESSAGE, 0)
        writer.add_topic("/a", "std_msgs/msg/String")
        with pytest.raises(DatasetError, match="/a: holds std_msgs/msg/String, not"):
            writer.add_topic("/a", TACTILE_TYPE)
        with pytest.raises(DatasetError, match="log_time_ns: -1 is no time since 1970"):
            writer.write("/a", MESSAGE, -1)
    assert_clean(tmp_path / "ds")


def test_clocks_that_jump_and_stamps_that_repeat_are_kept_as_they_are(tmp_path: Path) -> None:
    times = [5_000_000_000, 1_000, 1_000, 2**62, 0]
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        for time_ns in times:
            writer.receive(TACTILE)
            writer.write(TACTILE, MESSAGE, time_ns)
            made = record(0)
            writer.append(replace(made, sample=replace(made.sample, stamp_ns=time_ns % 2**60)), log_time_ns=time_ns)
    assert len(set(ids(tmp_path / "ds"))) == 5
    assert_clean(tmp_path / "ds")
    with RecordedDataset(tmp_path / "ds") as dataset:
        assert [stored.record.sample.stamp_ns for stored in dataset] == [t % 2**60 for t in times]


def test_messages_wait_no_longer_than_they_should(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, replace(QUICK, chunk_s=0.05)) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        before = writer.bytes_written
        writer.write(TACTILE, MESSAGE, 0)
        assert writer.bytes_written == before
        time.sleep(0.06)
        writer.write(TACTILE, MESSAGE, 1)
        assert writer.bytes_written > before
        writer.receive(TACTILE, 2)


def test_threads_are_put_in_a_row(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, replace(QUICK, chunk_s=0.0)) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)

        def messages() -> None:
            for k in range(200):
                writer.receive(TACTILE)
                writer.write(TACTILE, MESSAGE, k)

        threads = [threading.Thread(target=messages) for _ in range(3)]
        for thread in threads:
            thread.start()
        for number in range(20):
            writer.append(record(number))
        for thread in threads:
            thread.join()
    assert writer.counts.topics[TACTILE].written == 600
    assert_clean(tmp_path / "ds")
    assert len(ids(tmp_path / "ds")) == 20


def test_every_sample_is_waited_for_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[int] = []
    real = os.fdatasync
    monkeypatch.setattr(os, "fdatasync", lambda fd: (waits.append(fd), real(fd))[1])
    with RecordingWriter(tmp_path / "a", IDENTITY) as writer:
        waits.clear()
        writer.append(record(0))
        writer.append(record(1))
        assert len(waits) == 2
    with RecordingWriter(tmp_path / "b", IDENTITY, RecordingConfig(fsync_samples=3)) as writer:
        waits.clear()
        for number in range(7):
            writer.append(record(number))
        assert len(waits) == 2


def test_a_disk_that_is_almost_full_ends_the_session_cleanly(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    writer.append(record(0))
    free_mb = (os.statvfs(tmp_path).f_bavail * os.statvfs(tmp_path).f_frsize) / 1e6
    writer.config = replace(QUICK, min_free_mb=free_mb + 1000.0)
    assert writer.free_bytes == 0
    with pytest.raises(FileError, match=r"disk almost full: .* the session has ended, its 1 samples are in the file"):
        writer.append(record(1))
    assert writer.closed
    with pytest.raises(FileError, match="the session has ended"):
        writer.append(record(2))
    writer.close()
    assert_clean(tmp_path / "ds")
    assert ids(tmp_path / "ds") == ["ball/000001"]
    account = writer.counts.topics[SAMPLE_TOPIC]
    assert (account.received, account.written, dict(account.dropped)) == (2, 1, {"disk full": 1})


@pytest.mark.parametrize("code", [errno.EIO, errno.ENOSPC, errno.EROFS])
def test_a_failing_write_ends_the_session_with_what_was_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """Half of the sample's bytes get through before the device fails: they must be gone afterwards."""
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    told = [writer.append(record(number)) for number in range(3)]
    fail_writes(monkeypatch, 2, code, part=50)
    with pytest.raises(FileError, match=rf"{os.strerror(code)} \(errno {code}\): the session has ended, its 3 samples"):
        writer.append(record(3))
    monkeypatch.undo()
    assert ids(tmp_path / "ds") == told
    assert_clean(tmp_path / "ds")


def test_a_failing_wait_for_the_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, RecordingConfig(min_free_mb=0.0))

    def failing(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", failing)
    with pytest.raises(FileError, match="cannot be synchronised: Input/output error"):
        writer.append(record(0))
    assert writer.closed


_FILLING = """
import resource, sys
sys.path.insert(0, sys.argv[2])
from recording_builders import *
writer = RecordingWriter(sys.argv[1], IDENTITY, QUICK)
limit = int(sys.argv[3])
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
try:
    for number in range(10_000):
        print(writer.append(record(number, points=500)), flush=True)
except Exception as err:
    print(type(err).__name__, err, file=sys.stderr)
"""


def fill(path: Path, limit: int) -> tuple[list[str], str]:
    """Record in a process of its own until the system refuses; what was acknowledged, and the last line of errors."""
    command = [sys.executable, "-c", _FILLING, str(path), str(Path(__file__).parents[2]), str(limit)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return ended.stdout.split(), ended.stderr.strip()


def test_a_limit_on_the_size_of_files_loses_nothing_acknowledged(tmp_path: Path) -> None:
    told, error = fill(tmp_path / "ds", 200_000)
    assert error.startswith("FileError")
    assert "File too large (errno 27): the session has ended" in error
    assert len(told) > 5
    assert ids(tmp_path / "ds") == told
    repair_dataset(tmp_path / "ds")
    assert_clean(tmp_path / "ds")
    assert ids(tmp_path / "ds") == told


def test_a_disk_that_is_really_full_loses_nothing_acknowledged(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("a small disk cannot be mounted here")
    try:
        told, error = fill(disk / "ds", 0)
        assert "disk almost full" in error or "No space left on device" in error
        assert len(told) > 5
        assert ids(disk / "ds") == told
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes where nobody may")
def test_a_read_only_folder_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    with pytest.raises(FileError, match=r"Permission denied \(errno 13\)"):
        RecordingWriter(folder / "ds", IDENTITY)


def test_a_read_only_disk_is_named(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", disk], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("a read-only disk cannot be mounted here")
    try:
        with pytest.raises(FileError, match=r"Read-only file system \(errno 30\)"):
            RecordingWriter(disk / "ds", IDENTITY)
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


def test_memory_does_not_grow_with_the_session(tmp_path: Path) -> None:
    import tracemalloc

    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        sizes = []
        tracemalloc.start()
        for _ in range(4):
            for k in range(3000):
                writer.receive(TACTILE)
                writer.write(TACTILE, MESSAGE, k)
            writer.flush()
            sizes.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert np.ptp(sizes) < 60_000  # of 2.4 MB written, most of it the index

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

import pytest
from every_case import every_case
from recording_builders import (
    IDENTITY,
    MESSAGE,
    QUICK,
    TACTILE,
    TACTILE_TYPE,
    assert_same_sample,
    fail_writes,
    ids,
    record,
    write_dataset,
)

from foretouch.dataset.files import sealed
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings import writer as recorder
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.records import MessageCounts
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.sample_codec import SAMPLE_TOPIC
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.dataset.recordings.writer import RecordingConfig, RecordingWriter
from foretouch.errors import DatasetError, FileError

CAMPAIGN = Path(__file__).parents[3] / "benchmarks" / "recorder" / "kill.py"


def assert_clean(path: Path) -> None:
    assert [fault for report in verify_dataset(path) for fault in report.fault_lines()] == []


def test_what_is_appended_is_read_back_and_a_resumed_dataset_continues_its_ids(tmp_path: Path) -> None:
    write_dataset(tmp_path / "ds", 3)
    file = write_dataset(tmp_path / "ds", 2, name="sponge", first=3)
    dataset = RecordedDataset(tmp_path / "ds")
    assert len(dataset) == 5
    assert dataset.identity == IDENTITY
    for number, sample in enumerate(dataset):
        assert_same_sample(sample, record(number, "ball" if number < 3 else "sponge"))
    assert ids(tmp_path / "ds") == [*(f"ball/{n:06d}" for n in range(1, 4)), "sponge/000004", "sponge/000005"]
    files = sorted((tmp_path / "ds").glob("*.mcap"))
    assert [one.name for one in files] == ["session-0001.mcap", "session-0002.mcap"]
    assert_clean(tmp_path / "ds")
    file.write_bytes(file.read_bytes()[:-2000])  # a session that was cut off
    known = ids(tmp_path / "ds")
    write_dataset(tmp_path / "ds", 1)
    assert ids(tmp_path / "ds") == [*known, f"ball/{len(known) + 1:06d}"]


def test_another_hand_camera_or_version_and_a_changed_manifest_are_refused(tmp_path: Path, monkeypatch) -> None:
    write_dataset(tmp_path / "ds", 1)
    other = Identity(hand={**IDENTITY.hand, "serial": "9"}, camera={"name": "D435"})
    with pytest.raises(FileError) as caught:
        RecordingWriter(tmp_path / "ds", other)
    for field in ("hand.serial: 1234 there, 9 here", "camera.name: D415 there, D435", "camera.serial: 777 there, a"):
        assert field in str(caught.value)
    assert len(list((tmp_path / "ds").glob("*.mcap"))) == 1
    manifest = tmp_path / "ds" / "manifest.json"
    good = manifest.read_text()
    forged = {name: value for name, value in json.loads(good).items() if name != "sha256"}
    for text, message in (
        (good.replace("shadow", "shadoW"), "sha256: damaged: the text does not match its checksum"),
        (sealed({**forged, "hand": 5}, "sha256"), "hand: 5 is not a mapping"),
        (good[:-5], "is not JSON"),
    ):
        manifest.write_text(text)
        with pytest.raises(FileError, match=message):
            RecordingWriter(tmp_path / "ds", IDENTITY)
        with pytest.raises(FileError, match=message):
            verify_dataset(tmp_path / "ds")
    manifest.write_text(good)
    monkeypatch.setattr("foretouch.dataset.recordings.folder.__version__", "99.7.0")
    with pytest.raises(FileError, match=r"foretouch: [\d.]+ there, 99\.7 here"):
        RecordingWriter(tmp_path / "ds", IDENTITY)


def test_a_folder_with_other_things_and_one_that_another_recorder_writes_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(b"x")
    with pytest.raises(FileError, match="exists and is not a recorded dataset"):
        RecordingWriter(tmp_path, IDENTITY)
    assert [p.name for p in tmp_path.iterdir()] == ["photo.png"]
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK):
        with pytest.raises(FileError, match=f"process {os.getpid()} is writing this dataset"):
            RecordingWriter(tmp_path / "ds", IDENTITY)
        with pytest.raises(FileError, match="is writing this dataset"):
            repair_dataset(tmp_path / "ds")
    RecordingWriter(tmp_path / "ds", IDENTITY, QUICK).close()


def test_every_message_is_counted_and_losses_outlive_a_repair(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.receive(TACTILE, 10)
        for k in range(6):
            writer.write(TACTILE, MESSAGE, k)
        writer.drop(TACTILE, "queue full", 3)
        writer.lose(TACTILE, 3)
        writer.lose(TACTILE, 2)  # a total, which never decreases
        writer.append(record(0))
        assert writer.counts.topics[TACTILE].pending == 1
    counts = writer.counts.topics[TACTILE]
    assert (counts.received, counts.written, counts.lost) == (10, 6, 3)
    assert counts.dropped == {"queue full": 3, "not written when the session ended": 1}
    for _ in range(2):
        (report,) = verify_dataset(tmp_path / "ds")
        assert report.clean
        assert report.counts == writer.counts
        assert report.messages == {TACTILE: 6, SAMPLE_TOPIC: 1}
        writer.file.write_bytes(writer.file.read_bytes()[:-20])
        assert repair_dataset(tmp_path / "ds")[0].changed
    infinite = '{"received": 1e999, "written": 5, "lost": 0, "dropped": {}}'
    for text in ('{"received": "many"}', '{"received": 7, "written": 5, "dropped": {}}', "[]", "{", infinite):
        with pytest.raises(DatasetError, match="holds no counts"):
            MessageCounts.from_mapping({TACTILE: text})
    with RecordingWriter(tmp_path / "other", IDENTITY, QUICK) as writer:
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.write(TACTILE, MESSAGE, 0)  # never received
    (report,) = verify_dataset(tmp_path / "other")
    assert any("received 0 is not written 1" in fault for fault in report.fault_lines())


def test_topics_must_be_declared_and_messages_wait_no_longer_than_they_should(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(recorder, "CHUNK_S", 0.05)
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        with pytest.raises(DatasetError, match="/a was not declared"):
            writer.write("/a", MESSAGE, 0)
        writer.add_topic("/a", "std_msgs/msg/String")
        with pytest.raises(DatasetError, match="/a: holds std_msgs/msg/String, not"):
            writer.add_topic("/a", TACTILE_TYPE)
        with pytest.raises(DatasetError, match="log_time_ns: -1 is not a time since 1970"):
            writer.write("/a", MESSAGE, -1)
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.receive(TACTILE, 5)
        for time_ns in (5_000_000_000, 1_000, 1_000):  # clocks may jump
            writer.write(TACTILE, MESSAGE, time_ns)
        writer.flush()
        before = writer.output.size
        writer.write(TACTILE, MESSAGE, 0)
        assert writer.output.size == before
        time.sleep(0.06)
        writer.write(TACTILE, MESSAGE, 1)
        assert writer.output.size > before
    assert_clean(tmp_path / "ds")


def test_writes_of_several_threads_are_serialised(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(recorder, "CHUNK_S", 0.0)
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
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
    counts = writer.counts.topics[SAMPLE_TOPIC]
    assert (counts.received, counts.written, dict(counts.dropped)) == (2, 1, {"disk full": 1})


def test_a_failing_write_ends_the_session_with_what_was_acknowledged(tmp_path: Path, monkeypatch) -> None:
    """Half of the sample's bytes get through before the device fails: they must be gone afterwards."""

    def check(code: int) -> None:
        path = tmp_path / errno.errorcode[code]
        writer = RecordingWriter(path, IDENTITY, QUICK)
        writer.add_topic(TACTILE, TACTILE_TYPE)
        writer.receive(TACTILE)
        writer.write(TACTILE, MESSAGE, 0)
        acknowledged = [writer.append(record(number)) for number in range(3)]
        rule = rf"{os.strerror(code)}: the session has ended, its 3 samples are in the file; run `foretouch dataset repair`"
        with monkeypatch.context() as patch:
            fail_writes(patch, 2, code, part=50)
            with pytest.raises(FileError, match=rule):
                writer.append(record(3))
        assert ids(path) == acknowledged
        assert repair_dataset(path)[0].lost == []
        assert_clean(path)
        assert ids(path) == acknowledged

    every_case((errno.EIO, errno.ENOSPC, errno.EROFS), check)


def test_a_disk_that_fails_at_the_start_or_when_waited_for_is_named(tmp_path: Path, monkeypatch) -> None:
    with monkeypatch.context() as patch:
        fail_writes(patch, 2, errno.ENOSPC)  # magic and header, then the metadata
        with pytest.raises(FileError, match=r"session-0001.mcap: No space left on device"):
            RecordingWriter(tmp_path / "ds", IDENTITY, QUICK)
    writer = RecordingWriter(tmp_path / "ds", IDENTITY, RecordingConfig(min_free_mb=0.0))

    def failing(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", failing)
    with pytest.raises(FileError, match="cannot be synchronised: Input/output error"):
        writer.append(record(0))
    assert writer.closed


def test_a_disk_that_is_really_full_or_read_only_loses_nothing_acknowledged(tmp_path: Path) -> None:
    def fill(path: Path, acknowledged: list[str]) -> None:
        writer = RecordingWriter(path, IDENTITY, QUICK)
        while True:
            acknowledged.append(writer.append(record(len(acknowledged), points=500)))

    def check(name: str, options: str) -> None:
        disk, acknowledged = tmp_path / name, []
        disk.mkdir()
        if subprocess.call(["mount", "-t", "tmpfs", "-o", options, "tmpfs", disk]):
            return  # a disk cannot be mounted here
        try:
            with pytest.raises(FileError, match=r"disk almost full|No space left on device|Read-only file system"):
                fill(disk / "ds", acknowledged)
            assert (len(acknowledged) > 5) == (name == "full")
            assert not acknowledged or ids(disk / "ds") == acknowledged
        finally:
            subprocess.run(["umount", "-l", disk], check=True)

    every_case([("full", "size=300k"), ("read-only", "ro")], check)


@pytest.mark.slow
def test_eight_kills_lose_no_acknowledged_sample() -> None:
    """The short form of the campaign of `benchmarks/recorder`: a recorder is killed at random instants."""
    command = [sys.executable, CAMPAIGN, "--rounds", "8", "--seed", "5", "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout)
    assert (result["kills"], result["lost"], result["wrong"], result["not_clean"]) == (8, 0, 0, 0)
    assert result["acknowledged"] >= 4  # every second kill waits for a sample, however slow the machine is
    assert any(one["found"] for one in result["rounds"])

# SPDX-License-Identifier: Apache-2.0
"""Recordings as other libraries see them: `mcap`, which checks every checksum, and `rosbags`."""

from pathlib import Path

import numpy as np
from every_case import every_case
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from recording_builders import MESSAGE, TACTILE, record, write_dataset
from rosbags.highlevel import AnyReader

from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.sample_codec import SAMPLE_TOPIC, SAMPLE_TYPE


def write_and_repair(folder: Path) -> list[Path]:
    """Five samples with ten messages, finished by the writer and by a repair."""
    finished, repaired = (write_dataset(folder / name, 5) for name in ("finished", "repaired"))
    data = repaired.read_bytes()
    repaired.write_bytes(data[: data.rindex(b"foretouch_accounts") - 100])
    assert repair_dataset(repaired)[0].changed
    return [finished, repaired]


def test_mcap_and_rosbags_read_recordings_all_checksums_hold_and_samples_are_decoded(tmp_path: Path) -> None:
    def check(file: Path) -> None:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary.statistics.message_count == 15
            assert {channel.topic for channel in summary.channels.values()} == {SAMPLE_TOPIC, TACTILE}
            messages = [message.data for _, _, message in reader.iter_messages(topics=[TACTILE])]
            assert messages == 10 * [MESSAGE]
        with file.open("rb") as stream:
            kinds = [type(r).__name__ for r in StreamReader(stream, validate_crcs=True, emit_chunks=True).records]
        assert kinds[-1] == "Footer"
        assert kinds.count("Chunk") == 10  # five of a sample, five of the messages before it

        with AnyReader([file]) as reader:
            connections = [c for c in reader.connections if c.topic == SAMPLE_TOPIC]
            decoded = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections)]
        assert [message.id for message in decoded] == [f"ball/{number:06d}" for number in range(1, 6)]
        for number, message in enumerate(decoded):
            sample = record(number)
            np.testing.assert_array_equal(message.touch, sample.touch.values)
            np.testing.assert_array_equal(np.asarray(message.grasp.rotation).reshape(3, 3), sample.grasp.rotation)
            assert message.cloud.width == 30
        with Recording(file) as bag:
            assert sum(1 for _ in bag.messages()) == 15
            topics = {topic.name: topic for topic in bag.topics}
        assert (topics[SAMPLE_TOPIC].type, topics[SAMPLE_TOPIC].stamped) == (SAMPLE_TYPE, True)
        assert topics[TACTILE].count == 10

    every_case(write_and_repair(tmp_path), check)

# SPDX-License-Identifier: Apache-2.0
"""MCAP files with any of the optional parts of the format, by the writers of others, whole and cut off anywhere."""

import random
import shutil
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import pytest
from every_case import every_case
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader
from mcap_builders import FIRST_NS, STRING, Parts, in_front, text_of, write_strings

from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.mcap import McapReader
from foretouch.dataset.recordings.repair import repair_dataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.errors import FileError

TEXTS = [f"{k:03d} " + "x" * (k * 37 % 90) for k in range(24)]
PARTS = st.builds(
    Parts,
    writer=st.sampled_from(("mcap", "foxglove")),
    compression=st.sampled_from(("zstd", "lz4", "")),
    chunk_size=st.sampled_from((1, 300, 100_000)),
    profile=st.sampled_from(("ros2", "", "ros1")),
    **{
        name: st.booleans()
        for name in (
            "chunked", "chunk_index", "message_index", "repeat_channels", "repeat_schemas", "statistics", "offsets", "crcs",
            "definitions", "extras", "shuffled",
        )
    },
)  # fmt: skip


def read(path: Path) -> tuple[list[str], str]:
    """The strings in the order of their times, and the error at the end; "" if there is none."""
    texts: list[str] = []
    try:
        with Recording(path) as recording:
            assert {topic.type for topic in recording.topics} <= {STRING}
            for message in recording.messages():
                assert recording.content(message).data == text_of(message.data)
                texts.append(text_of(message.data))
    except FileError as err:
        return texts, str(err)
    return texts, ""


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(PARTS)
def test_every_combination_of_optional_parts_is_read_and_verified(tmp_path: Path, parts: Parts) -> None:
    path = tmp_path / "parts.mcap"
    path.unlink(missing_ok=True)
    write_strings(path, TEXTS, parts)
    assert read(path) == (TEXTS, "")
    (report,) = verify_dataset(path)
    assert (report.fault_lines(), report.messages.total()) == ([], len(TEXTS))
    before = path.read_bytes()
    (repaired,) = repair_dataset(path)
    assert (repaired.changed, repaired.messages, path.read_bytes()) == (False, len(TEXTS), before)


def cut_and_check(good: bytes, cut: int, folder: Path, written: Sequence[str] = TEXTS) -> None:
    """What is in front of a cut is read and repaired; nothing else than what was written ever appears."""
    path = folder / "cut.mcap"
    for old in folder.glob("cut.mcap*"):
        old.unlink()
    path.write_bytes(good[:cut])
    front = in_front(good, cut)
    texts, error = read(path)
    if cut >= 8:
        assert front <= set(texts) <= set(written)
        assert texts == sorted(texts)
        assert error.startswith(f"{path}: byte ")
        assert (f"dataset repair {path}" in error) == bool(texts)
    else:
        assert "is not an MCAP file" in error or "is empty" in error
    if texts:
        (report,) = repair_dataset(path)
        assert report.changed
        assert report.messages == len(texts)
        assert report.original is not None
        assert report.original.read_bytes() == good[:cut]
        assert verify_dataset(path)[0].clean
        assert read(path) == (texts, "")
        with path.open("rb") as stream:
            kept = [text_of(one.data) for _, _, one in NonSeekingReader(stream, validate_crcs=True).iter_messages()]
        assert kept == texts
    else:
        with pytest.raises(FileError, match=r"holds no message that could be kept|is not an MCAP file"):
            repair_dataset(path)
        assert path.read_bytes() == good[:cut]
        assert not list(folder.glob("cut.mcap.*"))


BARE = dict.fromkeys(
    ("message_index", "repeat_channels", "chunk_index", "repeat_schemas", "statistics", "offsets", "crcs"), False
)


@pytest.mark.parametrize("cuts", [3, pytest.param(50, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_a_cut_anywhere_keeps_every_message_in_front_of_it(tmp_path: Path, cuts: int) -> None:
    rng = random.Random(5)

    def check(writer: str, compression: str, chunked: bool, left_out: dict[str, bool]) -> None:
        write_strings(
            tmp_path / "good.mcap", TEXTS, Parts(writer=writer, compression=compression, chunked=chunked, **left_out)
        )
        good = (tmp_path / "good.mcap").read_bytes()
        (tmp_path / "good.mcap").unlink()
        for cut in [0, 5, 8, 30, len(good) - 1, *(rng.randrange(len(good)) for _ in range(cuts))]:
            cut_and_check(good, cut, tmp_path)

    forms = [*product(("", "zstd", "lz4"), (True,)), ("", False)]
    indexes = ({}, {"message_index": False, "repeat_channels": False}, BARE)
    every_case(
        [(writer, *form, left_out) for writer in ("mcap", "foxglove") for form in forms for left_out in indexes], check
    )


def test_within_a_cut_chunk_the_messages_in_front_of_the_cut_are_kept(tmp_path: Path) -> None:
    noise = random.Random(1)
    texts = ["".join(noise.choices("0123456789abcdef", k=60_000)) for _ in range(12)]

    def check(compression: str) -> None:
        path = tmp_path / f"{compression or 'none'}.mcap"
        write_strings(path, texts, Parts(compression=compression, chunk_size=10**9))
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        (report,) = repair_dataset(path)
        assert 3 <= report.messages <= 6  # packed blocks have up to 128 kB
        assert read(path) == (texts[: report.messages], "")

    every_case(["", "zstd", "lz4"], check)


def test_attachments_metadata_times_and_encodings_survive_a_repair(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_strings(path, TEXTS, Parts(extras=True, profile="own", compression="lz4"), first_ns=2**64 - 10**9)
    path.write_bytes(path.read_bytes()[:-30])
    assert repair_dataset(path)[0].messages == len(TEXTS)
    found = McapReader(path)
    messages = list(found.messages())
    assert (found.header.profile, found.header.library, found.metadata) == (
        "own",
        "of others",
        {"calibration": {"fx": "1"}},
    )
    assert b"<robot/>" in path.read_bytes()
    assert messages[0].log_time_ns == 2**64 - 10**9
    assert found.compression == "lz4"


def test_what_cannot_be_kept_is_refused_and_the_file_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    write_strings(path, TEXTS, Parts(crcs=False))
    data = path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0zst9")
    path.write_bytes(data)
    with pytest.raises(
        FileError, match="holds no message that could be kept, and stays as it is: a chunk is compressed by 'zst9'"
    ):
        repair_dataset(path)
    assert path.read_bytes() == data
    assert [one.name for one in tmp_path.iterdir()] == ["other.mcap"]
    assert "a chunk is compressed by 'zst9', which is not supported" in read(path)[1]
    path.write_bytes(data[:500])  # within a chunk
    assert "a chunk is compressed by 'zst9', which is not supported" in "".join(verify_dataset(path)[0].fault_lines())


def test_of_a_split_recording_the_cut_file_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    for k in range(3):
        write_strings(tmp_path / f"x_{k}.mcap", TEXTS[8 * k : 8 * k + 8], Parts(), first_ns=FIRST_NS + 8_000_000 * k)
    middle = tmp_path / "x_1.mcap"
    middle.write_bytes(middle.read_bytes()[: middle.stat().st_size // 4])
    texts, error = read(tmp_path)
    assert {*TEXTS[:8], *TEXTS[16:]} < set(texts) < set(TEXTS)
    assert error.startswith(f"{middle}: byte ")
    last = tmp_path / "x_2.mcap"
    last.write_bytes(last.read_bytes()[:-1])
    assert read(tmp_path)[1].endswith("; also damaged: x_2.mcap")
    assert [report.clean for report in verify_dataset(tmp_path)] == [True, False, False]
    reports = repair_dataset(tmp_path)
    assert [(report.changed, bool(report.refusal)) for report in reports] == [
        (False, False),
        (True, False),
        (True, False),
    ]
    for k, content in enumerate((b"", b"\x89MCAP0\r\n")):
        (tmp_path / f"y_{k}.mcap").write_bytes(content)
    kept, error = read(tmp_path)  # what is cut off within its first bytes costs no other file
    assert kept == TEXTS[:8] + [text for text in TEXTS[8:16] if text in texts] + TEXTS[16:]
    assert error.startswith(f"{tmp_path / 'y_0.mcap'}: byte 0: is empty")
    assert error.endswith("; also damaged: y_1.mcap")
    reports = repair_dataset(tmp_path)[3:]
    assert [report.refusal.partition(": ")[2] for report in reports] == [
        "holds no message that could be kept, and stays as it is: is empty",
        "holds no message that could be kept, and stays as it is: it has no end",
    ]
    for k in range(2):
        (tmp_path / f"y_{k}.mcap").unlink()
    shutil.move(middle, tmp_path.parent / "x_1.mcap")
    assert read(tmp_path) == (TEXTS[:8] + TEXTS[16:], "")


def test_a_bomb_takes_no_more_memory_than_it_states(tmp_path: Path) -> None:
    import tracemalloc

    path = tmp_path / "bomb.mcap"
    write_strings(path, ["0" * 60_000_000], Parts(chunk_size=1))
    small = path.read_bytes()
    assert len(small) < 100_000
    place = small.index(b"\x04\0\0\0zstd") - 12
    path.write_bytes(small[:place] + (1000).to_bytes(8, "little") + small[place + 8 :])
    tracemalloc.start()
    assert "does not match its checksum or size" in read(path)[1]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 30_000_000


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("compression", ["", "zstd"])
def test_fifty_cuts_of_a_bag(tmp_path: Path, compression: str) -> None:
    """Chunks of rosbags end at 1 MiB, so that the texts are longer, and have no checksum."""
    noise = random.Random(compression)
    texts = [f"{k:03d} " + "".join(noise.choices("0123456789abcdef", k=200_000)) for k in range(18)]
    write_strings(tmp_path / "good.mcap", texts, Parts(writer="rosbags", compression=compression))
    good = (tmp_path / "good.mcap").read_bytes()
    (tmp_path / "good.mcap").unlink()
    for _ in range(50):
        cut_and_check(good, noise.randrange(len(good)), tmp_path, texts)

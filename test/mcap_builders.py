# SPDX-License-Identifier: Apache-2.0
"""MCAP files as others write them, with any of the optional parts of the format; `mcap` itself tells what is in front of a cut."""

import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import foxglove
import lz4.frame
import zstandard
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

STRING = "std_msgs/msg/String"
FIRST_NS = 1_700_000_000_000_000_000


def string_cdr(text: str) -> bytes:
    """A `std_msgs/String` as CDR."""
    content = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(content)) + content


@dataclass(frozen=True, kw_only=True)
class Parts:
    """The optional parts of an MCAP file."""

    writer: str = "mcap"  # or foxglove, or rosbags, which has none of the choices but zstd or none
    compression: str = "zstd"  # or lz4, or ""
    chunked: bool = True
    chunk_size: int = 400
    chunk_index: bool = True
    message_index: bool = True
    repeat_channels: bool = True
    repeat_schemas: bool = True
    statistics: bool = True
    offsets: bool = True
    crcs: bool = True
    definitions: bool = True  # whether schemas hold their text
    profile: str = "ros2"
    extras: bool = False  # an attachment and metadata
    shuffled: bool = False  # messages that are not in the order of their times


def write_strings(path: Path, texts: list[str], parts: Parts, first_ns: int = FIRST_NS) -> None:
    """A file of strings on two topics, 1 ms apart."""
    times = [first_ns + k * 1_000_000 for k in range(len(texts))]
    order = sorted(range(len(texts)), key=lambda k: (k * 7) % 5) if parts.shuffled else range(len(texts))
    text = b"string data\n" if parts.definitions else b""
    if parts.writer == "rosbags":
        folder = path.with_suffix("")
        bag = BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        if parts.compression:
            bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with bag:
            store = get_typestore(Stores.ROS2_KILTED)
            connections = [bag.add_connection(topic, STRING, typestore=store) for topic in ("/a", "/b")]
            for k in order:
                bag.write(connections[k % 2], times[k], string_cdr(texts[k]))
        (folder / f"{folder.name}.mcap").rename(path)
        shutil.rmtree(folder)
        return
    if parts.writer == "foxglove":
        options = MCAPWriteOptions(
            compression={"zstd": MCAPCompression.Zstd, "lz4": MCAPCompression.Lz4, "": None}[parts.compression],
            profile=parts.profile, chunk_size=parts.chunk_size, use_chunks=parts.chunked,
            emit_statistics=parts.statistics, emit_summary_offsets=parts.offsets,
            emit_message_indexes=parts.message_index, emit_chunk_indexes=parts.chunk_index,
            repeat_channels=parts.repeat_channels, repeat_schemas=parts.repeat_schemas,
            calculate_chunk_crcs=parts.crcs, calculate_data_section_crc=parts.crcs,
            calculate_summary_section_crc=parts.crcs, calculate_attachment_crcs=parts.crcs,
        )  # fmt: skip
        context = foxglove.Context()
        with foxglove.open_mcap(path, context=context, writer_options=options) as out:
            schema = foxglove.Schema(name=STRING, encoding="ros2msg" if text else "", data=text)
            channels = [
                foxglove.Channel(topic, schema=schema, message_encoding="cdr", context=context)
                for topic in ("/a", "/b")
            ]
            if parts.extras:
                out.write_metadata("calibration", {"fx": "1"})
                out.attach(log_time=1, create_time=1, name="urdf", media_type="text/xml", data=b"<robot/>")
            for k in order:
                channels[k % 2].log(string_cdr(texts[k]), log_time=times[k])
        return
    indexes = [
        (parts.chunk_index, IndexType.CHUNK),
        (parts.message_index, IndexType.MESSAGE),
        (parts.extras, IndexType.ALL),
    ]
    kinds = IndexType.NONE
    for wanted, kind in indexes[:2]:
        kinds |= kind if wanted else IndexType.NONE
    with path.open("wb") as stream:
        writer = Writer(
            stream, chunk_size=parts.chunk_size, index_types=kinds, use_chunking=parts.chunked,
            compression=CompressionType[parts.compression.upper() or "NONE"], use_statistics=parts.statistics,
            repeat_channels=parts.repeat_channels, repeat_schemas=parts.repeat_schemas,
            use_summary_offsets=parts.offsets, enable_crcs=parts.crcs, enable_data_crcs=parts.crcs,
        )  # fmt: skip
        writer.start(parts.profile, "of others")
        schema = writer.register_schema(STRING, "ros2msg" if text else "", text)
        numbers = [writer.register_channel(topic, "cdr", schema) for topic in ("/a", "/b")]
        if parts.extras:
            writer.add_metadata("calibration", {"fx": "1"})
            writer.add_attachment(1, 1, "urdf", "text/xml", b"<robot/>")
        for k in order:
            writer.add_message(numbers[k % 2], times[k], string_cdr(texts[k]), times[k], k)
        writer.finish()


def in_front(data: bytes, cut: int) -> set[str]:
    """The strings whose messages end in front of a cut, in chunks that are whole in front of it, found by `mcap` and `lz4`."""
    found: set[str] = set()
    place = 8
    while place + 9 <= cut:
        opcode, length = struct.unpack_from("<BQ", data, place)
        end = place + 9 + length
        if end > cut or opcode in (2, 15):
            break
        content = data[place + 9 : end]
        if opcode == 5:
            found.add(text_of(content[22:]))
        elif opcode == 6:
            chunk = Chunk.read(ReadDataStream(BytesIO(content)))
            raw = chunk.data
            if chunk.compression:
                raw = (
                    lz4.frame.decompress(raw)
                    if chunk.compression == "lz4"
                    else zstandard.ZstdDecompressor().decompress(raw, max_output_size=chunk.uncompressed_size)
                )
            found |= set(_texts(raw))
        place = end
    return found


def text_of(data: bytes) -> str:
    """The text in a `std_msgs/String` as CDR."""
    return data[8:-1].decode()


def _texts(raw: bytes) -> Iterator[str]:
    place = 0
    while place < len(raw):
        opcode, length = struct.unpack_from("<BQ", raw, place)
        if opcode == 5:
            yield text_of(raw[place + 31 : place + 9 + length])
        place += 9 + length

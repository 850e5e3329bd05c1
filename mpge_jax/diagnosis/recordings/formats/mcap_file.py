"""MCAP files whose messages are those of ROS 2; also ones that were cut off when the robot lost its power."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from mpge_jax.diagnosis.recordings.formats import tables
from mpge_jax.diagnosis.recordings.formats.ros_messages import Collector
from mpge_jax.diagnosis.recordings.formats.tables import Log, extra
from mpge_jax.diagnosis.recordings.formats.unpacking import unpacked


def read(path: Path) -> list[Log]:
    collector = Collector(path)
    notes = collect(path, collector)
    log = collector.log(path.stem)
    return [replace(log, notes=notes + log.notes)]


def collect(path: Path, collector: Collector, packed: bool = False) -> tuple[str, ...]:
    """Give all messages of a file to `collector`; returns what there is to say of the file.

    Args:
        packed: whether each message is compressed for itself, as rosbag2 can.
    """
    exceptions, ended = extra("mcap.exceptions", "mcap"), False
    factory = extra("mcap_ros2.decoder", "mcap").DecoderFactory()
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    with path.open("rb") as file:
        messages = _messages(path, file)
        while True:
            try:
                schema, channel, message = next(messages)
            except StopIteration:
                break
            except exceptions.EndOfFile:
                ended = True
                break
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(factory, collector, schema, channel)
            decode = decoders[channel.id]
            if decode is None:
                continue
            data = unpacked(path, message.data, "zstd") if packed else message.data
            try:
                decoded = decode(data)
            except Exception:  # whatever a decoder stumbles over in damaged bytes
                collector.spoilt(channel.topic)
                continue
            collector.add(channel.topic, _kind(schema), message.log_time, decoded)
    if ended and not collector.series:
        raise exceptions.EndOfFile
    return (f"{path.name} ends in the middle of a record; it is read up to there.",) if ended else ()


def _kind(schema: Any) -> str:
    """`package/msg/Type`, also where a schema leaves `msg` out."""
    package, _, name = schema.name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}"


def _decoder(factory: Any, collector: Collector, schema: Any, channel: Any) -> Callable[[bytes], Any] | None:
    if schema is None or not collector.wants(channel.topic, _kind(schema)):
        if schema is None:
            collector.unread[channel.topic] = channel.message_encoding or "no schema"
        return None
    # the parser of definitions writes what it thinks of them, before it raises
    with contextlib.redirect_stderr(io.StringIO()):
        found: Callable[[bytes], Any] | None = factory.decoder_for(channel.message_encoding, schema)
    if found is None:
        collector.unread[channel.topic] = f"{schema.name}, encoded as {channel.message_encoding}"
    return found


def _messages(path: Path, file: IO[bytes]) -> Iterator[tuple[Any, Any, Any]]:
    """(schema, channel, message) in the order of the file, chunk by chunk."""
    stream, records = extra("mcap.stream_reader", "mcap"), extra("mcap.records", "mcap")
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    reader = stream.StreamReader(file, emit_chunks=True, record_size_limit=tables.MAX_BYTES)
    for record in reader.records:
        parts = [record]
        if isinstance(record, records.Chunk):
            data = record.data
            if record.compression:
                data = unpacked(path, data, record.compression, record.uncompressed_size)
            parts = stream.breakup_chunk(replace(record, compression="", data=data))
        for part in parts:
            if isinstance(part, records.Schema):
                schemas[part.id] = part
            elif isinstance(part, records.Channel):
                channels[part.id] = part
            elif isinstance(part, records.Message) and part.channel_id in channels:
                channel = channels[part.channel_id]
                yield schemas.get(channel.schema_id), channel, part

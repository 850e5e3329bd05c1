"""Unpack compressed pieces of a log, never beyond a limit: a few kilobytes may state that they hold terabytes."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from pathlib import Path

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats import tables
from mpge_jax.diagnosis.recordings.formats.tables import check_bytes, extra

BLOCK = 1 << 20
MAX_FILE = 16 << 30
"""Most bytes of a file that is unpacked to disk."""


def unpacked(path: Path, raw: bytes, kind: str, stated: int | None = None) -> bytes:
    """One piece. kind: `zstd`, `lz4` or `bz2`; stated: its size as the file has it."""
    if stated is not None:
        check_bytes(path.name, "a chunk", stated)
    most = tables.MAX_BYTES if stated is None else stated
    piece: bytes = _decompressors[kind](raw, most + 1)
    if len(piece) > most:
        check_bytes(path.name, "a chunk", tables.MAX_BYTES + 1)
    return piece


def _zstd(raw: bytes, most: int) -> bytes:
    zstd = extra("zstandard", "ros")
    stated = zstd.frame_content_size(raw)
    with zstd.ZstdDecompressor().stream_reader(raw) as source:
        return bytes(source.read(most if stated < 0 else min(stated + 1, most)))


def _lz4(raw: bytes, most: int) -> bytes:
    return bytes(extra("lz4.frame", "ros").LZ4FrameDecompressor().decompress(raw, max_length=most))


def _bz2(raw: bytes, most: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(raw, most)


_decompressors: dict[str, Callable[[bytes, int], bytes]] = {"zstd": _zstd, "lz4": _lz4, "bz2": _bz2}


def by_its_mark(path: Path) -> Callable[[bytes], bytes]:
    """A function that unpacks what begins as bz2 or lz4 does, and leaves other pieces as they are."""

    def unpack(raw: bytes) -> bytes:
        for mark, kind in ((b"BZh", "bz2"), (b"\x04\x22\x4d\x18", "lz4")):
            if raw.startswith(mark):
                return unpacked(path, raw, kind)
        return raw

    return unpack


def unpack_file(path: Path, target: Path) -> None:
    """A file compressed by zstd, piece by piece."""
    size = 0
    with extra("zstandard", "ros").open(path, "rb") as source, target.open("wb") as out:
        while block := source.read(BLOCK):
            size += len(block)
            if size > MAX_FILE:
                raise InputError(
                    f"{path.name} is larger than {MAX_FILE >> 30} GB unpacked; cut the bag into parts."
                )
            out.write(block)

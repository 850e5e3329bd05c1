"""Bags of ROS 1 (`.bag`) and ROS 2 (`.db3`, `.mcap`, or a folder of them, with or without its `metadata.yaml`)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats import mcap_file, ros_types
from mpge_jax.diagnosis.recordings.formats.ros_messages import Collector
from mpge_jax.diagnosis.recordings.formats.tables import Log, extra
from mpge_jax.diagnosis.recordings.formats.unpacking import by_its_mark, unpack_file, unpacked

STORES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
MAX_METADATA = 10 << 20


def read(path: Path) -> list[Log]:
    """One run: a bag file, or a folder that holds the parts of one bag."""
    collector = Collector(path)
    if path.suffix == ".bag":
        _read_ros1(path, collector)
        return [collector.log(path.stem)]
    files, mode = ([path], "none") if path.is_file() else _parts(path)
    notes: tuple[str, ...] = ()
    for file in files:
        notes += _read_part(file, mode, collector)
    log = collector.log(path.stem if path.is_file() else path.name)
    return [Log(log.name, log.tables, notes + log.notes, log.unread, log.origin)]


def is_bag(folder: Path) -> bool:
    """Whether a folder is one bag: it has bag's metadata, or parts of one bag by their names."""
    parts = [p.name for p in folder.iterdir() if p.name.endswith(STORES)]
    stems = {re.sub(r"_\d+$", "", name.partition(".")[0]) for name in parts}
    return bool(parts) and ((folder / "metadata.yaml").is_file() or (len(stems) == 1 and len(parts) > 1))


def _parts(folder: Path) -> tuple[list[Path], str]:
    """Files of a bag in their order, and how they are compressed: `none`, `file` or `message`."""
    found = sorted((p for p in folder.iterdir() if p.name.endswith(STORES)), key=lambda p: _counted(p.name))
    about = _metadata(folder / "metadata.yaml")
    listed = about.get("relative_file_paths")
    if isinstance(listed, list):
        # by their names alone: a bag's parts lie beside its metadata, wherever the metadata says that they are
        by_name = {p.name: p for p in found}
        files = [by_name[name] for entry in listed if (name := PurePath(str(entry)).name) in by_name]
        lacking = [str(entry) for entry in listed if PurePath(str(entry)).name not in by_name]
        if lacking:
            raise InputError(f"{folder.name}: {', '.join(lacking)[:300]} of the bag is not in its folder.")
        found = files or found
    if not found:
        raise InputError(f"the folder {folder} holds no part of a bag ({', '.join(STORES)}).")
    mode = str(about.get("compression_mode") or "none").lower()
    return found, "none" if mode == "file" else mode


def _counted(name: str) -> list[tuple[int, str]]:
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", name)]


def _metadata(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        if path.stat().st_size > MAX_METADATA:
            raise InputError(f"{path.parent.name}: metadata.yaml is larger than {MAX_METADATA >> 20} MB.")
        whole = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, OSError, RecursionError):
        raise InputError(
            f"{path.parent.name}: its metadata.yaml cannot be read; remove it, and the bag is read without."
        ) from None
    about = whole.get("rosbag2_bagfile_information") if isinstance(whole, dict) else None
    return about if isinstance(about, dict) else {}


def _read_part(path: Path, mode: str, collector: Collector) -> tuple[str, ...]:
    """One file of a bag; returns what there is to say of it."""
    if path.suffix == ".zstd":
        with TemporaryDirectory() as folder:
            target = Path(folder) / path.stem
            unpack_file(path, target)
            return _read_part(target, mode, collector)
    if path.suffix == ".mcap":
        return mcap_file.collect(path, collector, mode == "message")
    wal = path.with_name(path.name + "-wal")
    notes: tuple[str, ...] = ()
    if wal.is_file() and wal.stat().st_size:
        notes = (f"{wal.name} holds rows that were never written into the bag; they are not read.",)
    _read_sqlite(path, mode == "message", collector)
    return notes


def _read_sqlite(path: Path, packed: bool, collector: Collector) -> None:
    if set("?#%") & set(str(path.absolute())):
        raise InputError(f"the path of {path.name} holds one of the characters ? # %; rename it.")
    with extra("rosbags.rosbag2", "ros").Reader(path) as reader:
        _take(path, reader, _wanted(collector, reader.connections), collector, packed=packed, ros1=False)


def _read_ros1(path: Path, collector: Collector) -> None:
    with extra("rosbags.rosbag1", "ros").Reader(path) as reader:
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=by_its_mark(path))
        _take(path, reader, _wanted(collector, reader.connections), collector, packed=False, ros1=True)


def _wanted(collector: Collector, connections: Iterable[Any]) -> list[Any]:
    return [c for c in connections if collector.wants(c.topic, c.msgtype)]


def _take(
    path: Path, reader: Any, wanted: list[Any], collector: Collector, *, packed: bool, ros1: bool
) -> None:
    if not wanted:
        return
    stores, broken = ros_types.stores(ros1), extra("rosbags.serde", "ros").SerdeError
    for connection, stamp, raw in reader.messages(connections=wanted):
        data = unpacked(path, bytes(raw), "zstd") if packed else raw
        try:
            message = ros_types.decode(stores, connection.msgtype, data, ros1)
        except broken:
            collector.spoilt(connection.topic)
            continue
        collector.add(connection.topic, connection.msgtype, stamp, message)

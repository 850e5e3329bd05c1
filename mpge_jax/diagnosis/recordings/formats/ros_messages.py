"""Messages of ROS collected into tables: joint states by joint name, commands by topic, header stamps where there are
any. The bag's format does not matter here."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.recordings.formats.ros_types import READ
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table, check_values

COMMAND_WORDS = {
    "command",
    "commands",
    "cmd",
    "cmds",
    "desired",
    "target",
    "targets",
    "setpoint",
    "setpoints",
}
COMMAND_WORDS |= {"goal", "goals", "ref", "reference"}
"""Words in the name of a topic that say that its numbers were sent and not measured."""
QUANTITIES = {
    "position": "position",
    "positions": "position",
    "velocity": "velocity",
    "velocities": "velocity",
    "effort": "effort",
    "efforts": "effort",
    "torque": "effort",
    "torques": "effort",
}
MEASURED = {"position": "qpos", "velocity": "qvel", "effort": "actuator_force"}
_POINT = {"positions": "position", "velocities": "velocity", "effort": "effort"}


@dataclass(frozen=True)
class _Field:
    """Where a field of a message goes."""

    title: str
    values: Any
    parts: tuple[str, ...] | None
    means: str | None
    quantity: str | None = None


@dataclass
class _Series:
    """Messages of one topic that hold the same fields of the same joints."""

    fields: tuple[_Field, ...]
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    rows: array[float] = field(default_factory=lambda: array("d"))


class Collector:
    """Takes messages in the order in which they were recorded and gives a `Log`."""

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self.series: dict[str, dict[tuple[Any, ...], _Series]] = {}
        self.bad: dict[str, int] = {}
        self.plans: dict[str, int] = {}
        self.unread: dict[str, str] = {}

    def wants(self, topic: str, kind: str) -> bool:
        """Whether messages of that type are read; else the topic is told as unread."""
        if kind in READ:
            return True
        self.unread[topic] = kind
        return False

    def spoilt(self, topic: str) -> None:
        """Counts a message that cannot be decoded."""
        self.bad[topic] = self.bad.get(topic, 0) + 1

    def add(self, topic: str, kind: str, received: int, message: Any) -> None:
        """Args: kind: `package/msg/Type`. received: ns of the recorder's clock. message: with ROS's attributes."""
        if kind == "trajectory_msgs/msg/JointTrajectory" and len(message.points) != 1:
            self.plans[topic] = self.plans.get(topic, 0) + 1
            return
        fields = tuple(_fields(topic, kind, message))
        if not fields:
            return
        key = tuple((f.title, f.parts, len(f.values)) for f in fields)
        of_topic = self.series.setdefault(topic, {})
        if key not in of_topic:
            of_topic[key] = _Series(fields)
        series = of_topic[key]
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        series.stamps.append(0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec))
        series.received.append(received)
        for f in fields:
            series.rows.extend(map(float, f.values))
            self.count += len(f.values)
        check_values(self.path.name, topic, self.count)

    def log(self, name: str) -> Log:
        found = [
            _table(topic if i == 0 else f"{topic}#{i + 1}", topic, s)
            for topic, of_topic in self.series.items()
            for i, s in enumerate(of_topic.values())
        ]
        first = [min(t[0][0], t[1][0]) for t in found]
        origin = min(first, default=0)
        notes = [
            f"{count} messages of {topic} cannot be decoded and are left out."
            for topic, count in self.bad.items()
        ]
        notes += [
            f"{topic} holds {count} plans of several points, between which the controller interpolates: they are not "
            "read as commands; record the controller's state as well."
            for topic, count in self.plans.items()
        ]
        return Log(
            name,
            tuple(
                _on_clock(table, stamps, received, stamped, origin)
                for stamps, received, stamped, table in found
            ),
            tuple(notes),
            tuple(f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in self.unread.items()),
            origin / 1e9,
        )


def _table(title: str, topic: str, s: _Series) -> tuple[np.ndarray, np.ndarray, bool, Table]:
    """Stamps and receive times [T] ns in their order, whether the sender stamped, and a table that has no times yet."""
    stamps, received = np.array(s.stamps, dtype=np.int64), np.array(s.received, dtype=np.int64)
    # a header that nobody filled in, or filled in once
    stamped = bool(stamps.any()) and (stamps.size < 3 or np.unique(stamps).size > stamps.size // 2)
    clock = stamps if stamped else received
    order = np.argsort(clock, kind="stable")
    values = np.frombuffer(s.rows, dtype=float).reshape(stamps.size, -1)[order]
    ends = np.cumsum([len(f.values) for f in s.fields])
    columns = tuple(
        Column(
            f.title.replace(topic, title, 1),
            values[:, end - len(f.values) : end],
            f.parts,
            f.means,
            f.quantity,
        )
        for f, end in zip(s.fields, ends, strict=True)
    )
    return clock[order], received[order], stamped, Table(title, columns, None, "")


def _on_clock(t: Table, clock: np.ndarray, received: np.ndarray, stamped: bool, origin: int) -> Table:
    words = "header stamps" if stamped else "receive stamps"
    return Table(t.title, t.columns, (clock - origin) / 1e9, words, (received - origin) / 1e9)


def words_of(topic: str) -> list[str]:
    return re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", topic).lower())


def _fields(topic: str, kind: str, m: Any) -> Iterator[_Field]:
    words = words_of(topic)
    sent = any(w in COMMAND_WORDS for w in words)
    quantity = next((QUANTITIES[w] for w in words if w in QUANTITIES), None)
    name = kind.rpartition("/")[2]
    if name == "JointState":
        names = tuple(m.name)
        for q in MEASURED:
            yield from _joint_field(f"{topic}/{q}", getattr(m, q), names, q, sent)
    elif name == "JointTrajectory":
        yield from _point(topic, m.points[0], tuple(m.joint_names), sent=True)
    elif name == "JointTrajectoryControllerState":
        for part in ("output", "reference", "desired", "feedback", "actual"):
            if hasattr(m, part):
                yield from _point(
                    f"{topic}/{part}",
                    getattr(m, part),
                    tuple(m.joint_names),
                    sent=part not in ("feedback", "actual"),
                )
    elif name == "DynamicJointState":
        for q in MEASURED:
            pairs = [
                (joint, v.values[list(v.interface_names).index(q)])
                for joint, v in zip(m.joint_names, m.interface_values, strict=False)
                if q in v.interface_names and len(v.values) == len(v.interface_names)
            ]
            names = tuple(joint for joint, _ in pairs)
            yield from _joint_field(f"{topic}/{q}", [x for _, x in pairs], names, q, sent)
    elif name.endswith("MultiArray"):
        if len(m.data):
            yield _Field(f"{topic}/data", m.data, None, "ctrl" if sent else None, quantity)
    else:
        own = tuple(w for w in words if w not in COMMAND_WORDS and w not in QUANTITIES)
        yield _Field(f"{topic}/data", [m.data], ("_".join(own),), "ctrl" if sent else None, quantity)


def _joint_field(title: str, values: Any, names: tuple[str, ...], q: str, sent: bool) -> Iterator[_Field]:
    """A field of joints, unless the message left it empty."""
    if len(values) == len(names) > 0:
        yield _Field(title, values, names, "ctrl" if sent else MEASURED[q], q if sent else None)


def _point(title: str, point: Any, names: tuple[str, ...], sent: bool) -> Iterator[_Field]:
    for attribute, q in _POINT.items():
        yield from _joint_field(f"{title}/{q}", getattr(point, attribute), names, q, sent)

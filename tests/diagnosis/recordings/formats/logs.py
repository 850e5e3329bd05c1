"""Logs of an arm, written by the packages that people write them with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.recordings.formats import ros_types

RATE, ROWS = 100, 60
NAMES = ["arm_elbow_joint", "arm_shoulder_joint"]
"""As the log has them: in another order than the model, and with more words."""


def motion(rows: int = ROWS) -> dict[str, np.ndarray]:
    """What the arm did, in the model's order (shoulder, elbow)."""
    t = np.arange(rows) / RATE
    q = np.stack([np.sin(3 * t), 0.5 * np.cos(2 * t)], 1)
    v = np.stack([3 * np.cos(3 * t), -np.sin(2 * t)], 1)
    return {
        "time": t,
        "qpos": q,
        "qvel": v,
        "force": np.stack([t, -t], 1),
        "ctrl": np.stack([2 * t, 0.3 * t], 1),
    }


def store(ros1: bool = False, version: int = 0) -> Any:
    return ros_types.stores(ros1)[version]


def stamp(types: Any, ns: int) -> Any:
    return types.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(types: Any, ns: int, ros1: bool) -> Any:
    extra = {"seq": 0} if ros1 else {}
    return types.types["std_msgs/msg/Header"](stamp=stamp(types, ns), frame_id="", **extra)


def joint_state(
    types: Any, ns: int, row: dict[str, np.ndarray], names: list[str] = NAMES, ros1: bool = False
) -> Any:
    """A JointState with the elbow first."""
    return types.types["sensor_msgs/msg/JointState"](
        header=header(types, ns, ros1),
        name=names,
        position=row["qpos"][::-1].copy(),
        velocity=row["qvel"][::-1].copy(),
        effort=row["force"][::-1].copy(),
    )


def multi_array(types: Any, values: np.ndarray) -> Any:
    layout = types.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return types.types["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.asarray(values, float))


Message = tuple[str, int, Any]
"""Topic, ns at which it is received, and the message."""


def arm_messages(
    types: Any, origin: int = 10**18, late: int = 2_000_000, rows: int = ROWS, ros1: bool = False
) -> list[Message]:
    """Joint states with header stamps from `origin` on, received `late` ns after; commands that carry no stamp, sent
    1 ms before each."""
    m, out = motion(rows), []
    for k in range(rows):
        ns = origin + round(m["time"][k] * 1e9)
        row = {key: value[k] for key, value in m.items()}
        out.append(("/arm/commands", ns - 1_000_000 + late, multi_array(types, row["ctrl"])))
        out.append(("/joint_states", ns + late, joint_state(types, ns, row, ros1=ros1)))
    return out


def write_ros2(
    path: Path, messages: list[Message], types: Any, storage: str = "sqlite3", compress: str = ""
) -> Path:
    """A bag's folder by rosbags' writer. compress: `file` or `message`."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    plugin = StoragePlugin.SQLITE3 if storage == "sqlite3" else StoragePlugin.MCAP
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compress:
        writer.set_compression(CompressionMode[compress.upper()], CompressionFormat.ZSTD)
    _write_all(writer, messages, types, types.serialize_cdr)
    return path


def write_ros1(path: Path, messages: list[Message], types: Any, compress: str = "") -> Path:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compress:
        writer.set_compression(Writer.CompressionFormat[compress.upper()])
    _write_all(writer, messages, types, types.serialize_ros1)
    return path


def _write_all(writer: Any, messages: list[Message], types: Any, serialize: Any) -> None:
    with writer:
        connections: dict[str, Any] = {}
        for topic, ns, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], ns, serialize(message, kind))


JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
ARRAY = """std_msgs/MultiArrayLayout layout
float64[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""


def write_mcap(path: Path, compression: str = "zstd", rows: int = ROWS, chunk: int = 1024 * 1024) -> Path:
    """The arm by the writer of mcap-ros2-support."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    m = motion(rows)
    with (
        path.open("wb") as file,
        Writer(file, compression=CompressionType[compression.upper()], chunk_size=chunk) as w,
    ):
        states = w.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        commands = w.register_msgdef("std_msgs/msg/Float64MultiArray", ARRAY)
        other = w.register_msgdef("std_msgs/msg/String", "string data\n")
        w.write_message("/rosout", other, {"data": "ready"}, log_time=0, publish_time=0)
        for k in range(rows):
            ns = 10**18 + round(m["time"][k] * 1e9)
            array = {"layout": {"dim": [], "data_offset": 0}, "data": m["ctrl"][k].tolist()}
            w.write_message("/arm/commands", commands, array, log_time=ns - 10**6, publish_time=ns)
            state = {
                "header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""},
                "name": NAMES,
                "position": m["qpos"][k][::-1].tolist(),
                "velocity": m["qvel"][k][::-1].tolist(),
                "effort": m["force"][k][::-1].tolist(),
            }
            w.write_message("/joint_states", states, state, log_time=ns, publish_time=ns)
    return path


def write_lerobot(
    path: Path, version: int, names: Any, stamps: Any = None, episodes: int = 2, fps: int = 50
) -> Path:
    """A LeRobot folder: one file an episode (version 2), or one for all (version 3)."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq

    m = motion()
    count = len(m["time"])
    feature = {"dtype": "float32", "shape": [2], "names": names}
    features = {"observation.state": feature, "action": feature}
    features |= {"observation.images.top": {"dtype": "video", "shape": [4, 4, 3], "names": None}}
    info = {"codebase_version": f"v{version}.0", "fps": fps, "features": features, "total_episodes": episodes}
    info["data_path"] = "../../elsewhere/episode_{episode_index:06d}.parquet"
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for e in range(episodes):
        frames = np.arange(count)
        tables.append(
            pa.table(
                {
                    "observation.state": pa.array(
                        (m["qpos"] + e).astype("float32").tolist(), pa.list_(pa.float32())
                    ),
                    "action": pa.FixedSizeListArray.from_arrays(m["ctrl"].astype("float32").ravel(), 2),
                    "timestamp": (frames / fps if stamps is None else stamps).astype("float32"),
                    "frame_index": frames,
                    "episode_index": np.full(count, e),
                    "task": ["lift"] * count,
                }
            )
        )
    folder = path / "data" / "chunk-000"
    folder.mkdir(parents=True)
    if version == 3:
        pq.write_table(pa.concat_tables(tables), folder / "file-000.parquet")
    else:
        for e, table in enumerate(tables):
            pq.write_table(table, folder / f"episode_{e:06d}.parquet")
    return path

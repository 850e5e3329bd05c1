"""The ROS messages that are read, by definitions of our own: those that a file brings along are never compiled."""

from __future__ import annotations

from typing import Any

from mpge_jax.diagnosis.recordings.formats.tables import extra

PLAIN = (
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/Float32MultiArray",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float32",
    "trajectory_msgs/msg/JointTrajectory",
)
"""Messages that do not change from one distribution of ROS to the next."""

DYNAMIC = "control_msgs/msg/DynamicJointState"
STATE = "control_msgs/msg/JointTrajectoryControllerState"
READ = (*PLAIN, DYNAMIC, STATE)

_POINT, _MULTI = "trajectory_msgs/JointTrajectoryPoint", "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_HEAD = "std_msgs/Header header\nstring[] joint_names\n"
_OLD_STATE = _HEAD + "".join(f"{_POINT} {name}\n" for name in ("desired", "actual", "error"))
_NAMES = ("reference", "feedback", "error", "output")
_NEW_STATE = (
    _HEAD
    + "".join(f"{_POINT} {name}\n" for name in _NAMES)
    + "string[] multi_dof_joint_names\n"
    + "".join(f"{_MULTI} multi_dof_{name}\n" for name in _NAMES)
)
_DEPRECATED_TOO = (
    _HEAD
    + "".join(f"{_POINT} {name}\n" for name in (*_NAMES, "desired", "actual"))
    + "string[] multi_dof_joint_names\n"
    + "".join(f"{_MULTI} multi_dof_{name}\n" for name in (*_NAMES, "desired", "actual"))
)
STATES = (_DEPRECATED_TOO, _NEW_STATE, _OLD_STATE)
"""`JointTrajectoryControllerState` as the versions of control_msgs have it."""
_DYNAMIC_TEXT = _HEAD + "control_msgs/InterfaceValue[] interface_values\n"
_INTERFACE = "control_msgs/msg/InterfaceValue"
_INTERFACE_TEXT = "string[] interface_names\nfloat64[] values\n"


def stores(ros1: bool) -> list[Any]:
    """Type stores of rosbags that know all messages of `READ`, one for each version of control_msgs."""
    typesys = extra("rosbags.typesys", "ros")
    which = typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE
    out = []
    for state in (_OLD_STATE,) if ros1 else STATES:
        store = typesys.get_typestore(which)
        types: dict[str, Any] = {}
        for name, text in ((STATE, state), (_INTERFACE, _INTERFACE_TEXT), (DYNAMIC, _DYNAMIC_TEXT)):
            types.update(typesys.get_types_from_msg(text, name))
        store.register(types)
        out.append(store)
    return out


def decode(stores: list[Any], kind: str, raw: bytes, ros1: bool) -> Any:
    """One message by the first of the stores that it fits; that store is put first.

    Raises:
        SerdeError: it fits none (an exception of rosbags).
    """
    for i, store in enumerate(stores):
        try:
            found = store.deserialize_ros1(raw, kind) if ros1 else store.deserialize_cdr(raw, kind)
        except extra("rosbags.serde", "ros").SerdeError:
            if i + 1 == len(stores) or kind != STATE:
                raise
            continue
        if i:
            stores.insert(0, stores.pop(i))
        return found

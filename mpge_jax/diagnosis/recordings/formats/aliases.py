"""What people call the columns of a recording: LeRobot's, D4RL's, robomimic's, ALOHA's names and the plain ones."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

PREFIXES = ("", "observation.", "observations.", "obs.", "obs.robot0.", "observations.robot0.", "infos.")
NAMES = {
    "qpos": ("qpos", "joint.positions", "joint.position", "joint.pos"),
    "qvel": ("qvel", "velocity", "joint.velocities", "joint.velocity", "joint.vel"),
    "actuator_force": (
        "actuator.force",
        "effort",
        "joint.torques",
        "joint.torque",
        "joint.efforts",
        "joint.effort",
    ),
    "ctrl": ("ctrl", "action", "actions"),
    "time": ("time", "timestamp", "timestamps"),
}
"""Names of the keys of a recording, likeliest first; `.` stands for any separator."""
WHOLE = {"observation.state": "qpos", "observations.state": "qpos"}
"""Names that mean something only with what stands before them."""
AFTER_NAMES = {
    "positions by joint": ("qpos", ("pos", "position")),
    "velocities by joint": ("qvel", ("vel", "velocity")),
    "torques by joint": ("actuator_force", ("effort", "torque")),
    "commands by name": ("ctrl", ("cmd", "command")),
}
"""Arrays of columns that are called by a joint or actuator and one of these words: `elbow_pos`, `motor.cmd`. They count
where no array of another name has what they have."""


def _plain(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", ".", title.lower()).strip(".")


RANK: dict[str, tuple[str, int]] = {
    _plain(prefix + name): (key, i * len(PREFIXES) + j)
    for key, of_key in NAMES.items()
    for i, name in enumerate(of_key)
    for j, prefix in enumerate(PREFIXES)
}
RANK |= {name: (key, len(NAMES[key]) * len(PREFIXES)) for name, key in WHOLE.items()}
RANK |= {_plain(name): (key, len(NAMES[key]) * len(PREFIXES) + 1) for name, (key, _) in AFTER_NAMES.items()}


def meaning(title: str) -> str | None:
    """The key of a recording that a column of that title holds."""
    found = RANK.get(_plain(title))
    return None if found is None else found[0]


def is_of_actuators(title: str) -> bool:
    """Whether forces of that title are those of actuators, before their gears, and not of joints."""
    return _plain(title).endswith("actuator.force")


def best(titles: Iterable[str]) -> dict[str, str]:
    """Key to the title that holds it, of several the likeliest."""
    out: dict[str, str] = {}
    for title in titles:
        key = meaning(title)
        if key is not None and (key not in out or RANK[_plain(title)][1] < RANK[_plain(out[key])][1]):
            out[key] = title
    return out


ASKED_FOR = {"target", "desired", "des", "goal", "ref", "reference", "setpoint", "cmd", "command"}
"""Words of what a joint was asked for, which is no measurement."""
_UNIT = re.compile(r"\s*[\[(]\s*([A-Za-z][A-Za-z /*.]*)\s*[\])]$")


def split_unit(title: str, units: Collection[str]) -> tuple[str, str | None]:
    """`elbow_pos [deg]` -> (`elbow_pos`, `deg`), where that is one of the `units`; else the title as it is."""
    found = _UNIT.search(title)
    if found is None:
        return title, None
    unit = {"Nm": "N m", "N*m": "N m", "N.m": "N m", "sec": "s"}.get(found[1].strip(), found[1].strip())
    bare = title[: found.start()]
    # the part of an array may have the name of a unit: action[m]
    named = meaning(bare) not in (None, "time") and title[found.start()] in "[("
    return (title, None) if unit not in units or named or not bare else (bare, unit)


def split_title(title: str) -> tuple[str, str] | None:
    """`observation.state.elbow`, `action[2]`, `qpos_0`, `elbow_pos` -> (`observation.state`, `elbow`): a part of an
    array that was written column by column."""
    for cut in range(len(title) - 1, 0, -1):
        if not title[cut - 1].isalnum() or title[cut].isalnum():
            continue
        head, tail = title[:cut], title[cut:].strip(".:/[]_- ")
        if tail and meaning(head) is not None:
            return head, tail
    found = re.fullmatch(r"([A-Za-z].*?)[^A-Za-z0-9]+([A-Za-z]+)", title)
    if found is None or ASKED_FOR & set(_plain(found[1]).split(".")):
        return None
    return next(
        ((whole, found[1]) for whole, (_, words) in AFTER_NAMES.items() if found[2].lower() in words), None
    )

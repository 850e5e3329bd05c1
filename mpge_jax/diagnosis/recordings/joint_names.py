"""Which name in a log stands for which joint or actuator of the model: `fer_joint1` for `joint1`, `elbow.pos` for
`elbow`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import mujoco

from mpge_jax.diagnosis.machine.model import Names, actuators_of_joint, is_joint_transmission, is_scalar


def words(name: str) -> tuple[str, ...]:
    """`LeftElbow_joint1` -> left, elbow, joint, 1."""
    return tuple(re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()))


def match(found: Sequence[str], wanted: Sequence[str]) -> dict[int, int]:
    """Index in `found` to index in `wanted`, one to one.

    A name fits another whose words it holds one after another, or that holds its words; with the fewest words over.
    What fits several equally well fits none.
    """
    exact = {name: i for i, name in enumerate(wanted)}
    out = {i: exact[name] for i, name in enumerate(found) if name in exact and list(found).count(name) == 1}
    left_found = [i for i in range(len(found)) if i not in out]
    left_wanted = [j for j in range(len(wanted)) if j not in out.values()]
    over = {
        (i, j): spare
        for i in left_found
        for j in left_wanted
        if (spare := _over(words(found[i]), words(wanted[j]))) is not None
    }
    for spare in sorted(set(over.values())):
        free = {(i, j) for (i, j), s in over.items() if s == spare and i not in out and j not in out.values()}
        for i, j in sorted(free):
            if sum(a == i for a, _ in free) == 1 and sum(b == j for _, b in free) == 1:
                out[i] = j
        # what two fit equally well is left to neither, now or with more words over
        over = {
            (i, j): s
            for (i, j), s in over.items()
            if s > spare and not any(i == a or j == b for a, b in free)
        }
    return out


def _over(a: tuple[str, ...], b: tuple[str, ...]) -> int | None:
    """Words that the longer has beside the shorter, which it must hold as one piece."""
    long, short = (a, b) if len(a) >= len(b) else (b, a)
    held = any(long[k : k + len(short)] == short for k in range(len(long) - len(short) + 1))
    return len(long) - len(short) if short and held else None


def numbered(names: Sequence[str]) -> bool:
    """Whether names only count: motor_0, motor_1, motor_2."""
    split = [words(n) for n in names]
    stems = {tuple(w for w in s if not w.isdigit()) for s in split}
    numbers = [int(next((w for w in s if w.isdigit()), -1)) for s in split]
    return (
        len(stems) == 1 and numbers == list(range(numbers[0], numbers[0] + len(numbers))) and numbers[0] >= 0
    )


def joint_columns(model: mujoco.MjModel, names: Names, key: str) -> list[tuple[str, int]]:
    """(name, column of qpos or qvel) of each hinge and slide."""
    table = model.jnt_qposadr if key == "qpos" else model.jnt_dofadr
    return [(names.joints[j], int(table[j])) for j in range(model.njnt) if is_scalar(model, j)]


def driven_joints(model: mujoco.MjModel, names: Names) -> list[str]:
    """The joint that each actuator drives alone, or no name."""
    out = []
    for a in range(model.nu):
        joint = int(model.actuator_trnid[a, 0]) if is_joint_transmission(model, a) else -1
        alone = joint >= 0 and len(actuators_of_joint(model, joint)) == 1
        out.append(names.joints[joint] if alone else "")
    return out


def match_actuators(found: Sequence[str], model: mujoco.MjModel, names: Names) -> dict[int, int]:
    """Index in `found` to actuator, by its own name or by its joint's, whichever names more."""
    return max((match(found, driven_joints(model, names)), match(found, names.actuators)), key=len)

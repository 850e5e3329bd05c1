"""Writes the cases: models and recordings in one folder, answers in another, in the format of `experiments.blind`."""

import csv
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from experiments.second_author.cases import CASES
from experiments.second_author.recording import FREE, Case, Sensors, columns_of, record
from experiments.second_author.visibility import visibility

OPEN_LOOP = ("desk_arm", "gripper")
"""Machines of which every command is the reference itself."""


def same_drive(m: mujoco.MjModel, at: str) -> set[str]:
    """Names that mean the same drive as `at`: the joint, the body that it moves, the actuators on it."""
    drives = {}
    for a in range(m.nu):
        if m.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT:
            drives[m.actuator(a).name] = int(m.actuator_trnid[a, 0])
    if at in drives:
        joints = [drives[at]]
    else:
        joints = [j for j in range(m.njnt) if at in (m.joint(j).name, m.body(m.jnt_bodyid[j]).name)]
    names = {at}
    for j in joints:
        names |= {m.joint(j).name, m.body(m.jnt_bodyid[j]).name, *(a for a in drives if drives[a] == j)}
    return names


def sensors_of(case: Case, m: mujoco.MjModel) -> dict[str, float | None]:
    """The coarsest of the sensors that read angles [rad]; `jitter`: standard deviation of a row's period, a share."""
    read, free = Sensors(case, m), m.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    turning = m.jnt_qposadr[m.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    noise = [*read.noise[turning], *([FREE[1]] if free.any() else [])]
    jumps = np.arange(-case.jitter, case.jitter + 1)
    return {
        "noise": float(max(noise)),
        "step": float(max(read.step[turning], default=0.0)),
        "jitter": round(float(jumps.std() * case.dt * case.rate), 4),
        "velocity_noise": max(case.velocity) if case.velocity else None,
        "force_noise": None,
    }


def concealed(case: Case, m: mujoco.MjModel, sensors: dict[str, float | None]) -> list[str]:
    """What hides the physics, in words."""
    words = [f"noise {sensors['noise']:.1e} rad"]
    if sensors["step"]:
        words.append(f"encoder steps of {sensors['step']:.1e} rad")
    if case.jitter:
        words.append("jittered clock")
    if not case.velocity:
        words.append("no velocities")
    words.append(f"true step {case.dt} s, {'Euler' if m.opt.integrator == 0 else 'implicitfast'}")
    words.append("open loop" if case.model in OPEN_LOOP else "closed loop")
    if case.motor_side:
        words.append("loop closed at the motor")
    return words


def answer(case: Case, seen: dict[str, float]) -> dict:
    """What the scorer has to know about a case; `seen`: how far each effect stands out."""
    m = mujoco.MjModel.from_xml_string(case.xml)
    effects = case.effects()
    rows = [{"id": e.id, "at": e.at, "parameters": e.values} for e in effects]
    known = [row for row, e in zip(rows, effects, strict=True) if not e.unknown]
    sensors = sensors_of(case, m)
    places = sorted({*(e.at for e in effects), *case.also_at})
    return {
        "case": case.name,
        "schema": 1,
        "kind": case.kind,
        "model": case.model,
        "plane": list(case.plane),
        "effects": [
            row
            | {
                "twins": [list(twin) for twin in case.twins.get(str(row["id"]), ())],
                "coin": False,
                "same_place": list(case.same_place.get(str(row["id"]), ())),
            }
            for row in known
        ],
        "unknown": [row for row, e in zip(rows, effects, strict=True) if e.unknown],
        "places": {at: sorted(same_drive(m, at)) for at in places},
        "visibility": seen,
        "concealed": concealed(case, m, sensors),
        "sensors": sensors,
    }


def build_case(case: Case, folder: Path, answers: Path, seed: int = 0, longest: float | None = None) -> None:
    """Write one case into `folder`, and its answer with the two recordings that only judge into `answers`."""
    shown, judging = case.runs(seed, longest)
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "recordings").mkdir(parents=True)
    (folder / "model.xml").write_text(case.xml)
    runs = []
    for number, run in enumerate(shown):
        recorded = record(case, run, number, seed)
        runs.append(recorded)
        columns = columns_of(case, recorded)
        file = folder / "recordings" / f"{number + 1:02d}_{run.name}.csv"
        with file.open("w", newline="") as out:
            table = csv.writer(out)
            table.writerow(columns)
            table.writerows([f"{x:.10g}" for x in row] for row in zip(*columns.values(), strict=True))
    for number, run in enumerate(judging):
        r = record(case, run, len(shown) + number, seed)
        file = answers / f"{case.name}_judge_{number}.npz"
        np.savez_compressed(file, allow_pickle=False, time=r.time, qpos=r.qpos, qvel=r.qvel, ctrl=r.ctrl)
    # last, as it says that the case is whole
    target = answers / f"{case.name}.json"
    partial = target.with_suffix(".partial")
    partial.write_text(json.dumps(answer(case, visibility(case, runs)), indent=1))
    partial.rename(target)


def wanted(only: Sequence[str]) -> list[Case]:
    """The cases of these names; all when there are none. Raises ValueError for names that do not exist."""
    unknown = sorted(set(only) - {case.name for case in CASES})
    if unknown:
        raise ValueError(
            f"no such case: {', '.join(unknown)}; `python -m experiments.second_author list` names all"
        )
    return [case for case in CASES if not only or case.name in only]


def build(
    out: Path,
    answers: Path,
    only: Sequence[str] = (),
    seed: int = 0,
    progress: Callable[[], None] | None = None,
    longest: float | None = None,
) -> int:
    """Write cases into `out` and their answers into `answers`; returns how many. Finished cases are kept.

    Args:
        only: names; all when empty. seed: of the motions and the noise. longest: seconds of a recording at most.

    Raises ValueError for names that do not exist, and where `answers` belongs to another seed.
    """
    cases = wanted(only)
    out.mkdir(parents=True, exist_ok=True)
    answers.mkdir(parents=True, exist_ok=True)
    # not `seed`, by whose number the blind cases tell those for building from those for reporting
    plan = {"set": "second_author", "motions": seed, "longest": longest}
    note = answers / "plan.json"
    if note.exists() and json.loads(note.read_text()) != plan:
        raise ValueError(f"{answers} holds other answers or those of another seed; choose another folder")
    note.write_text(json.dumps(plan, indent=1))
    for case in cases:
        if not (answers / f"{case.name}.json").exists():
            build_case(case, out / case.name, answers, seed, longest)
        if progress is not None:
            progress()
    return len(cases)

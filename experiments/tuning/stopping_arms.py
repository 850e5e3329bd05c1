"""Arms that stop and go under a controller, with their motors' forces measured: what is named of what they lack.

python -m experiments.tuning.stopping_arms

Robots are mostly recorded so. A joint that stops is held by dry friction with whatever force the controller happens to
give, and moves before it slides. The cases are kept for tuning; no table of results shows them.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np
import tyro

from experiments.ending import exit_status
from experiments.storage import versions
from mpge_jax import files
from mpge_jax.diagnosis import Config, Diagnosis, Recording, diagnose

Array = np.ndarray
ARM = """
<mujoco><option timestep="0.00025"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="turn" axis="0 0 1" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0.1 0 0.2" size="0.04" mass="2"/>
<body name="middle" pos="0.1 0 0.2"><joint name="lift" axis="0 1 0" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0.35 0 0" size="0.035" mass="1.5"/>
<body name="lower" pos="0.35 0 0"><joint name="bend" axis="0 1 0" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.8"/></body></body></body></worldbody>
<actuator><motor name="m_turn" joint="turn"/><motor name="m_lift" joint="lift"/><motor name="m_bend" joint="bend"/>
</actuator></mujoco>
"""
JOINTS = ("turn", "lift", "bend")
LIGHT = np.array([1.0, 1.0, 0.5])
"""Sizes of joints: friction, damping and the controller's gains are in proportion."""
SECONDS, ROW = 8.0, 0.005
NAMES = ("run_0", "run_1", "run_2", "run_3", "heldout_0", "heldout_1")


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """What an arm lacks, by `effect@place`: sizes in N m, N m s/rad and kg."""
    out = {}
    for joint, light in zip(JOINTS, LIGHT, strict=True):
        if rng.random() < 0.6:
            out[f"coulomb_friction@{joint}"] = light * rng.uniform(0.3, 1.5)
        if rng.random() < 0.4:
            out[f"viscous_damping@{joint}"] = light * rng.uniform(0.3, 1.2)
        if rng.random() < 0.2:
            out[f"actuator_bias@m_{joint}"] = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8)
    if rng.random() < 0.4:
        out["payload_mass@lower"] = rng.uniform(0.2, 0.6)
    return out


def machine(lacks: Mapping[str, float]) -> mujoco.MjModel:
    """The arm with what the model lacks, but for the biases of its motors."""
    spec = mujoco.MjSpec.from_string(ARM)
    for name, size in lacks.items():
        effect, at = name.split("@")
        if effect == "coulomb_friction":
            spec.joint(at).frictionloss = size
        if effect == "viscous_damping":
            spec.joint(at).damping[0] = size
        if effect == "payload_mass":
            ball = spec.body(at).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=[0.25, 0, 0], mass=size)
            ball.size[0], ball.contype, ball.conaffinity = 0.03, 0, 0
    return spec.compile()


def recorded(lacks: Mapping[str, float], rng: np.random.Generator, name: str) -> Recording:
    """One recording: moves of a random part of the joints, each with a rest after it."""
    m = machine(lacks)
    d = mujoco.MjData(m)
    bias = np.array([lacks.get(f"actuator_bias@m_{joint}", 0.0) for joint in JOINTS])
    stiff, damped, sums = 60.0 * LIGHT, 4.0 * LIGHT, 60.0 * LIGHT * rng.uniform(0.0, 1.0)
    d.qpos[:] = rng.uniform(-0.6, 0.6, m.nv)
    where, to, start, lasts, until, summed = d.qpos.copy(), d.qpos.copy(), 0.0, 1.0, 0.0, np.zeros(m.nv)
    every, rows = round(ROW / m.opt.timestep), []
    for step in range(round(SECONDS / m.opt.timestep)):
        if d.time >= until:
            where, start, lasts = to, d.time, rng.uniform(0.6, 1.2)
            to = np.where(rng.random(m.nv) < 0.6, rng.uniform(-1.0, 1.0, m.nv), where)
            until = start + lasts + rng.uniform(0.3, 1.5)
        x = min((d.time - start) / lasts, 1.0)
        wrong = where + (to - where) * (3 * x**2 - 2 * x**3) - d.qpos
        summed = summed + wrong * m.opt.timestep
        push = stiff * wrong + damped * ((to - where) * 6 * x * (1 - x) / lasts - d.qvel) + sums * summed
        force = push + d.qfrc_bias
        if step % every == 0:
            rows.append((d.time, d.qpos.copy(), d.qvel.copy(), force))
        d.ctrl[:] = force + bias
        mujoco.mj_step(m, d)
    time, q, v, f = (np.array(column) for column in zip(*rows, strict=True))
    q, v, f = (x + s * rng.standard_normal(x.shape) for x, s in ((q, 2e-5), (v, 2e-3), (f, 0.02)))
    return Recording(name, time, q, v, None, f)


def case(seed: int) -> tuple[dict[str, float], list[Recording]]:
    """What an arm lacks, and its recordings."""
    rng = np.random.default_rng([seed, 6])
    lacks = drawn(rng)
    return lacks, [recorded(lacks, rng, name) for name in NAMES]


def score(lacks: Mapping[str, float], d: Diagnosis) -> dict[str, Any]:
    """What was missed, and what was named for certain that is not there. A name counts as said with those that cannot
    be told apart from it, and as uncertain where it may be a part of something unknown."""
    said = {str(t): {str(t), *(str(r.term) for r in d.rivals.get(t, []) if r.tied)} for t in d.terms}
    perhaps = {str(t) for t in d.doubtful}
    return {
        "lacks": {k: round(float(x), 3) for k, x in lacks.items()},
        "verdict": d.verdict,
        "missed": sorted(set(lacks) - set().union(*said.values())),
        "false": sorted(k for k, names in said.items() if k not in perhaps and not names & set(lacks)),
    }


def summary(found: list[dict[str, Any]]) -> str:
    """All cases in one sentence."""
    lacked, missed, false = (sum(len(each[key]) for each in found) for key in ("lacks", "missed", "false"))
    right = sum(not each["missed"] and not each["false"] for each in found)
    return f"{len(found)} arms, {right} all right; {missed} of {lacked} effects missed, {false} false names"


@dataclass(frozen=True)
class Args:
    """Diagnoses arms that stop and go."""

    cases: Annotated[int, tyro.conf.arg(help="how many arms")] = 12
    first: Annotated[int, tyro.conf.arg(help="seed of the first")] = 0
    out: Annotated[Path, tyro.conf.arg(help="file of the result")] = Path("results/stopping_arms.json")


def _run() -> int:
    args, found = (
        tyro.cli(Args, prog="python -m experiments.tuning.stopping_arms", description=Args.__doc__),
        [],
    )
    for seed in range(args.first, args.first + args.cases):
        lacks, recordings = case(seed)
        found.append(
            score(lacks, diagnose(mujoco.MjSpec.from_string(ARM), recordings, Config(jobs=1, quiet=True)))
        )
        last = found[-1]
        print(f"arm {seed}: {last['verdict']}; missed {last['missed']}; false {last['false']}", flush=True)
    files.write_text(args.out, json.dumps({"cases": found, "versions": versions()}, indent=1) + "\n")
    print(summary(found))
    return 0


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("tuning.stopping_arms", _run, goes_on=False)


if __name__ == "__main__":
    sys.exit(main())

"""What a case consists of, and its recordings: the true machine under its controllers, as its sensors read it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from experiments.second_author.excitation import Array, Run
from experiments.second_author.simulation import Effect, Sim, Snapshot

Noise = tuple[float, float]
"""Of an encoder: standard deviation, and the step that it then rounds to (0: none) [rad or m]."""
FREE = (5e-4, 8e-4)
"""Standard deviations of motion capture of a free body: places [m] and angles [rad]."""
JUDGES = 50
"""Added to the seed of a motion for the recordings that only judge."""
OTHER = 10_000
"""Added to it for every further seed of the whole set."""


def bits(n: int, noise: float = 0.0) -> Noise:
    """An encoder of 2^n steps a turn."""
    return noise, 2 * np.pi / 2**n


@dataclass(frozen=True)
class Case:
    """One machine with what is true beside its nominal model, how it is moved and how it is measured.

    Attributes:
        number, model: its place in the list and its machine, which are its name. xml: the nominal model.
        kind: as the blind cases have it. effects: makes the hidden effects anew, with nothing remembered.
        motion: from a seed to the runs. judging: names of the two runs that are made once more to judge.
        rate: of rows [Hz]. dt: of the true machine [s]. noise: of all joints, or by joint. velocity: standard
            deviations [nv] of the velocities that are recorded; none are where it is empty. jitter: steps by which rows
            come early or late, at most. smooth: share of the last estimate in that of the controller's velocities.
        motor_side: the drive's loop is closed at the motor, by an encoder that is not recorded.
        twins: by effect, what cannot be told from it on this machine. same_place: by effect, other names of its place.
        also_at: further places where unknown physics acts. plane: components of vectors that the motion can show.
        note: what the author of the cases says of it.
    """

    number: int
    model: str
    xml: str
    kind: str
    effects: Callable[[], list[Effect]]
    motion: Callable[[str, int], list[Run]]
    judging: tuple[str, str]
    rate: int
    dt: float
    noise: Noise | dict[str, Noise] = (1e-4, 0)
    velocity: tuple[float, ...] = ()
    jitter: int = 0
    smooth: float = 0.5
    motor_side: bool = False
    twins: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    same_place: dict[str, tuple[str, ...]] = field(default_factory=dict)
    also_at: tuple[str, ...] = ()
    plane: tuple[int, ...] = (0, 1, 2)
    note: str = ""

    @property
    def name(self) -> str:
        """Of its folder and its answer."""
        return f"case_{self.number:02d}_{self.model}"

    def noise_of(self, joint: str) -> Noise:
        """The encoder of a joint."""
        return self.noise[joint] if isinstance(self.noise, dict) else self.noise

    def runs(self, seed: int = 0, longest: float | None = None) -> tuple[list[Run], list[Run]]:
        """What is recorded, and what only judges; `longest`: seconds of a run at most."""
        first = 100 * self.number + OTHER * seed
        # where nothing in a motion is random, another seed is the same again: `other_` runs are for judging alone
        shown = [run for run in self.motion(self.xml, first) if not run.name.startswith("other_")]
        hidden = {run.name: run for run in self.motion(self.xml, first + JUDGES)}
        both = shown, [hidden[name] for name in self.judging]
        if longest is None:
            return both
        short = [[replace(run, seconds=min(run.seconds, longest)) for run in runs] for runs in both]
        return short[0], short[1]


@dataclass(frozen=True)
class Recorded:
    """One recording, rows in time order.

    time [T] s; qpos [T, nq], qvel [T, nv]: as the sensors would read without noise; read_qpos, read_qvel: with it
    (velocities are the controller's estimate where none are recorded); ctrl [T, nu]; moments: the machine's own states.
    """

    time: Array
    qpos: Array
    qvel: Array
    read_qpos: Array
    read_qvel: Array
    ctrl: Array
    moments: list[Snapshot]


class Sensors:
    """Reads positions: noise first, then the steps of encoders; orientations of free bodies are turned."""

    def __init__(self, case: Case, m: mujoco.MjModel):
        self.noise, self.step = np.zeros(m.nq), np.zeros(m.nq)
        self.sigma = np.zeros(m.nv)
        """Standard deviation [nv] of a position as it is read."""
        self.free: list[int] = []
        for i in range(m.njnt):
            column, dof = m.jnt_qposadr[i], m.jnt_dofadr[i]
            if m.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE:
                self.free.append(column)
                self.noise[column : column + 3] = FREE[0]
                self.sigma[dof : dof + 6] = np.repeat(FREE, 3)
            else:
                self.noise[column], self.step[column] = case.noise_of(m.joint(i).name)
                self.sigma[dof] = np.hypot(self.noise[column], self.step[column] / np.sqrt(12))

    def read(self, q: Array, rng: np.random.Generator) -> Array:
        """Positions [nq] as read."""
        q = q + self.noise * rng.standard_normal(len(q))
        rounds = self.step > 0
        q[rounds] = np.round(q[rounds] / self.step[rounds]) * self.step[rounds]
        for column in self.free:
            turn = rng.standard_normal(3) * FREE[1]
            mujoco.mju_quatIntegrate(q[column + 3 : column + 7], turn, 1.0)
        return q


def record(case: Case, run: Run, number: int, seed: int = 0) -> Recorded:
    """Make one recording. `number`: among those of the case, for its noise.

    Raises ValueError where the machine runs away.
    """
    key = [ord(c) for c in case.name.replace("case_", "c", 1)]
    rng = np.random.default_rng([*key, number, *([seed] if seed else [])])
    sim = Sim(case.xml, case.effects(), case.dt)
    m = sim.nominal
    sensors = Sensors(case, m)
    sim.reset(np.array(run.start, float), np.zeros(m.nv))
    count = round(1 / case.rate / sim.dt)
    limited = m.actuator_ctrllimited.astype(bool)
    low, high = m.actuator_ctrlrange[limited].T
    rows: list[tuple[float, Array, Array, Array, Array, Array]] = []
    moments = []
    t, last = 0.0, None
    v: Array = np.zeros(m.nv)
    while t < run.seconds - 1e-9:
        q_true, v_true = sim.measured()
        q_read = sensors.read(q_true, rng)
        q_seen = sim.at_motors(q_read) if case.motor_side else q_read
        if case.velocity:
            v = v_true + np.array(case.velocity) * rng.standard_normal(m.nv)
        elif last is not None:
            moved = np.zeros(m.nv)
            mujoco.mj_differentiatePos(m, moved, t - last[0], last[1], q_seen)
            v = case.smooth * v + (1 - case.smooth) * moved
        last = (t, q_seen)
        wish: Array = np.array(run.policy(t, q_seen, v), dtype=np.float64).reshape(m.nu)
        wish[limited] = np.clip(wish[limited], low, high)
        u: Array = wish.round(6)
        rows.append((t, q_true, v_true, q_read, v, u))
        moments.append(sim.snapshot())
        late = int(rng.integers(-case.jitter, case.jitter + 1)) if case.jitter else 0
        steps = max(1, count + late)
        for _ in range(steps):
            sim.step(u)
        t = round(t + steps * sim.dt, 9)
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    if not all(np.isfinite(column).all() for column in columns):
        raise ValueError(f"{case.name} runs away in {run.name}")
    time, qpos, qvel, read_qpos, read_qvel, ctrl = columns
    return Recorded(time, qpos, qvel, read_qpos, read_qvel, ctrl, moments)


def columns_of(case: Case, recorded: Recorded) -> dict[str, Array]:
    """The columns of a recording [T] by name, as its table has them."""
    m = mujoco.MjModel.from_xml_string(case.xml)
    columns = {"time": recorded.time}

    def add(what: str, values: Array, wide: int) -> None:
        i = 0
        for j in range(m.njnt):
            free = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
            ends: Sequence[str] = [f":{k}" for k in range(wide)] if free else [""]
            for end in ends:
                columns[f"{what}:{m.joint(j).name}{end}"] = values[:, i]
                i += 1

    add("qpos", recorded.read_qpos, 7)
    if case.velocity:
        add("qvel", recorded.read_qvel, 6)
    for a in range(m.nu):
        columns[f"ctrl:{m.actuator(a).name}"] = recorded.ctrl[:, a]
    return columns

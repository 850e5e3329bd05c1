"""One machine of a case: nominal model file, true time step, sensors and the plan of its recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from experiments.blind.robots.robot import Robot
from experiments.blind.truth.control import CONTROLLERS, Controller
from experiments.blind.truth.excitation import reference
from experiments.blind.truth.physics import stages_of
from experiments.blind.truth.plant import Plant
from experiments.blind.truth.sensors import Sensors
from experiments.blind.truth.simulate import Trajectory, simulate
from experiments.blind.truth.stages import Stages
from experiments.blind.vocabulary import Effect

WARMUP = 1.0  # s, run before the first recorded row, so that recordings do not start at rest


@dataclass(frozen=True)
class Plan:
    """One recording to be made: its name, excitation, length [s] and random seed."""

    name: str
    kind: str
    duration: float
    seed: int


@dataclass
class Machine:
    """A robot with everything drawn but the hidden physics."""

    robot: Robot
    xml: Path
    dt: float
    integrator: str
    period: float
    bandwidth: float
    sensors: Sensors
    plans: tuple[Plan, ...]
    open_loop: bool = False
    law: str = "at once"
    model: mujoco.MjModel = field(init=False)

    def __post_init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(self.xml))
        self._commands: dict[str, np.ndarray] = {}

    @property
    def checking(self) -> tuple[Plan, ...]:
        """Short forms of two recordings on which sizes are checked: the mixture and the chirp."""
        picked = [next(p for p in self.plans if p.kind == kind) for kind in ("mix", "chirp")]
        return tuple(replace(p, name=f"check {p.name}", duration=min(p.duration, 3.5)) for p in picked)

    @property
    def judging(self) -> tuple[Plan, ...]:
        """Two recordings like those held out, of other seeds, that only judge the answer."""
        held = [p for p in self.plans if p.name.startswith("heldout_")]
        return tuple(
            replace(p, name=f"judge_{i}", seed=int(np.random.SeedSequence([p.seed, 1]).generate_state(1)[0]))
            for i, p in enumerate(held)
        )

    def record(self, plan: Plan, effects: Sequence[Effect] = ()) -> Trajectory:
        """One recording with the given hidden physics; raises Unstable if the machine runs away."""
        rng = np.random.default_rng(plan.seed)
        ticks = self.sensors.ticks(self.period, plan.duration + WARMUP, self.dt, rng)
        times = np.asarray(ticks * self.dt, float)
        centres, spans = np.array(self.robot.references).T
        ref = reference(plan.kind, rng, times, centres, spans, self.robot.top)
        start, velocity = self.model.qpos0.copy(), np.zeros(self.model.nv)
        if self.robot.controller in ("torque", "servo"):
            start, velocity = ref.q[0].copy(), ref.v[0].copy()
        for joint, value in self.robot.start.items():
            start[self.model.joint(joint).qposadr[0]] = value
        controller = CONTROLLERS[self.robot.controller](self.model, ref, self.bandwidth)
        commands: Controller | np.ndarray = controller
        warmup = int(np.searchsorted(times, WARMUP))
        if self.open_loop:
            commands = self._replayed(plan, controller, ticks, (start, velocity))
        plant = Plant(str(self.xml), self.dt, self.integrator, stages_of(effects, self.law))
        return simulate(plant, commands, ticks, warmup, (start, velocity), self.sensors, rng)

    def _replayed(self, plan: Plan, controller: Controller, ticks: np.ndarray, start: tuple) -> np.ndarray:
        """The commands that the controller gives to the nominal machine, noise-free."""
        if plan.name not in self._commands:
            plant = Plant(str(self.xml), self.dt, self.integrator, Stages())
            silent, rng = Sensors(noise=0.0), np.random.default_rng(0)
            self._commands[plan.name] = simulate(plant, controller, ticks, 0, start, silent, rng).ctrl
        return self._commands[plan.name]


def columns_of(run: Trajectory, sensors: Sensors, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The columns of one .npz as the contract defines it; time starts at a random moment."""
    columns = {
        "time": run.time - run.time[0] + round(rng.uniform(0, 20), 3),
        "qpos": run.measured_qpos,
        "ctrl": run.ctrl,
    }
    if sensors.velocity_noise is not None:
        columns["qvel"] = run.measured_qvel
    if sensors.force_noise is not None:
        columns["actuator_force"] = sensors.read_force(run.force, rng)
    return columns

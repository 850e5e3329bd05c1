"""The fit of given parameters on given windows beside `mujoco.sysid`: two joints with other damping and inertia.

Both start from the nominal model and minimise the same whitened residuals of the same windows; sysid takes its own
finite differences, its own Gauss-Newton and MuJoCo's rollouts.
"""

import contextlib
import importlib
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from experiments.scale import robots
from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.whitening import Whitener, whitener
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.pipeline import Progress, find
from mpge_jax.diagnosis.recordings.reader import read
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.simulation.remembered import Remembered

DAMPING, ARMATURE = "viscous_damping", "armature"
AS_GOOD = 1.001
"""Times the lowest loss of the two at which a fit counts as there."""


@dataclass(frozen=True)
class Problem:
    """What both are given.

    Attributes:
      folder: of `model.xml` and `robots`.
      search: of our diagnosis: its simulator and training windows.
      hypothesis: damping and rotor inertia at every joint.
      white: of the training windows, in units of the noise.
    """

    folder: Path
    search: Search
    hypothesis: Hypothesis
    white: Whitener

    def start(self) -> Fitted:
        """The nominal model."""
        nothing = np.zeros(len(self.hypothesis.params(self.search.sim.ctx)))
        return Fitted(self.hypothesis, nothing, nothing)

    def loss(self, theta: np.ndarray) -> float:
        """The objective of our fit, its weak prior aside."""
        at = replace(self.start(), theta=theta)
        return evaluate(self.search.sim, [at], self.search.train, self.white)[0].loss


def toolbox() -> Any:
    """`mujoco.sysid`; empty where its own requirements are not installed."""
    # By name: with its types alone the type checker would take MuJoCo for empty.
    return importlib.import_module("mujoco.sysid")


def problem(folder: Path, joints: int, runs: int) -> Problem:
    """Recordings of a chain whose damping and rotor inertia are not those of its model, and what is to be fitted."""
    record(folder, joints, runs)
    spec = load_spec(folder / "model.xml")
    plain = compile_variable(spec)
    p = prepare(spec, read(folder / "robots" / "robot_0", plain, names_of(plain)), Config(quiet=True))
    search = build_search(p, lambda _: None, p.config.decide_s)
    terms = [t for t in search.terms if t.id in (DAMPING, ARMATURE)]
    hypothesis = Hypothesis.of(*terms)
    start = np.zeros(len(hypothesis.params(search.sim.ctx)))
    rough = whitener(search.sim, hypothesis, start, search.train, search.noise)
    found = fit(search.sim, [Fitted(hypothesis, start, start)], search.train, rough)[0]
    white = whitener(search.sim, hypothesis, found.theta, search.train, search.noise, temper=False)
    return Problem(folder, search, hypothesis, white)


def record(folder: Path, joints: int, runs: int) -> None:
    """Writes `model.xml` and recordings of a machine with more damping and rotor inertia at every joint."""
    robots.write(robots.Robots(joints, runs=runs), folder)
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    for joint in spec.joints:
        joint.damping[0] *= 2.0
        joint.armature *= 2.0
    machine, rng = spec.compile(), np.random.default_rng(1)
    for path in sorted((folder / "robots" / "robot_0").glob("*.npz")):
        with np.load(path) as file:
            columns = dict(file)
        data = mujoco.MjData(machine)
        data.qpos[:] = rng.uniform(-0.3, 0.3, machine.nq)
        for row, command in enumerate(columns["ctrl"]):
            columns["qpos"][row] = data.qpos + 2e-4 * rng.standard_normal(machine.nq)
            data.ctrl[:] = command
            mujoco.mj_step(machine, data, round(0.01 / machine.opt.timestep))
        np.savez(path, **columns)


def ours(given: Problem) -> tuple[float, np.ndarray]:
    """Seconds of our fit, and its parameters; nothing simulated before is remembered."""
    sim = given.search.sim
    sim.known = Remembered()
    start = time.perf_counter()
    # To its end: the search itself stops after eight and weighs what it has.
    found = fit(sim, [given.start()], given.search.train, given.white, iterations=40)[0]
    return time.perf_counter() - start, found.theta


def theirs(given: Problem) -> tuple[float, list[tuple[float, np.ndarray]]]:
    """Seconds that sysid's own optimiser took in all, and the parameters that it had looked at after how many."""
    sysid = toolbox()
    params = _parameters(sysid, given)
    residual = sysid.build_residual_fn(
        models_sequences=[_sequences(sysid, given)],
        modify_residual=_whitened(given),
        n_threads=given.search.sim.threads,
        resample_true=False,
    )
    seen: list[tuple[float, np.ndarray]] = []
    start = time.perf_counter()

    def noted(x: np.ndarray, params: Any, **options: Any) -> Any:
        out = residual(x, params, **options)
        if x.ndim == 1 or x.shape[1] == 1:
            seen.append((time.perf_counter() - start, np.array(x).reshape(-1)))
        return out

    # Its optimiser prints every iteration, whatever one asks for.
    with contextlib.redirect_stdout(io.StringIO()):
        sysid.optimize(params, noted, verbose=False)
    return time.perf_counter() - start, seen


def seconds_to(given: Problem, seen: Sequence[tuple[float, np.ndarray]], loss: float) -> float:
    """When sysid was first at a loss as good as `loss`; infinite where it never was."""
    return next((at for at, x in seen if given.loss(x) <= AS_GOOD * loss), float("inf"))


def whole_search(given: Problem) -> float:
    """Seconds of the whole diagnosis, from recordings that are read and smoothed to its verdict."""
    spec = load_spec(given.folder / "model.xml")
    plain = compile_variable(spec)
    start = time.perf_counter()
    checked = read(given.folder / "robots" / "robot_0", plain, names_of(plain))
    find(prepare(spec, checked, Config(quiet=True)), plain, Progress(quiet=True))
    return time.perf_counter() - start


def _parameters(sysid: Any, given: Problem) -> Any:
    """Each parameter of the hypothesis as sysid's, which writes it into the specification."""
    out = sysid.ParameterDict()
    ctx = given.search.sim.ctx
    for term in given.hypothesis.terms:
        (param,) = term.params(ctx)
        dof = ctx.dof(term.place)
        model = given.search.sim.model
        nominal = float((model.dof_damping if term.id == DAMPING else model.dof_armature)[dof])

        write = _setter(term.id, term.place.name, nominal)
        out.add(sysid.Parameter(f"{term.id}_{term.place.name}", 0.0, param.low, param.high, modifier=write))
    # As it asks for where a start lies at a bound.
    out.move_off_bounds()
    return out


def _setter(effect: str, joint: str, nominal: float) -> Callable[[Any, Any], None]:
    """Writes a parameter of sysid's into a specification."""

    # Set, not added: the specification keeps what an earlier trial wrote.
    def write(spec: Any, parameter: Any) -> None:
        total = nominal + float(parameter.value[0])
        if effect == DAMPING:
            spec.joint(joint).damping[0] = total
        else:
            spec.joint(joint).armature = total

    return write


def _sequences(sysid: Any, given: Problem) -> Any:
    w, spec = given.search.train, mujoco.MjSpec.from_file(str(given.folder / "model.xml"))
    spec.option.timestep = w.dt
    for joint in spec.joints:
        spec.add_sensor(
            name=f"q_{joint.name}",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    model = spec.compile()
    # The last row of a time series is not driven.
    at = np.arange(w.steps + 1) * w.dt
    controls = sysid.TimeSeries.compute_all_control_mapping(model)
    sensors = sysid.TimeSeries.compute_all_sensor_mapping(model)
    starts, commands, measured = [], [], []
    for k in range(w.count):
        starts.append(sysid.create_initial_state(model, w.q0[k], w.v0[k]))
        commands.append(
            sysid.TimeSeries(at, np.vstack([w.command[k, w.history :], w.command[k, -1:]]), controls)
        )
        # Which window it is of, in the place of numbers that the residual takes from the window itself.
        measured.append(sysid.TimeSeries(at, np.full((w.steps + 1, model.nsensordata), float(k)), sensors))
    return sysid.ModelSequences(
        "chain", spec, "window", starts, commands, measured, allow_missing_sensors=False
    )


def _whitened(given: Problem) -> Callable[..., Any]:
    """sysid's hook for residuals: those of our windows, whitened, so that their squares sum to the mean excess."""
    w, white = given.search.train, given.white
    nv = w.v0.shape[1]
    rows = np.round(w.times / w.dt).astype(int)
    weight = 1.0 / np.sqrt(white.count * white.expected * w.count)

    def hook(params: Any, predicted: Any, measured: Any, model: Any, all_: bool, state: np.ndarray) -> Any:
        del params, model, all_
        k = int(measured.data[0, 0])
        # A rollout's first row is the state after its first step.
        q = np.vstack([w.q0[k], state[:, 1 : 1 + nv]])[rows[k]]
        r = (w.qpos[k] - q) / white.scale[k, :, :nv]
        r = np.hstack([np.where(np.isfinite(r), r, 0.0) * w.seen[k][:, None], np.zeros_like(r)]).reshape(-1)
        r = r + white.offset[k]
        r = r - white.basis[k] @ (white.shrink[k] * (white.basis[k].T @ r))
        return weight[k] * r, predicted, predicted

    return hook

"""A rival that is told the answer: the true effects at their places, of which it fits the sizes alone.

It steps the true machine of `truth`, begins at the true sizes (no local minimum is its fault), and fits by the
optimiser of `mujoco.sysid` (`mujoco.minimize.least_squares`) the errors of positions in short windows of a case's
recordings. What it finds is written as a diagnosis writes it, so that the same recordings judge both.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from mujoco import minimize
from numpy.typing import NDArray

from experiments.blind.truth.physics import stages_of
from experiments.blind.truth.plant import Plant, Unstable
from experiments.blind.truth.sensors import Sensors
from experiments.blind.truth.simulate import simulate
from experiments.blind.vocabulary import ACTUATOR, Effect

Array = NDArray[np.float64]
LENGTH, WINDOWS = 0.25, 24
"""Seconds of a window, and how many of them in all recordings."""
AROUND, FEWEST = 0.05, 3
"""Seconds before and after a window's start by whose positions that is told, and rows at least."""
ITERATIONS = 8
STEP = 0.02
"""Of differences, as a share of the true sizes."""
FIXED = ("periods",)
"""Parameters that are whole numbers; they are told."""
PLACES = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
}


@dataclass(frozen=True)
class Window:
    """A stretch of a recording: seconds [T] since its start, measured positions [T, nq] and commands [T, nu], and the
    time and columns of the recording that tell the start."""

    time: Array
    qpos: Array
    ctrl: Array
    begin: float
    run: dict[str, Array]


@dataclass(frozen=True)
class Rival:
    """The machine of a case with its true effects.

    Attributes:
        model: file of the model as given. effects: the true ones. dt, integrator: of the true machine.
        windows: what is fitted to.
    """

    model: Path
    effects: tuple[Effect, ...]
    dt: float
    integrator: str
    windows: tuple[Window, ...]

    @staticmethod
    def of(case: Path, answer: dict) -> "Rival":
        """The rival of a case, from the folder that the engine is given and its answer."""
        effects = tuple(Effect(e["id"], e["at"], e["parameters"]) for e in answer["effects"])
        stepped = next(w for w in answer["concealed"] if w.startswith("true step "))
        dt, integrator = stepped.removeprefix("true step ").split(" s, ")
        late = "commands logged a row late" in answer["concealed"]
        runs = [dict(np.load(p)) for p in sorted((case / "recordings").glob("*.npz"))]
        windows = [w for run in runs for w in _windows(run, -(-WINDOWS // len(runs)), late)]
        return Rival(case / "model.xml", effects, float(dt), integrator, tuple(windows))

    @property
    def sizes(self) -> Array:
        """All parameters that are fitted [P]."""
        return np.array([x for e in self.effects for name in _free(e) for x in np.ravel(e.parameters[name])])

    def sized(self, sizes: Array) -> tuple[Effect, ...]:
        """The effects with other parameters [P]."""
        left, out = list(map(float, sizes)), []
        for e in self.effects:
            parameters = dict(e.parameters)
            for name in _free(e):
                old = parameters[name]
                parameters[name] = [left.pop(0) for _ in old] if isinstance(old, list) else left.pop(0)
            out.append(replace(e, parameters=parameters))
        return tuple(out)

    def misses(self, effects: Sequence[Effect]) -> list[Array]:
        """Of every window, predicted less measured positions [T - 1, nv] after its start."""
        plant = Plant(str(self.model), self.dt, self.integrator, stages_of(effects))
        return [self._missed(plant, w, effects) for w in self.windows]

    def _missed(self, plant: Plant, w: Window, effects: Sequence[Effect]) -> Array:
        m, ticks = plant.nominal, np.round(w.time / self.dt).astype(int)
        out = np.full((len(ticks) - 1, m.nv), np.nan)
        silent, rng = Sensors(noise=0.0), np.random.default_rng(0)
        try:
            run = simulate(plant, w.ctrl, ticks, 0, _start(m, w, effects), silent, rng)
        except Unstable:
            return out
        for row in range(1, len(ticks)):
            mujoco.mj_differentiatePos(m, out[row - 1], 1.0, w.qpos[row], run.qpos[row])
        return out

    def fitted(self) -> tuple[Effect, ...]:
        """The effects with the sizes that the windows are predicted best with."""
        truth = self.sizes
        free = np.flatnonzero(truth)
        if not free.size or not self.windows:
            return self.effects
        # what the start of a window leaves open grows with time, otherwise at each degree of freedom
        at_truth = self.misses(self.effects)
        rows = max(len(x) for x in at_truth)
        padded = np.full((len(at_truth), rows, at_truth[0].shape[1]), np.nan)
        for k, x in enumerate(at_truth):
            padded[k, : len(x)] = x
        scale = np.sqrt(np.nanmedian(padded**2, axis=0)) + 1e-9

        def residual(x: Array) -> Array:
            columns = []
            for share in x.T:
                sizes = truth.copy()
                sizes[free] = truth[free] * share
                missed = [r / scale[: len(r)] for r in self.misses(self.sized(sizes))]
                # what no window tells stays
                columns.append(np.append(_robust(np.concatenate(missed).ravel()), share - 1.0))
            return np.stack(columns, 1)

        bounds = [np.full(free.size, 0.05), np.full(free.size, 20.0)]
        found, _ = minimize.least_squares(
            np.ones(free.size), residual, bounds, eps=STEP, max_iter=ITERATIONS,
            verbose=minimize.Verbosity.SILENT,
        )  # fmt: skip
        truth[free] *= found
        return self.sized(truth)


def _windows(run: dict[str, Array], count: int, late: bool) -> list[Window]:
    time, ctrl = run["time"], run["ctrl"]
    if late:
        # of all actuators alike: a row holds the command of the row before
        ctrl = np.concatenate([ctrl[1:], ctrl[-1:]])
    out = []
    for start in np.linspace(time[FEWEST], time[-FEWEST - 1] - LENGTH, count):
        first, last = (int(np.searchsorted(time, t)) for t in (start, start + LENGTH))
        rows = slice(first, max(last, first + 3) + 1)
        if rows.stop <= len(time):
            out.append(Window(time[rows] - time[first], run["qpos"][rows], ctrl[rows], time[first], run))
    return out


def _start(m: mujoco.MjModel, w: Window, effects: Sequence[Effect]) -> tuple[Array, Array]:
    """Position and velocity where a window begins: a cubic through the positions around it, joint by joint where
    sensors are late, less their offsets."""
    late = {e.at: e.number("delay") for e in effects if e.id == "sensor_delay"}
    qpos, qvel = _smoothed(m, w.run, w.begin)
    for joint, delay in late.items():
        q, v = _smoothed(m, w.run, w.begin + delay)
        column, dof = m.joint(joint).qposadr[0], m.joint(joint).dofadr[0]
        qpos[column], qvel[dof] = q[column], v[dof]
    for e in effects:
        if e.id == "encoder_offset":
            qpos[m.joint(e.at).qposadr[0]] -= e.number("offset")
    return qpos, qvel


def _smoothed(m: mujoco.MjModel, run: dict[str, Array], at: float) -> tuple[Array, Array]:
    row = int(np.argmin(np.abs(run["time"] - at)))
    first, last = np.searchsorted(run["time"], [at - AROUND, at + AROUND])
    rows = range(max(min(first, row - FEWEST), 0), min(max(last, row + FEWEST + 1), len(run["time"])))
    moved = np.zeros((len(rows), m.nv))
    for k, r in enumerate(rows):
        mujoco.mj_differentiatePos(m, moved[k], 1.0, run["qpos"][row], run["qpos"][r])
    t = run["time"][list(rows)] - at
    # a stray reading is not followed
    weight = np.ones_like(moved)
    for _ in range(3):
        fits = [np.polyfit(t, moved[:, d], 3, w=weight[:, d]) for d in range(m.nv)]
        error = np.abs(moved - np.stack([np.polyval(f, t) for f in fits], 1))
        weight = 1.0 / np.maximum(error / (3.0 * np.median(error, 0) + 1e-12), 1.0)
    qpos = run["qpos"][row].copy()
    mujoco.mj_integratePos(m, qpos, np.array([f[-1] for f in fits]), 1.0)
    return qpos, np.array([f[-2] for f in fits])


def _robust(r: Array) -> Array:
    """Residuals whose squares grow no faster than their sizes from three on; a machine that runs away counts so."""
    r = np.clip(np.nan_to_num(r, nan=1e3), -1e3, 1e3)
    return np.asarray(np.sign(r) * 3.0 * np.sqrt(2.0 * (np.sqrt(1.0 + (r / 3.0) ** 2) - 1.0)))


def _free(effect: Effect) -> list[str]:
    return [name for name in effect.parameters if name not in FIXED]


def _entry(model: mujoco.MjModel, effect: Effect) -> dict:
    """As a diagnosis writes it."""
    there = [k for k, v in PLACES.items() if mujoco.mj_name2id(model, v, effect.at) >= 0]
    kind = "actuator" if effect.id in ACTUATOR else "world" if effect.at == "world" else there[0]
    return {"id": effect.id, "at": effect.at, "kind": kind, "parameters": effect.parameters}


def write_rivals(
    cases: Path, answers: Path, out: Path, progress: Callable[[int, int], None] | None = None
) -> int:
    """Write OUT/case/report for every case in which nothing but effects of the vocabulary is hidden, and return how
    many there are; those that are there are kept."""
    paths = sorted(answers.glob("case_*.json"))
    count = 0
    for number, path in enumerate(paths, 1):
        answer = json.loads(path.read_text())
        told = bool(answer["effects"]) and not answer["unknown"]
        report = out / path.stem / "report"
        if told and not (report / "effects.json").exists():
            rival = Rival.of(cases / path.stem, answer)
            model = mujoco.MjModel.from_xml_path(str(rival.model))
            report.mkdir(parents=True, exist_ok=True)
            shutil.copy(rival.model, report / "nominal.xml")
            entries = [_entry(model, e) for e in rival.fitted()]
            table = {"schema": 1, "model": "nominal.xml", "effects": entries}
            partial = report / "effects.partial"
            partial.write_text(json.dumps(table, indent=1))
            partial.rename(report / "effects.json")
        count += told
        if progress is not None:
            progress(number, len(paths))
    return count

"""Simulate windows under many hypotheses at once: windows x parameter vectors x start states in one batch."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.contact_pairs import never_touches
from mpge_jax.diagnosis.simulation.batch_fields import BatchFields
from mpge_jax.diagnosis.simulation.driving.actuator_state import shifted
from mpge_jax.diagnosis.simulation.encoders import Encoders
from mpge_jax.diagnosis.simulation.guided import Guide
from mpge_jax.diagnosis.simulation.pushes import Push, by_step
from mpge_jax.diagnosis.simulation.remembered import Remembered
from mpge_jax.diagnosis.simulation.runtime_effects import Group, Runtime
from mpge_jax.diagnosis.simulation.slider_weights import weigh_anew
from mpge_jax.diagnosis.simulation.trajectories import Commands, by_the_engine, step_by_step
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
MANY_STEPS = 50
"""Steps of a window from which cheaper ones show what a change does nearly as the model's own do."""
BY_THE_ENGINE, STEP_BY_STEP, WITH_RUN_UP = (
    "by the engine alone",
    "step by step",
    "step by step after a run-up",
)
CHUNKS = {BY_THE_ENGINE: 500, STEP_BY_STEP: 3000, WITH_RUN_UP: 3000}
"""Most simulations of a batch: alone, more only take memory; stepped together, they do not fit the caches."""


@dataclass(frozen=True)
class Run:
    """One simulation of all windows.

    Attributes:
        theta: flat parameters of the hypothesis.
        shift: [W, 2 nv] change of the start state in (position, velocity), or None.
    """

    hypothesis: Hypothesis
    theta: Array
    shift: Array | None = None
    push: Push | None = None

    @property
    def key(self) -> Hashable:
        """What tells it from other runs."""
        shift = None if self.shift is None else self.shift.tobytes()
        return self.hypothesis, self.theta.tobytes(), shift, self.push


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's instability warnings out of the console and of its log file."""
    mujoco.set_mju_user_warning(lambda _message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


@dataclass
class Simulator:
    """Predicts windows.

    Attributes:
        threads: of the engine. work: steps that were asked for, by cost: nv^1.5 each, four times that with
        Runge-Kutta. stride: steps that are simulated as one where what a change does is asked for
        (`cheaper_steps.stride`). known: what was simulated, which is not done twice. always: terms with their flat
        parameters that act in every run. guided: degrees of freedom that move as recorded. on_readings: servos that act
        on what the encoders of their joints read. timestep: the model's (s).
    """

    model: mujoco.MjModel
    ctx: Context
    threads: int = 1
    work: float = 0.0
    stride: int = 1
    known: Remembered = field(default_factory=Remembered)
    always: tuple[Hypothesis, Array] = (Hypothesis(), np.zeros(0))
    guided: tuple[int, ...] = ()
    on_readings: tuple[int, ...] = ()
    timestep: float = 0.0
    _larger: tuple[Windows, int, Windows] | None = None

    def __post_init__(self) -> None:
        self.timestep = self.timestep or float(self.model.opt.timestep)
        self.model = _bare(self.model)
        self.ctx = replace(self.ctx, model=self.model)

    def beside(self, hypothesis: Hypothesis, theta: Array) -> Simulator:
        """The same machine with these terms in every run, too."""
        parts = self.acting(hypothesis, theta)
        every = Hypothesis.of(*parts)
        always = every, every.gather(self.ctx, parts)
        return replace(self, always=always, known=Remembered(), _larger=None)

    def acting(self, hypothesis: Hypothesis, theta: Array) -> dict[Term, Array]:
        """All that acts in a run of a hypothesis, with its parameters."""
        known, fixed = self.always
        return known.split(self.ctx, fixed) | hypothesis.split(self.ctx, theta)

    def guiding(self, *dofs: int) -> Simulator:
        """The same machine where hinges and slides move as recorded."""
        return replace(self, guided=dofs, known=Remembered(), _larger=None)

    @property
    def fourfold(self) -> bool:
        """Whether a step evaluates the dynamics four times."""
        return bool(self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4)

    def costly(self, w: Windows) -> bool:
        """Whether there are so many steps that cheaper ones show what a change does nearly as well."""
        return (self.fourfold or self.stride > 1) and w.steps >= MANY_STEPS

    def cheaply(self, runs: list[Run], w: Windows, exactly: Array | None = None) -> Array:
        """As `residuals`, in larger steps, and semi-implicit ones for those that evaluate the dynamics four times:
        differences between runs are told far better than runs. Where parts strike each other each step decides, so
        that such runs are simulated in steps no larger than the model's; those [R] that are asked for `exactly` as by
        `residuals`."""
        own_steps = self.own_steps(runs, w)
        if exactly is not None:
            own_steps |= exactly
        if own_steps.any():
            out = np.empty((len(runs), w.count, w.times.shape[1], 2 * self.model.nv))
            for each, told in ((own_steps, self.residuals), (~own_steps, self.cheaply)):
                if each.any():
                    out[each] = told([runs[i] for i in np.flatnonzero(each)], w)
            return out
        own = self.model.opt.integrator
        if self._larger is None or self._larger[0] is not w or self._larger[1] != self.stride:
            self._larger = w, self.stride, w if self.stride == 1 else w.in_larger_steps(self.stride)
        with self.integrator(mujoco.mjtIntegrator.mjINT_EULER if self.fourfold else own):
            return self.residuals(runs, self._larger[2])

    def own_steps(self, runs: list[Run], w: Windows) -> Array:
        """Which runs [R] are simulated in the windows' own steps where cheaper ones are asked for."""
        other = self.fourfold or self.stride * w.dt > 1.001 * self.timestep
        return np.array([other and run.hypothesis.rugged for run in runs], dtype=bool)

    def rugged(self, hypothesis: Hypothesis) -> bool:
        """Whether things strike each other, inside the drives or out, which makes losses rugged."""
        return bool(self.ctx.contacts) or hypothesis.rugged

    @contextmanager
    def integrator(self, kind: mujoco.mjtIntegrator) -> Iterator[None]:
        """Simulate with another integrator inside a `with` block."""
        own, self.model.opt.integrator = self.model.opt.integrator, kind
        try:
            yield
        finally:
            self.model.opt.integrator = own

    @contextmanager
    def explicitly(self) -> Iterator[None]:
        """Simulate with steps that are explicit in the velocity inside a `with` block: Euler's, of which MuJoCo makes
        the damping of joints implicit unless it is told not to."""
        flags = self.model.opt.disableflags
        self.model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
        try:
            with self.integrator(mujoco.mjtIntegrator.mjINT_EULER):
                yield
        finally:
            self.model.opt.disableflags = flags

    def residuals(self, runs: list[Run], w: Windows) -> Array:
        """Measured minus predicted: [R, W, N, 2 nv], positions then velocities, in joint space; NaN unmeasured."""
        out = np.empty((len(runs), w.count, w.times.shape[1], 2 * self.model.nv))
        steps = int(self.model.opt.integrator), int(self.model.opt.disableflags)
        keys = [(w.digest, id(w.sources), steps, run.key) for run in runs]
        new = self.known.recall(keys, out)
        with quiet():
            for way, chunk in CHUNKS.items():
                some = [i for i in new if self._way(runs[i]) == way]
                per = max(1, chunk // max(w.count, 1))
                for a in range(0, len(some), per):
                    part = some[a : a + per]
                    out[part] = self._chunk([runs[i] for i in part], w, way)
        self.known.keep(keys, out, new, w.sources)
        # what is decided by the work does not hang on what is remembered
        self.work += len(runs) * w.count * w.steps * self.model.nv**1.5 * (4 if self.fourfold else 1)
        return out

    def _way(self, run: Run) -> str:
        """How a run is simulated, by what it costs."""
        if run.hypothesis.rugged:
            return WITH_RUN_UP
        stepped = self.guided or any(t.effect.runtime for t in (*self.always[0].terms, *run.hypothesis.terms))
        return STEP_BY_STEP if stepped else BY_THE_ENGINE

    def _chunk(self, runs: list[Run], w: Windows, way: str) -> Array:
        m, nwin = self.model, w.count
        n = len(runs) * nwin
        batch = Batch(self._timed(w.dt), n, self.threads)
        window = np.tile(np.arange(nwin), len(runs))
        rows_of = np.arange(n).reshape(len(runs), nwin)
        groups = self._groups(runs, rows_of)
        self._apply_models(batch, groups)
        encoders, shift = Encoders.under(groups, self.ctx, w, window), _shifts(runs, w)
        encoders.act_on(batch, self.on_readings)
        batch.bind("qpos")[:], batch.bind("qvel")[:] = encoders.starts(shift)
        commands = Commands(w, window, self._changed(groups, w, window))
        if m.na:
            batch.bind("act")[:] = w.act0[window]
            for a, (rows, u) in commands.changed.items():
                before = u[:, : w.history] - w.command[window[rows], : w.history, a]
                batch.bind("act")[rows] += shifted(m, a, before, w.dt)
        pushed = [(run.push, rows) for run, rows in zip(runs, rows_of, strict=True) if run.push is not None]
        pushes = by_step(pushed, n, m.nv, w.steps)
        if way == BY_THE_ENGINE:
            q, v = by_the_engine(batch, commands, pushes)
        else:
            guide = Guide(m, batch, w, window, self.guided) if self.guided else None
            runtime = [g for g in groups if g.term.effect.runtime]
            engine = Runtime(m, self.ctx, batch, runtime, pushes[0], w.dt)
            q, v = step_by_step(batch, engine, guide, commands, shift[:, m.nv :], pushes)
        return encoders.misses(q, v).reshape(len(runs), nwin, w.times.shape[1], -1)

    def _timed(self, dt: float) -> mujoco.MjModel:
        if abs(self.model.opt.timestep - dt) > 1e-12:
            self.model.opt.timestep = dt
        return self.model

    def _groups(self, runs: list[Run], rows_of: Array) -> list[Group]:
        table: dict[Term, tuple[list[Array], list[Array]]] = {}
        for run, rows in zip(runs, rows_of, strict=True):
            for term, theta in self.acting(run.hypothesis, run.theta).items():
                lists = table.setdefault(term, ([], []))
                lists[0].append(rows)
                lists[1].append(np.tile(theta, (rows.size, 1)))
        groups = [Group(t, np.concatenate(r), np.concatenate(p)) for t, (r, p) in table.items()]
        return sorted(groups, key=lambda g: g.term.turn)

    def _apply_models(self, batch: Batch, groups: list[Group]) -> None:
        derived = []
        for g in groups:
            g.term.effect.model(BatchFields(batch, g.rows), self.ctx, g.term.place, g.theta)
            if g.term.effect.set_const:
                derived.append(g.rows)
        if derived:
            rows = np.unique(np.concatenate(derived))
            batch.set_const(rows)
            weigh_anew(BatchFields(batch, rows), self.model)

    def _changed(self, groups: list[Group], w: Windows, window: Array) -> dict[int, tuple[Array, Array]]:
        """Command timelines that are not the windows': actuator -> (rows, [rows, H + K])."""
        out: dict[int, dict[int, Array]] = {}
        for g in groups:
            if not g.term.effect.commands:
                continue
            a = g.term.place.index
            done = out.setdefault(a, {})
            u = w.command[window[g.rows], :, a].copy()
            for i, row in enumerate(g.rows):
                if row in done:
                    u[i] = done[row]
            u = g.term.effect.timeline(self.ctx, g.term.place, g.theta, u, w.dt)
            done.update(zip(g.rows.tolist(), u, strict=True))
        return {a: (np.array(list(rows)), np.array(list(rows.values()))) for a, rows in out.items()}


def _shifts(runs: list[Run], w: Windows) -> Array:
    """By how much each simulation starts elsewhere than estimated, [R W, 2 nv]."""
    shift = w.shift
    return np.concatenate([shift if run.shift is None else shift + run.shift for run in runs])


def _bare(model: mujoco.MjModel) -> mujoco.MjModel:
    """Without what simulated windows do not need: resets, the search for contacts where there are none, and that for
    islands, which takes longer than it saves in a single machine."""
    model, off = copy.copy(model), mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_AUTORESET) | int(off.mjDSBL_ISLAND)
    if never_touches(model):
        model.opt.disableflags |= int(off.mjDSBL_CONTACT)
    return model

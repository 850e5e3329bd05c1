"""Command to measured force: what an actuator does with its command, without any simulation of motion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from mpge_jax.diagnosis.candidates import compatible
from mpge_jax.diagnosis.effects.base import REGISTRY, Context, Fields, Place, Step
from mpge_jax.diagnosis.evidence import rare
from mpge_jax.diagnosis.fit import NOTHING, Fitted, timing_error
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.model import is_joint_transmission
from mpge_jax.diagnosis.noise import column_noise
from mpge_jax.diagnosis.prepare import Prepared, has_plain_law
from mpge_jax.diagnosis.windows import Source

Array = np.ndarray
BLOCK_S = 0.25
MAX_EFFECTS = 3
DETAIL, FEW = 0.02, 5
"""Share of an actuator's largest forces by which an effect must change so many: less is a matter of when within a
timestep a force was measured."""


class _Table(Fields):
    """Actuator fields of a model as plain arrays [1, ...] that hooks may change."""

    xp = np

    def __init__(self, model: mujoco.MjModel) -> None:
        names = (
            "actuator_gainprm", "actuator_biasprm", "actuator_gaintype", "actuator_biastype",
            "actuator_forcerange", "actuator_forcelimited",
        )  # fmt: skip
        self.values = {n: np.array(getattr(model, n), dtype=float)[None] for n in names}

    def get(self, name: str, index: Any) -> Array:
        return self.values[name][(slice(None), *index)]

    def set(self, name: str, index: Any, value: Any) -> None:
        self.values[name][(slice(None), *index)] = value


@dataclass(frozen=True)
class _Log:
    """One recording of one actuator on a uniform grid.

    Attributes:
        u: [1, L] command on the grid. at: [T] grid index of each sample. force, length, speed: [T]. block: [T].
    """

    u: Array
    at: Array
    force: Array
    length: Array
    speed: Array
    block: Array


def _log(source: Source, ctx: Context, actuator: int, dt: float, first_block: int) -> _Log | None:
    r, m = source.recording, ctx.model
    good = np.isfinite(r.known("force")[:, actuator])
    if good.sum() < 20:
        return None
    t = r.time
    grid = np.arange(t[0], t[-1] + 2 * dt, dt)
    u = r.known("ctrl")[np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, t.size - 1), actuator]
    length = speed = np.zeros(t.size)
    if is_joint_transmission(m, actuator):
        joint, gear = int(m.actuator_trnid[actuator, 0]), float(m.actuator_gear[actuator, 0])
        length = gear * source.states.qpos[:, m.jnt_qposadr[joint]]
        speed = gear * source.states.qvel[:, m.jnt_dofadr[joint]]
    # the first point of the grid that sees the row's own command
    at = np.clip(np.ceil((t - t[0]) / dt - 1e-6).astype(int), 0, grid.size - 1)
    block = first_block + ((t - t[0]) / BLOCK_S).astype(int)
    return _Log(u[None], at[good], r.known("force")[good, actuator], length[good], speed[good], block[good])


def predict(model: mujoco.MjModel, ctx: Context, f: Fitted, actuator: int, log: _Log, dt: float) -> Array:
    """Force [T] of an actuator under its command and motion; `model` is the nominal one."""
    ctx = replace(ctx, model=model)
    table = _Table(model)
    parts = [(t, th[None]) for t, th in f.hypothesis.split(ctx, f.theta).items()]
    u = log.u
    for term, theta in parts:
        if term.effect.commands:
            u = term.effect.timeline(ctx, term.place, theta, u, dt)
        term.effect.model(table, ctx, term.place, theta)
    command = u[0][log.at]
    if model.actuator_ctrllimited[actuator]:
        command = np.clip(command, *model.actuator_ctrlrange[actuator])
    gain = table.values["actuator_gainprm"][0, actuator]
    affine = table.values["actuator_biastype"][0, actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias = table.values["actuator_biasprm"][0, actuator] * affine
    free = gain[0] * command + bias[0] + bias[1] * log.length + bias[2] * log.speed
    low, high = table.values["actuator_forcerange"][0, actuator]
    if not table.values["actuator_forcelimited"][0, actuator]:
        low, high = -1e12, 1e12
    out = np.clip(free, low, high)

    def wide(value: Any) -> Array:
        column = np.zeros((out.size, model.nu))
        column[:, actuator] = value
        return column

    for term, theta in parts:
        if term.effect.runtime:
            s = Step(
                np.zeros((out.size, model.nq)), np.zeros((out.size, model.nv)), wide(command), wide(out),
                wide(free), wide(low), wide(high), wide(bias[1]), wide(bias[2]), lambda _b: np.zeros(3), dt,
            )  # fmt: skip
            forces, _ = term.effect.force(np, ctx, term.place, theta, s, ())
            if forces.actuator is not None:
                out = out + forces.actuator
    return out


@dataclass
class ActuatorSide:
    """What was found between commands and measured forces.

    Attributes:
        effects: entries of `diagnosis.json`. table: entries of `effects.json`. errors: actuator -> held-out rms
        force error (before, after).
    """

    ctx: Context
    fits: list[Fitted] = field(default_factory=list)
    effects: list[dict[str, Any]] = field(default_factory=list)
    table: list[dict[str, Any]] = field(default_factory=list)
    sentences: list[str] = field(default_factory=list)
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)

    def between_rows(self) -> tuple[set[int], dict[int, float], dict[int, float]]:
        """Actuators whose force lags behind the command; those with back-EMF, with their force per command; and those
        whose force does not jump with the command as the model expects, with the share of its jumps."""
        lag: set[int] = set()
        back_emf: dict[int, float] = {}
        jumps: dict[int, float] = {}
        for f in self.fits:
            parts = {t.id: (t.place.index, x) for t, x in f.hypothesis.split(self.ctx, f.theta).items()}
            a = next(iter(parts.values()))[0]
            gain = float(parts["actuator_gain"][1][0]) if "actuator_gain" in parts else 1.0
            jumps[a] = gain if set(parts) <= {"actuator_gain", "actuator_bias"} else 0.0
            if "actuator_lag" in parts:
                lag.add(a)
            if "back_emf" in parts:
                back_emf[a] = gain * float(self.ctx.model.actuator_gainprm[a, 0])
        return lag, back_emf, jumps

    def export(self, spec: mujoco.MjSpec) -> dict[Term, bool]:
        """Add native forms to a compiled spec; returns which effects have one."""
        return {
            term: term.effect.export(spec, self.ctx, term.place, theta)
            for f in self.fits
            for term, theta in f.hypothesis.split(self.ctx, f.theta).items()
        }


@dataclass
class _Data:
    train: list[_Log]
    held: list[_Log]
    sigma: float
    dt: float


def _residual(model: mujoco.MjModel, ctx: Context, f: Fitted, a: int, logs: list[_Log], d: _Data) -> Array:
    return np.concatenate([log.force - predict(model, ctx, f, a, log, d.dt) for log in logs]) / d.sigma


def _blocks(r: Array, logs: list[_Log]) -> Array:
    """Mean squared residual of each block [B]."""
    block = np.concatenate([log.block for log in logs])
    _, index = np.unique(block, return_inverse=True)
    return np.bincount(index, r**2) / np.bincount(index)


def _robust(blocks: Array, reference: Array) -> Array:
    """Loss of blocks in units of the reference's median block; wild blocks count little."""
    return 5.0 * np.log1p(blocks / max(float(np.median(reference)), 1e-12) / 5.0)


def _fit(model: mujoco.MjModel, ctx: Context, start: Fitted, a: int, d: _Data) -> Fitted:
    params = start.hypothesis.params(ctx)
    if not params:
        return start
    low = np.array([p.low for p in params])
    high = np.array([p.high for p in params])
    scale = np.array([p.scale for p in params])

    def residual(x: Array) -> Array:
        return _residual(model, ctx, replace(start, theta=x * scale), a, d.train, d)

    x0 = np.clip(start.theta, low + 1e-6 * (high - low), high - 1e-6 * (high - low)) / scale
    spread = max(float(np.median(np.abs(residual(x0)))), 1.0)
    out = least_squares(
        residual, x0, bounds=(low / scale, high / scale), loss="soft_l1", f_scale=3 * spread, max_nfev=30,
        diff_step=1e-3,
    )  # fmt: skip
    theta = out.x * scale
    # covariance clustered by block: the residual of a drive is not white
    j, r = out.jac / scale, residual(out.x)
    _, index = np.unique(np.concatenate([log.block for log in d.train]), return_inverse=True)
    scores = np.stack([np.bincount(index, j[:, i] * r) for i in range(len(params))], 1)
    bread = np.linalg.pinv(j.T @ j)
    return replace(start, theta=theta, cov=bread @ (scores.T @ scores) @ bread, loss=float(out.cost))


def _search(model: mujoco.MjModel, ctx: Context, place: Place, d: _Data, ids: list[str]) -> Fitted:
    a = place.index
    current = NOTHING
    while len(current.hypothesis.terms) < MAX_EFFECTS:
        field_ = []
        for i in ids:
            term = Term(i, place)
            if place not in REGISTRY[i].places(ctx) or not compatible(current.hypothesis, term):
                continue
            best = None
            for start in REGISTRY[i].starts(ctx, place):
                h = current.hypothesis.with_term(term)
                parts = current.hypothesis.split(ctx, current.theta)
                f = _fit(model, ctx, Fitted(h, h.gather(ctx, {**parts, term: start}), np.zeros(0)), a, d)
                if best is None or f.loss < best.loss:
                    best = f
            if best is not None:
                blocks = _blocks(_residual(model, ctx, best, a, d.held, d), d.held)
                field_.append((best, blocks))
        if not field_:
            return current
        before = _blocks(_residual(model, ctx, current, a, d.held, d), d.held)
        reference = min((x[1] for x in field_), key=np.median)
        before = _robust(before, reference)
        field_ = sorted(((f, _robust(b, reference)) for f, b in field_), key=lambda x: x[1].mean())
        top = field_[0]
        tied = [
            x for x in field_
            if (x[1] - top[1]).mean() <= max(2 * (x[1] - top[1]).std() / np.sqrt(x[1].size), 0.01 * top[1].mean())
        ]  # fmt: skip
        chosen, after = min(tied, key=lambda x: (x[0].theta.size, x[1].mean()))
        gain = before - after
        error = gain.std() / np.sqrt(max(gain.size - 1, 1))
        if gain.mean() < 3 * error or gain.mean() < 0.05 * before.mean():
            first, second = (
                _robust(_blocks(_residual(model, ctx, f, a, d.train, d), d.train), reference)
                for f in (current, chosen)
            )
            worse, better = np.concatenate([first, before]), np.concatenate([second, after])
            if not rare(worse, better, fitted=first.size):
                return current
        old, new = (_residual(model, ctx, f, a, d.held, d) for f in (current, chosen))
        if float(np.sort(np.abs(new - old))[-FEW:][0]) * d.sigma < DETAIL * ctx.drive[a]:
            return current
        current = chosen
    return current


def diagnose_actuators(p: Prepared, nominal: mujoco.MjModel, ids: list[str]) -> ActuatorSide | None:
    """Effects between `ctrl` and `actuator_force`, actuator by actuator; None where forces were not measured.

    Args:
        nominal: the model as given (commands in). ids: effects to try.
    """
    from mpge_jax.diagnosis.parameters import number, parameters

    together = p.train_sources + p.held_sources
    if not p.measured.any() or any(s.recording.ctrl is None for s in together):
        return None
    drive = np.array(
        [
            np.nanquantile(np.abs(np.concatenate([s.recording.known("force")[:, a] for s in together])), 0.98)
            for a in range(nominal.nu)
        ]
    )
    ctx = replace(p.ctx, model=nominal, drive=np.maximum(np.nan_to_num(drive), 1e-6))
    out = ActuatorSide(ctx=ctx)
    steps = np.concatenate([np.diff(s.recording.time) for s in together])
    jittered = float(np.quantile(np.abs(steps - ctx.period), 0.9)) > 0.01 * ctx.period
    dt = (0.25 if jittered else 0.5) * ctx.period
    for a in np.flatnonzero(p.measured):
        place = Place("actuator", p.names.actuators[a], int(a))
        if not has_plain_law(nominal, int(a)):
            p.warnings.append(
                f"how {place.name} turns commands into force is not checked: in the model it has a state, a delay, or "
                "acts on more than one joint."
            )
            continue
        logs: dict[bool, list[_Log]] = {False: [], True: []}
        count = 0
        for held, sources in ((False, p.train_sources), (True, p.held_sources)):
            for s in sources:
                log = _log(s, ctx, int(a), dt, count)
                if log is not None:
                    logs[held].append(log)
                    count = int(log.block.max()) + 1
        if not logs[False] or not logs[True]:
            continue
        sigma, _ = column_noise(
            [s.recording.time for s in together], [s.recording.known("force")[:, a] for s in together]
        )
        sigma = max(sigma if np.isfinite(sigma) else 0.0, 1e-5 * float(ctx.drive[a]), 1e-9)
        data = _Data(logs[False], logs[True], sigma, dt)
        f = _search(nominal, ctx, place, data, ids)
        if f.cov.size:
            late = timing_error(f.hypothesis.params(ctx), f.theta, float(nominal.opt.timestep))
            f = replace(f, cov=f.cov + np.diag(late**2))
        before = _residual(nominal, ctx, NOTHING, int(a), data.held, data) * sigma
        after = _residual(nominal, ctx, f, int(a), data.held, data) * sigma
        rms = (float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))))
        out.errors[place.name] = rms
        if not f.hypothesis.terms:
            continue
        out.fits.append(f)
        parts = f.hypothesis.split(ctx, f.theta)
        for term, theta in parts.items():
            h = f.hypothesis.without(term)
            less = Fitted(h, h.gather(ctx, parts), np.zeros(0))
            without = _residual(nominal, ctx, less, int(a), data.held, data) * sigma
            drop = 1.0 - rms[1] ** 2 / max(float(np.mean(without**2)), 1e-30)
            reported = parameters(ctx, f, term)
            entry = {"id": term.name, "at": place.name, "parameters": reported}
            out.effects.append({**entry, "error_drop": number(drop), "rivals": []})
            values = {k: _value(v) for k, v in term.effect.report(ctx, place, theta).items()}
            out.table.append(
                {
                    "id": term.name,
                    "form": term.id,
                    "at": place.name,
                    "kind": "actuator",
                    "parameters": values,
                }
            )
            from mpge_jax.diagnosis.words import quantity

            shown = {k: quantity(v) for k, v in reported.items()}
            out.sentences.append("Between command and measured force: " + term.effect.sentence(place, shown))
    return out


def _value(value: Any) -> Any:
    value = np.asarray(value, dtype=float)
    return float(value) if value.ndim == 0 else value.tolist()

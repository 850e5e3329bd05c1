"""What an actuator does with its command: laws fitted to measured forces, without any simulation of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.step import Fields, Step
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio
from mpge_jax.diagnosis.machine.model import clipped, is_joint_transmission
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.measured_drives import stroke

Array = np.ndarray
DELAY = "actuator_delay"
BLOCK_S = 0.25
MAX_EFFECTS = 3
DETAIL, FEW = 0.02, 5
"""Share of an actuator's largest forces by which an effect changes so many: less may be a matter of when within a
timestep a force was measured."""
SLIGHT = 0.005
"""Share of them below which the median change is a detail, however slowly the forces change."""
BETTER = 0.25
"""Share of the loss that an effect may leave, of what forces from another moment within two timesteps would, to be more
than a matter of that moment."""
FAST = 0.3
"""Time constant, in steps of the grid, below which a lag cannot be told from a delay."""
NEAR = 1e-6
"""Length and speed by which a law is probed for its slopes."""
STEPS, GAIN, MOVES = (-4, -2, -1, 1, 2, 4), 1e-2, 60
"""Points of the grid by which a time is moved (a row has at most four) while that lowers the cost by this share, and
how often at most."""
ALIKE = 65
"""Times near a fitted one that are asked whether they change anything."""
PAUSE = 2.0
"""Seconds that a gap in a log counts for at most."""


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
class Log:
    """One recording of one actuator on a uniform grid.

    Attributes:
        name: of the recording. time: [T] s. u: [1, L] command on the grid. at: [T] grid index of each sample. force,
        length, speed: [T]. block: [T].
    """

    name: str
    time: Array
    u: Array
    at: Array
    force: Array
    length: Array
    speed: Array
    block: Array


def log_of(
    source: Source, ctx: Context, actuator: int, dt: float, first_block: int, first_row: int = 0
) -> Log | None:
    """One actuator's log, from a row on; those before only say how what follows began."""
    r, m = source.recording, ctx.model
    good = np.isfinite(r.known("force")[:, actuator])
    good[:first_row] = False
    if good.sum() < 20:
        return None
    # a pause in the log, over which the command stays, need not last longer than anything in a drive does
    t = np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(r.time), PAUSE))])
    grid = dt * np.arange(int(np.ceil(t[-1] / dt)) + 2)
    u = clipped(m, r.known("ctrl"))[
        np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, t.size - 1), actuator
    ]
    length, speed = stroke(m, actuator, source.states)
    # the first point of the grid that sees the row's own command
    at = np.clip(np.ceil(t / dt - 1e-6).astype(int), 0, grid.size - 1)
    block = first_block + (t / BLOCK_S).astype(int)
    force = r.known("force")[good, actuator]
    return Log(
        r.name, (r.origin + r.time)[good], u[None], at[good], force, length[good], speed[good], block[good]
    )


def between(
    model: mujoco.MjModel, ctx: Context, f: Fitted, actuator: int, source: Source
) -> tuple[Array, Array]:
    """`between_rows.Law` of one actuator under the law `f`: by how much its force jumps at each row as its command
    does [T] (without delays), and its slopes [T, 2]."""
    r = source.recording
    sent = clipped(model, r.known("ctrl"))[:, actuator]
    length, speed = stroke(model, actuator, source.states)
    rows = np.arange(r.time.size)

    def force(u: Array, further: float = 0.0, faster: float = 0.0) -> Array:
        log = Log(r.name, r.time, u[None], rows, np.zeros(rows.size), length + further, speed + faster, rows)
        return predict(model, ctx, f, actuator, log, ctx.period)

    now = force(sent)
    jump = now - force(np.concatenate([sent[:1], sent[:-1]]))
    slopes = np.stack([force(sent, further=NEAR) - now, force(sent, faster=NEAR) - now], 1) / NEAR
    known = np.isfinite(r.known("force")[:, actuator])
    return np.where(known, jump, 0.0), np.where(known[:, None], slopes, 0.0)


def predict(model: mujoco.MjModel, ctx: Context, f: Fitted, actuator: int, log: Log, dt: float) -> Array:
    """Force [T] of an actuator under its command and motion; `model` is the nominal one."""
    ctx = replace(ctx, model=model)
    table = _Table(model)
    parts = [(t, th[None]) for t, th in f.hypothesis.split(ctx, f.theta).items()]
    u = log.u
    for term, theta in parts:
        if term.effect.commands:
            u = term.effect.sampled(ctx, term.place, theta, u, dt)
        term.effect.model(table, ctx, term.place, theta)
    command = u[0][log.at]
    # an effect may add to what was clipped already
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
                # as in simulation, what drives of no joint lose is taken from their command
                out = out if is_joint_transmission(model, actuator) else free
                out = out + forces.actuator
    return out


@dataclass
class Data:
    train: list[Log]
    held: list[Log]
    sigma: float
    dt: float


def residual(model: mujoco.MjModel, ctx: Context, f: Fitted, a: int, logs: list[Log], d: Data) -> Array:
    return np.concatenate([log.force - predict(model, ctx, f, a, log, d.dt) for log in logs]) / d.sigma


def blocks_of(r: Array, logs: list[Log]) -> Array:
    """Mean squared residual of each block [B]."""
    block = np.concatenate([log.block for log in logs])
    _, index = np.unique(block, return_inverse=True)
    return np.bincount(index, r**2) / np.bincount(index)


def _robust(blocks: Array, reference: Array) -> Array:
    """Loss of blocks in units of the reference's median block; wild blocks count little."""
    return 5.0 * np.log1p(blocks / max(float(np.median(reference)), 1e-12) / 5.0)


def _fit(model: mujoco.MjModel, ctx: Context, start: Fitted, a: int, d: Data) -> Fitted:
    params = start.hypothesis.params(ctx)
    if not params:
        return start
    low = np.array([p.low for p in params])
    high = np.array([p.high for p in params])
    scale = np.array([p.scale for p in params])

    def scaled(x: Array) -> Array:
        return residual(model, ctx, replace(start, theta=x * scale), a, d.train, d)

    def within(theta: Array) -> Array:
        return np.clip(theta, low + 1e-6 * (high - low), high - 1e-6 * (high - low)) / scale

    x0 = within(start.theta)
    spread = 3.0 * max(float(np.median(np.abs(scaled(x0)))), 1.0)

    def solved(x: Array) -> OptimizeResult:
        bounds = (low / scale, high / scale)
        return least_squares(
            scaled, x, bounds=bounds, loss="soft_l1", f_scale=spread, max_nfev=30, diff_step=1e-3
        )

    def cost(x: Array) -> float:
        return float(spread**2 * (np.sqrt(1.0 + (scaled(x) / spread) ** 2) - 1.0).sum())

    out = solved(x0)
    # as long as no command of another row arrives a delay changes nothing, so that no slope leads on from there
    times = np.flatnonzero([p.unit == "s" for p in params])
    steps = [k * d.dt * np.eye(len(params))[i] for i in times for k in STEPS]
    for _ in range(MOVES if steps else 0):
        least, x = min((cost(x), tuple(x)) for x in (within(out.x * scale + step) for step in steps))
        if not least < (1.0 - GAIN) * out.cost:
            break
        out = solved(np.array(x))
    # a command arrives or does not: what lies between two points of the grid would be a mean of two
    delays = _delays(ctx, start)
    for i in delays:
        points = d.dt * np.array([np.floor(out.x[i] * scale[i] / d.dt), np.ceil(out.x[i] * scale[i] / d.dt)])
        each = np.tile(out.x * scale, (2, 1))
        each[:, i] = points
        out.cost, x = min((cost(x), tuple(x)) for x in map(within, each))
        out.x = np.array(x)
    theta, far = out.x * scale, 4.0 * d.dt
    # covariance clustered by block: the residual of a drive is not white
    j, r = out.jac / scale, scaled(out.x)
    j[:, delays] = 0.0
    _, index = np.unique(np.concatenate([log.block for log in d.train]), return_inverse=True)
    scores = np.stack([np.bincount(index, j[:, i] * r) for i in range(len(params))], 1)
    bread = np.linalg.pinv(j.T @ j)
    cov = bread @ (scores.T @ scores) @ bread
    for i in delays:
        # it is one of those that change nothing, each as likely as another
        others = theta + np.linspace(-far, far, ALIKE)[:, None] * np.eye(len(params))[i]
        others = others[(others[:, i] >= low[i]) & (others[:, i] <= high[i])]
        alike = [x[i] for x in others if cost(within(x)) < (1.0 + 1e-4) * out.cost]
        first, last = min([theta[i], *alike]), max([theta[i], *alike])
        theta[i], cov[i, i] = (first + last) / 2, (last - first) ** 2 / 12
    return replace(start, theta=theta, cov=cov, loss=float(out.cost))


def _delays(ctx: Context, f: Fitted) -> list[int]:
    """Indices of the parameters that are delays."""
    parts = zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True)
    return [part.start for t, part in parts if t.name == DELAY]


def _too_fast(ctx: Context, f: Fitted, dt: float) -> Term | None:
    """A lag that passes before its first sample after a step of the command: there it is a delay."""
    parts = f.hypothesis.split(ctx, f.theta).items()
    return next((t for t, x in parts if t.id == "actuator_lag" and float(x[0]) < FAST * dt), None)


def _tier(f: Fitted) -> int:
    return sum(t.effect.tier for t in f.hypothesis.terms)


def _is_detail(old: Array, new: Array, logs: list[Log], largest: float, timestep: float) -> bool:
    """Whether what changes residuals from `old` [T] to `new` is slight, or may be a matter of when within a timestep
    the forces were measured: nowhere large, mostly no more than the forces themselves change in two timesteps, and not
    much better an account of `old` than that the forces are from another moment."""
    change = np.abs(new - old)
    if np.sort(change)[-FEW:][0] >= DETAIL * largest:
        return False
    if np.median(change) <= SLIGHT * largest:
        return True
    steps = np.concatenate([np.abs(np.diff(log.force) / np.diff(log.time)) for log in logs])
    if np.median(change) > 2.0 * timestep * float(np.median(steps)):
        return False
    rates = np.concatenate([np.gradient(log.force, log.time) for log in logs])
    late = float(rates @ old) / max(float(rates @ rates), 1e-300)
    timing = old - np.clip(late, -2.0 * timestep, 2.0 * timestep) * rates
    left, otherwise = (blocks_of(r, logs) for r in (new, timing))
    return bool(_robust(left, left).mean() > BETTER * _robust(otherwise, left).mean())


def search_law(model: mujoco.MjModel, ctx: Context, place: Place, d: Data, ids: list[str]) -> Fitted:
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
            if best is not None and (fast := _too_fast(ctx, best, d.dt)) is not None:
                # found before the delay for which it stood
                h = best.hypothesis.without(fast)
                parts = best.hypothesis.split(ctx, best.theta)
                best = (
                    _fit(model, ctx, Fitted(h, h.gather(ctx, parts), np.zeros(0)), a, d)
                    if fast != term
                    else None
                )
            if best is not None:
                blocks = blocks_of(residual(model, ctx, best, a, d.held, d), d.held)
                field_.append((best, blocks))
        if not field_:
            return current
        before = blocks_of(residual(model, ctx, current, a, d.held, d), d.held)
        reference = min((x[1] for x in field_), key=np.median)
        before = _robust(before, reference)
        field_ = sorted(((f, _robust(b, reference)) for f, b in field_), key=lambda x: x[1].mean())
        top = field_[0]
        tied = [x for x in field_ if not beyond_doubt(log_ratio(x[1] - top[1]))]
        chosen, after = min(tied, key=lambda x: (x[0].theta.size, _tier(x[0]), x[1].mean()))
        if not beyond_doubt(log_ratio(before - after), len(field_)):
            return current
        old, new = (residual(model, ctx, f, a, d.held, d) for f in (current, chosen))
        if _is_detail(old * d.sigma, new * d.sigma, d.held, float(ctx.drive[a]), float(model.opt.timestep)):
            return current
        current = chosen
    return current

"""Design the commands that would tell ambiguous explanations apart, and show in simulation that they do."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations
from pathlib import Path

import numpy as np

from mpge_jax import files
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_widths
from mpge_jax.diagnosis.estimation.whitening import column_scale
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import changes
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import HISTORY, Windows
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray
DURATION = 3.0
SIZES = (1.0, 0.3, 0.1, 0.03)
"""Shares of the command range; the smaller ones are for joints with limits."""
SEPARATED = 3.0
"""Root-mean-square distance of the predictions after a refit, in units of noise, that counts as told apart."""
MARGIN = 0.1
"""Share of a joint's range that stays free at either end."""
FARTHER, FASTER = 0.5, 2.0
"""How far a joint may leave the recorded range, as a share of it, and how fast it may be, over the fastest recorded."""
SHORTEST = 0.3
"""Seconds that a sequence lasts at least."""
_EVERY = 5
_VERIFIED = 4


def command_range(d: Result) -> tuple[Array, Array]:
    """Limits [nu] of the commands: the model's where it has any, else as large as recorded, in both directions.

    A recording that went one way only must not keep the proposal from turning back.
    """
    m = d.prepared.model
    recorded = np.concatenate([s.command for s in d.prepared.train])
    largest = np.abs(recorded).max(0) + 1e-6
    # the command of a position servo is a position: half as far again as recorded
    middle, half = recorded.mean(0), 0.75 * np.ptp(recorded, axis=0) + 1e-6
    servo = m.actuator_biasprm[:, 1] != 0
    low, high = np.where(servo, middle - half, -largest), np.where(servo, middle + half, largest)
    limited = m.actuator_ctrllimited.astype(bool)
    return (
        np.where(limited, m.actuator_ctrlrange[:, 0], low),
        np.where(limited, m.actuator_ctrlrange[:, 1], high),
    )


def proposals(low: Array, high: Array, time: Array, rng: np.random.Generator) -> list[tuple[str, Array]]:
    """Command sequences [T, nu] of different kinds inside the limits."""
    nu, t = low.size, time[:, None]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    phase = rng.uniform(0, 2 * np.pi, nu)
    side = np.where(np.arange(nu) % 2, -1.0, 1.0)
    sweep = np.cumsum(0.2 + 4.0 * time / time[-1])[:, None] * (time[1] - time[0])
    levels = rng.uniform(-1, 1, (64, nu))
    # reversals start at a quarter of their period, so that the speed changes its sign, not only the force
    shapes = {
        "reversals every 0.5 s": side * np.sign(np.cos(2 * np.pi * t)),
        "reversals every 1.5 s": side * np.sign(np.cos(2 * np.pi * t / 3.0)),
        "slow sines": side * np.cos(2 * np.pi * 0.33 * t),
        "a chirp from 0.2 to 4 Hz": np.sin(2 * np.pi * sweep + phase),
        "random steps of 0.3 s": levels[np.minimum((time / 0.3).astype(int), 63)],
        "short pushes followed by coasting": np.where(t % 1.5 < 0.4, 1.0, 0.0) * side * (-1.0) ** (t // 1.5),
    }
    return [
        (f"{name} at {100 * size:.0f} % of the command range", np.clip(middle + size * half * x, low, high))
        for name, x in shapes.items()
        for size in SIZES
    ]


def design(d: Result, groups: Mapping[Term, list[Fitted]], path: Path) -> dict[str, object] | None:
    """Write the command sequence that best separates the candidates of every ambiguous effect, `groups`.

    The file holds `time` [T] s, `ctrl` [T, nu] and the pose `qpos0` [nq] in which the machine starts at rest.
    A sequence ends before it brings a joint near its limit under any candidate. Two candidates count as separated
    by what is left when each is refitted to the other's prediction, as far as the old recordings let it move.

    Returns what was found, or None when there is nothing to separate or no command inside the limits does.
    """
    m = d.prepared.model
    path.unlink(missing_ok=True)
    if not groups or m.nu == 0 or d.prepared.measured.any():
        return None
    fits = list({f.hypothesis: f for fs in groups.values() for f in fs}.values())
    if len(fits) < 2:
        return None
    dt, rng = d.prepared.dt, np.random.default_rng([d.config.seed, 9])
    time = dt * np.arange(round(DURATION / dt))
    q0 = d.prepared.train[0].states.qpos[0]
    tried = proposals(*command_range(d), time, rng)
    w = _windows(d, q0, np.array([command for _, command in tried]), dt)
    models = {f.hypothesis: _Linear(d, f, w) for f in fits}
    seen = np.logical_and.reduce(
        [_inside_limits(d, q0, x.base) & _as_recorded(d, q0, x.base) for x in models.values()]
    )
    lasting = np.flatnonzero(seen.sum(1) * _EVERY * dt >= SHORTEST)
    tied = dict.fromkeys(
        pair for fs in groups.values() for pair in permutations(dict.fromkeys(f.hypothesis for f in fs), 2)
    )
    pairs = [(models[one], models[other]) for one, other in tied]
    apart = np.array([_refitted(a, b, seen)[0] for a, b in pairs])
    best, most = SEPARATED, None
    for k in sorted(lasting.tolist(), key=lambda i: -apart[:, i].min())[:_VERIFIED]:
        least = np.inf
        # those that are nearest first: one pair that is too near decides
        for i in np.argsort(apart[:, k], kind="stable"):
            truth, other = pairs[i]
            least = min(least, _verified(d, truth, other, w, seen, k))
            if least <= best:
                break
        else:
            best, most = least, k
    if most is None:
        return None
    name, command = tried[most]
    rows = slice(_EVERY * int(seen[most].sum()))
    files.write_npz(path, {"time": time[rows], "ctrl": command[rows], "qpos0": q0})
    return {"separation": best, "kind": name, "path": path.name, "seconds": float(time[rows].size * dt)}


class _Linear:
    """Predicted motion of one candidate under every proposal, to first order in its parameters and start state.

    Attributes:
        base: [W, N, nv] residual against the start pose. columns: [p + nv, W, N, nv] by parameters and by start
        positions. precision: [p + nv, p + nv] of what the old recordings and a reading at rest say about these.
    """

    def __init__(self, d: Result, f: Fitted, w: Windows) -> None:
        nv = d.prepared.model.nv
        self.fit, self.scale = f, column_scale(d.prepared.noise, d.prepared.model)[:nv]
        widths = prior_widths(f.hypothesis.params(d.prepared.ctx))
        cov = f.cov if f.cov.size else np.diag(widths**2)
        start = np.where(np.isfinite(self.scale), self.scale, 1e-3)
        deviation = np.concatenate([np.sqrt(np.maximum(np.diag(cov), 1e-24)), start])
        steps = 0.1 * deviation
        runs = [Run(f.hypothesis, f.theta)]
        for i, h in enumerate(steps):
            theta, shift = f.theta.copy(), np.zeros((w.count, 2 * nv))
            if i < theta.size:
                theta[i] += h
            else:
                shift[:, i - theta.size] = h
            runs.append(Run(f.hypothesis, theta, shift))
        sim = d.prepared.sim
        self.base = sim.residuals(runs[:1], w)[0, ..., :nv]
        self.columns = changes(sim, runs, w)[..., :nv] / steps[:, None, None, None]
        self.precision = np.zeros((steps.size, steps.size))
        p = f.theta.size
        self.precision[:p, :p] = np.linalg.pinv(cov, hermitian=True)
        self.precision[p:, p:] = np.diag(start**-2.0)

    def noise_units(self, residual: Array) -> Array:
        """Residuals in units of noise, columns that are not measured left out."""
        return np.where(np.isfinite(self.scale), np.nan_to_num(residual) / self.scale, 0.0)


def _rms(x: Array, seen: Array) -> Array:
    """Root mean square of [..., N, nv] over the samples `seen` [..., N], of the joint where it is largest."""
    total = ((x * seen[..., None]) ** 2).sum(-2)
    return np.sqrt(total / np.maximum(seen.sum(-1), 1)[..., None]).max(-1)


def _refitted(truth: _Linear, other: _Linear, seen: Array) -> tuple[Array, Array]:
    """(distance [W] that is left when `other` is refitted to what `truth` predicts, change [W, p + nv])."""
    left = other.noise_units(other.base - truth.base) * seen[..., None]
    columns = other.noise_units(other.columns) * seen[..., None]
    gram = np.einsum("iwnv,jwnv->wij", columns, columns, optimize=True) + other.precision
    change = -np.linalg.solve(gram, np.einsum("iwnv,wnv->wi", columns, left)[..., None])[..., 0]
    return _rms(left + np.einsum("iwnv,wi->wnv", columns, change), seen), change


def _verified(d: Result, truth: _Linear, other: _Linear, w: Windows, seen: Array, k: int) -> float:
    """The same distance for one proposal, simulated with the refitted parameters: the least of several steps."""
    one, nv, p = w.take(np.array([k])), d.prepared.model.nv, other.fit.theta.size
    change = _refitted(truth, other, seen)[1][k]
    params = other.fit.hypothesis.params(d.prepared.ctx)
    low, high = np.array([x.low for x in params]), np.array([x.high for x in params])
    runs = []
    for step in (0.0, 0.25, 0.5, 1.0):
        shift = np.zeros((1, 2 * nv))
        shift[0, :nv] = step * change[p:]
        theta = np.clip(other.fit.theta + step * change[:p], low, high)
        runs.append(Run(other.fit.hypothesis, theta, shift))
    res = d.prepared.sim.residuals(runs, one)[:, 0, :, :nv]
    return float(_rms(other.noise_units(res - truth.base[k]), seen[k]).min())


def _inside_limits(d: Result, q0: Array, base: Array) -> Array:
    """Samples [W, N] up to which every limited joint has kept away from its ends; the start pose is allowed."""
    m, out = d.prepared.model, np.isfinite(base).all(-1)
    for j in range(m.njnt):
        if not (is_scalar(m, j) and m.jnt_limited[j]):
            continue
        start = q0[m.jnt_qposadr[j]]
        low, high = m.jnt_range[j] + MARGIN * np.ptp(m.jnt_range[j]) * np.array([1.0, -1.0])
        q = start - base[..., m.jnt_dofadr[j]]
        out &= (q >= min(low, start - 1e-3)) & (q <= max(high, start + 1e-3))
    return np.logical_and.accumulate(out, axis=1)


def _as_recorded(d: Result, q0: Array, base: Array) -> Array:
    """Samples [W, N] up to which every joint moved about as far and as fast as in the recordings."""
    m, out = d.prepared.model, np.isfinite(base).all(-1)
    states = [s.states for s in d.prepared.train]
    for j in range(m.njnt):
        if not is_scalar(m, j):
            continue
        column, dof = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
        recorded = np.concatenate([s.qpos[:, column] for s in states])
        fastest = max(float(np.abs(s.qvel[:, dof]).max()) for s in states)
        q = q0[column] - base[..., dof]
        speed = np.abs(np.diff(q, axis=1, prepend=q0[column])) / (_EVERY * d.prepared.dt)
        spare = FARTHER * np.ptp(recorded) + 1e-3
        out &= (q >= recorded.min() - spare) & (q <= recorded.max() + spare)
        out &= speed <= FASTER * fastest + 1e-2
    return np.logical_and.accumulate(out, axis=1)


def _windows(d: Result, q0: Array, commands: Array, dt: float) -> Windows:
    """A window for each command sequence [W, T, nu], from rest, sampled every `_EVERY` steps."""
    m, (count, steps, _) = d.prepared.model, commands.shape
    before = int(np.ceil(HISTORY / dt))
    # at rest for long: late sensors look back
    rest, still = np.array([0.0, HISTORY]), np.zeros((2, m.nv))
    states = States(np.tile(q0, (2, 1)), still, still, np.zeros((2, m.nv, 2, 2)))
    source = Source.build(Recording("at rest", rest, states.qpos), states, np.zeros((2, m.nu)))
    grid = np.arange(_EVERY, steps + 1, _EVERY) * dt
    n = grid.size
    return Windows(
        (source,), np.zeros(count, int), np.zeros(count), dt, steps,
        np.tile(q0, (count, 1)), np.zeros((count, m.nv)), np.zeros((count, m.nv, 2, 2)),
        np.zeros((count, m.na)), np.concatenate([np.repeat(commands[:, :1], before, 1), commands], 1),
        np.tile(grid, (count, 1)), np.ones((count, n), bool), np.tile(q0, (count, n, 1)),
        np.full((count, n, m.nv), np.nan), np.zeros((count, m.nv, 2)),
        np.zeros((count, n), bool), *np.zeros((2, count, n, m.nv)),
    )  # fmt: skip

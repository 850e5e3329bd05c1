"""Design the commands that would tell ambiguous explanations apart, and show in simulation that they do."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mpge_jax.diagnosis.fit import Fitted
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.simulate import Run
from mpge_jax.diagnosis.whiten import column_scale
from mpge_jax.diagnosis.windows import Windows

if TYPE_CHECKING:
    from mpge_jax.diagnosis.diagnosis import Diagnosis

Array = np.ndarray
DURATION = 3.0
SEPARATED = 5.0
"""Root-mean-square distance of the predictions, in units of noise, that counts as told apart."""


def _command_range(d: Diagnosis) -> tuple[Array, Array]:
    """Limits [nu] of the commands: the model's, and no wider than one and a half times what was recorded."""
    m = d.prepared.model
    recorded = np.concatenate([s.command for s in d.prepared.train_sources])
    middle, half = recorded.mean(0), 0.75 * np.ptp(recorded, axis=0) + 1e-6
    low, high = middle - half, middle + half
    limited = m.actuator_ctrllimited.astype(bool)
    low = np.where(limited, np.maximum(low, m.actuator_ctrlrange[:, 0]), low)
    high = np.where(limited, np.minimum(high, m.actuator_ctrlrange[:, 1]), high)
    return low, high


def proposals(low: Array, high: Array, time: Array, rng: np.random.Generator) -> list[tuple[str, Array]]:
    """Command sequences [T, nu] of different kinds inside the limits."""
    nu, middle, half = low.size, 0.5 * (low + high), 0.5 * (high - low)
    out: list[tuple[str, Array]] = []
    phase = rng.uniform(0, 2 * np.pi, nu)
    for size in (0.3, 1.0):
        sweep = 0.2 + 4.0 * time / time[-1]
        chirp = np.sin(2 * np.pi * np.cumsum(sweep)[:, None] * (time[1] - time[0]) + phase)
        out.append(
            (
                f"a chirp from 0.2 to 4 Hz at {100 * size:.0f} % of the command range",
                middle + size * half * chirp,
            )
        )
        levels = rng.uniform(-1, 1, (64, nu))
        steps = levels[np.minimum((time / 0.3).astype(int), 63)]
        out.append(
            (
                f"random steps of 0.3 s at {100 * size:.0f} % of the command range",
                middle + size * half * steps,
            )
        )
        slow = np.sin(2 * np.pi * 0.33 * time[:, None] + phase)
        out.append(
            (f"slow reversals at {100 * size:.0f} % of the command range", middle + size * half * slow)
        )
    burst = np.where((time[:, None] % 1.5) < 0.4, 1.0, 0.0) * np.sign(np.sin(phase))
    out.append(("short pushes followed by coasting with the command at rest", middle + half * burst))
    return out


def design(d: Diagnosis, groups: Mapping[Term, list[Fitted]], path: Path) -> dict[str, object] | None:
    """Write the command sequence that best separates the candidates of every ambiguous effect, `groups`.

    Returns what was found, or None when there is nothing to separate or no command inside the limits does.
    """
    m = d.prepared.model
    path.unlink(missing_ok=True)
    if not groups or m.nu == 0 or d.prepared.measured.any():
        return None
    fits = list({f.hypothesis: f for fs in groups.values() for f in fs}.values())
    dt, rng = d.prepared.dt, np.random.default_rng([d.config.seed, 9])
    steps = round(DURATION / dt)
    time = dt * np.arange(steps)
    low, high = _command_range(d)
    source = d.prepared.train_sources[0]
    best: tuple[float, str, Array] | None = None
    scale = column_scale(d.prepared.noise, m)
    for name, command in proposals(low, high, time, rng):
        command = np.clip(command, low, high)
        w = _window(d, source.states.qpos[0], np.zeros(m.nv), command, dt)
        res = d.prepared.sim.residuals([Run(f.hypothesis, f.theta) for f in fits], w)[:, 0, :, : m.nv]
        gaps = [
            np.sqrt(np.mean((np.clip(res[i] - res[j], -10, 10) / scale[: m.nv]) ** 2))
            for i in range(len(fits))
            for j in range(i)
        ]
        least = float(min(gaps)) if gaps else 0.0
        if best is None or least > best[0]:
            best = (least, name, command)
    if best is None or best[0] < SEPARATED:
        return None
    np.savez(path, time=time, ctrl=best[2], qpos0=source.states.qpos[0])
    return {"separation": best[0], "kind": best[1], "path": path.name}


def _window(d: Diagnosis, q0: Array, v0: Array, command: Array, dt: float) -> Windows:
    """One window that starts at rest, with samples every five steps."""
    m, steps = d.prepared.model, len(command)
    before = int(np.ceil(0.3 / dt))
    grid = np.arange(5, steps + 1, 5) * dt
    padded = np.concatenate([np.repeat(command[:1], before, 0), command])[None]
    n = grid.size
    return Windows(
        d.prepared.train_sources, np.zeros(1, int), np.zeros(1), dt, steps, q0[None], v0[None],
        np.zeros((1, m.nv, 2, 2)), np.zeros((1, m.na)), padded, grid[None], np.ones((1, n), bool),
        np.tile(q0, (1, n, 1)), np.full((1, n, m.nv), np.nan),
    )  # fmt: skip

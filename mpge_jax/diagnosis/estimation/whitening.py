"""Residuals in units of noise with the start state marginalised.

A window's residual has covariance S = sigma^2 I + kappa^2 Phi P Phi^T + D D^T: measurement noise, the uncertain
start state (Phi: sensitivity of the window to its start, P: the smoother's covariance) and nuisance directions D
such as those of a finer timestep. Whitening multiplies by S^(-1/2), through a thin SVD per window.

Where the hypothesis around which one whitens misses the data by more than noise, sigma is enlarged until its median
window is ordinary (tempering): a model that is wrong by a hundred deviations says nothing at the scale of one, and
the robust loss would no longer tell better from worse. As effects are found, sigma shrinks to the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import default_places
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.joint_space import columns_of
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import changes
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
KAPPA = 5.0
NUISANCE = 3.0
ORDINARY = 5.0
"""Relative chi^2 up to which a window counts fully, or nearly."""
STEP, LATE, INTEGRATOR, OLDER = "timestep", "late commands", "integrator", "older forces"
HOLDING = "given dry friction"
"""What changes motion and is no physics (see `numerics`)."""
LATER = 0.125
"""Timesteps by which LATE has commands act later."""
BEFORE = "commands before the recording, of actuator"
"""What late actuators still obey when it begins (see `nuisances`), and the actuator's index."""
GUIDED = "motion of guided joints"
"""What may have been otherwise there (see `nuisances`), and the number of a draw."""
INEXACT = 0.03
"""Share of what the timestep, and commands from before the recordings, change that follows no direction: where drives
saturate or starts are uncertain, it is not linear. It counts as noise."""
_CAP = 1e8


@dataclass(frozen=True)
class Whitener:
    """Whitens residuals of one set of windows.

    Attributes:
        scale: [W, N, 2 nv] deviations of the noise, infinite for columns that are not compared.
        basis: [W, M, k] orthonormal directions. shrink: [W, k]. seen: [W, M] mask.
        count: [W] compared values. expected: [W] chi^2 over count when the hypothesis is true.
        factor: by which tempering enlarged sigma (1: residuals are in units of the noise).
        inexact: whether most of sigma is what the timestep leaves unknown, and not noise.
        offset: [W, M] what leads from residuals of windows that start elsewhere than estimated back to those of the
            estimate, by the slopes at where they start.
    """

    scale: Array
    basis: Array
    shrink: Array
    seen: Array
    count: Array
    expected: Array
    offset: Array
    factor: float = 1.0
    inexact: bool = False

    def take(self, index: Array) -> Whitener:
        keys = (
            "basis",
            "shrink",
            "seen",
            "count",
            "expected",
            "offset",
            "scale",
        )
        return replace(self, **{k: getattr(self, k)[index] for k in keys})

    def plain(self, residual: Array) -> Array:
        """Residuals [..., W, N, 2 nv] in units of noise: [..., W, M], zero where unseen."""
        return np.clip(in_units(residual, self.scale), -_CAP, _CAP) + self.offset

    def __call__(self, residual: Array) -> Array:
        """Whitened residuals [..., W, M]."""
        r = self.plain(residual)
        inner = np.einsum("wmk,...wm->...wk", self.basis, r, optimize=True)
        return r - np.einsum("wmk,...wk->...wm", self.basis, self.shrink * inner, optimize=True)

    def excess(self, whitened: Array) -> Array:
        """chi^2 of each window over what noise and start alone give: [..., W]."""
        return (whitened**2).sum(-1) / self.count / self.expected

    def by_dof(self, whitened: Array, nv: int) -> Array:
        """`excess` of each degree of freedom by itself: [W, nv] from whitened residuals [W, M]."""
        square, seen = (x.reshape(len(whitened), -1, nv).sum(1) for x in (whitened**2, self.seen))
        return square / np.maximum(seen, 1) / self.expected[:, None]


def in_units(residual: Array, scale: Array) -> Array:
    """Residuals [..., N, 2 nv] in units of `scale` [..., N, 2 nv], zero where nothing was measured: [..., M]."""
    x = np.where(np.isfinite(residual), residual / scale, 0.0)
    return x.reshape(*x.shape[:-2], x.shape[-2] * x.shape[-1])


def column_scale(noise: Noise, model) -> Array:
    """Noise deviations [2 nv] in joint space."""

    scale = np.full(2 * model.nv, np.inf)
    columns, dofs, quats = columns_of(model)
    scale[dofs] = noise.qpos[columns]
    for q, v in quats:
        scale[v : v + 3] = noise.angle(q)
    scale[model.nv :] = noise.qvel
    return scale


def row_scale(noise: Noise, model, w: Windows) -> Array:
    """Noise deviations [W, N, 2 nv] of the rows of windows: of positions also what an inexact time stamp makes, and
    rounding that rows share."""
    scale = np.broadcast_to(column_scale(noise, model), (*w.seen.shape, 2 * model.nv)).copy()
    scale[..., : model.nv] = np.sqrt(scale[..., : model.nv] ** 2 + w.drift**2 + w.held**2)
    return scale


def start_runs(hypothesis: Hypothesis, theta: Array, w: Windows) -> list[Run]:
    """The nominal start and one run per column of the start's covariance root."""
    nv = w.v0.shape[1]
    runs = [Run(hypothesis, theta)]
    for dof in range(nv):
        for column in (0, 1):
            shift = np.zeros((w.count, 2 * nv))
            shift[:, dof] = w.root[:, dof, 0, column]
            shift[:, nv + dof] = w.root[:, dof, 1, column]
            runs.append(Run(hypothesis, theta, shift))
    return runs


def whitener(
    sim: Simulator,
    hypothesis: Hypothesis,
    theta: Array,
    w: Windows,
    noise: Noise,
    nuisance: dict[str, Array] | None = None,
    temper: bool | float = True,
) -> Whitener:
    """Whitener of windows `w` around a hypothesis.

    Args:
        nuisance: `numerics`. temper: enlarge sigma to the hypothesis's own misfit, or by a known factor.
    """
    scale, inexact = row_scale(noise, sim.model, w), False
    if nuisance:
        changed = [np.nan_to_num(d) for kind, d in nuisance.items() if kind.startswith((STEP, BEFORE))]
        # where a change crosses zero, what is unknown of it does not
        square = [np.maximum(x**2, (x**2).mean(1, keepdims=True)) for x in changed]
        unknown = INEXACT * np.sqrt(np.sum(square, axis=0))
        compared = np.isfinite(nuisance[STEP]) & np.isfinite(scale)
        inexact = bool(compared.any() and (unknown > scale)[compared].mean() > 0.5)
        scale = np.hypot(scale, unknown)
    starts = start_runs(hypothesis, theta, w)
    base, moved = sim.residuals(starts[:1], w)[0], changes(sim, starts, w)
    seen = np.isfinite(base) & np.isfinite(scale)
    flat_seen = seen.reshape(w.count, -1)
    count = np.maximum(flat_seen.sum(1), 1).astype(float)
    columns = np.where(seen, moved / scale, 0.0).reshape(len(moved), w.count, -1)
    columns = np.clip(columns, -_CAP, _CAP)
    offset = -np.einsum("swm,ws->wm", columns, w.moved.reshape(w.count, -1))
    stack = [KAPPA * columns]
    if nuisance:
        extra = (np.where(seen & np.isfinite(d), d / scale, 0.0) for d in nuisance.values())
        flat = [x.reshape(1, w.count, -1) for x in extra]
        stack += [NUISANCE * np.clip(x, -_CAP, _CAP) for x in flat]
    u = np.moveaxis(np.concatenate(stack), 0, -1)
    basis, singular, _ = np.linalg.svd(u, full_matrices=False)
    bare = np.einsum("wmk,rwm->rwk", basis, columns, optimize=True)

    def build(factor: float) -> Whitener:
        s = singular / factor
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
        # expected chi^2 with the true start covariance (kappa = 1): noise plus start through S^(-1)
        gained = ((bare / factor) ** 2 / (1.0 + s**2)).sum((0, 2))
        expected = (count - (s**2 / (1.0 + s**2)).sum(-1) + gained) / count
        expected = np.maximum(expected, 0.05)
        return Whitener(
            scale * factor, basis, shrink, flat_seen, count, expected, offset / factor, factor, inexact
        )

    factor = 1.0 if isinstance(temper, bool) else temper
    white = build(factor)
    for _ in range(4 if temper is True else 0):
        median = float(np.median(white.excess(white(base[None])))) if w.count else 1.0
        # well below one, the noise was overestimated (fast motion logged at a low rate looks like noise)
        if 0.5 <= median <= 1.2 or factor < 1e-3 or (inexact and median < 0.5):
            break
        factor *= float(np.sqrt(max(median, 1e-6)))
        white = build(factor)
    return white


def numerics(sim: Simulator, hypothesis: Hypothesis, theta: Array, w: Windows) -> dict[str, Array]:
    """Changes of the residuals [W, N, 2 nv] by what is no physics.

    STEP: the timestep is halved (of Runge-Kutta, which that does not change: replaced by semi-implicit steps of a
    quarter). LATE: the commands act `LATER` timesteps later. INTEGRATOR: explicit steps are made implicit in the
    velocity or the other way round (not of Runge-Kutta), which moves stiff servos and strong damping otherwise than a
    timestep does. OLDER: servos' forces that act late do so by a tenth more. HOLDING: the dry friction that the model
    gives stops joints within a timestep (MuJoCo's creeps, and what rubs does neither quite so), where no effect has it
    so already.
    """
    run, kind = [Run(hypothesis, theta)], mujoco.mjtIntegrator
    plain, late = (sim.residuals(run, x)[0] for x in (w, w.later(LATER * w.dt)))
    steps = sim.model.opt.integrator
    runge_kutta, euler = steps == kind.mjINT_RK4, steps == kind.mjINT_EULER
    out = {STEP: in_finer_steps(sim, run, w, 4 if runge_kutta else 2)[0] - plain}
    if not runge_kutta:
        with sim.integrator(kind.mjINT_IMPLICITFAST if euler else kind.mjINT_EULER):
            out[INTEGRATOR] = sim.residuals(run, w)[0] - plain
    out[LATE] = late - plain
    older = w.older(1.1)
    if older is not None:
        out[OLDER] = sim.residuals(run, older)[0] - plain
    holds = _holding(sim, hypothesis, theta)
    if holds is not None:
        out[HOLDING] = sim.residuals([holds], w)[0] - plain
    return out


def explicit_damping(sim: Simulator, hypothesis: Hypothesis, theta: Array, w: Windows) -> Array | None:
    """Change of the residuals [W, N, 2 nv] by explicit damping of joints, which MuJoCo makes implicit in Euler's steps
    too; None where no joint has any. An implicit step adds a step's damping to the inertia, and no machine has more
    than half of that. It is like so much else at every joint that searches do not see past it.
    """
    added = any("dof_damping" in t.effect.fields for t in hypothesis.terms)
    runge_kutta = sim.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    if runge_kutta or not (added or (sim.model.dof_damping > 0.0).any()):
        return None
    run = [Run(hypothesis, theta)]
    with sim.integrator(mujoco.mjtIntegrator.mjINT_EULER):
        implicit = sim.residuals(run, w)[0]
    with sim.explicitly():
        explicit: Array = sim.residuals(run, w)[0]
    return explicit - implicit


def _holding(sim: Simulator, hypothesis: Hypothesis, theta: Array) -> Run | None:
    """The same with given dry friction that holds; None where no joint has any whose law is not told."""
    ctx = sim.ctx
    told = {t.place for t in hypothesis.terms if "dof_solref" in t.effect.fields}
    joints = [
        place
        for place in default_places(ctx, "joint")
        if place not in told and ctx.model.dof_frictionloss[ctx.dof(place)] > 0.0
    ]
    if not joints:
        return None
    more = {t: t.effect.null(ctx, t.place) for t in (Term("coulomb_friction", place) for place in joints)}
    stiff = Hypothesis.of(*hypothesis.terms, *more)
    return Run(stiff, stiff.gather(ctx, hypothesis.split(ctx, theta) | more))


def nuisances(sim: Simulator, hypothesis: Hypothesis, theta: Array, w: Windows) -> dict[str, Array]:
    """Changes of the residuals [W, N, 2 nv] by `numerics`; by commands from before the recordings, of which late or
    lagging actuators still have some at the first rows; and by what is not known of guided joints' motion."""
    out = numerics(sim, hypothesis, theta, w)
    run = [Run(hypothesis, theta)]
    plain = sim.residuals(run, w)[0]
    for k, changed in enumerate(_guided_otherwise(sim, run, w)):
        out[f"{GUIDED} {k}"] = changed
    for a in sorted({t.place.index for t in hypothesis.terms if t.effect.commands}):
        other = w.commanded_before(a)
        if other is not None:
            out[f"{BEFORE} {a}"] = sim.residuals(run, other)[0] - plain
    return out


def _guided_otherwise(sim: Simulator, run: list[Run], w: Windows) -> list[Array]:
    """Changes [W, N, 2 nv] by what guided joints may have done instead, whose squares add up to their variance."""
    motions = w.otherwise() if sim.guided else []
    if not motions:
        return []
    simulate = sim.cheaply if sim.costly(w) else sim.residuals
    plain, *moved = (simulate(run, x)[0] for x in (w, *motions))
    return [(x - plain) / np.sqrt(len(motions)) for x in moved]


def whitener_beside(
    sim: Simulator,
    hypothesis: Hypothesis,
    theta: Array,
    w: Windows,
    noise: Noise,
    temper: bool | float = True,
) -> Whitener:
    """The `whitener` that sees past `nuisances`."""
    return whitener(sim, hypothesis, theta, w, noise, nuisances(sim, hypothesis, theta, w), temper)


def in_finer_steps(sim: Simulator, runs: list[Run], w: Windows, factor: int) -> Array:
    """Residuals [R, W, N, 2 nv] in `factor` times as many steps; of Runge-Kutta, in such semi-implicit ones."""
    if sim.model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        return sim.residuals(runs, w.refined(factor))
    with sim.integrator(mujoco.mjtIntegrator.mjINT_EULER):
        return sim.residuals(runs, w.refined(factor))


def robust_loss(x: Array) -> Array:
    """Loss of windows with relative chi^2 x: linear for ordinary windows, and logarithmic for those far above."""
    return ORDINARY * np.log1p(x / ORDINARY)


def robust_weight(x: Array) -> Array:
    """What a window's chi^2 counts in a fit: the slope of `robust_loss`."""
    return np.asarray(1.0 / (1.0 + x / ORDINARY))


def usual_excess(loss: float) -> float:
    """The relative chi^2 of a window with that `robust_loss`."""
    return float(ORDINARY * np.expm1(loss / ORDINARY))

"""Which law an actuator's measured forces follow: effects are added while forces that were held back gain by them."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.drives.drive_law import Data, Log, blocks_of, residual
from mpge_jax.diagnosis.drives.law_fit import fit_law
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.whitening import robust_loss
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio

Array = np.ndarray
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


def search_law(model: mujoco.MjModel, ctx: Context, place: Place, d: Data, ids: list[str]) -> Fitted:
    """Effects of these `ids` at an actuator, one after the other."""
    current = NOTHING
    while len(current.hypothesis.terms) < MAX_EFFECTS:
        better = _one_more(model, ctx, place, d, current, ids)
        if better is None:
            break
        current = better
    return current


def _one_more(
    model: mujoco.MjModel, ctx: Context, place: Place, d: Data, current: Fitted, ids: list[str]
) -> Fitted | None:
    """The law with a further effect, if held forces gain by it beyond doubt and by more than a detail."""

    def held(f: Fitted) -> Array:
        return residual(model, ctx, f, place.index, d.held, d)

    laws = [f for i in ids if (f := _with(model, ctx, place, d, current, i)) is not None]
    if not laws:
        return None
    each = [(f, blocks_of(held(f), d.held)) for f in laws]
    reference = min((blocks for _, blocks in each), key=np.median)
    scored = sorted(((f, _robust(blocks, reference)) for f, blocks in each), key=lambda x: x[1].mean())
    tied = [x for x in scored if not beyond_doubt(log_ratio(x[1] - scored[0][1]))]
    chosen, after = min(tied, key=lambda x: (x[0].theta.size, _tier(x[0]), x[1].mean()))
    before = _robust(blocks_of(held(current), d.held), reference)
    if not beyond_doubt(log_ratio(before - after), len(scored)):
        return None
    old, new = (d.sigma * held(f) for f in (current, chosen))
    if np.sqrt(np.mean((new - old) ** 2)) < WITHIN * d.unsure:
        # a smoother's errors are no noise: they go with what a servo does, as a gain does
        return None
    largest, timestep = float(ctx.drive[place.index]), float(model.opt.timestep)
    return None if _is_detail(old, new, d.held, largest, timestep) else chosen


def _with(
    model: mujoco.MjModel, ctx: Context, place: Place, d: Data, current: Fitted, name: str
) -> Fitted | None:
    """The law with the effect `name` too, at the best of its starts; None if it cannot act there."""
    term = Term(name, place)
    if place not in REGISTRY[name].places(ctx) or not compatible(current.hypothesis, term):
        return None
    h = current.hypothesis.with_term(term)
    parts = current.hypothesis.split(ctx, current.theta)
    starts = [h.gather(ctx, {**parts, term: start}) for start in REGISTRY[name].starts(ctx, place)]
    fits = [fit_law(model, ctx, Fitted(h, theta, np.zeros(0)), place.index, d) for theta in starts]
    best = min(fits, key=lambda f: f.loss)
    fast = _too_fast(ctx, best, d.dt)
    if fast is None:
        return best
    if fast == term:
        return None
    # found before the delay for which it stood
    h, parts = best.hypothesis.without(fast), best.hypothesis.split(ctx, best.theta)
    return fit_law(model, ctx, Fitted(h, h.gather(ctx, parts), np.zeros(0)), place.index, d)


def _robust(blocks: Array, reference: Array) -> Array:
    """Loss of blocks in units of the reference's median block; wild blocks count little."""
    return robust_loss(blocks / max(float(np.median(reference)), 1e-12))


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

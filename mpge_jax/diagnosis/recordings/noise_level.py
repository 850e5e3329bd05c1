"""Measurement noise and quantisation, estimated from the recordings alone."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
MAD = 1.4826
"""Standard deviations of a normal variable in its median absolute one."""
ORDERS = (4, 6, 8)
"""Orders of the differences that noise is told by."""
MIN_ROWS = 12
HALVINGS = 30
"""Steps of the bisection that tells noise at rest from that of stamps."""
STILL = 50
"""Rows for each change of a signal from which on it counts as resting."""
COARSE = 0.02
"""Steps (rad or m) as large are no encoder's, where only a few were seen."""
REACH = 100
"""Rows on either side that may share the rounding of one."""
AVERAGED = 5
"""Rows whose mean tells where the machine is, for that."""


def difference_noise(time: Array, value: Array, order: int = 8) -> Array:
    """Normalised divided differences [T - order]: unit-variance combinations that cancel smooth motion.

    Weights are those of the divided difference on the actual sample times (jitter is no noise), scaled to unit
    norm, so that white noise of deviation s gives values of deviation s.
    """
    n = time.size - order
    index = np.arange(n)[:, None] + np.arange(order + 1)
    t = time[index]
    t = (t - t.mean(1, keepdims=True)) / np.ptp(t, axis=1)[:, None]
    gaps = t[:, :, None] - t[:, None, :] + np.eye(order + 1)
    weights = 1.0 / gaps.prod(-1)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return (weights * value[index]).sum(1)


def speed_around(time: Array, value: Array, order: int) -> Array:
    """[T - order - 2] mean speed between the rows on either side of those of each difference but the outermost, whose
    noise it does not share."""
    reach = order + 2
    return (value[reach:] - value[:-reach]) / (time[reach:] - time[:-reach])


def noise_level(time: Array, value: Array, stamp: float = 0.0) -> float:
    """Deviation of white measurement noise: median absolute 8th (or lower) difference, whichever is least.

    Args:
        stamp: deviation (s) of the time stamps, which adds as much times the speed.
    """
    if value.size < MIN_ROWS:
        return float("nan")
    levels = []
    for order in ORDERS:
        d = np.abs(difference_noise(time, value, order))
        if stamp:
            d = _at_rest(d[1:-1], stamp * speed_around(time, value, order))
        levels.append(MAD * float(np.median(d)))
        moving = d[d > 0]
        if moving.size > 0.2 * d.size:
            # long rests of a quantised encoder must not hide the noise of the moving parts
            levels[-1] = max(levels[-1], 0.5 * MAD * float(np.median(moving)))
    least = min(levels)
    return float(np.mean([x for x in levels if x <= 1.15 * least]))


def _at_rest(d: Array, moved: Array) -> Array:
    """Differences [N] as they would be of a machine at rest, where its motion `moved` [N] within the deviation of a
    time stamp adds to their noise."""
    low, high = 0.0, MAD * float(np.median(d))
    for _ in range(HALVINGS):
        level = 0.5 * (low + high)
        more = MAD * float(np.median(d / np.maximum(np.hypot(level, moved), 1e-300))) > 1.0
        low, high = (level, high) if more else (low, level)
    return d * high / np.maximum(np.hypot(high, moved), 1e-300)


def quantum(values: list[Array], rests: bool = False) -> float:
    """Step of a signal that was quantised in the same way in all recordings, 0 when there is none that matters.

    Args:
        values: [T] of each recording. rests: a signal that stays where it is but for equal steps is quantised too (the
            encoder of a joint that hardly moves; not a force that is switched).
    """
    steps = np.concatenate([np.abs(np.diff(v)) for v in values])
    largest = max(float(np.abs(v).max(initial=0.0)) for v in values)
    moves = steps[steps > 1e-12 * max(1.0, largest)]
    if moves.size < 8:
        # an encoder that flickered now and then; a few moves among few rows, or far ones, may be anything
        resting = rests and moves.size > 1 and steps.size >= STILL * moves.size and moves.min() < COARSE
        ratio = moves / moves.min() if resting else np.array([0.5])
        return float(moves.min()) if np.abs(ratio - np.round(ratio)).max() < 0.02 else 0.0
    q = float(np.quantile(moves, 0.01))
    ratio = moves / q
    error = np.abs(ratio - np.round(ratio))
    single = float(np.spacing(np.float32(largest)))
    if q <= 4 * single or np.mean(error < 0.02 + single / q) < 0.97:
        return 0.0
    # equal steps without rests are an even motion
    return q if ratio.max() > 1.5 or (rests and moves.size < 0.5 * steps.size) else 0.0


def column_noise(
    times: list[Array], values: list[Array], rests: bool = False, stamp: float = 0.0
) -> tuple[float, float]:
    """(noise deviation including quantisation, quantum) of one column over several recordings; `rests`: `quantum`,
    `stamp`: `noise_level`."""
    levels, known = [], []
    for t, v in zip(times, values, strict=True):
        t, v = t[np.isfinite(v)], v[np.isfinite(v)]
        if v.size:
            levels.append(noise_level(t, v, stamp))
            known.append(v)
    levels = [x for x in levels if np.isfinite(x)]
    if not levels:
        return float("nan"), 0.0
    level, q = float(np.median(levels)), quantum(known, rests)
    return max(level, q / np.sqrt(12)), q


def held_error(position: Array, step: float, sigma: float) -> Array:
    """Deviation [T] that readings have beyond `sigma`, so that as many as share their rounding weigh as one does.

    Rounding errs by step / sqrt(12); while the machine moves by less than half a step all readings err alike. White
    noise of deviation w beneath the steps blurs that: exp(-2 pi^2 w^2 / step^2) of it is left (the first harmonic of
    the mean rounding error by position; Widrow and Kollar, Quantization Noise, 2008).

    Args:
        position: [T] as read. step: of the encoder, 0 for none. sigma: deviation of single readings, rounding included.
    """
    rows = position.size
    if step <= 0.0 or rows < AVERAGED:
        return np.zeros(rows)
    white = max(sigma**2 - step**2 / 12.0, 0.0)
    shared = step / np.sqrt(12.0) * np.exp(-2.0 * np.pi**2 * white / step**2)
    padded = np.pad(position, AVERAGED // 2, mode="edge")
    where = np.convolve(padded, np.full(AVERAGED, 1.0 / AVERAGED), "valid")
    count = np.ones(rows)
    for x, counted in ((where, count), (where[::-1], count[::-1])):
        near = np.ones(rows, bool)
        for lag in range(1, min(REACH, rows - 1) + 1):
            near[:-lag] &= np.abs(x[lag:] - x[:-lag]) < 0.5 * step
            near[rows - lag :] = False
            if not near.any():
                break
            counted += near
    return shared * np.sqrt(count - 1.0)

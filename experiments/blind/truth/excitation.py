"""Reference motions that excite: multisines, chirps, slow ramps, steps with holds, and mixtures of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

Array = NDArray[np.float64]
GRID = 1000  # points a second on which references are drawn
KINDS = ("multisine", "chirp", "slow", "steps", "mix")


@dataclass(frozen=True)
class Reference:
    """Positions, velocities and accelerations [T, n] of n reference signals at given times."""

    q: Array
    v: Array
    a: Array


def multisine(rng: np.random.Generator, t: Array, top: float) -> Array:
    """Six sines with amplitudes falling with frequency, random phases; within [-1, 1]."""
    f = np.exp(rng.uniform(np.log(0.12), np.log(top), 6))
    amplitude = 1 / np.maximum(f, 0.5)
    amplitude /= amplitude.sum()
    return np.sin(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (6, 1))).T @ amplitude


def chirp(rng: np.random.Generator, t: Array, top: float) -> Array:
    """0.2 Hz to twice `top`, logarithmic; the amplitude falls so that the speed stays bounded."""
    low, high, span = 0.2, 2 * top, t[-1] - t[0]
    f = low * (high / low) ** ((t - t[0]) / span)
    phase = 2 * np.pi * np.cumsum(f) * (t[1] - t[0]) + rng.uniform(0, 2 * np.pi)
    return np.minimum(1.0, 0.35 / f) * np.sin(phase)


def slow(rng: np.random.Generator, t: Array, top: float) -> Array:
    """Ramps between random turning points at a tenth to a half of the span a second."""
    knots, levels = [t[0]], [rng.uniform(-1, 1)]
    while knots[-1] < t[-1]:
        step = rng.uniform(0.15, 0.8) * (1 if levels[-1] < 0 else -1)
        knots.append(knots[-1] + abs(step) / rng.uniform(0.2, 1.0))
        levels.append(levels[-1] + step)
    return np.interp(t, knots, levels)


def steps(rng: np.random.Generator, t: Array, top: float) -> Array:
    """Random levels, each reached within 0.2 to 0.5 s and held for 0.3 to 1 s."""
    knots, levels = [t[0]], [rng.uniform(-1, 1)]
    while knots[-1] < t[-1]:
        knots += [knots[-1] + rng.uniform(0.2, 0.5)]
        knots += [knots[-1] + rng.uniform(0.3, 1.0)]
        levels += [rng.uniform(-1, 1)] * 2
    return gaussian_filter1d(np.interp(t, knots, levels), 0.04 * GRID)


def mix(rng: np.random.Generator, t: Array, top: float) -> Array:
    """Thirds: a multisine, slow ramps, steps, in random order, joined smoothly."""
    parts = [multisine, slow, steps]
    rng.shuffle(parts)
    out, edges = np.zeros_like(t), np.linspace(t[0], t[-1], 4)
    for part, begin, end in zip(parts, edges[:-1], edges[1:], strict=True):
        gate = np.clip((t - begin) / 0.15 + 0.5, 0, 1) * np.clip((end - t) / 0.15 + 0.5, 0, 1)
        out += gate * part(rng, t, top)
    return gaussian_filter1d(out, 0.04 * GRID)


def reference(
    kind: str, rng: np.random.Generator, times: Array, centres: Array, spans: Array, top: float
) -> Reference:
    """References [T, n] at `times`: signal i stays about within centres[i] +- spans[i]; `top` in Hz."""
    if kind not in KINDS:
        raise ValueError(f"unknown excitation {kind!r}; there are {', '.join(KINDS)}")
    grid = np.arange(times[0], times[-1] + 1 / GRID, 1 / GRID)
    draw = {"multisine": multisine, "chirp": chirp, "slow": slow, "steps": steps, "mix": mix}[kind]
    raw = np.stack([draw(rng, grid, top * rng.uniform(0.8, 1.2)) for _ in centres], axis=1)
    q = gaussian_filter1d(centres + spans * raw, 0.015 * GRID, axis=0, mode="nearest")
    v = np.gradient(q, 1 / GRID, axis=0)
    a = np.gradient(v, 1 / GRID, axis=0)
    return Reference(
        *(np.stack([np.interp(times, grid, x[:, i]) for i in range(x.shape[1])], 1) for x in (q, v, a))
    )

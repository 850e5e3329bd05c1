"""A fitted function in words, where few known terms say it."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, joint_unit
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import ANGLE, WITHIN_TURN, Axis
from mpge_jax.diagnosis.effects.residual.force import Residual

Array = np.ndarray
WAVES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
MOST = 3
"""Terms of a formula."""
ENOUGH = 0.95
"""Share of a function's variance, over where it was seen, that a formula must say."""
WORTH = 0.02
"""Share of it that a further term must add."""
SLOW = (0.02, 0.1)
"""Speeds, in the greatest seen, at which dry friction turns over."""

Atom = tuple[tuple[str, ...], list[Array]]
"""Names, and the columns that belong together (a wave's sine and cosine)."""


def formula(effect: Residual, theta: Array, seen: dict[str, Array], term: Term, ctx: Context) -> str | None:
    """'about 0.31 N m sin(2 q + 0.4), for -1.2 < q < 1.2 rad' or None where no few terms say it.

    Args:
        theta: values of the function. seen: values [N] of the inputs along the recordings.
    """
    values = [a.within(seen[a.key]) for a in effect.axes]
    target = np.asarray(effect.value(np, theta, values), dtype=float)
    whole = float(np.var(target))
    if whole <= 0:
        return None
    atoms = _atoms(effect, values)
    chosen: list[int] = []
    said = 0.0
    for _ in range(MOST):
        tried = [
            (_said(target, [atoms[i][1] for i in (*chosen, k)]), k)
            for k in range(len(atoms))
            if k not in chosen
        ]
        best, k = max(tried)
        if best - said < WORTH:
            break
        chosen.append(k)
        said = best
        if said > 1.0 - WORTH:
            break
    if said < ENOUGH:
        return None
    unit = joint_unit(ctx, term.place, "N m", "N")
    columns = [np.ones_like(target)] + [c for k in chosen for c in atoms[k][1]]
    x = np.linalg.lstsq(np.stack(columns, 1), target, rcond=None)[0]
    parts, at = [], 1
    for k in chosen:
        names, cols = atoms[k]
        parts.append(_told(names, x[at : at + len(cols)]))
        at += len(cols)
    if abs(x[0]) > 0.05 * np.sqrt(np.mean(target**2)):
        parts.append(f"{x[0]:+.2g}")
    text = parts[0].removeprefix("+") + "".join(f" {part[0]} {part[1:]}" for part in parts[1:])
    ranges = " and ".join(
        f"{a.low:.2g} < {a.letter} < {a.high:.2g} {a.unit(ctx, term.place)}"
        for a in effect.axes
        if not a.around
    )
    return f"about {text} {unit}" + (f", for {ranges}" if ranges else "")


def _said(target: Array, groups: list[list[Array]]) -> float:
    columns = np.stack([np.ones_like(target)] + [c for g in groups for c in g], 1)
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return 1.0 - float(np.var(left)) / float(np.var(target))


def _told(names: tuple[str, ...], x: Array) -> str:
    if len(names) == 1:
        return f"{x[0]:+.2g} {names[0]}"
    size, phase = float(np.hypot(*x)), float(np.arctan2(x[1], x[0]))
    return f"+{size:.2g} {names[0].replace('PHASE', f'{phase:+.2g}')}"


def _alone(axis: Axis, x: Array) -> list[Atom]:
    """Terms of one input."""
    name = axis.letter
    out: list[Atom] = [((name,), [x]), ((f"{name}^2",), [x**2]), ((f"{name}^3",), [x**3])]
    if axis.around:
        out = []
    if axis.input in (ANGLE, WITHIN_TURN):
        for n in WAVES:
            wave = f"sin({n if n > 1 else ''}{name} PHASE)"
            out.append(((wave, wave), [np.sin(n * x), np.cos(n * x)]))
        return out
    largest = max(float(np.abs(x).max()), 1e-12)
    out += [((f"{name} |{name}|",), [x * np.abs(x)]), ((f"|{name}|",), [np.abs(x)])]
    out += [((f"tanh({name}/{s * largest:.2g})",), [np.tanh(x / (s * largest))]) for s in SLOW]
    return out


def _atoms(effect: Residual, values: list[Array]) -> list[Atom]:
    alone = [_alone(a, x) for a, x in zip(effect.axes, values, strict=True)]
    out = [atom for atoms in alone for atom in atoms]
    if len(alone) == 2:
        for names, one in alone[0]:
            for others, other in alone[1]:
                columns = [a * b for a in one for b in other]
                if len(columns) <= 2:
                    longer = names if len(names) == 2 else others
                    short = others[0] if len(names) == 2 else names[0]
                    out.append((tuple(f"{short} {n}" for n in longer), columns))
    return out

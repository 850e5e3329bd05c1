"""What is left as fitted functions: plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.family import residual_of
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.thresholds import REMAINS

Array = np.ndarray
WORTH = 0.01
"""Share by which the error of test recordings must fall."""


@dataclass(frozen=True)
class Function:
    """A force that no known effect explains, as a function of what goes on where it acts.

    Attributes:
        term: where it acts, and of which inputs. theta: its values. formula: it in words, where few terms say it.
    """

    term: Term
    theta: Array
    formula: str | None

    @property
    def effect(self) -> Residual:
        return residual_of(self.term.id)

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.effect.axes


@dataclass(frozen=True)
class ResidualModel:
    """All that is left as functions, and what they do to recordings that they never saw.

    Attributes:
        functions: one of each place. before, after: errors on the test recordings with the named effects only, and with
            the functions too, in the report's unit.
    """

    functions: tuple[Function, ...]
    before: float
    after: float

    def told(self, guess: str) -> str:
        """On what that which is left depends, in words: the functions' inputs, where these take most of the error away;
        else a guess."""
        if self.after**2 > REMAINS * self.before**2:
            return guess
        said = [" and ".join(f"the {a.says}" for a in f.axes) for f in self.functions]
        if len(said) == 1:
            return f"it depends on {said[0]}"
        return "; ".join(
            f"at the {f.term.place.name} it depends on {x}" for f, x in zip(self.functions, said, strict=True)
        )


def worthwhile(found: list[Function], before: float, after: float) -> ResidualModel | None:
    """The model, if it makes the test recordings better predicted."""
    return ResidualModel(tuple(found), before, after) if found and after < (1.0 - WORTH) * before else None


def with_residual(ctx: Context, f: Fitted, r: ResidualModel) -> Fitted:
    """`f` with all of the functions."""
    return with_functions(ctx, f, r.functions)


def with_functions(ctx: Context, f: Fitted, functions: Sequence[Function]) -> Fitted:
    for function in functions:
        f = with_function(ctx, f, function.term, function.theta)
    return f


def with_function(ctx: Context, f: Fitted, term: Term, theta: Array | None = None) -> Fitted:
    """`f` with a function of given values (0)."""
    own = np.zeros(len(term.params(ctx))) if theta is None else theta
    return f.exchanged(ctx, (), {term: own})

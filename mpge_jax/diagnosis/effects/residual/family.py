"""Residuals by their identifiers."""

from __future__ import annotations

import re
from functools import lru_cache

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.residual.axis import AXIS, TURNED, Axis
from mpge_jax.diagnosis.effects.residual.force import RESIDUAL, Residual
from mpge_jax.diagnosis.effects.residual.since_turn import SinceTurn

_ID = re.compile(rf"residual:(?P<dry>dry:)?(?P<axes>(?:{AXIS}){{1,2}})below (?P<below>\S+)")


@lru_cache(maxsize=256)
def residual_of(form: str) -> Residual:
    """The effect of an identifier.

    Raises:
        KeyError: it is none of a residual.
    """
    match = _ID.fullmatch(form)
    if match is None:
        raise KeyError(form)
    axes, below, dry = re.findall(AXIS, match["axes"]), match["below"], match["dry"] is not None
    try:
        told = tuple(
            Axis.of_key(key, float(low), float(high), int(knots or 0)) for key, low, high, knots in axes
        )
        if [a.input for a in told] == [TURNED] and not dry:
            return SinceTurn(told[0], float(below))
        return Residual(told, float(below), dry)
    except ValueError:
        raise KeyError(form) from None


REGISTRY.families[RESIDUAL] = residual_of

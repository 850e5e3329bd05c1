"""The vocabulary as a table for people: what every effect is, where it acts and what its parameters are."""

from __future__ import annotations

import mujoco

from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.effects.context import Context, nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable

_HINGE = """<mujoco><worldbody><geom type="plane" size="5 5 1"/><body pos="0 0 .5">
<joint name="hinge" axis="0 1 0" armature="0.01"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/>
</body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""
"""A machine on which every effect can act."""


def vocabulary_table() -> str:
    """Every registered effect as a row of a Markdown table, with the units that a driven hinge gives its parameters.

    The second forms of effects, which share their names, are left out.
    """
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(_HINGE)))
    rows = [_row(name, effect, ctx) for name, effect in REGISTRY.items() if ":" not in name]
    head = ["effect", "at", "equation", "parameters", "is seen best in"]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows))


def _row(name: str, effect: Effect, ctx: Context) -> list[str]:
    places = effect.places(ctx)
    units = effect.units(ctx, places[0]) if places else {}
    params = ", ".join(f"{p} ({unit})" if unit != "1" else p for p, unit in units.items())
    cells = [f"`{name}`", ", ".join(effect.kinds), effect.equation, params, effect.remedy]
    return [cell.replace("|", r"\|") for cell in cells]

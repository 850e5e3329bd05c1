"""`effects.md`: every effect with its equation, its signature, and what it is confused with, from the registry."""

from __future__ import annotations

from pathlib import Path

import mujoco
from signatures import PENDULUM, signature

from mpge_jax.diagnosis.effects import VOCABULARY
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Context, nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable

STYLE = """<style>
.signature{width:100%;height:auto;font:11px system-ui,sans-serif}
.signature text{fill:currentColor;opacity:.75}
.signature .frame{fill:none;stroke:currentColor;opacity:.3}
.signature polyline{fill:none;stroke-width:1.5}
.signature polyline.given{stroke:#c1502e;stroke-dasharray:4 3}
.signature polyline.true{stroke:#3b8fd6}
.signature circle.true{fill:#3b8fd6;opacity:.7}
</style>
"""
HEAD = """# The effects

What the diagnosis can name. v is the velocity of the joint, q its position, a its acceleration, u the command, tau the
force of the actuator. The pictures show a driven pendulum of 1 kg and 0.3 m (the two of contacts: a box on a floor),
whose motor is given the same commands each time: its motion with the effect (blue) and without (red, dashed), and the
torque that the model without the effect lacks along that motion, by inverse dynamics. What the numbers of each effect
mean is told in [the vocabulary](vocabulary.md#what-the-numbers-mean); how to add one of your own in
[the diagnosis](diagnosis.md#the-vocabulary).

"""


def page() -> str:
    """The page in Markdown."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    return STYLE + HEAD + "\n".join(_section(name, ctx) for name in VOCABULARY)


def _section(name: str, ctx: Context) -> str:
    effect = REGISTRY[name]
    others = ", ".join(f"[{_title(o).lower()}](#{o})" for o in effect.confused_with)
    places = effect.places(ctx)
    units = effect.units(ctx, places[0]) if places else {}
    params = ", ".join(f"{p} ({u})" if u != "1" else p for p, u in units.items())
    rows = [
        ("equation", f"`{effect.equation}`"),
        ("acts at", " or ".join(effect.kinds)),
        ("parameters", params or "none"),
        ("confused with", others or "nothing"),
        ("what separates them", effect.remedy),
    ]
    table = "\n".join(f"| {a} | {b} |" for a, b in [("identifier", f"`{name}`"), ("---", "---"), *rows])
    return f"## {_title(name)} {{ #{name} }}\n\n{table}\n\n{signature(name)}\n"


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


if __name__ == "__main__":
    Path("effects.md").write_text(page(), encoding="utf-8")

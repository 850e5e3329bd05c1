"""The vocabulary's 28 effects as stages of a plant, each written from its equation."""

from collections.abc import Callable, Sequence

from experiments.blind.truth.physics import actuator, joint, sensor, transmission, world
from experiments.blind.truth.physics.unknown import UNKNOWN
from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import Stages
from experiments.blind.vocabulary import PARAMETERS, Effect


def _find(name: str) -> Callable[[Effect, Stages[Plant]], None]:
    for module in (joint, actuator, transmission, world, sensor):
        if hasattr(module, name):
            return getattr(module, name)
    raise LookupError(f"no physics written for {name!r}")


INSTALL: dict[str, Callable[[Effect, Stages[Plant]], None]] = {
    name: _find(name) for name in PARAMETERS
} | UNKNOWN


def stages_of(effects: Sequence[Effect], law: str = "at once") -> Stages[Plant]:
    """Stages with all effects installed in the given order; `law`: how dry friction sets in (`joint.LAWS`)."""
    stages: Stages[Plant] = Stages(law=law)
    for effect in effects:
        INSTALL[effect.id](effect, stages)
    return stages

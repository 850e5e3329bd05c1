"""Random parameters for every effect, scaled by what the machine does in nominal motion."""

from collections.abc import Callable

from experiments.blind.draws import joint, other, unknown
from experiments.blind.draws.place import Parameters, Place
from experiments.blind.truth.physics import UNKNOWN
from experiments.blind.vocabulary import PARAMETERS, Effect

__all__ = ["DRAWS", "Place", "draw"]


def _find(name: str) -> Callable[[Place, float], Parameters]:
    for module in (joint, other, unknown):
        if hasattr(module, name):
            return getattr(module, name)
    raise LookupError(f"no parameters are drawn for {name!r}")


DRAWS: dict[str, Callable[[Place, float], Parameters]] = {
    name: _find(name) for name in (*PARAMETERS, *UNKNOWN)
}


def draw(effect: str, place: Place, size: float, unknown: bool = False) -> Effect:
    """The effect at a place, of a size (1: typical); the same place gives the same random numbers."""
    parameters: Parameters = {
        name: [float(x) for x in value] if isinstance(value, list) else float(value)
        for name, value in DRAWS[effect](place, size).items()
    }
    return Effect(effect, place.at, parameters, unknown=unknown)

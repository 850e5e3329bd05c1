"""What an effect is: its parameters, where it can act, and its equations.

Equations are written once, for NumPy and `jax.numpy` alike (`xp`), with any leading batch dimensions: theta is
[..., p], states are [..., nq]. Hooks that an effect does not need stay as they are here.

- `model`    changes fields of the MuJoCo model (native effects);
- `force`    adds forces each step, with a memory if it needs one;
- `command`  changes the command each step (delay, lag), with a memory;
- `timeline` is the same over a whole recorded timeline at once (overridden only for speed);
- `sense`    offset and delay of the measured position.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import (
    Context,
    Param,
    Place,
    all_places,
    default_places,
)
from mpge_jax.diagnosis.effects.native import SpecFields, has_form
from mpge_jax.diagnosis.effects.step import Array, Fields, Follower, Forces, Step


class Effect:
    """Base class. A new effect sets `id`, `kinds`, `params`, and one or more hooks; see `register`."""

    id: str = ""
    """Identifier; a second form of an effect carries its name after a colon and is reported without it."""
    kinds: tuple[str, ...] = ()
    side: str = "mechanical"
    """Where it stands in the chain: mechanical, actuator, or sensor."""
    order: int = 0
    """Effects apply in this order."""
    tier: int = 1
    """How plain an explanation it is; among explanations that fit alike, lower tiers are preferred."""
    equation: str = ""
    says: str = ""
    """One plain sentence for the report, with {at} for the place and the parameters by name."""
    says_less: str = ""
    """The same where the model has too much of it: the first parameter is negative then, down to what the model has,
    and {its name} tells how much too much. Empty: nothing of it is in a model."""
    remedy: str = ""
    """What recording shows the effect best."""
    confused_with: tuple[str, ...] = ()
    """Effects whose traces look much alike where recordings do not show the difference."""
    tries: tuple[float, ...] = (1.0,)
    """Starting values of the fit, each for all parameters, in their scales; small effects first."""
    vanishes_at: float = 0.0
    """Value of the parameters at which the effect vanishes."""
    runtime = False
    """Whether `force` must be called each step."""
    external = False
    """Whether `force` reads `Step.external`."""
    inertial = False
    """Whether `force` reads `Step.inertia`."""
    commands = False
    """Whether it changes the command (`command`)."""
    jagged = False
    """Whether predictions jump with the parameters (contacts), or have kinks, so that the fit must also try without
    slopes."""
    rugged = False
    """Whether parts strike each other, so that slopes say little of where the best parameters lie."""
    traced = False
    """Whether `along` tells its force where only the motion is known."""
    simulated = True
    """Whether the search by simulated windows tries it; else only where motion and force are given."""
    closer: tuple[str, ...] = ()
    """How the identifiers of its closer forms end (see `closer.Closer`), in the order in which they are tried."""
    form_of: str = ""
    """The identifier of the effect of which it is another form, with the same parameters: no candidate by itself."""
    named = True
    """Whether it is physics that a verdict names; else it corrects what is given."""
    senses = False
    """Whether it changes the measurement (`sense`)."""
    fields: tuple[str, ...] = ()
    """Model fields that `model` touches."""
    set_const = False
    """Whether derived constants must follow (masses, inertias, armature)."""

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return ()

    def places(self, ctx: Context) -> list[Place]:
        return [p for kind in self.kinds for p in default_places(ctx, kind)]

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        """Starting values [k, p] for the fit."""
        scales = np.array([p.scale for p in self.params(ctx, place)])
        return np.array([k * scales for k in self.tries])

    def containing(self, ctx: Context, place: Place, plainer: str, theta: np.ndarray) -> np.ndarray:
        """Parameters [k, p] at which it does what a plainer effect does there with theta; none where it cannot.

        Args:
            plainer: identifier of the other effect, which acts at the same place.
        """
        return np.zeros((0, len(self.params(ctx, place))))

    def detours(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Other parameters [k, p] worth a try from `theta` [p], where slopes lead the fit astray."""
        return np.outer((0.8, 0.93, 0.98, 1.02, 1.07, 1.25) if self.jagged else (), theta)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        """Change model fields; theta [..., p]."""

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        """Memory of `force` at the start of a stretch that begins in state s."""
        return ()

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Seconds [n] of recorded motion of its joint through which the memory is followed to the start of a stretch,
        for theta [n, p]; 0 where `memory` knows it from the start's state."""
        return np.zeros(len(theta))

    def follower(self, ctx: Context, place: Place, theta: np.ndarray, dt: float) -> Follower:
        """What follows the memory through a step of `dt` s of recorded motion, for theta [n, p]."""
        return lambda s, _then, memory: self.force(np, ctx, place, theta, s, memory)[1]

    def resumed(
        self,
        theta: np.ndarray,
        memory: Any,
        reached: tuple[np.ndarray, np.ndarray],
        start: tuple[np.ndarray, np.ndarray],
    ) -> tuple[Any, np.ndarray]:
        """What a run-up tells of the start of a stretch, if `rugged`.

        Args:
            memory: that the run-up ends with. reached: positions [n] and speeds [n] of its joint in which it ends.
            start: those that were estimated, from which the stretch goes on.

        Returns:
            The memory there, and the speeds [n] from which the stretch had better go on.
        """
        raise NotImplementedError

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        return Forces(), memory

    def along(self, ctx: Context, place: Place, theta: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Generalised force [T] on its joint along a recorded motion q [T, nq], memory included; if `traced`."""
        raise NotImplementedError(f"{self.id} does not follow from the motion alone")

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        return ()

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        """Command [...] that reaches the actuator in this step."""
        return u, memory

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        """`command` over a whole timeline u [n, L] of consecutive steps."""
        memory = self.command_memory(np, ctx, place, u[:, 0], dt)
        out = np.empty_like(u)
        for k in range(u.shape[1]):
            out[:, k], memory = self.command(np, theta, u[:, k], memory, dt)
        return out

    def sampled(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        """As `timeline`, at the beginnings of the steps instead of over them."""
        return self.timeline(ctx, place, theta, u, dt)

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        """(offset, delay) of the measured position of the place's joint."""
        return 0.0, 0.0

    def _groups(self, ctx: Context, place: Place) -> dict[str, list[int]]:
        """Reported name -> indices of its parameters: one, or three of a vector."""
        names = [p.name for p in self.params(ctx, place)]
        groups: dict[str, list[int]] = {}
        for i, name in enumerate(names):
            stem = name[:-2]
            joined = name[-2:] in ("_x", "_y", "_z") and all(f"{stem}_{axis}" in names for axis in "xyz")
            groups.setdefault(stem if joined else name, []).append(i)
        return groups

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters [..., p] as the vocabulary names them: name -> value [...] or vector [..., 3]."""
        groups = self._groups(ctx, place)
        return {name: theta[..., i if len(i) > 1 else i[0]] for name, i in groups.items()}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        """Inverse of `report`: theta [p].

        Raises:
            KeyError, ValueError: a parameter is missing, or is no number or vector of three.
        """
        theta = np.zeros(len(self.params(ctx, place)))
        for name, i in self._groups(ctx, place).items():
            theta[i] = np.asarray(values[name], dtype=float).reshape(len(i))
        return theta

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        params = self.params(ctx, place)
        return {name: params[i[0]].unit for name, i in self._groups(ctx, place).items()}

    def naming(self, ctx: Context, place: Place) -> list[int]:
        """Indices of the parameters of which at least one must differ from `null` for the effect to exist."""
        return self._first(ctx, place)

    def vector(self, ctx: Context, place: Place) -> list[int]:
        """Indices of the parameters that are components of one vector, which is at `null` where there is no effect."""
        first = self._first(ctx, place)
        return first if len(first) > 1 else []

    def _first(self, ctx: Context, place: Place) -> list[int]:
        """Indices of the parameters of what is reported first."""
        return next(iter(self._groups(ctx, place).values()), [])

    def contrasts(self, ctx: Context, place: Place) -> np.ndarray:
        """Combinations [k, p] of the parameters of which at least one must differ from its value at `null` for this to
        be the effect, and not a plainer one that it contains: by default each of `naming` by itself."""
        return np.eye(len(self.params(ctx, place)))[self.naming(ctx, place)]

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        """Parameters at which the effect vanishes."""
        return np.full(len(self.params(ctx, place)), self.vanishes_at)

    def export(self, spec: mujoco.MjSpec, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        """Add the native MJCF form to a compiled spec. Returns False where MuJoCo has none."""
        if self.runtime or self.commands or self.senses or not has_form(self.fields):
            return False
        self.model(SpecFields(spec), ctx, place, theta)
        return True

    def sentence(self, place: Place, values: dict[str, Any], less: bool = False) -> str:
        """One plain sentence for the report; `values` are formatted parameters, of what the model has too much of if it
        is `less`."""
        at = "the whole machine" if place.kind == "world" else place.name
        says = self.says_less if less else self.says
        if says:
            return says.format(at=at, **values)
        shown = ", ".join(f"{k} {v}" for k, v in values.items())
        return f"{at} has {self.id.replace('_', ' ')} that the model lacks ({shown})."


class Registry(dict[str, "Effect"]):
    """Effects by identifier.

    Attributes:
        families: of effects without number, by what their identifiers begin with: they are made from their identifiers
            and are not listed. forms: the same, by what they end with.
    """

    def __init__(self) -> None:
        super().__init__()
        self.families: dict[str, Callable[[str], Effect]] = {}
        self.forms: dict[str, Callable[[str], Effect]] = {}

    def __missing__(self, name: str) -> Effect:
        family = self.families.get(name.partition(":")[0])
        return self.forms[name.rpartition(":")[2]](name) if family is None else family(name)


REGISTRY = Registry()


def register(effect: type[Effect]) -> type[Effect]:
    """Class decorator: add an effect to the vocabulary. It is then screened, fitted, reported and exported."""
    instance = effect()
    if not instance.id or not instance.kinds:
        raise ValueError(f"{effect.__name__} must set 'id' and 'kinds'.")
    if instance.id in REGISTRY and type(REGISTRY[instance.id]).__qualname__ != effect.__qualname__:
        raise ValueError(f"an effect named '{instance.id}' exists already.")
    REGISTRY[instance.id] = instance
    return effect


def find_place(ctx: Context, effect: Effect, name: str, kind: str | None = None) -> Place:
    """The place of that name, of a kind, or of the first on which the effect acts."""
    for which in (k for k in effect.kinds if kind in (None, k)):
        for place in all_places(ctx, which):
            if place.name == name:
                return place
    raise ValueError(
        f"{effect.id} cannot act at '{name}': the model has no such {' or '.join(effect.kinds)}."
    )

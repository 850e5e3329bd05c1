"""What is drawn: which cases there shall be, and of each its machine and its hidden physics."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.blind.case import Bench, Unfit, draw_as_is, draw_visible
from experiments.blind.robots.models import ROBOTS, Robot
from experiments.blind.truth.machine import Machine, Plan
from experiments.blind.truth.physics import UNKNOWN
from experiments.blind.truth.sensors import draw_sensors
from experiments.blind.vocabulary import ACTUATOR, DRY_FRICTION, PARAMETERS, SENSOR, TRANSMISSION, Effect

KINDS = ("multisine", "chirp", "slow", "steps")
FAMILIES = (
    (*DRY_FRICTION, "viscous_damping", "quadratic_drag"),
    ACTUATOR,
    SENSOR,
    TRANSMISSION,
    ("payload_mass", "mass_scale", "com_offset", "armature"),
    ("gravity_tilt", "external_force", "joint_stiffness", "cogging_torque"),
    ("contact_friction", "contact_stiffness"),
)
#: Not combined: alone they are already a question of which of two twins it is.
ALONE = ("back_emf", "gravity_tilt", "encoder_offset", "sensor_delay", "dead_actuator")


@dataclass(frozen=True)
class Wish:
    """What one case shall be: its kind and the effects asked for (identifiers)."""

    kind: str  # single | pair | triple | unknown | null | mixed | whole
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Counts:
    """How many cases: `repeats` of every effect alone, two and three effects at once, unknown physics, nothing."""

    repeats: int = 4
    pairs: int = 28
    triples: int = 4
    unknown: int = 24
    nulls: int = 36
    mixed: int = 0
    """One effect beside unknown physics."""
    whole: int = 0
    """Arms with friction and rotor inertia in every joint, and a payload."""
    lifelike: bool = False
    """A third of the machines are generated at random, models and logs have what real ones have
    (`circumstances.py`), and sizes are kept as drawn, visible or not."""


def wishes(rng: np.random.Generator, counts: Counts) -> list[Wish]:
    """All cases of a benchmark, shuffled so that a case's number says nothing."""
    out = [Wish("single", (effect,)) for effect in PARAMETERS for _ in range(counts.repeats)]
    for count, kind, size in ((counts.pairs, "pair", 2), (counts.triples, "triple", 3)):
        drawn = 0
        while drawn < count:
            families = rng.choice(len(FAMILIES), size, replace=False)
            allowed = [[e for e in FAMILIES[f] if e not in ALONE] or list(FAMILIES[0]) for f in families]
            wish = Wish(kind, tuple(str(rng.choice(effects)) for effects in allowed))
            if any(all(effect in robot.places for effect in wish.effects) for robot in ROBOTS.values()):
                out.append(wish)
                drawn += 1
    strange = list(UNKNOWN)
    out += [Wish("unknown", (strange[i % len(strange)],)) for i in range(counts.unknown)]
    out += [Wish("null")] * counts.nulls
    for i in range(counts.mixed):
        known = [e for e in PARAMETERS if e not in ALONE]
        at = [
            n
            for n in known
            if any(n in r.places and strange[i % len(strange)] in r.places for r in ROBOTS.values())
        ]
        out.append(Wish("mixed", (str(rng.choice(at)), strange[i % len(strange)])))
    out += [Wish("whole")] * counts.whole
    return [out[i] for i in rng.permutation(len(out))]


def draw_machine(robot: Robot, wish: Wish, xml: Path, rng: np.random.Generator) -> Machine:
    """Everything about the machine but its hidden physics."""
    dt, integrator = robot.steps[rng.integers(len(robot.steps))]
    if set(wish.effects) & {*TRANSMISSION}:
        dt = min(dt, 0.00025)
    force = True if "back_emf" in wish.effects and rng.random() < 0.75 else None
    if robot.name == "pendulum" and set(wish.effects) & {"actuator_delay", "sensor_delay"}:
        force = rng.random() < 0.75
    low, high = robot.duration
    names = [f"rec_{i}" for i in range(len(KINDS))] + ["heldout_0", "heldout_1"]
    kinds = [*KINDS, "mix", str(rng.choice(["multisine", "mix"]))]
    plans = tuple(
        Plan(name, kind, float(rng.uniform(low, high)), int(rng.integers(2**31)))
        for name, kind in zip(names, kinds, strict=True)
    )
    return Machine(
        robot=robot,
        xml=xml,
        dt=dt,
        integrator=integrator,
        period=float(rng.choice(robot.periods)),
        bandwidth=robot.bandwidth * float(rng.uniform(0.8, 1.2)),
        sensors=draw_sensors(rng, force),
        plans=plans,
        open_loop=robot.open_loop and wish.kind not in ("unknown", "mixed") and rng.random() < 0.25,
    )


def draw_effects(bench: Bench, wish: Wish, rng: np.random.Generator, as_is: bool = False) -> list[Effect]:
    """The wished effects at random places, each visible by itself, or (`as_is`) of whatever size was drawn."""
    robot = bench.machine.robot
    if wish.kind == "whole":
        return _in_every_joint(bench, rng)
    effects: list[Effect] = []
    for name in wish.effects:
        free = [at for at in robot.places[name] if at not in {e.at for e in effects} or at == "world"]
        if not free:
            raise Unfit("no place left for another effect")
        at = str(rng.choice(free))
        find = draw_as_is if as_is else draw_visible
        effects.append(find(bench, name, at, rng, unknown=name in UNKNOWN))
    together = bench.look(effects) if len(effects) > 1 else None
    if len(effects) > 1 and (together is None or together.share > 2):
        raise Unfit("together they change the motion beyond recognition")
    return effects


def _in_every_joint(bench: Bench, rng: np.random.Generator) -> list[Effect]:
    """Dry or viscous friction and rotor inertia in every joint, a payload at the end: what robots lack altogether."""
    places = bench.machine.robot.places
    friction = [
        draw_as_is(bench, str(rng.choice(["coulomb_friction", "viscous_damping"])), at, rng)
        for at in places["coulomb_friction"]
    ]
    inertia = [draw_as_is(bench, "armature", at, rng) for at in places["armature"]]
    return [*friction, *inertia, draw_as_is(bench, "payload_mass", places["payload_mass"][-1], rng)]


def fits(robot: Robot, wish: Wish) -> bool:
    """Whether a machine has places for what is wished."""
    if wish.kind == "whole":
        arm = {"coulomb_friction", "viscous_damping", "armature", "payload_mass"} <= set(robot.places)
        return arm and robot.controller in ("torque", "servo")
    return all(effect in robot.places for effect in wish.effects)

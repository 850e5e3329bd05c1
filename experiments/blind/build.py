"""Draws the cases: models and recordings in one folder, answers in another one that the engine never sees."""

import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from experiments.blind.case import Bench, Unfit, answer, draw_visible
from experiments.blind.robots.models import ROBOTS, Robot
from experiments.blind.truth.machine import Machine, Plan, write_recording
from experiments.blind.truth.physics import UNKNOWN
from experiments.blind.truth.plant import Unstable
from experiments.blind.truth.sensors import draw_sensors
from experiments.blind.vocabulary import ACTUATOR, DRY_FRICTION, PARAMETERS, SENSOR, TRANSMISSION, Effect

KINDS = ("multisine", "chirp", "slow", "steps")
ATTEMPTS = 60
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

    kind: str  # single | pair | triple | unknown | null
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Counts:
    """How many cases: `repeats` of every effect alone, two and three effects at once, unknown physics, nothing."""

    repeats: int = 4
    pairs: int = 28
    triples: int = 4
    unknown: int = 24
    nulls: int = 36


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
        open_loop=robot.open_loop and wish.kind != "unknown" and rng.random() < 0.25,
    )


def draw_effects(bench: Bench, wish: Wish, rng: np.random.Generator) -> list[Effect]:
    """The wished effects at random places, each visible by itself."""
    robot = bench.machine.robot
    effects: list[Effect] = []
    for name in wish.effects:
        free = [at for at in robot.places[name] if at not in {e.at for e in effects} or at == "world"]
        if not free:
            raise Unfit("no place left for another effect")
        at = str(rng.choice(free))
        effects.append(draw_visible(bench, name, at, rng, unknown=wish.kind == "unknown"))
    together = bench.look(effects) if len(effects) > 1 else None
    if len(effects) > 1 and (together is None or together.share > 2):
        raise Unfit("together they change the motion beyond recognition")
    return effects


def build_case(
    wish: Wish,
    folder: Path,
    seed: list[int],
    used: dict[str, int],
    robots: Sequence[Robot] = tuple(ROBOTS.values()),
) -> dict:
    """Write one case into `folder` and return its answer. `used` counts machines, so that all of them occur."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    fit = [r for r in robots if all(e in r.places for e in wish.effects)]
    if not fit:
        raise Unfit(f"no machine has a place for {wish.effects}")
    folder.mkdir(parents=True, exist_ok=True)
    xml = folder / "model.xml"
    tries: Counter[str] = Counter()
    for _ in range(ATTEMPTS):
        robot = min(
            fit, key=lambda r: (used.get(r.name, 0) + 2 * tries[r.name] + rng.uniform(0, 2.5), r.name)
        )
        tries[robot.name] += 1
        xml.write_text(robot.spec().to_xml())
        machine = draw_machine(robot, wish, xml, rng)
        try:
            bench = Bench.of(machine)
            effects = draw_effects(bench, wish, rng)
            runs = {plan.name: machine.record(plan, effects) for plan in machine.plans}
        except (Unfit, Unstable):
            continue
        used[robot.name] = used.get(robot.name, 0) + 1
        (folder / "recordings").mkdir(exist_ok=True)
        for name, run in runs.items():
            write_recording(folder / "recordings" / f"{name}.npz", run, machine.sensors, rng)
        return answer(bench, wish.kind, effects)
    raise Unfit(f"{wish.kind} case {wish.effects} was not drawn in {ATTEMPTS} attempts")


def _built(wish: Wish, folder: Path, seed: int, number: int, counts: Counts, used: dict[str, int]) -> dict:
    """The wished case; two or three effects that cannot be drawn together give way to others."""
    for retry in range(4):
        try:
            return build_case(wish, folder, [seed, 1, number, retry], used)
        except Unfit:
            if retry == 3:
                raise
            if wish.kind in ("pair", "triple"):
                others = wishes(np.random.default_rng([seed, 2, number, retry]), counts)
                wish = next(other for other in others if other.kind == wish.kind)
    raise AssertionError("unreachable")


def build(
    out: Path,
    answers: Path,
    seed: int,
    counts: Counts | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Write all cases into `out` and their answers into `answers`; returns how many. Finished cases are kept.

    Raises ValueError when `answers` belongs to another seed or other counts.
    """
    counts = counts or Counts()
    plan = {"seed": seed, **asdict(counts)}
    out.mkdir(parents=True, exist_ok=True)
    answers.mkdir(parents=True, exist_ok=True)
    note = answers / "plan.json"
    if note.exists() and json.loads(note.read_text()) != plan:
        raise ValueError(
            f"{answers} holds the answers of another seed or other counts; choose another folder"
        )
    note.write_text(json.dumps(plan, indent=1))
    wanted = wishes(np.random.default_rng([seed, 0]), counts)
    used: dict[str, int] = {}
    for number, wish in enumerate(wanted):
        name = f"case_{number:03d}"
        target = answers / f"{name}.json"
        if target.exists():
            model = json.loads(target.read_text())["model"]
            used[model] = used.get(model, 0) + 1
        else:
            shutil.rmtree(out / name, ignore_errors=True)
            result = _built(wish, out / name, seed, number, counts, used)
            partial = target.with_suffix(".partial")
            partial.write_text(json.dumps({"case": name, **result}, indent=1))
            partial.rename(target)
        if progress is not None:
            progress(number + 1, len(wanted))
    return len(wanted)

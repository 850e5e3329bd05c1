"""Draws the cases: models and recordings in one folder, answers in another one that the engine never sees."""

import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from experiments.blind.case import Bench, Unfit, answer
from experiments.blind.circumstances import Circumstances, draw_circumstances
from experiments.blind.robots.models import ROBOTS, Robot
from experiments.blind.robots.trees import random_tree
from experiments.blind.truth.machine import columns_of
from experiments.blind.truth.plant import Unstable
from experiments.blind.truth.simulate import Trajectory
from experiments.blind.wishes import Counts, Wish, draw_effects, draw_machine, fits, wishes

ATTEMPTS = 60
TREES = 1 / 3  # of the machines of lifelike cases are generated at random


def build_case(
    wish: Wish,
    folder: Path,
    seed: list[int],
    used: dict[str, int],
    robots: Sequence[Robot] = tuple(ROBOTS.values()),
    lifelike: bool = False,
) -> tuple[dict, dict[str, Trajectory]]:
    """Write one case into `folder`; returns its answer and the recordings that only judge it.

    Args:
        used: counts machines, so that all of them occur. lifelike: see `Counts`.

    Raises:
        Unfit: it cannot be drawn.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    fit = [r for r in robots if fits(r, wish)]
    if not fit:
        raise Unfit(f"no machine has a place for {wish.kind} {wish.effects}")
    folder.mkdir(parents=True, exist_ok=True)
    xml = folder / "model.xml"
    tries: Counter[str] = Counter()
    for _ in range(ATTEMPTS):
        grown = random_tree(rng) if lifelike and rng.random() < TREES else None
        if grown is not None and fits(grown, wish):
            robot = grown
        else:
            robot = min(
                fit, key=lambda r: (used.get(r.name, 0) + 2 * tries[r.name] + rng.uniform(0, 2.5), r.name)
            )
        tries[robot.name] += 1
        xml.write_text(robot.spec().to_xml())
        machine = draw_machine(robot, wish, xml, rng)
        as_found = draw_circumstances(rng, machine, wish.kind != "null") if lifelike else Circumstances()
        machine = replace(machine, period=as_found.period or machine.period)
        try:
            bench = Bench.of(machine)
            effects = draw_effects(bench, wish, rng, lifelike)
            runs = {plan.name: machine.record(plan, effects) for plan in machine.plans}
            judging = {plan.name: machine.record(plan, effects) for plan in machine.judging}
        except (Unfit, Unstable):
            continue
        used[robot.name] = used.get(robot.name, 0) + 1
        (folder / "recordings").mkdir(exist_ok=True)
        for name, run in runs.items():
            columns = as_found.logged(columns_of(run, machine.sensors, rng), rng)
            _save(folder / "recordings" / f"{name}.npz", columns)
        told = answer(bench, wish.kind, effects, as_found.ways(effects))
        xml.write_text(as_found.given(robot.spec(), rng))
        return told, judging
    raise Unfit(f"{wish.kind} case {wish.effects} was not drawn in {ATTEMPTS} attempts")


def _save(path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savez_compressed(path, allow_pickle=False, **columns)


def _built(
    wish: Wish, folder: Path, seed: int, number: int, counts: Counts, used: dict[str, int]
) -> tuple[dict, dict[str, Trajectory]]:
    """The wished case; two or three effects that cannot be drawn together give way to others."""
    for retry in range(4):
        try:
            return build_case(wish, folder, [seed, 1, number, retry], used, lifelike=counts.lifelike)
        except Unfit:
            if retry == 3:
                raise
            if wish.kind in ("pair", "triple", "mixed"):
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
            result, judging = _built(wish, out / name, seed, number, counts, used)
            for run, seen in judging.items():
                columns = {"time": seen.time, "qpos": seen.qpos, "qvel": seen.qvel, "ctrl": seen.ctrl}
                _save(answers / f"{name}_{run}.npz", columns)
            partial = target.with_suffix(".partial")
            partial.write_text(json.dumps({"case": name, **result}, indent=1))
            partial.rename(target)
        if progress is not None:
            progress(number + 1, len(wanted))
    return len(wanted)

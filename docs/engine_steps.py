"""What the diagnosis of cases costs: engine steps (the same on every machine), CPU seconds, and the answers.

    python -m experiments.blind build --out blind --seed 47 --repeats 1 --pairs 8 --triples 2 --unknown 8 --nulls 5
    python docs/engine_steps.py run blind/cases before        # from a checkout of the one revision
    python docs/engine_steps.py run blind/cases after         # from a checkout of the other
    python docs/engine_steps.py table before after

The cases run one after the other in one process on one thread; those that OUT holds already are not run again.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mujoco.batch import Batch

SECOND_HALF = 2
"""The stage of a step whose first half is counted."""
HEADER = (
    "| case | verdict | effects | engine steps before | after | share | CPU s before | after | moved by |",
    "|---|---|---|---|---|---|---|---|---|",
)


@contextmanager
def counted() -> Iterator[list[int]]:
    """Counts the steps of all simulations in the first entry, of any revision."""
    steps, step, rollout = [0], Batch.step, Batch.rollout

    def stepped(self: Batch, ids: Any = None, nstep: int = 1, stage: int = 0) -> Any:
        steps[0] += (self.nsim if ids is None else np.size(ids)) * nstep * (stage != SECOND_HALF)
        return step(self, ids, nstep, stage)

    def rolled_out(self: Batch, nstep: int, *args: Any, **options: Any) -> Any:
        steps[0] += self.nsim * nstep
        return rollout(self, nstep, *args, **options)

    Batch.step, Batch.rollout = stepped, rolled_out
    try:
        yield steps
    finally:
        Batch.step, Batch.rollout = step, rollout


def run(cases: Path, out: Path, names: list[str]) -> None:
    """Write OUT/<case>.json for every case, or for those named."""
    from mpge_jax.diagnosis import Config, diagnose

    out.mkdir(parents=True, exist_ok=True)
    for name in names or sorted(path.parent.name for path in cases.glob("*/model.xml")):
        note = out / f"{name}.json"
        if note.exists():
            continue
        with counted() as steps:
            began = time.process_time()
            config = Config(seed=0, jobs=1, quiet=True)
            answer = diagnose(cases / name / "model.xml", cases / name / "recordings", config).to_json()
            row = {"case": name, "steps": steps[0], "cpu": time.process_time() - began, "answer": answer}
        partial = note.with_suffix(".partial")
        partial.write_text(json.dumps(row))
        partial.rename(note)


def effects(answer: dict[str, Any]) -> list[str]:
    """Those that are named, and those among which the recordings cannot decide."""
    named = [f"{e['id']}@{e['at']}" for e in answer["effects"]]
    either = [
        "(" + " or ".join("+".join(f"{e['id']}@{e['at']}" for e in c) for c in a["candidates"]) + ")"
        for a in answer["ambiguous"]
    ]
    return sorted(named) + sorted(either)


def moved(before: dict[str, Any], after: dict[str, Any]) -> float:
    """By how many of its deviations the parameter moved that moved most."""
    then = {(e["id"], e["at"]): e["parameters"] for e in before["effects"]}
    most = 0.0
    for e in after["effects"]:
        for name, new in e["parameters"].items():
            old = then[e["id"], e["at"]][name]
            parts = (
                x if isinstance(x, list) else [x]
                for x in (old["value"], new["value"], old["low"], old["high"])
            )
            for a, b, low, high in zip(*parts, strict=True):
                if None not in (a, b, low, high) and high > low:
                    most = max(most, abs(b - a) / ((high - low) / 3.92))
    return most


def table(before: Path, after: Path) -> str:
    """The cases that both folders hold, as Markdown; a case with another answer has both of them."""
    lines, sums, alike = list(HEADER), [0.0] * 4, 0
    pairs = [(p, after / p.name) for p in sorted(before.glob("*.json")) if (after / p.name).exists()]
    for old, new in pairs:
        a, b = (json.loads(path.read_text()) for path in (old, new))
        x, y = a["answer"], b["answer"]
        same = x["verdict"] == y["verdict"] and effects(x) == effects(y)
        verdict = x["verdict"] if same else f"{x['verdict']}; now {y['verdict']}"
        what = ", ".join(effects(x)) if same else f"{', '.join(effects(x))}; now {', '.join(effects(y))}"
        figures = [a["steps"], b["steps"], a["cpu"], b["cpu"]]
        sums, alike = [s + f for s, f in zip(sums, figures, strict=True)], alike + same
        shift = f"{moved(x, y):.2f}" if same and x["effects"] else ""
        lines.append(
            f"| {a['case']} | {verdict} | {what} | {a['steps']} | {b['steps']} | {b['steps'] / a['steps']:.2f} | "
            f"{a['cpu']:.1f} | {b['cpu']:.1f} | {shift} |"
        )
    total = f"{sums[0]:.0f} | {sums[1]:.0f} | {sums[1] / max(sums[0], 1):.2f} | {sums[2]:.0f} | {sums[3]:.0f}"
    lines.append(f"| {len(pairs)} cases | {alike} with the same verdict and names | | {total} | |")
    return "\n".join(lines)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["run", cases, out, *names]:
            run(Path(cases), Path(out), names)
        case ["table", before, after]:
            print(table(Path(before), Path(after)))
        case _:
            sys.exit(__doc__)

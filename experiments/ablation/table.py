"""The table of docs/ablation.md: every rule with its numbers, and what the answers are without it."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.ablation.compared import NEEDED_BY, Case, Effect, acted, effect, note
from experiments.ablation.one import ALL
from experiments.ablation.rules import GATES

LITTLE = 0.01
"""Share of the cases whose answers a rule must change to be one that decides anything."""
HEAD = """Each rule of the diagnosis that decides which effects are reported of
a driven machine was switched off by itself. Where a rule, switched off, changes nothing that its
function returns, the diagnosis is the same, and was not run again. An answer is changed if its verdict, a name or a
place is another one; it is better or worse with the rule by its mark, then by how few certain wrong names it has. The
cases of a rule that is known to be needed (as many better ones would be chance with a probability below {by:g}) were
not all run.

    {command}

{count} cases, all of seeds for building and tuning, a third of those of the second seed of machines drawn at random;
and {machines} public machines, on which it was watched which rules act. Rules are ordered by what they do; of those
that are not all run, the figures are of the cases that were.

| rule | what it is for | numbers | acted: machines | cases | run without | changed | better with it | worse with it | |
|---|---|---|--:|--:|--:|--:|--:|--:|---|
"""

BEGIN, END = "<!-- begin of the table of rules -->", "<!-- end of the table of rules -->"
LATER = ("face value", "adding", "beside unknown", "given up")
"""Rules that came after these cases were diagnosed: what they did is told in words."""


def verdict(cases: int, e: Effect) -> str:
    """What is to be said of a rule after so many cases, in a few words."""
    if e.needed:
        return "needed"
    if e.changed + e.cases - e.run < LITTLE * cases:
        return "fewer than 1 % change"
    if e.run < e.cases:
        return "not all run"
    return "no better without it" if e.better > e.worse else "no worse without it"


def text(out: Path, cases: list[Case], command: str) -> str:
    """What stands between the marks, from what was run so far."""
    known = {c: acted(out, c) for c in cases if note(out, ALL, c).exists()}
    machines = [set(json.loads(p.read_text())) for p in sorted((out / "public").glob("*.json"))]
    rows = []
    for g in (g for g in GATES if g.name not in LATER):
        e = effect(out, g.name, known)
        word = verdict(len(known), e)
        numbers = ", ".join(f"`{n}`" for n in g.numbers)
        there = sum(g.name in acts for acts in machines)
        figures = f"{there} | {e.cases} | {e.run} | {e.changed} | {e.better} | {e.worse}"
        rows.append(
            (e.worse - e.better, -e.changed, f"| {g.name} | {g.meaning} | {numbers} | {figures} | {word} |")
        )
    head = HEAD.format(by=NEEDED_BY, command=command, count=len(known), machines=len(machines))
    return head + "\n".join(row for _, _, row in sorted(rows))

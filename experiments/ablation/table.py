"""docs/ablation.md: every rule with its numbers, and what the answers are without it."""

from __future__ import annotations

import json
from pathlib import Path

from experiments.ablation.compared import NEEDED_BY, Case, Effect, acted, effect, note
from experiments.ablation.one import ALL
from experiments.ablation.rules import GATES

LITTLE = 0.01
"""Share of the cases whose answers a rule must change to be one that decides anything."""
HEAD = """# Which rules decide anything

Written by `experiments.ablation`. Each rule of the diagnosis that decides which effects are reported of
a driven machine was switched off by itself. A rule that changed no answer of the function where it acts cannot have
changed the diagnosis, so cases were diagnosed again only where it did. An answer is changed if its verdict, a name or a
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

GONE = """
Gone, before these cases were diagnosed, as one likelihood ratio does as well (58 of them before and after: the
answers of three changed, two for the better, one for the worse): that windows gain by three standard errors, or by
1.8 beside known effects, and by a ratio of their own; that large gains in few windows count, and what stands out in
several; slight differences as ties; and other standard errors wherever something is confirmed.

Gone by these cases, as without them fewer than 1 % of the answers change, none for the worse, and as they acted on
none of 13 public machines: second effects tried beside several first ones, the nearest alternative compared under
its own noise, and that an added mass may tie with a direction more (they acted in four cases, of which two answers
changed without all three, by no mark); a least excess over what noise leaves (three cases, one changed, by no
mark); that one degree of freedom may show more than noise by itself (three cases, one changed, for the better).
Gone earlier, as they changed nothing in 121 diagnoses of 79 of these cases: that a joint's loss falls by a share of
it, that delays last a timestep, that differences and what is left count by ranks too, a higher noise beside known
effects, known effects led out of a local minimum by a further one, two effects that convince only together.

Kept though fewer than 1 % change: one joint's loss alone keeps a search going (without it, what one joint of many
lacks ended as `none`); that a further effect moves predictions (a certain wrong name without it); and what a report
promises, whatever the cases: that effects are confirmed by recordings that chose nothing and by test recordings,
and that a large error is not nothing.

Came later: where the better hypothesis leaves noise alone, gains of few windows count for what they are (`face
value`). 61 of these cases (all nulls and all unknown physics among them) with it, and with rows of commands told by the
likelihood and removals weighed together: one answer is another one, a drive that saturates now and then, named now.

Later still, a factor near one for every given mass and inertia is a candidate as well, which names no physics. Of
the 13 single effects of machines whose given masses are off by 3 %, in `build --seed 62 --repeats 3 --pairs 6
--triples 0 --unknown 0 --nulls 10 --mixed 6 --whole 6 --lifelike`, with and without it: answers right 10 and 9,
certain wrong names none and one, true parameters within their intervals 18 of 19 and 14 of 19.

Last came that an effect goes with which far more force is missing than without (`adding`): on an arm with springs that
are in no vocabulary, far too much inertia was named with a remainder of 36 times the noise, and on another one uneven
friction; without them the function that models what is left brings the second one's held-out error down 150 times. In
18 other diagnoses that were watched (building cases, machines of another author, two public ones) the usual missing
force with an effect was at most 1.35 times that without it; with those effects it was 30 times and more.

Then came that an unknown force is asked what it explains alone (`beside unknown`): a share of one drive's force at
another joint, on a leg of another author, had been four effects that left 17 times the noise; as one function of that
drive's force it leaves 1.2 times. Of 12 building cases with something known beside something unknown, one more known
effect is named (a late drive, hidden by a coupling of two joints), and no right name was given up. And several windows
count as far (`far windows`) from twice the largest loss on that noise leaves in any, where it was a loss of 5 and more:
kicks at one joint of an arm, unseen beside a known effect until then, are told; all of 20 building cases without any
effect are still `none`.

Then came that an effect is in doubt of which the interval that is reported holds that there is none (`may be none`): of
80 effects that were reported in 49 diagnoses of building cases and of cases of another author two were of that kind,
and both were no part of the truth. That a fit tells which effects masses pass for (`as given`) took the place of a list
of six of them.

Then a mass at one body is tried beside friction, damping and rotor inertia in every joint (`every joint`). Of
`build --seed 66 --repeats 0 --pairs 0 --triples 0 --unknown 0 --nulls 0 --whole 20 --lifelike` a servo arm (case 003)
that lacks all that had been told to have weaker drives, a force and a moved centre of mass, and something unknown;
eight of its nine effects are named now, and nothing else. A geared arm and another servo arm of that set (000, 007) are
answered as before.

Then names go beside which a function of what has no name could not be told (`given up`): where the function without
them leaves less than half of the squared error. On a table that tilts, of another author, a magnet had been cogging
in part, and its function brought the test error down 1.86 times beside that; without it, 22 times. Of five building
cases with something known beside something unknown (`build --seed 64 --repeats 0 --pairs 0 --triples 0 --unknown 24
--nulls 0 --mixed 36 --lifelike`, cases 002, 011, 019, 025 and 037) one changed: a back-EMF that was no part of the
truth went, and the error with the function is .0053 in place of .018 rad. What names were given up for is
`unexplained`, however slight: without that the same case ended with a remainder of 1.9 %, told and not modelled.
That was revision b14a66e. Since functions are told by whole recordings and as finely as windows show, the magnet's
brings the error down 14 times beside the cogging, which stays as something that may be a part of it.

Then effects are confirmed by predictions in the timestep and integrator that recordings show (`steps as seen`). Of
`build --seed 45 --repeats 0 --pairs 6 --triples 4 --unknown 8 --nulls 6 --mixed 10 --whole 12 --lifelike` a servo arm
(case 004) that moves in half the model's steps was told nine right effects, and something unknown: what its steps miss
(1 mrad) is more than the last rotor inertia explains, which so went and was missed. All nine are named now, and
nothing else. On an arm of another author a moved centre of mass is certain now, for the same reason. Closer forms of
an effect are fitted where a first look moves predictions like any further effect does (`moves`), and factors of the
given masses are tried beside friction, damping and rotor inertia in every joint (`every joint`): two arms of four and
six joints of that author, of which masses are off by 2 %, take 126 and 152 s of one core in place of 391 and more than
580, with the same names, all right. When `moves` was asked a second time, of the whole fit, the public XL330 servo
kept the plain law (median error 0.0354 rad); by evidence alone it gets the one that falls (0.0307). The arm of six
joints has the same answer after the same 65 s.

Then one joint's loss keeps a search going beside known effects too, and where the floor is simulated by what the truth
would leave of that joint (`loud`): of that set a half cheetah (case 032) lacked dry friction of 0.76 N m at one of nine
joints beside another effect (there 2.5 to 2.8 times the noise, 1.1 times in the mean); it is named now.

Alternatives are compared beside the same now: each begins with what stands beside the effect as it stands there, and
beside many effects all that a sample of windows does not speak against are fitted to the end, where one was. Of twelve
cases of another author a rotary pendulum lacks rotor inertia at its upright axis, where the inertia of a body does the
same: a moved centre of mass had been certain, with odds of more than a million to 1 against rotor inertia, which at its
best leaves the same (the logarithm of that ratio is 0.2 in place of 19); now it is told that the two cannot be told
apart. Of the other eleven ten were answered, by this revision or the one before, none with a certain wrong name. Two
servo arms of building cases have nine right effects of nine, as before; two mixed ones are answered as before.

Components of a vector are nothing where their intervals hold that (`without_open_components`): on a ball on a beam of
that author gravity had been tilted by 0.11 rad, nearly all of it about an axis about which nothing turns; it is 0.028
rad now, as it is.

Tried and not kept: ranks in place of a mean that is in doubt (two windows slip, the others differ by next to nothing:
a certain wrong answer); searching longer windows also where the shorter ones leave nothing (four cases, no answer
better; on a balancing robot, which no one can predict for long, three wrong names in place of one);
where the motion is given, functions of how far a joint went since it turned (on brfd, kinova_gen3 and
panda_bag, no steady gain on test recordings); weak or late drives of all joints at once, beside friction, damping
and rotor inertia. Weak drives together imitate a mass (on two of six arms that lack something in every joint the
names became wrong), and delays of all drives are, in a log, those of all sensors. Where the motion is given: factors of
given masses as a candidate (never chosen on kinova_gen3, panda_bag and ur10_bag: on stretches that were not fitted to
the ratio was against them), and that any chosen effect may give way to a rival that predicts better (on kinova_gen3
the test error rose from 0.62 to 0.75 N m).
"""


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


def page(out: Path, cases: list[Case], command: str) -> str:
    """The page, from what was run so far."""
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
    return head + "\n".join(row for _, _, row in sorted(rows)) + "\n" + GONE

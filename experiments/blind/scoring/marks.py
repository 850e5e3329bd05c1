"""Marking one case: what was named against what was hidden.

Full mark: verdict `effects` with exactly the true (id, at); or `ambiguous` between the truth and effects that are
identical to it in principle (the answer file lists them as twins).
Beside unknown physics (`mixed`) the known part counts: all of it named, whatever the verdict, and nothing else for
certain. Where every joint lacks something (`whole`), the share that is named, less what is named wrongly.
Half mark: `ambiguous` with the truth among at most three candidates; a twin named alone; and, where the contract asks
for `ambiguous` (`coin`), the truth named alone, because the data cannot have told.
A dead actuator reported as a gain of 0 is a wrong name: the contract gives it its own.
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field

from experiments.blind.scoring.parameters import Compared, compare

MOST_CANDIDATES = 3
SEEN = 12.0
"""Window error over what noise explains from which on an effect is visible."""
INERTIAL = frozenset({"mass_scale", "payload_mass", "com_offset", "armature"})
"""What is truly missing beside anything else where the given model's masses and inertias are off."""
Named = tuple[str, str]


@dataclass
class Mark:
    """One marked case. `exact` is 0, 0.5 or 1; `place` says whether the leading effect is in the right place."""

    case: str
    kind: str
    model: str
    truth: list[Named]
    answer: str
    verdict: str
    seconds: float
    exact: float = 0.0
    place: bool = False
    parameters: list[Compared] = field(default_factory=list)
    drop: float | None = None
    failed: bool = False
    alarm: bool = False  # null cases: an effect was reported
    located: bool = False  # unknown cases: `unexplained`, at the right place
    concealed: list[str] = field(default_factory=list)
    visible: bool = True  # every hidden effect stands out of what noise explains
    seen: float = 0.0  # by how much the least of them does
    wrong: list[Named] = field(default_factory=list)  # named for certain, and neither true nor a twin
    # errors of recordings that only the scorer has: before, after, and with the sizes of a rival that was told names
    judged: tuple[float, float] | None = None
    told: float | None = None


def judge(answer: dict, report: dict | None, seconds: float) -> Mark:
    """Mark one case; `report` is its diagnosis.json, None when the run failed."""
    hidden = answer["effects"] + answer["unknown"]
    mark = Mark(
        case=answer["case"],
        kind=answer["kind"],
        model=answer["model"],
        truth=[(e["id"], e["at"]) for e in hidden],
        answer="(no report)",
        verdict="failed",
        seconds=seconds,
        failed=report is None,
        concealed=answer["concealed"],
    )
    if answer.get("visibility"):
        mark.seen = min(answer["visibility"].values())
        mark.visible = mark.seen >= SEEN
    if report is None:
        return mark
    named = [_rename(answer, e) for e in report.get("effects") or []]
    mark.verdict = str(report.get("verdict"))
    mark.answer = _words(report, named)
    mark.drop = _drop(report)
    mark.wrong = _wrong(answer, report, named)
    if mark.kind == "null":
        mark.exact, mark.alarm = (
            float(mark.verdict == "none"),
            bool(named) or mark.verdict in ("effects", "ambiguous"),
        )
    elif mark.kind == "unknown":
        mark.located = mark.verdict == "unexplained" and _unexplained_here(answer, report)
        mark.exact, mark.place = float(mark.located), mark.located
    else:
        if mark.kind == "mixed":
            mark.exact = _beside_unknown(answer, report, named, mark.wrong)
            mark.located = _unexplained_here(answer, report)
        elif mark.kind == "whole":
            mark.exact = _share(answer, report, named, mark.wrong)
        else:
            mark.exact = _exact(answer, report, named)
        mark.place = _place(answer, report, named)
        for effect in answer["effects"]:
            for entry in report.get("effects") or []:
                if _rename(answer, entry) == (effect["id"], effect["at"]):
                    found = entry.get("parameters") or {}
                    mark.parameters += compare(effect["id"], effect["parameters"], found, answer["plane"])
    return mark


def _rename(answer: dict, entry: dict) -> Named:
    """(id, at) of a reported effect, with other names of the same place replaced by the answer's."""
    name, at = str(entry.get("id")), str(entry.get("at"))
    for effect in answer["effects"]:
        if effect["id"] == name and at in effect["same_place"]:
            return name, effect["at"]
    return name, at


def _exact(answer: dict, report: dict, named: list[Named]) -> float:
    truth = frozenset((e["id"], e["at"]) for e in answer["effects"])

    def meant(names: Iterable[Named]) -> list[Named]:
        """Without what stands for the given model's masses."""
        return [n for n in names if n in truth or not _truly_off(answer, n)]

    named = meant(named)
    twins = frozenset((i, a) for e in answer["effects"] for i, a in e["twins"])
    coin = any(e["coin"] for e in answer["effects"])
    if report.get("verdict") == "effects":
        if frozenset(named) == truth and len(named) == len(truth):
            return 0.5 if coin else 1.0
        if len(named) == 1 and named[0] in twins:
            return 0.5
        return 0.0
    if report.get("verdict") != "ambiguous":
        return 0.0
    groups = [
        [frozenset(meant(_rename(answer, e) for e in c)) for c in group.get("candidates") or []]
        for group in report.get("ambiguous") or []
    ]
    if not groups or any(not group for group in groups):
        return 0.0
    members = frozenset().union(*(candidate for group in groups for candidate in group))
    sure = frozenset(named) - members
    full = [frozenset().union(*choice) | sure for choice in itertools.product(*groups)]
    bare = [frozenset().union(*choice) for choice in itertools.product(*groups)]
    if truth not in full and truth not in bare:
        return 0.0
    if len(truth) == 1 and members | sure <= truth | twins:
        return 1.0
    return 0.5 if max(len(group) for group in groups) <= MOST_CANDIDATES else 0.0


def _open(report: dict) -> list[dict]:
    """All effects of all candidates that a report leaves open."""
    return [e for g in report.get("ambiguous") or [] for c in g.get("candidates") or [] for e in c]


def _wrong(answer: dict, report: dict, named: list[Named]) -> list[Named]:
    """What is named for certain, not as one of several candidates, and is neither hidden nor a twin of what is."""
    right = {(e["id"], e["at"]) for e in answer["effects"]} | {
        (i, a) for e in answer["effects"] for i, a in e["twins"]
    }
    candidates = _doubted(answer, report)
    return [n for n in named if n not in right and n not in candidates and not _truly_off(answer, n)]


def _truly_off(answer: dict, named: Named) -> bool:
    """Whether an effect stands for what is off in the given model beside what is hidden."""
    return "masses and inertias off" in answer["concealed"] and named[0] in INERTIAL


def _beside_unknown(answer: dict, report: dict, named: list[Named], wrong: list[Named]) -> float:
    truth = {(e["id"], e["at"]) for e in answer["effects"]}
    if wrong or not truth <= {*named, *(_rename(answer, e) for e in _open(report))}:
        return 0.0
    return 1.0 if truth <= {*named} - _doubted(answer, report) else 0.5


def _share(answer: dict, report: dict, named: list[Named], wrong: list[Named]) -> float:
    """How much of all that is hidden was named: for certain or beside twins alone, or by half, beside others too."""
    found = 0.0
    for e in answer["effects"]:
        same = {(e["id"], e["at"]), *((i, a) for i, a in e["twins"])}
        open_ = [_apart(answer, group) for group in report.get("ambiguous") or []]
        beside = [members for members in open_ if members & same]
        found += 1.0 if same & {*named} or any(m <= same for m in beside) else 0.5 * bool(beside)
    return max(0.0, (found - len(wrong)) / len(answer["effects"]))


def _apart(answer: dict, group: dict) -> set[Named]:
    """In what the candidates of a group differ."""
    sets = [{_rename(answer, e) for e in candidate} for candidate in group.get("candidates") or []]
    return {n for members in sets for n in members if not all(n in other for other in sets)}


def _doubted(answer: dict, report: dict) -> set[Named]:
    """What is only one of several candidates."""
    return {n for group in report.get("ambiguous") or [] for n in _apart(answer, group)}


def _here(answer: dict, at: str) -> bool:
    """Whether a place is the drive train of a hidden effect, or the place of a twin."""
    places = {name for names in answer["places"].values() for name in names}
    places |= {a for e in answer["effects"] for _, a in e["twins"]}
    places |= {name for e in answer["effects"] for name in e["same_place"]}
    return at in places


def _place(answer: dict, report: dict, named: list[Named]) -> bool:
    entries = sorted(report.get("effects") or [], key=lambda e: -(e.get("error_drop") or 0.0))
    if entries:
        return _here(answer, str(entries[0].get("at")))
    candidates = _open(report)
    if candidates:
        return any(_here(answer, str(e.get("at"))) for e in candidates)
    return _unexplained_here(answer, report)


def _unexplained_here(answer: dict, report: dict) -> bool:
    """The first place of `unexplained`, or one of two, is right (a longer list is no place)."""
    at = (report.get("unexplained") or {}).get("at") or []
    at = [at] if isinstance(at, str) else list(at)
    return any(_here(answer, str(name)) for name in (at if len(at) <= 2 else at[:1]))


def _drop(report: dict) -> float | None:
    held_out = (report.get("fit") or {}).get("held_out") or {}
    before, after = held_out.get("before"), held_out.get("after")
    if not isinstance(before, int | float) or not isinstance(after, int | float) or after <= 0:
        return None
    return before / after


def _words(report: dict, named: list[Named]) -> str:
    parts = [f"{name}@{at}" for name, at in named]
    for group in report.get("ambiguous") or []:
        sets = [" + ".join(f"{e.get('id')}@{e.get('at')}" for e in c) for c in group.get("candidates") or []]
        parts.append("ambiguous{" + " | ".join(sets) + "}")
    strange = (report.get("unexplained") or {}).get("at")
    if strange:
        parts.append(f"unexplained@{strange if isinstance(strange, str) else ','.join(map(str, strange))}")
    return " + ".join(parts) or "none"

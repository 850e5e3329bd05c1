"""Steps of the search of forces: what may be added to what is chosen, or put in its place."""

from __future__ import annotations

from itertools import combinations

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance.bank import Entry, hypothesis_of

GROUPS = (
    ("coulomb_friction",),
    ("viscous_damping",),
    ("armature",),
    ("actuator_bias",),
    ("actuator_gain",),
    ("coulomb_friction", "viscous_damping"),
    ("coulomb_friction", "viscous_damping", "armature"),
    ("coulomb_friction", "viscous_damping", "actuator_bias"),
    ("coulomb_friction", "viscous_damping", "armature", "actuator_bias"),
)
"""Effects that robots lack in every joint at once; more elaborate ones have to win joint by joint."""
Chosen = tuple[Entry, ...]


def additions(entries: list[Entry], together: list[Chosen], chosen: Chosen) -> list[Chosen]:
    """Every candidate added, put in the place of what it cannot stand beside, and groups of them."""
    hypothesis = hypothesis_of(chosen)
    moves: list[Chosen] = []
    for e in entries:
        if compatible(hypothesis, e.term):
            moves.append((*chosen, e))
        elif e not in chosen:
            moves.append((*_beside(chosen, e), e))
    for group in together:
        rest = chosen
        for e in group:
            rest = _beside(rest, e)
        moves.append((*rest, *group))
    return moves


def exchanges(entries: list[Entry], chosen: Chosen) -> list[Chosen]:
    """Every candidate in the place of one effect, or of two that have several parameters."""
    several = [e for e in chosen if len(e.columns) > 1]
    moves: list[Chosen] = []
    for gone in [(e,) for e in chosen] + list(combinations(several, 2)):
        rest, terms = tuple(e for e in chosen if e not in gone), {e.term for e in gone}
        hypothesis = hypothesis_of(rest)
        moves += [(*rest, e) for e in entries if e.term not in terms and compatible(hypothesis, e.term)]
    return moves


def groups(entries: list[Entry]) -> list[Chosen]:
    """Each of `GROUPS` at every joint or actuator, at each start that one of its effects has; those with fewer are at
    their last."""
    starts: dict[Term, list[Entry]] = {}
    for e in entries:
        if e.term.place.kind in ("joint", "actuator"):
            starts.setdefault(e.term, []).append(e)
    out: list[Chosen] = []
    for ids in GROUPS:
        members = [own for i in ids for term, own in starts.items() if term.id == i]
        for k in range(max(map(len, members), default=0)):
            out.append(tuple(own[min(k, len(own) - 1)] for own in members))
    return out


def _beside(chosen: Chosen, e: Entry) -> Chosen:
    """What may stand beside a candidate."""
    one = hypothesis_of([e])
    return tuple(o for o in chosen if o.term != e.term and compatible(one, o.term))

"""Keep the state of a search in a file, so that an interrupted diagnosis goes on where it was, to the same result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax import files
from mpge_jax.diagnosis import own_effects
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted, nothing
from mpge_jax.diagnosis.evidence.scored import Reached, Scored
from mpge_jax.diagnosis.selection.search_state import Search

_FIT = ("theta", "centre", "information", "cov", "x")
_Terms = Mapping[tuple[str, str, int], Term]


def fingerprint(p: Prepared) -> str:
    """Changes with the model, the recordings, the settings and the user's own effects."""
    digest = hashlib.sha256(repr(p.config).encode())
    digest.update(p.spec.to_xml().encode() + own_effects.contents())
    for source in p.sources:
        r = source.recording
        digest.update(r.name.encode())
        for array in (r.time, r.qpos, r.qvel, source.command):
            if array is not None:
                digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def attach(s: Search, p: Prepared, path: Path) -> None:
    """Resume the search from `path` where that belongs to the same question, and keep its progress there."""
    mark = fingerprint(p)

    def keep(r: Reached) -> None:
        table = {"of": mark, "work": p.sim.work, "looked": s.looked, "fit": _fit_table(r.fit)}
        table["last"] = [_scored_table(x) for x in r.last]
        files.write_text(path, json.dumps(table))

    s.keep = keep
    terms = {(t.id, t.place.kind, t.place.index): t for t in s.terms}
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if table["of"] != mark:
            return
        counts = s.train.count, s.held.count
        last = tuple(_scored(p.ctx, terms, x, counts) for x in table["last"])
        reached = Reached(_fit(p.ctx, terms, table["fit"]), last)
        work = float(table["work"])
        if not 0.0 <= work < np.inf:
            raise ValueError("no work")
        p.sim.work, s.looked, s.resume = work, bool(table["looked"]), reached
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError):
        return


def _fit_table(f: Fitted) -> dict[str, Any]:
    terms = [{"id": t.id, "kind": t.place.kind, "index": t.place.index} for t in f.hypothesis.terms]
    return {"terms": terms, "loss": f.loss, **{name: getattr(f, name).tolist() for name in _FIT}}


def _fit(ctx: Context, terms: _Terms, table: dict[str, Any]) -> Fitted:
    """Raises KeyError or ValueError where a version kept it whose effects had other names or parameters, or where it
    was changed since."""
    hypothesis = Hypothesis.of(*(terms[t["id"], t["kind"], t["index"]] for t in table["terms"]))
    arrays = {name: np.array(table[name], dtype=float) for name in _FIT}
    size = len(hypothesis.params(ctx))
    for name in ("information", "cov"):
        # an empty list does not tell that it was a table
        arrays[name] = arrays[name] if arrays[name].size else nothing()
        if arrays[name].shape not in ((0, 0), (size, size)):
            raise ValueError("other parameters")
    if not arrays["theta"].shape == arrays["centre"].shape == (size,) or arrays["x"].ndim != 1:
        raise ValueError("other parameters")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise ValueError("not finite")
    return Fitted(hypothesis, loss=float(table["loss"]), **arrays)


def _scored_table(r: Scored) -> dict[str, Any]:
    table: dict[str, Any] = {
        "directions": r.directions,
        "tier": r.tier,
        "factor": r.factor,
        "unlikely": r.unlikely,
    }
    return {
        "fit": _fit_table(r.fit),
        "train": r.train.tolist(),
        "held": r.held.tolist(),
        "each": r.each.tolist(),
        **table,
    }


def _scored(ctx: Context, terms: _Terms, table: dict[str, Any], counts: tuple[int, int]) -> Scored:
    """Raises like `_fit`, and ValueError where it was told of other numbers of windows."""
    train, held = (np.array(table[name], dtype=float) for name in ("train", "held"))
    if (train.shape, held.shape) != ((counts[0],), (counts[1],)):
        raise ValueError("other windows")
    directions, tier, factor = int(table["directions"]), int(table["tier"]), float(table["factor"])
    each = np.array(table["each"], dtype=float).reshape(sum(counts), -1)
    unlikely = float(table["unlikely"])
    if not all(np.isfinite(x).all() for x in (train, held, each, factor, unlikely)):
        raise ValueError("not finite")
    return Scored(_fit(ctx, terms, table["fit"]), train, held, directions, tier, factor, each, unlikely)

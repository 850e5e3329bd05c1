"""Keep the state of a search in a file, so that an interrupted diagnosis goes on where it was."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np

from mpge_jax.diagnosis.fitted import Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.prepare import Prepared
from mpge_jax.diagnosis.select import Search


def fingerprint(p: Prepared) -> str:
    """Changes with the model, the recordings and the settings."""
    digest = hashlib.sha256(repr(p.config).encode())
    digest.update(p.spec.to_xml().encode())
    for source in p.train_sources + p.held_sources:
        r = source.recording
        digest.update(r.name.encode())
        for array in (r.time, r.qpos, r.qvel, source.command):
            if array is not None:
                digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def attach(s: Search, p: Prepared, path: Path) -> None:
    """Resume the search from `path` where that belongs to the same question, and keep its progress there."""
    mark = fingerprint(p)

    def keep(f: Fitted) -> None:
        terms = [{"id": t.id, "kind": t.place.kind, "index": t.place.index} for t in f.hypothesis.terms]
        table = {"of": mark, "terms": terms, "theta": f.theta.tolist(), "centre": f.centre.tolist()}
        table["work"], table["looked"] = p.sim.work, s.looked
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_text(json.dumps(table), encoding="utf-8")
        part.replace(path)

    s.keep = keep
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if table["of"] != mark:
            return
        known = {(t.id, t.place.kind, t.place.index): t for t in s.terms}
        terms: list[Term] = [known[t["id"], t["kind"], t["index"]] for t in table["terms"]]
        hypothesis = Hypothesis.of(*terms)
        resumed = Fitted(hypothesis, np.array(table["theta"]), np.array(table["centre"]))
        # kept by a version whose effects had other parameters
        if not resumed.theta.size == resumed.centre.size == len(hypothesis.params(p.ctx)):
            return
        p.sim.work, s.looked, s.resume = float(table["work"]), bool(table["looked"]), resumed
    except (OSError, ValueError, KeyError, TypeError):
        return

"""Windows that errors are told of start from what lies before the rows that they are judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.dataset.starts_from_before import LEAD, started_from_before


def _with_other_rows(p, w, since):
    """The windows' starts with nonsense from so many seconds after each start on; a window at a time."""
    starts = []
    for k in range(w.count):
        sources = list(w.sources)
        r = sources[w.source[k]].recording
        later = r.time > w.start[k] + since + 1e-9
        qpos = np.where(later[:, None], 0.3, r.qpos)
        sources[w.source[k]] = replace(sources[w.source[k]], recording=replace(r, qpos=qpos))
        one = replace(w, sources=tuple(sources)).take(np.array([k]))
        again = started_from_before(one, p.model, p.noise)
        starts.append(np.concatenate([again.q0[0], again.v0[0]]))
    return np.array(starts)


@pytest.mark.parametrize("part", ["test", "choice"])
def test_starts_know_nothing_of_what_comes_after(rubbing, part):
    _, p = rubbing
    w = p.windows(part, 0.5, 6, judged=True)
    w = w.take(np.flatnonzero(w.start > 0.1))
    now = np.concatenate([w.q0, w.v0], axis=1)
    np.testing.assert_allclose(_with_other_rows(p, w, 0.0), now, rtol=0, atol=1e-12)
    assert (np.abs(_with_other_rows(p, w, -0.05) - now) > 1e-6).any(1).all()


def test_the_first_rows_of_a_window_are_not_compared(rubbing):
    _, p = rubbing
    w = p.windows("test", 0.5, 6)
    first = np.where(w.seen, w.times, np.inf).min(1)
    assert (first > 0.9 * LEAD * w.times.max(1)).all() and (w.seen.mean(1) > 0.6).all()
    assert (w.lead.any(1)).all() and not (w.lead & w.seen).any()
    assert not p.windows("train", 0.5, 6).lead.any()

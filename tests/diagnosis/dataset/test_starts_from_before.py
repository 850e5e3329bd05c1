"""Test windows start from what lies before the rows that they are judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.dataset.starts_from_before import LEAD, started_from_before


def test_starts_know_nothing_of_the_rows_that_are_compared(rubbing):
    _, p = rubbing
    w = p.windows("test", 0.5, 6)
    first = np.where(w.seen, w.times, np.inf).min(1)
    assert (first > 0.9 * LEAD * w.times.max(1)).all() and (w.seen.mean(1) > 0.6).all()
    assert np.isnan(w.qpos[~w.seen]).all() and np.isfinite(w.qpos[w.seen]).all()

    def with_other_rows(since):
        """Nonsense from so many seconds after each window's start on; a window at a time."""
        starts = []
        for k in range(w.count):
            sources = list(p.test)
            r = sources[w.source[k]].recording
            later = r.time > w.start[k] + since[k] + 1e-9
            qpos = np.where(later[:, None], 0.3, r.qpos)
            sources[w.source[k]] = replace(sources[w.source[k]], recording=replace(r, qpos=qpos))
            again = started_from_before(
                replace(w, sources=tuple(sources)).take(np.array([k])), p.model, p.noise
            )
            starts.append(np.concatenate([again.q0[0], again.v0[0]]))
        return np.array(starts)

    now = np.concatenate([w.q0, w.v0], axis=1)
    np.testing.assert_allclose(with_other_rows(first - 0.001), now, rtol=0, atol=1e-12)
    assert (np.abs(with_other_rows(np.zeros(w.count)) - now) > 1e-6).any(1).all()

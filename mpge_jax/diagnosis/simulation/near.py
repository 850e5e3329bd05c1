"""Residuals of many runs near a known one: told from it by cheaper steps, and not simulated twice."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
REMEMBERED = 256_000_000
"""Bytes of residuals that are kept."""


@dataclass(frozen=True)
class Near:
    """Residuals near those of a known run. Where cheaper steps show what a change does, only the known run is simulated
    in the model's own: the others are told from it by those.

    Near the model as given every effect at every place is tried twice: as a first one, and as a rival of the one that
    was chosen. What was simulated for the former serves the latter where that asks for the same windows.

    Attributes:
        offset: [W, N, 2 nv] by how much the two differ for the known run; None where there is one kind of steps.
        kept: residuals and work of earlier runs, by what was run; None where nothing is asked for twice.
    """

    sim: Simulator
    w: Windows
    offset: Array | None
    kept: dict[bytes, tuple[Array, float]] | None = None

    @staticmethod
    def to(sim: Simulator, known: Run, w: Windows) -> Near:
        offset = sim.residuals([known], w)[0] - sim.cheaply([known], w)[0] if sim.costly(w) else None
        if known.hypothesis.terms:
            return Near(sim, w, offset)
        digest = hashlib.blake2b(repr((w.dt, w.steps, sim.stride, offset is None)).encode())
        for x in (w.source, w.start, w.q0, w.v0, w.act0, w.command, w.times, w.seen, w.qpos, w.qvel, w.moved):
            digest.update(np.ascontiguousarray(x).tobytes())
        if sim.first[0] != digest.digest():
            sim.first = digest.digest(), {}
        return Near(sim, w, offset, sim.first[1])

    def residuals(self, runs: list[Run]) -> Array:
        """[R, W, N, 2 nv], as `Simulator.residuals`."""
        out = self._remembered(runs) if self.kept is not None else self._simulated(runs)
        return out if self.offset is None else out + self.offset

    def _simulated(self, runs: list[Run]) -> Array:
        return (self.sim.residuals if self.offset is None else self.sim.cheaply)(runs, self.w)

    def _remembered(self, runs: list[Run]) -> Array:
        assert self.kept is not None
        keys = [_what(r) for r in runs]
        new = [i for i, key in enumerate(keys) if key not in self.kept]
        before = self.sim.work
        fresh = self._simulated([runs[i] for i in new])
        each = (self.sim.work - before) / max(len(new), 1)
        out = np.empty((len(runs), *fresh.shape[1:]))
        out[new] = fresh
        for i in set(range(len(runs))) - set(new):
            out[i], work = self.kept[keys[i]]
            # what is decided by the work done does not hang on what is remembered
            self.sim.work += work
        room = max(0, REMEMBERED // max(out[:1].nbytes, 1) - len(self.kept))
        self.kept.update({keys[i]: (out[i].copy(), each) for i in new[:room]})
        return out


def _what(run: Run) -> bytes:
    moved = b"" if run.shift is None else run.shift.tobytes()
    return repr((run.hypothesis, run.push)).encode() + run.theta.tobytes() + moved

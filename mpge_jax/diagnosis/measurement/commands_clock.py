"""Commands on a clock of their own: a delay that all actuators have in common may be the clock's, as far as nobody
knows that clock."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray


def common_delay(p: Prepared, f: Fitted) -> float:
    """Seconds by which all commands were found to act late and their clock may be off; 0 where that is nothing, or
    where one log has commands and motion on the same clock."""
    within = min(s.recording.clock_within for s in p.sources)
    parts = f.hypothesis.split(p.ctx, f.theta)
    delays = {t.place.index: float(x[0]) for t, x in parts.items() if t.id == "actuator_delay"}
    commanded = np.flatnonzero(~p.measured)
    return min([within, *(delays.get(int(a), 0.0) for a in commanded)]) if commanded.size else 0.0


def with_later_commands(p: Prepared, seconds: float) -> Prepared:
    """The same with commands that act later, but of actuators whose force was measured, which drives them."""

    def again(s: Source) -> Source:
        late = np.zeros(p.measured.size) if s.late is None else s.late
        return s.rebuilt(late=late + np.where(p.measured, 0.0, seconds))

    return p.mapped(again)


def describe_clock(seconds: float) -> str:
    """A sentence for the user."""
    return (
        f"all commands act {1e3 * seconds:.2g} ms later than they were read. As they came on another clock, known no "
        "better than that, this may be the clock's: it was taken off, and is no actuator's effect."
    )

"""What recording did to the recordings: which row holds a command, what the commands' clock shows, how old servos'
forces are, when late forces began, where encoders had their zeros."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.measurement.command_rows import rows_are_late, with_earlier_commands
from mpge_jax.diagnosis.measurement.commands_clock import common_delay, describe_clock, with_later_commands
from mpge_jax.diagnosis.measurement.delay_within_a_row import Arrival, arrivals, moved, with_arrivals
from mpge_jax.diagnosis.measurement.drifting_rows import rows_earlier, with_rows_moved
from mpge_jax.diagnosis.measurement.encoder_zeros import describe_zeros, other_zeros, with_zeros
from mpge_jax.diagnosis.measurement.finer_steps import in_steps_as_seen
from mpge_jax.diagnosis.measurement.servo_force_age import age_of, aged, describe_age, other_age
from mpge_jax.diagnosis.recordings.rows.late_rows import MOST, READ_SO
from mpge_jax.diagnosis.selection.procedure import Found

ROUNDS = 3
"""How often the rows of drifting clocks are told, each time given those of before."""


@dataclass(frozen=True)
class MeasurementModel:
    """Rows, ages, delays and zeros with which recordings are read.

    Attributes:
        at_rows: the recordings with their zeros, and with forces that begin at the rows. late: actuator -> the delays
            (s) between which its force may have begun. delays: those that are taken. servos: those whose force was
            measured.
    """

    at_rows: Prepared
    late: dict[int, tuple[float, float]]
    delays: dict[int, Arrival]
    servos: tuple[int, ...] = ()

    @staticmethod
    def without_physics(
        at_rows: Prepared, late: dict[int, tuple[float, float]], servos: Sequence[int] = ()
    ) -> MeasurementModel:
        """Before anything was found: zeros as the model has them, delays as the model as given tells them."""
        return MeasurementModel(at_rows, late, arrivals(at_rows, NOTHING, late), tuple(servos))

    def read(self) -> Prepared:
        """The recordings, read with these delays and zeros."""
        return with_arrivals(self.at_rows, self.delays)

    def given(self, f: Fitted) -> MeasurementModel:
        """The same with the delays that are likeliest if `f` is true."""
        return replace(self, delays=arrivals(self.at_rows, f, self.late))

    def with_moved_steps(self, found: Found) -> MeasurementModel | None:
        """In finer steps than the model's, where what was found shows that the machine moves as in these: what was
        missing hid it. Else None."""
        finer = in_steps_as_seen(self.at_rows, found.fit) if found.fit.hypothesis.terms else self.at_rows
        return None if finer is self.at_rows else replace(self.given(found.fit), at_rows=finer)

    def with_moved_rows(self, found: Found) -> MeasurementModel | None:
        """With every command on the row before, or on one earlier, where what was found predicts better so; and where
        that is known of the rows, with those of some logs and times otherwise than of others, as what was found tells.
        Else None."""
        nothing = not found.fit.hypothesis.terms and found.left is None
        if nothing:
            return None
        moved = self
        if READ_SO not in self.at_rows.warnings:
            for _ in range(MOST):
                if not rows_are_late(moved.read(), found.fit):
                    break
                moved = replace(moved, at_rows=with_earlier_commands(moved.at_rows))
            if moved is not self:
                moved.at_rows.warnings.append(READ_SO)
        elif found.left is not None:
            for _ in range(ROUNDS):
                by = rows_earlier(moved.read(), found.fit)
                if by is None:
                    break
                moved = replace(moved, at_rows=with_rows_moved(moved.at_rows, by))
        return None if moved is self else moved.given(found.fit)

    def with_moved_clock(self, found: Found) -> MeasurementModel | None:
        """With commands later by what all their delays have in common, where that may be their clock's; else None."""
        seconds = common_delay(self.at_rows, found.fit)
        if not seconds:
            return None
        self.at_rows.warnings.append(describe_clock(seconds))
        return replace(self, at_rows=with_later_commands(self.at_rows, seconds)).given(found.fit)

    def with_moved_ages(self, found: Found) -> MeasurementModel | None:
        """With another age of the servos' forces, where what was found leaves something and tells one: what was missing
        at some joint hid it. Else None."""
        age = None if found.left is None else other_age(self.at_rows, self.servos, found.fit)
        if age is None:
            return None
        warnings, before = self.at_rows.warnings, describe_age(age_of(self.at_rows, self.servos))
        if before in warnings:
            warnings.remove(before)
        warnings.append(describe_age(age))
        return replace(self.given(found.fit), at_rows=aged(self.at_rows, self.servos, age))

    def with_moved_delays(self, found: Found) -> MeasurementModel | None:
        """With other delays where those of `given` differ clearly from these: what was missing seemed to be a matter
        of delays. None where they do not, or where nothing was found."""
        now = self.given(found.fit) if found.fit.hypothesis.terms else self
        return now if moved(self.delays, now.delays) else None

    def with_moved_zeros(self, found: Found) -> MeasurementModel | None:
        """With other zeros where recordings differ in them and what was found leaves something; else None."""
        zeros = {} if found.left is None else other_zeros(self.read(), found.fit)
        if not zeros:
            return None
        self.at_rows.warnings.append(describe_zeros(self.at_rows, zeros))
        return replace(self.given(found.fit), at_rows=with_zeros(self.at_rows, zeros))


Way = Callable[[MeasurementModel, Found], MeasurementModel | None]
WAYS: tuple[Way, ...] = (
    MeasurementModel.with_moved_steps,
    MeasurementModel.with_moved_rows,
    MeasurementModel.with_moved_clock,
    MeasurementModel.with_moved_ages,
    MeasurementModel.with_moved_delays,
    MeasurementModel.with_moved_zeros,
)
"""What is told again given what was found, each given those before it."""

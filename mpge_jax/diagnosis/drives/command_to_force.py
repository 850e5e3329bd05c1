"""Command to measured force: what each actuator lacks, and what the machine does once that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.drive_law import Data, Log, between, left_open, log_of, residual
from mpge_jax.diagnosis.drives.drive_remainder import unexplained_drive
from mpge_jax.diagnosis.drives.law_fit import DELAY
from mpge_jax.diagnosis.drives.law_search import search_law
from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.intervals import number, parameters
from mpge_jax.diagnosis.estimation.levenberg_marquardt import timing_error
from mpge_jax.diagnosis.estimation.quantities import clause, quantity
from mpge_jax.diagnosis.machine.model import clipped, compile_variable, has_plain_law
from mpge_jax.diagnosis.measurement.delay_within_a_row import Arrival, row_of
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.three_parts import PARTS, Part
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.force_between_rows import Law, nominal
from mpge_jax.diagnosis.simulation.driving.measured_drives import drive_by_force, is_servo

Array = np.ndarray
LATE = {DELAY, "actuator_lag"}
"""Drives whose force does not jump when its command does."""
MOVING = {"actuator_lag", "back_emf"}
"""Those whose force changes between two commands."""


@dataclass
class ActuatorSide:
    """What was found between commands and measured forces.

    Attributes:
        fits: one per actuator that lacks something. drops: by how much each effect lowers the held-out squared error
        of the force. errors: actuator -> held-out rms force error (before, after). excess: actuator -> squared error
        as given over that of the noise. left: entries of what no law explains.
        grid: step (s) in which commands were followed.
    """

    ctx: Context
    fits: list[Fitted] = field(default_factory=list)
    drops: dict[Term, float] = field(default_factory=dict)
    errors: dict[str, tuple[float, float]] = field(default_factory=dict)
    excess: dict[str, float] = field(default_factory=dict)
    left: list[dict[str, Any]] = field(default_factory=list)
    grid: float = 0.0

    @property
    def laws(self) -> dict[int, Fitted]:
        """`fits` by actuator."""
        return {f.hypothesis.terms[0].place.index: f for f in self.fits}

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Entries of `diagnosis.json`."""
        return [
            {
                "id": term.name,
                "at": term.place.name,
                "parameters": parameters(self.ctx, f, term),
                "error_drop": number(self.drops[term]),
                "rivals": [],
            }
            for f in self.fits
            for term in f.hypothesis.terms
        ]

    @property
    def table(self) -> list[dict[str, Any]]:
        """Entries of `effects.json`."""
        return [
            {
                "id": term.name,
                "form": term.id,
                "at": term.place.name,
                "kind": "actuator",
                "parameters": {
                    k: np.asarray(v, dtype=float).tolist()
                    for k, v in term.effect.report(self.ctx, term.place, theta).items()
                },
            }
            for f in self.fits
            for term, theta in f.hypothesis.split(self.ctx, f.theta).items()
        ]

    @property
    def sentences(self) -> list[str]:
        out = []
        for f in self.fits:
            for term in f.hypothesis.terms:
                shown = {k: quantity(v) for k, v in parameters(self.ctx, f, term).items()}
                says = clause(term.effect.sentence(term.place, shown))
                out.append(f"Between command and measured force, {says}.")
        return out

    def delay(self, a: int) -> float:
        """Seconds by which an actuator was found to obey late."""
        if a not in self.laws:
            return 0.0
        parts = self.laws[a].hypothesis.split(self.ctx, self.laws[a].theta)
        return next((float(theta[0]) for t, theta in parts.items() if t.name == DELAY), 0.0)

    def late(self, plain: mujoco.MjModel, by_law: Array | None = None) -> dict[int, tuple[float, float]]:
        """Actuators that were found to obey late and whose force is held between rows all the same, or is their law's
        (`by_law` [nu]), each with the delays that its forces allow."""
        out = {}
        for a, f in self.laws.items():
            held = not is_servo(plain, a) and not any(t.name in MOVING for t in f.hypothesis.terms)
            if self.delay(a) and (held or (by_law is not None and by_law[a])):
                out[a] = row_of(self.delay(a), self.ctx.period)
        return out

    def arrived(self, when: dict[int, Arrival]) -> ActuatorSide:
        """The same with delays as the motion tells them, within the rows that the forces told."""
        fits = []
        for a, f in self.laws.items():
            delay = next((t for t in f.hypothesis.terms if t.name == DELAY), None)
            if delay is not None and a in when:
                i = f.hypothesis.slices(self.ctx)[f.hypothesis.terms.index(delay)].start
                theta, cov = f.theta.copy(), f.cov.copy()
                theta[i] = when[a].delay
                cov[i], cov[:, i] = 0.0, 0.0
                # in steps of another length a machine answers up to half of one earlier or later
                cov[i, i] = when[a].deviation ** 2 + float(self.ctx.model.opt.timestep) ** 2 / 12
                f = replace(f, theta=theta, cov=cov)
            fits.append(f)
        return replace(self, fits=fits)

    def between_rows(self, plain: mujoco.MjModel) -> tuple[set[int], Callable[[Source], Law]]:
        """Actuators whose force was found not to be held between two rows, as it lags behind the command or falls with
        speed; and the law of those and of servos between the rows of a recording."""
        found = self.laws
        names = {a: {t.name for t in f.hypothesis.terms} for a, f in found.items()}
        moving = {a for a, terms in names.items() if terms & MOVING}

        def of(source: Source) -> Law:
            out = nominal(source.recording, source.states, plain)
            for a, f in found.items():
                if is_servo(plain, a) or a in moving:
                    out.jumps[:, a], out.slopes[:, a] = between(plain, self.ctx, f, a, source)
                if names[a] & LATE:
                    out.jumps[:, a] = 0.0
            return out

        return moving, of

    def export(self, spec: mujoco.MjSpec) -> dict[Term, bool]:
        """Add native forms to a compiled spec; returns which effects have one."""
        return {
            term: term.effect.export(spec, self.ctx, term.place, theta)
            for f in self.fits
            for term, theta in f.hypothesis.split(self.ctx, f.theta).items()
        }


def diagnose_actuators(p: Prepared, nominal: mujoco.MjModel, ids: list[str]) -> ActuatorSide | None:
    """Effects between `ctrl` and `actuator_force`, actuator by actuator; None where forces were not measured.

    Args:
        nominal: the model as given (commands in). ids: effects to try.
    """
    together = p.looked_at
    if not p.measured.any() or any(s.recording.ctrl is None for s in together):
        return None
    drive = np.array(
        [
            np.nanquantile(np.abs(np.concatenate([s.recording.known("force")[:, a] for s in together])), 0.98)
            for a in range(nominal.nu)
        ]
    )
    ctx = replace(p.ctx, model=nominal, drive=np.maximum(np.nan_to_num(drive), 1e-6))
    steps = np.concatenate([np.diff(s.recording.time) for s in together])
    jittered = float(np.quantile(np.abs(steps - ctx.period), 0.9)) > 0.01 * ctx.period
    dt = (0.25 if jittered else 0.5) * ctx.period
    out = ActuatorSide(ctx, grid=dt)
    for a in np.flatnonzero(p.measured):
        place = Place("actuator", p.names.actuators[a], int(a))
        if not has_plain_law(nominal, int(a)):
            p.warnings.append(
                f"how {place.name} turns commands into force is not checked: in the model it has a state or a delay, "
                "or its force depends on more than one joint."
            )
            continue
        logs: dict[Part, list[Log]] = {part: [] for part in PARTS}
        count = 0
        for part in PARTS:
            for s in getattr(p, part):
                log = log_of(s, ctx, int(a), dt, count, s.recording.first_shown)
                if log is not None:
                    logs[part].append(log)
                    count = int(log.block.max()) + 1
        if not all(logs.values()):
            continue
        sigma, _ = column_noise(
            [s.recording.time for s in together], [s.recording.known("force")[:, a] for s in together]
        )
        sigma = max(sigma if np.isfinite(sigma) else 0.0, 1e-5 * float(ctx.drive[a]), 1e-9)
        unsure = left_open(nominal, int(a), together)
        data, test = Data(logs["train"], logs["choice"], sigma, dt, unsure), logs["test"]
        f = search_law(nominal, ctx, place, data, ids)
        if f.cov.size:
            late = timing_error(f.hypothesis.params(ctx), f.theta, float(nominal.opt.timestep))
            f = replace(f, cov=f.cov + np.diag(late**2))
        before = residual(nominal, ctx, NOTHING, int(a), test, data) * sigma
        after = residual(nominal, ctx, f, int(a), test, data) * sigma
        rms = (float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))))
        out.errors[place.name] = rms
        out.excess[place.name] = (rms[0] / sigma) ** 2
        left = unexplained_drive(nominal, ctx, f, int(a), data)
        if left is not None:
            out.left.append({**left, "at": [place.name]})
        if not f.hypothesis.terms:
            continue
        out.fits.append(f)
        parts = f.hypothesis.split(ctx, f.theta)
        for term in parts:
            h = f.hypothesis.without(term)
            less = Fitted(h, h.gather(ctx, parts), np.zeros(0))
            without = residual(nominal, ctx, less, int(a), test, data) * sigma
            out.drops[term] = 1.0 - rms[1] ** 2 / max(float(np.mean(without**2)), 1e-30)
    return out


def by_command(p: Prepared, plain: mujoco.MjModel, found: ActuatorSide) -> tuple[Prepared, Fitted]:
    """The machine driven by its commands rather than by measured forces, with what was found between the two: where
    nothing is missing on the mechanical side, only this shows what the correction changes."""

    def by_its_commands(s: Source) -> Source:
        command = clipped(plain, s.recording.known("ctrl"))
        return Source.build(s.recording, s.states, command, late=plain.actuator_delay)

    model = compile_variable(drive_by_force(p.spec, np.zeros_like(p.measured)))
    sim = Simulator(model, found.ctx, threads=p.config.jobs)
    parts = {t: x for f in found.fits for t, x in f.hypothesis.split(found.ctx, f.theta).items()}
    driven = replace(
        p.mapped(by_its_commands), model=sim.model, ctx=sim.ctx, sim=sim, measured=np.zeros_like(p.measured)
    )
    return driven, Fitted.start(sim.ctx, parts)

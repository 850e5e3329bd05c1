"""Measured forces of motors whose law is known, freed of the noise with which they were measured.

Noise in a force that drives the simulation adds up along a window and hides what the machine lacks. Where the law that
was found between commands and forces leaves nothing but white noise, the law's force is the better one.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import MOVING, ActuatorSide
from mpge_jax.diagnosis.drives.drive_law import BLOCK_S, log_of, predict
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.whitening import robust_loss, whitener
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio
from mpge_jax.diagnosis.machine.model import has_plain_law
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import follows

Array = np.ndarray
WHITE = 1.2
"""What a law leaves (root mean square), over the white noise in that, up to which it leaves nothing else."""
SLIGHT = 1e-4
"""Share of a motor's largest forces below which their noise does not matter."""
SHIFTED = 5.0
"""Deviations by which the mean of a stretch must differ for its forces to be taken as measured all the same."""
WINDOWS = 40
"""Windows in which the machine is driven in both ways."""


def freed(p: Prepared, plain: mujoco.MjModel, found: ActuatorSide) -> Prepared:
    """The machine driven by the laws' forces where these explain the measured ones, if that fits its motion no worse.

    Args:
        plain: the nominal model. found: what its drives lack. Only plain motors are freed: the force of a servo, or of
            a motor with back-EMF, depends on a motion that is noisy too.
    """
    groups = (p.looked_at, p.test)
    changed = [list(group) for group in groups]
    known = np.zeros(plain.nu, bool)
    follow, unexplained = follows(plain), {at for entry in found.left for at in entry["at"]}
    for a in map(int, np.flatnonzero(p.measured)):
        f = found.laws.get(a, NOTHING)
        moving = any(t.name in MOVING for t in f.hypothesis.terms)
        if follow[a] or moving or not has_plain_law(plain, a) or p.names.actuators[a] in unexplained:
            continue
        errors = [[_error(s, plain, found, f, a) for s in group] for group in groups]
        white = _white_noise(list(p.looked_at), errors[0])
        if white < SLIGHT * found.ctx.drive[a]:
            continue
        known[a] = True
        for sources, group in zip(changed, errors, strict=True):
            for k, error in enumerate(group):
                sources[k] = _less(sources[k], a, error, white)
    if not known.any():
        return p
    seen, test = changed
    trained = len(p.train)
    out = replace(p, train=tuple(seen[:trained]), choice=tuple(seen[trained:]), test=tuple(test), known=known)
    if _worse(p, out):
        return p
    names = ", ".join(p.names.actuators[a] for a in np.flatnonzero(known))
    p.warnings.append(
        f"what was measured as force of {names} is what the commands make of it plus white noise; the machine is "
        "driven without that noise."
    )
    return out


def _error(s: Source, plain: mujoco.MjModel, found: ActuatorSide, f: Fitted, a: int) -> Array:
    """Measured forces [T] of an actuator less those of its law `f`; NaN where there is none, or too few."""
    out = np.full(s.recording.time.size, np.nan)
    log = log_of(s, found.ctx, a, found.grid, 0)
    if log is not None:
        force = predict(plain, found.ctx, f, a, log, found.grid)
        out[np.isfinite(s.recording.known("force")[:, a])] = log.force - force
    return out


def _white_noise(sources: list[Source], errors: list[Array]) -> float:
    """Deviation of what a law leaves if that is white noise, else 0."""
    level, _ = column_noise([s.recording.time for s in sources], errors)
    every = np.concatenate(errors)
    every = every[np.isfinite(every)]
    if not every.size or not np.isfinite(level):
        return 0.0
    return level if float(np.sqrt(np.mean(every**2))) < WHITE * level else 0.0


def _less(s: Source, a: int, error: Array, white: float) -> Source:
    """A recording driven without the error [T] of one actuator's force, but for stretches in which it is no noise."""
    error = np.nan_to_num(error)
    stretches = (s.recording.time / BLOCK_S).astype(int)
    _, index, count = np.unique(stretches, return_inverse=True, return_counts=True)
    mean = np.bincount(index, error) / count
    noise = np.abs(mean) < SHIFTED * white / np.sqrt(count)
    command = s.command.copy()
    command[:, a] -= np.where(noise[index], error, 0.0)
    return s.rebuilt(command=command)


def _worse(measured: Prepared, laws: Prepared) -> bool:
    """Whether windows of the machine as given are predicted clearly worse by the laws' forces."""
    w = measured.windows("train", measured.config.decide_s, WINDOWS, seed=13)
    if not w.count:
        return True
    h, theta = NOTHING.hypothesis, NOTHING.theta
    white = whitener(measured.sim, h, theta, w, measured.noise, temper=False)
    losses = [
        robust_loss(white.excess(white(measured.sim.residuals([Run(h, theta)], x))[0]))
        for x in (w, w.driven_by(laws.train))
    ]
    return beyond_doubt(log_ratio(losses[1] - losses[0]))

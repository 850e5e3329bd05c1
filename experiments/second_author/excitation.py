"""What moves a machine: references, which are functions of the time [s] to a vector, and controllers that follow them.

A controller maps the time [s], positions [nq] as read and velocities [nv] as estimated to commands [nu].
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm, solve_discrete_are

Array = NDArray[np.float64]
Reference = Callable[[float], Array]
Policy = Callable[[float, Array, Array], Array]
RNG = np.random.Generator
RISE = 0.6  # s, in which a motion sets in


@dataclass(frozen=True)
class Run:
    """One recording to be made: its name, length [s], controller, and start [nq]."""

    name: str
    seconds: float
    policy: Policy
    start: Sequence[float] | Array


def _soft(t: float) -> float:
    return min(1.0, t / RISE)


def _vector(amplitude: ArrayLike) -> Array:
    return np.atleast_1d(np.asarray(amplitude, float))


def sines(
    rng: RNG, amplitude: ArrayLike, band: tuple[float, float] = (0.2, 2.0), centre: Array | float = 0.0
) -> Reference:
    """Four sines in each component, of frequencies in a `band` [Hz]."""
    a, count = _vector(amplitude), 4
    w = 2 * np.pi * rng.uniform(band[0], band[1], (count, len(a)))
    phase = rng.uniform(0, 2 * np.pi, (count, len(a)))
    shares = rng.dirichlet(np.ones(count) * 3, len(a)).T * a * 1.6
    return lambda t: centre + _soft(t) * np.sum(shares * np.sin(w * t + phase), axis=0)


def chirp(
    amplitude: ArrayLike, low: float, high: float, span: float, centre: Array | float = 0.0
) -> Reference:
    """From `low` to `high` [Hz] in `span` seconds, each component a little faster than the one before."""
    a = _vector(amplitude)
    phase = 0.7 * np.arange(len(a))

    def at(t: float) -> Array:
        turned = 2 * np.pi * (low * t + (high - low) * t * t / (2 * span)) * (1 + 0.13 * phase)
        return centre + _soft(t) * a * np.sin(turned + phase)

    return at


def _levels(rng: RNG, amplitude: Array, count: int = 40) -> Array:
    levels = rng.uniform(-1, 1, (count, len(amplitude))) * amplitude
    levels[0] = 0
    return levels


def steps(rng: RNG, amplitude: ArrayLike, hold: float = 0.8, centre: Array | float = 0.0) -> Reference:
    """Random levels, each for `hold` seconds."""
    v = _levels(rng, _vector(amplitude))
    return lambda t: centre + v[min(int(t / hold), len(v) - 1)]


def moves(
    rng: RNG, amplitude: ArrayLike, hold: float = 1.2, rise: float = 0.6, centre: Array | float = 0.0
) -> Reference:
    """From one random level to the next with least jerk in `rise` seconds, every `hold` seconds."""
    v = _levels(rng, _vector(amplitude))

    def at(t: float) -> Array:
        i = min(int(t / hold), len(v) - 2)
        s = min(1.0, (t - i * hold) / rise)
        return centre + v[i] + (v[i + 1] - v[i]) * (s**3 * (10 - 15 * s + 6 * s * s))

    return at


def triangle(amplitude: ArrayLike, period: float, centre: Array | float = 0.0) -> Reference:
    """Ramps up and down at constant speed, each component a little faster than the one before."""
    a = _vector(amplitude)
    faster = 1 + 0.17 * (0.21 * np.arange(len(a)))

    def at(t: float) -> Array:
        return centre + a * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * (t / period * faster)))

    return at


def slope(reference: Reference, t: float, h: float = 1e-3) -> Array:
    """Its derivative at a time, by differences."""
    return (reference(t + h) - reference(max(t - h, 0))) / (h + min(h, t))


def still(count: int) -> Reference:
    """Commands of zero."""
    return lambda t: np.zeros(count)


def play(reference: Reference) -> Policy:
    """The reference itself as the command."""
    return lambda t, q, v: reference(t)


def pd(xml: str, reference: Reference, kp: ArrayLike, kd: ArrayLike, gravity: bool = True) -> Policy:
    """Follows a reference of the joints that have a motor; with what the nominal model needs against `gravity`."""
    m = mujoco.MjModel.from_xml_string(xml)
    d = mujoco.MjData(m)
    joints = m.actuator_trnid[:, 0]
    columns, dofs, gear = m.jnt_qposadr[joints], m.jnt_dofadr[joints], m.actuator_gear[:, 0]
    kp, kd = np.asarray(kp, float), np.asarray(kd, float)

    def act(t: float, q: Array, v: Array) -> Array:
        force = kp * (reference(t) - q[columns]) + kd * (slope(reference, t) - v[dofs])
        if gravity:
            d.qpos[:], d.qvel[:] = q, 0
            mujoco.mj_forward(m, d)
            force = force + d.qfrc_bias[dofs]
        return np.asarray(force / gear)

    return act


def _regulator(a: Array, b: Array, state: list[float], effort: float) -> Array:
    """Gains of the linear-quadratic regulator in discrete time; `state`, `effort`: what errors and commands cost."""
    weight = np.eye(1) * effort
    x = solve_discrete_are(a, b, np.diag(state), weight)
    return np.asarray(np.linalg.solve(weight + b.T @ x @ b, b.T @ x @ a))


def balance_cart(xml: str, period: float, reference: Reference) -> Policy:
    """Holds the pole of a cart upright (at pi) and follows a reference of the cart; `period`: between commands [s]."""
    m = mujoco.MjModel.from_xml_string(xml)
    d = mujoco.MjData(m)
    d.qpos[:] = [0, np.pi]
    a, b = np.zeros((4, 4)), np.zeros((4, 1))
    mujoco.mjd_transitionFD(m, d, 1e-6, True, a, b, None, None)
    a_row, b_row = np.eye(4), np.zeros((4, 1))
    for _ in range(round(period / m.opt.timestep)):
        a_row, b_row = a @ a_row, a @ b_row + b
    gains = _regulator(a_row, b_row, [60, 60, 3, 1.0], 0.05)

    def act(t: float, q: Array, v: Array) -> Array:
        return np.asarray(-gains @ np.array([q[0] - reference(t)[0], q[1] - np.pi, v[0], v[1]]))

    return act


def balance_wheels(period: float, reference: Reference, kick: Callable[[float], float]) -> Policy:
    """Holds the balancing robot upright, follows a reference of its place, and adds `kick` to the command.

    Positions are x, z, pitch and wheel; the place is told from the wheel. The numbers are those of the nominal model.
    """
    body, height, wheels, r, turning = 1.15, 0.11, 0.18, 0.05, 0.0006 + 2 * 0.4 * 0.09 * 0.05**2
    tilting = 1.15 / 3 * (0.03**2 + 0.09**2)
    coupling = body * height
    inertia = np.array(
        [[body + wheels + turning / r**2, coupling], [coupling, tilting + body * height * height]]
    )
    weight = np.array([[0, 0], [0, body * 9.81 * height]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [np.linalg.solve(inertia, weight), np.zeros((2, 2))]])
    b = np.concatenate([np.zeros(2), np.linalg.solve(inertia, np.array([1 / r, -1.0]))])[:, None]
    held = expm(np.block([[a, b], [np.zeros((1, 5))]]) * period)
    gains = _regulator(held[:4, :4], held[:4, 4:], [30, 40, 3, 1.0], 8)

    def act(t: float, q: Array, v: Array) -> Array:
        x, speed = r * (q[3] + q[2]), r * (v[3] + v[2])
        ahead = speed - 0.7 * slope(reference, t)[0]
        state = np.array([x - reference(t)[0], q[2], ahead, v[2]])
        return np.asarray(-gains @ state + kick(t))

    return act


def fly(reference: Reference, yaw: Callable[[float], float], dither: Reference) -> Policy:
    """Flies the quadrotor along a reference of its place with a heading, and adds `dither` to the four thrusts."""
    mass, arm, c = 0.92, 0.12, 0.016
    mixer = np.linalg.inv(
        np.array([[1, 1, 1, 1], [arm, arm, -arm, -arm], [-arm, arm, arm, -arm], [-c, c, -c, c]])
    )

    def act(t: float, q: Array, v: Array) -> Array:
        flat = np.zeros(9)
        mujoco.mju_quat2Mat(flat, q[3:])
        turn = flat.reshape(3, 3)
        wish = 6 * (reference(t) - q[:3]) + 4 * (slope(reference, t) - v[:3]) + [0, 0, 9.81]
        up = wish / np.linalg.norm(wish)
        heading = yaw(t)
        left = np.cross(up, [np.cos(heading), np.sin(heading), 0])
        left /= np.linalg.norm(left)
        wanted = np.column_stack([np.cross(left, up), left, up])
        skew = 0.5 * (wanted.T @ turn - turn.T @ wanted)
        error = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        moment = -np.array([0.55, 0.55, 0.3]) * error - np.array([0.09, 0.09, 0.1]) * v[3:]
        return np.asarray(mixer @ np.concatenate([[mass * wish @ turn[:, 2]], moment]) + dither(t))

    return act


def drive(speeds: Reference, gain: float = 0.06) -> Policy:
    """Turns the two wheels of the rover at a reference of speeds [rad/s]."""
    return lambda t, q, v: gain * (speeds(t) - v[6:8]) + 0.004 * speeds(t)

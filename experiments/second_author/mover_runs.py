"""How the machines of `movers` are moved in their recordings; the random numbers of a motion are those of a seed."""

from collections.abc import Sequence

import numpy as np
from numpy.random import default_rng as rng
from numpy.typing import ArrayLike

from experiments.second_author.excitation import (
    Policy,
    Reference,
    Run,
    balance_cart,
    balance_wheels,
    chirp,
    drive,
    fly,
    moves,
    pd,
    play,
    sines,
    steps,
    still,
    triangle,
)


def cart_pole(xml: str, s: int, rate: float = 125) -> list[Run]:
    def cart(reference: Reference) -> Policy:
        return pd(xml, reference, [60], [12], gravity=False)

    upright = balance_cart(xml, 1 / rate, sines(rng(s + 2), [0.15], (0.05, 0.3)))
    return [
        Run("sines", 10, cart(sines(rng(s), [0.3], (0.2, 1.2))), [0, 0]),
        Run("steps", 8, cart(moves(rng(s + 1), [0.35], 1.3, 0.5)), [0, 0.3]),
        Run("balance", 10, upright, [0, np.pi + 0.08]),
        Run("release", 8, play(still(1)), [0, 1.3]),
        Run("chirp_force", 8, play(chirp([5.0], 0.6, 3, 8)), [0, 0]),
    ]


def gantry(xml: str, s: int, T: float = 9.0) -> list[Run]:
    def run(name: str, reference: Reference, start: Sequence[float] = (0, 0, 0, 0)) -> Run:
        return Run(name, T, pd(xml, reference, [160, 80], [55, 30], gravity=False), start)

    return [
        run("moves", moves(rng(s), [0.7, 0.45], 3.0, 2.0)),
        run("sines", sines(rng(s + 1), [0.5, 0.3], (0.08, 0.45))),
        run("swing", still(2), (0, 0, 0.7, -0.5)),
        run("swing2", sines(rng(s + 2), [0.1, 0.1], (0.2, 0.5)), (0, 0, -0.4, 0.6)),
    ]


def furuta(xml: str, s: int) -> list[Run]:
    slow = pd(xml, triangle([1.4], 7.0), [0.12], [0.008], gravity=False)
    return [
        Run("chirp", 8, play(chirp([0.06], 0.4, 5, 8)), [0, 0]),
        Run("sines", 10, play(sines(rng(s), [0.045], (0.3, 2.0))), [0, 0]),
        Run("turn", 8, play(lambda t: np.array([0.012 + 0.02 * np.sin(2 * np.pi * 0.35 * t)])), [0, 0]),
        Run("decay", 7, play(still(1)), [0.2, 1.6]),
        Run("pulses", 8, play(steps(rng(s + 1), [0.05], 0.35)), [0, 0]),
        Run("slow", 10, slow, [0, 0]),
    ]


def pendulum(xml: str, s: int) -> list[Run]:
    def shaft(reference: Reference) -> Policy:
        return pd(xml, reference, [4], [0.25])

    return [
        Run("slow", 12, shaft(triangle([1.2], 8.0)), [0]),
        Run("sines", 8, shaft(sines(rng(s), [1.2], (0.2, 1.2))), [0]),
        Run("decay", 8, play(still(1)), [1.8]),
        Run("torque", 8, play(sines(rng(s + 1), [0.3], (0.2, 1.0))), [0]),
        Run("creep", 12, shaft(sines(rng(s + 2), [0.5], (0.05, 0.2))), [0.0]),
    ]


def tank_stage(xml: str, s: int, T: float = 8.0) -> list[Run]:
    a = np.array([0.25, 0.08, 0.25])

    def run(name: str, reference: Reference, kp: float = 500, kd: float = 70) -> Run:
        return Run(name, T, pd(xml, reference, [kp, 900, 8], [kd, 110, 0.5]), np.zeros(3))

    return [
        run("moves", moves(rng(s), a, 1.6, 0.6)),
        run("sines", sines(rng(s + 1), 0.7 * a, (0.1, 0.65))),
        run("chirp", chirp(np.array([0.008, 0.012, 0.05]), 0.5, 3, T)),
        run("stop_go", steps(rng(s + 2), 0.35 * a, 1.3)),
        run("push", moves(rng(s + 3), a, 1.2, 0.8), 120, 25),
    ]


def rover(xml: str, s: int, T: float = 8.0) -> list[Run]:
    def run(name: str, reference: Reference, gain: float = 0.06) -> Run:
        wheels = np.array([[1, -1], [1, 1]])
        return Run(name, T, drive(lambda t: wheels @ reference(t), gain), [0, 0, 0.05, 1, 0, 0, 0, 0, 0])

    return [
        run("sines", sines(rng(s), [10, 4], (0.2, 1.0))),
        run("dashes", steps(rng(s + 1), [12, 4], 0.9), 0.09),
        run("spins", steps(rng(s + 2), [3, 9], 0.8), 0.09),
        run("arcs", moves(rng(s + 3), [14, 6], 1.4, 0.6)),
        run("dashes2", steps(rng(s + 4), [10, 6], 0.8), 0.09),
    ]


def hopper(xml: str, s: int, T: float = 5.0) -> list[Run]:
    """Nothing in these is random; the last two, whose numbers are, only judge."""
    c = np.array([-0.6, 1.2])

    def hop(period: float) -> Reference:
        return lambda t: c + np.array([0.28, -0.56]) * ((t % period) < 0.12 and t > 0.6)

    def squat(rate: float) -> Reference:
        return lambda t: c + np.array([-0.15, 0.3]) * np.sin(2 * np.pi * rate * t) * min(1, t)

    def run(name: str, height: float, reference: Reference, seconds: float = T) -> Run:
        return Run(name, seconds, pd(xml, reference, [70, 70], [1.5, 1.5], gravity=False), [height, *c])

    drawn = rng(s).uniform
    return [
        run("drop_low", 0.02, lambda t: c, 4),
        run("drop_mid", 0.08, lambda t: c, 4),
        run("drop_high", 0.14, lambda t: c, 4),
        run("hop", 0.02, hop(0.7)),
        run("hop2", 0.05, hop(0.55)),
        run("squat", -0.05, squat(1.3)),
        run("other_hop", drawn(0.02, 0.1), hop(drawn(0.5, 0.8))),
        run("other_squat", drawn(-0.05, 0.0), squat(drawn(0.9, 1.6))),
    ]


def balancer(xml: str, s: int, rate: float = 200) -> list[Run]:
    def run(
        name: str, T: float, reference: Reference, pitch: float = 0.0, kicks: Sequence[Sequence[float]] = ()
    ) -> Run:
        def kick(t: float) -> float:
            return 0.15 if any(begin < t < end for begin, end in kicks) else 0.0

        return Run(name, T, balance_wheels(1 / rate, reference, kick), [0, 0, pitch, 0])

    return [
        run("stand", 8, still(1), 0.05),
        run("sines", 10, sines(rng(s), [0.5], (0.1, 0.5))),
        run("kicks", 9, still(1), -0.04, [(3.0, 3.15), (6.0, 6.1)]),
        run("drive", 10, moves(rng(s + 1), [0.8], 2.2, 1.4)),
    ]


def quadrotor(
    xml: str, s: int, T: float = 8.0, height: float = 1.0, spans: ArrayLike = (0.6, 0.6, 0.3)
) -> list[Run]:
    base, a = np.array([0, 0, height]), np.asarray(spans)
    drawn = rng(s + 9)
    w, phase = drawn.uniform(2, 6, 4) * 2 * np.pi, drawn.uniform(0, 6, 4)

    def run(
        name: str, reference: Reference, depth: float = 0.0, rate: float = 0.0, seconds: float = T
    ) -> Run:
        shaken = fly(reference, lambda t: depth * np.sin(rate * t), lambda t: 0.12 * np.sin(w * t + phase))
        return Run(name, seconds, shaken, [*base, 1, 0, 0, 0])

    return [
        run("sines", sines(rng(s), a, (0.1, 0.5), base), 0.5, 0.8),
        run("moves", moves(rng(s + 1), a, 2.0, 1.4, base)),
        run("hover", lambda t: base, 0.3, 1.5, 6),
        run("sines2", sines(rng(s + 2), a, (0.2, 0.8), base), -0.4, 0.6),
    ]

"""How the machines of `arms` are moved in their recordings; the random numbers of a motion are those of a seed."""

import mujoco
import numpy as np
from numpy.random import default_rng as rng
from scipy.optimize import fsolve

from experiments.second_author.excitation import (
    Array,
    Reference,
    Run,
    chirp,
    moves,
    pd,
    play,
    sines,
    steps,
    triangle,
)


def closed(xml: str, left: float, right: float) -> list[float]:
    """Positions [4] of the five-bar robot with these angles of its drives, whose elbows close the loop."""
    m = mujoco.MjModel.from_xml_string(xml)
    d = mujoco.MjData(m)

    def gap(x: Array) -> Array:
        d.qpos[:] = [left, x[0], right, x[1]]
        mujoco.mj_kinematics(m, d)
        return np.asarray((d.site_xpos[0] - d.site_xpos[1])[[0, 2]])

    x = fsolve(gap, [-2 * left, -2 * right], xtol=1e-13)
    return [left, x[0], right, x[1]]


def desk_arm(xml: str, s: int, T: float = 8.0) -> list[Run]:
    c = np.array([0, 0.3, 0.2, 0])
    a = np.array([0.8, 0.5, 0.6, 0.7])
    return [
        Run("sines", T, play(sines(rng(s), a, (0.15, 1.2), c)), c),
        Run("steps", T, play(steps(rng(s + 1), 0.6 * a, 0.9, c)), c),
        Run("moves", T, play(moves(rng(s + 2), a, 1.4, 0.7, c)), c),
        Run("chirp", T, play(chirp(0.3 * a, 0.3, 4, T, c)), c),
        Run("triangle", T, play(triangle(0.7 * a, 4.0, c)), c),
    ]


def scara(xml: str, s: int, T: float = 7.0) -> list[Run]:
    kp, kd = [120, 60, 900, 1.5], [14, 6, 90, 0.08]
    a, c = np.array([0.9, 1.0, 0.06, 1.5]), np.array([0, 0.6, 0, 0])

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, pd(xml, reference, kp, kd), c)

    return [
        run("pick_place", moves(rng(s), 0.8 * a, 1.2, 0.7, c)),
        run("sines", sines(rng(s + 1), 0.8 * a, (0.2, 1.2), c)),
        run("chirp", chirp(0.08 * a, 0.3, 4, T, c)),
        run("slow", triangle(0.6 * a, 5.0, c)),
    ]


def arm6(xml: str, s: int, T: float = 8.0) -> list[Run]:
    kp, kd = [300, 400, 250, 60, 50, 25], [40, 50, 30, 5, 4, 2]
    a, c = np.array([0.8, 0.5, 0.6, 0.8, 0.7, 1.0]), np.array([0, 0.2, 0.1, 0, 0.3, 0])

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, pd(xml, reference, kp, kd), c)

    return [
        run("sines", sines(rng(s), a, (0.1, 0.7), c)),
        run("moves", moves(rng(s + 1), 0.8 * a, 2.0, 1.4, c)),
        run("chirp", chirp(0.07 * a, 0.3, 3, T, c)),
        run("slow", triangle(0.5 * a, 6.0, c)),
        run("sines2", sines(rng(s + 2), 0.6 * a, (0.2, 0.9), c)),
    ]


def five_bar(xml: str, s: int, T: float = 6.0) -> list[Run]:
    start, c = closed(xml, 0.6, -0.6), np.array([0.6, -0.6])

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, pd(xml, reference, [14, 14], [0.5, 0.5], gravity=False), start)

    return [
        run("sines", sines(rng(s), [0.35, 0.35], (0.3, 2.0), c)),
        run("moves", moves(rng(s + 1), [0.4, 0.4], 0.9, 0.4, c)),
        run("slow", triangle([0.35, 0.3], 3.5, c)),
        run("chirp", chirp([0.12, 0.12], 0.5, 5, T, c)),
    ]


def gripper(xml: str, s: int, T: float = 8.0) -> list[Run]:
    a = np.array([0.7, 1.1, 0.018])

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, play(reference), np.zeros(4))

    return [
        run("sines", sines(rng(s), a, (0.2, 1.6))),
        run("steps", steps(rng(s + 1), 0.8 * a, 0.8)),
        run("moves", moves(rng(s + 2), a, 1.2, 0.5)),
        run("triangle", triangle(a, 4.0)),
        run("chirp", chirp(0.3 * a, 0.3, 5, T)),
    ]


def head(xml: str, s: int, T: float = 7.0) -> list[Run]:
    a = np.array([1.0, 0.6])

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, pd(xml, reference, [9, 7], [0.35, 0.28], gravity=False), [0, 0])

    return [
        run("scan", triangle(a, 4.0)),
        run("sines", sines(rng(s), a, (0.2, 2.0))),
        run("looks", moves(rng(s + 1), 0.7 * a, 0.9, 0.4)),
        run("chirp", chirp(0.1 * a, 0.4, 5, T)),
        run("track", sines(rng(s + 2), 0.5 * a, (0.3, 1.6))),
    ]


def leg(xml: str, s: int, T: float = 7.0) -> list[Run]:
    c, a = np.array([0, -0.5, 1.1]), np.array([0.35, 0.6, 0.6])

    def trot(t: float) -> Array:
        swing = np.sin(2 * np.pi * 1.6 * t + np.array([0, 0, 1.4]))
        return np.asarray(c + np.array([0.05, 0.4, 0.45]) * swing * min(1, t))

    def run(name: str, reference: Reference) -> Run:
        return Run(name, T, pd(xml, reference, (45, 45, 40), (1.2, 1.2, 0.9)), c)

    return [
        run("trot", trot),
        run("sines", sines(rng(s), a, (0.3, 2.5), c)),
        run("moves", moves(rng(s + 1), a, 0.9, 0.35, c)),
        run("chirp", chirp(0.2 * a, 0.5, 9, T, c)),
        run("slow", triangle(0.7 * a, 4.0, c)),
    ]

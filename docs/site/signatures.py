"""What every effect of the vocabulary does to a driven pendulum, as small pictures in SVG.

Along the motion of the pendulum that has the effect: the motion itself beside that of the model, and the torque that
the model lacks over what tells most of it (speed, command or angle).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.effects.base import REGISTRY

PENDULUM = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody><body name="arm">
<joint name="hinge" axis="0 1 0" damping="0.05" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="hinge" ctrlrange="-3 3"/></actuator></mujoco>"""
BOX = """<mujoco><option timestep="0.004"/><worldbody><geom name="floor" type="plane" size="9 9 1"/>
<body name="box" pos="0 0 .1"><joint name="hinge" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom name="block" type="box" size=".1 .1 .1" mass="1"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
SIZES: dict[str, dict[str, object]] = {
    "viscous_damping": {"coefficient": 0.2},
    "coulomb_friction": {"torque": 0.3},
    "stribeck_friction": {"coulomb": 0.15, "static": 0.5, "velocity": 0.5},
    "load_dependent_friction": {"coulomb": 0.05, "load_coefficient": 0.3},
    "asymmetric_friction": {
        "coulomb_forward": 0.3, "coulomb_backward": 0.1, "viscous_forward": 0.1, "viscous_backward": 0.0,
    },
    "quadratic_drag": {"coefficient": 0.06},
    "joint_stiffness": {"stiffness": 0.8, "reference": 0.3},
    "cogging_torque": {"amplitude": 0.4, "phase": 0.0, "periods": 8.0},
    "backlash": {"gap": 0.15, "restitution": 0.2},
    "joint_flexibility": {"stiffness": 8.0, "damping": 0.02},
    "armature": {"inertia": 0.03},
    "actuator_gain": {"gain": 0.6},
    "dead_actuator": {},
    "actuator_bias": {"bias": 0.4},
    "torque_saturation": {"limit": 0.9},
    "actuator_deadzone": {"width": 0.4},
    "actuator_delay": {"delay": 0.08},
    "actuator_lag": {"time_constant": 0.1},
    "back_emf": {"coefficient": 0.2},
    "payload_mass": {"mass": 0.4, "position": [0.05, 0.0, -0.3]},
    "mass_scale": {"factor": 1.4},
    "com_offset": {"offset": [0.03, 0.0, 0.03]},
    "gravity_tilt": {"angle": 0.25, "axis": [0.0, 1.0, 0.0]},
    "external_force": {"force": [2.0, 0.0, 0.0]},
    "contact_friction": {"mu": 0.4},
    "contact_stiffness": {"time_constant": 0.06},
    "encoder_offset": {"offset": 0.2},
    "sensor_delay": {"delay": 0.06},
}  # fmt: skip
"""Parameters that are large enough to be seen."""
SECONDS, EVERY = 3.0, 3


@dataclass(frozen=True)
class Trace:
    """One motion: time [T] s; measured position, velocity and command [T]; torque that the model lacks [T]."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    missing: np.ndarray


def command(t: float) -> float:
    """Command of the motor, N m."""
    return float(1.1 * np.sin(3.1 * t) + 0.5 * np.sin(8.3 * t + 1.0))


@cache
def given_trace(xml: str = PENDULUM, pushed: bool = True, column: int = 0) -> Trace:
    """The machine as its model has it."""
    return trace([], xml, pushed, column)


def trace(
    effects: list[dict[str, object]], xml: str = PENDULUM, pushed: bool = True, column: int = 0
) -> Trace:
    """The machine with effects, and what the model without them lacks along its motion.

    Args:
        effects: rows of `effects.json`. xml: the model. pushed: whether the motor acts. column: which joint is shown.
    """
    machine = CorrectedModel.build(mujoco.MjSpec.from_string(xml), effects).c_stepper()
    start = np.zeros(machine.model.nq)
    start[column] = 0.5 if xml is PENDULUM else (0.0 if pushed else 0.4)
    machine.reset(start, np.zeros(machine.model.nv))
    rows = []
    for k in range(round(SECONDS / machine.model.opt.timestep)):
        u = command(machine.data.time) * (4.0 if xml is BOX else 1.0) * pushed
        if k % EVERY == 0:
            rows.append((machine.data.time, machine.measured()[column], u))
        machine.step(np.array([u]))
    time, position, u = (np.array(x) for x in zip(*rows, strict=True))
    velocity = np.gradient(position, time)
    return Trace(
        time, position, velocity, u, _missing(position, velocity, np.gradient(velocity, time), u, xml)
    )


def _missing(q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray, xml: str) -> np.ndarray:
    """Torque that the motion needs beyond the motor's, by inverse dynamics; 0 for machines of more joints."""
    model = mujoco.MjModel.from_xml_string(xml)
    if model.nv > 1:
        return np.zeros_like(q)
    data, out = mujoco.MjData(model), []
    for row in zip(q, v, a, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        out.append(data.qfrc_inverse[0])
    return np.array(out) - u


def signature(name: str) -> str:
    """SVG of one effect: motion over time, and where it acts in a joint the missing torque."""
    effect = REGISTRY[name]
    contact = name.startswith("contact")
    kind = effect.kinds[0]
    at = {"joint": "hinge", "actuator": "motor", "body": "arm", "world": "world"}[kind]
    row = {"id": name, "at": at, "kind": kind, "parameters": SIZES[name]}
    if contact:
        # a slide that is pushed, or a fall
        falls = name == "contact_stiffness"
        where = (BOX, not falls, int(falls))
        true, given = trace([row], *where), given_trace(*where)
        return _svg([_Panel("time (s)", "height (m)" if falls else "way (m)", *_moved(true, given))], name)
    true, given = trace([row]), given_trace()
    over = {"actuator": ("command (N m)", true.command)}.get(kind, ("speed (rad/s)", true.velocity))
    return _svg(
        [
            _Panel("time (s)", "angle (rad)", *_moved(true, given)),
            _Panel(over[0], "missing torque (N m)", over[1], (true.missing,), points=True),
            _Panel("angle (rad)", "missing torque (N m)", true.position, (true.missing,), points=True),
        ],
        name,
    )


def _moved(true: Trace, given: Trace) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    return true.time, (given.position, true.position)


@dataclass(frozen=True)
class _Panel:
    """Curves over one x: of two, the first is the model as given."""

    x_label: str
    y_label: str
    x: np.ndarray
    curves: tuple[np.ndarray, ...]
    points: bool = False


WIDTH, HEIGHT, LEFT, BELOW = 250, 150, 46, 34


def _svg(panels: list[_Panel], name: str) -> str:
    body = "".join(_drawn(p, k * (WIDTH + 20)) for k, p in enumerate(panels))
    width = len(panels) * (WIDTH + 20)
    return (
        f'<svg class="signature" viewBox="0 0 {width} {HEIGHT}" style="max-width:{width}px" role="img" '
        f'aria-label="signature of {name}">{body}</svg>'
    )


def _drawn(p: _Panel, left: float) -> str:
    """One panel, its frame at `left`."""
    x0, y0, w, h = left + LEFT, 8, WIDTH - LEFT, HEIGHT - BELOW - 8
    low, high = (_padded(side) for side in (_range(p.x), _range(np.concatenate(p.curves))))
    xs = x0 + w * (p.x - low[0]) / (low[1] - low[0])
    lines = []
    for k, curve in enumerate(p.curves):
        ys = y0 + h * (1 - (np.clip(curve, *high) - high[0]) / (high[1] - high[0]))
        kind = "true" if k == len(p.curves) - 1 else "given"
        if p.points:
            lines += [
                f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="1.3"/>'
                for x, y in zip(xs, ys, strict=True)
            ]
        else:
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True))
            lines.append(f'<polyline class="{kind}" points="{path}"/>')
    texts = [
        (x0, y0 + h + 13, "start", f"{low[0]:.2g}"),
        (x0 + w, y0 + h + 13, "end", f"{low[1]:.2g}"),
        (x0 + w / 2, y0 + h + 26, "middle", p.x_label),
        (x0 - 4, y0 + 9, "end", f"{high[1]:.2g}"),
        (x0 - 4, y0 + h, "end", f"{high[0]:.2g}"),
    ]
    words = "".join(f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{a}">{t}</text>' for x, y, a, t in texts)
    middle = y0 + h / 2
    at = f"{left + 9:.0f} {middle:.0f}"
    up = f'<text x="{left + 9:.0f}" y="{middle:.0f}" text-anchor="middle" transform="rotate(-90 {at})">'
    frame = f'<rect class="frame" x="{x0}" y="{y0}" width="{w}" height="{h}"/>'
    return f"{frame}{''.join(lines)}{words}{up}{p.y_label}</text>"


def _range(values: np.ndarray) -> tuple[float, float]:
    """Where nearly all of the values lie: impacts leave the picture."""
    low, high = np.quantile(values, [0.01, 0.99])
    return float(low), float(high)


def _padded(side: tuple[float, float]) -> tuple[float, float]:
    pad = 0.06 * (side[1] - side[0]) + 1e-3
    return side[0] - pad, side[1] + pad

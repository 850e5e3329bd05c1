"""Hidden effects in drives, and in the encoders beside them."""

from collections import deque

import numpy as np

from experiments.second_author.simulation import Array, Effect, Sim, sign


class Gain(Effect):
    """A drive whose force is `gain` times what it should be; of a servo the stiffness and the damping alike."""

    def __init__(self, at: str, gain: float):
        super().__init__("actuator_gain", at, gain=gain)

    def bind(self, sim: Sim) -> None:
        a = sim.actuator(self.at)
        sim.m.actuator_gainprm[a, :3] *= self.number("gain")
        sim.m.actuator_biasprm[a, :3] *= self.number("gain")


class Saturation(Effect):
    """A drive that gives no more than `limit`."""

    def __init__(self, at: str, limit: float):
        super().__init__("torque_saturation", at, limit=limit)

    def bind(self, sim: Sim) -> None:
        a = sim.actuator(self.at)
        sim.m.actuator_forcelimited[a] = 1
        sim.m.actuator_forcerange[a] = [-self.number("limit"), self.number("limit")]


class Deadzone(Effect):
    """A plain motor whose force lacks up to `width`."""

    beyond_range = True

    def __init__(self, at: str, width: float):
        super().__init__("actuator_deadzone", at, width=width)

    def command(self, sim: Sim, u: Array) -> Array:
        a = sim.actuator(self.at)
        gain = sim.m.actuator_gainprm[a, 0]
        u = u.copy()
        force = gain * u[a]
        u[a] = sign(force) * max(abs(force) - self.number("width"), 0.0) / gain
        return u


class Delay(Effect):
    """Commands that act `delay` seconds later, rounded to steps; the first one stands for those before it."""

    def __init__(self, at: str, delay: float):
        super().__init__("actuator_delay", at, delay=delay)

    def bind(self, sim: Sim) -> None:
        self.steps = round(self.number("delay") / sim.dt)

    def command(self, sim: Sim, u: Array) -> Array:
        a = sim.actuator(self.at)
        if self.state is None:
            self.state = deque([u[a]] * self.steps)
        self.state.append(u[a])
        u = u.copy()
        u[a] = self.state.popleft()
        return u


class Lag(Effect):
    """Commands through a filter of first order; each step gets the mean of its ends."""

    def __init__(self, at: str, time_constant: float):
        super().__init__("actuator_lag", at, time_constant=time_constant)

    def command(self, sim: Sim, u: Array) -> Array:
        a = sim.actuator(self.at)
        if self.state is None:
            self.state = u[a]
        old = self.state
        self.state = u[a] + (old - u[a]) * np.exp(-sim.dt / self.number("time_constant"))
        u = u.copy()
        u[a] = 0.5 * (old + self.state)
        return u


class Crosstalk(Effect):
    """Coupled drives: a `share` of the command of `source` acts at another drive too."""

    unknown = True
    beyond_range = True

    def __init__(self, at: str, source: str, share: float):
        super().__init__("crosstalk", at, share=share)
        self.source = source

    def command(self, sim: Sim, u: Array) -> Array:
        u = u.copy()
        u[sim.actuator(self.at)] += self.number("share") * u[sim.actuator(self.source)]
        return u


class GroundEffect(Effect):
    """Rotors give more thrust near the floor: 1 / (1 - (c / z)^2) of it, z being each rotor's height [m]."""

    unknown = True
    beyond_range = True

    def __init__(self, at: str, c: float):
        super().__init__("ground_effect", at, c=c)

    def command(self, sim: Sim, u: Array) -> Array:
        c = self.number("c")
        z = np.maximum(sim.d.site_xpos[:, 2], 1.3 * c)
        return u / (1 - (c / z) ** 2)


class EncoderOffset(Effect):
    """An encoder that reads `offset` too much."""

    in_sensor = True

    def __init__(self, at: str, offset: float):
        super().__init__("encoder_offset", at, offset=offset)

    def sense(self, sim: Sim, q: Array, v: Array) -> tuple[Array, Array]:
        q = q.copy()
        q[sim.given_column(self.at)] += self.number("offset")
        return q, v


class SensorDelay(Effect):
    """An encoder that reads what was `delay` seconds ago, rounded to steps."""

    in_sensor = True

    def __init__(self, at: str, delay: float):
        super().__init__("sensor_delay", at, delay=delay)

    def bind(self, sim: Sim) -> None:
        self.steps = round(self.number("delay") / sim.dt)

    def after(self, sim: Sim) -> None:
        if self.state is None:
            self.state = deque([self._now(sim)] * (self.steps + 1), maxlen=self.steps + 1)
        self.state.append(self._now(sim))

    def sense(self, sim: Sim, q: Array, v: Array) -> tuple[Array, Array]:
        old = self._now(sim) if self.state is None else self.state[0]
        q, v = q.copy(), v.copy()
        q[sim.given_column(self.at)], v[sim.given_dof(self.at)] = old
        return q, v

    def _now(self, sim: Sim) -> tuple[float, float]:
        return sim.d.qpos[sim.column(self.at)], sim.d.qvel[sim.dof(self.at)]

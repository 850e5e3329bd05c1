"""The text of a task file for a machine: what `python -m experiments.new` and a diagnosis write."""

import json

from mpge_jax.task_files.robot import Robot


def text_of(r: Robot) -> str:
    """The whole file: a task, and a target to try methods on."""
    return _filled(r, _ABOUT, _MODEL, _TARGET)


def corrected_text_of(r: Robot) -> str:
    """The same task in the machine as a diagnosis corrected it, from the files beside it."""
    return _filled(r, _ABOUT_CORRECTED, _MODEL_CORRECTED, _CORRECTED)


def _filled(r: Robot, about: str, model: str, last: str) -> str:
    unseen = [r.base[c] for c in ("x", "y") if c in r.base]
    seen = [i for i in range(len(r.start)) if i not in unseen]
    head = about.strip("\n") + "\n\n" + model.strip("\n") + "\n" + _HEAD
    parts = [head, _moving(r) if r.base else _FIXED, _TASK + last]
    values = {
        "name": r.name,
        "file": _said(r.file),
        "module": _said(r.file).removesuffix(".py"),
        "model": json.dumps(r.model),
        "model_said": _said(r.model),
        "frame_skip": r.frame_skip,
        "physics": f"{r.timestep:g}",
        "dt": f"{r.timestep * r.frame_skip:g}",
        "pose": _said(r.pose),
        "start": _listed(r.start),
        "seen": _listed(seen),
        "but": " but the base's place on the ground" if unseen else "",
        "joints": _listed(r.joints),
        "nv": r.nv,
        "ranges": _ranges(r),
        "mass": f"{r.mass:.6g}",
        "to_state": "None,  # actuators have states that no observation tells" if r.hidden else "to_state,",
    }
    return "\n\n\n".join(part.strip("\n") for part in parts).format(**values) + "\n"


def _said(name: str) -> str:
    """A name from a model or a file, for remarks in a program: nothing in it ends the remark."""
    return "".join(c if c.isprintable() and c not in "\"'\\" else "_" for c in name)


def _listed(values: tuple[float, ...] | list[int] | tuple[int, ...]) -> str:
    lines, line = [], ""
    for word in (f"{v!r}" for v in values):
        if len(line) + len(word) > 90:
            lines.append(line.rstrip())
            line = ""
        line += f"{word}, "
    lines.append(line.rstrip(", "))
    return "[" + "\n    ".join(lines) + "]"


def _ranges(r: Robot) -> str:
    if not r.ranges:
        return ""
    rows = "".join(f"        ({a}, {low:.6g}, {high:.6g}),\n" for a, low, high in r.ranges)
    return (
        "    # The model gives these actuators no control range: look whether yours go so far.\n"
        f"    for actuator, low, high in (\n{rows}    ):\n"
        "        out.actuators[actuator].ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE\n"
        "        out.actuators[actuator].ctrlrange = [low, high]\n"
    )


def _moving(r: Robot) -> str:
    columns = "\n".join(f"{k.upper()} = {v}" for k, v in r.base.items() if k not in ("y", "quat", "pitch"))
    if "quat" in r.base:
        q = r.base["quat"]
        upright = f"    # How far the base's own vertical points up, from its quaternion.\n    return 1.0 - 2.0 * (qpos[{q + 1}] ** 2 + qpos[{q + 2}] ** 2)"  # noqa: E501
    else:
        upright = f"    return jnp.cos(qpos[{r.base['pitch']}])"
    lowest = r.start[r.base["z"]] - r.height / 2
    return f"""
# Columns of qpos that place the base.
{columns}
# Half as high above the ground as at the start.
LOWEST = {lowest:.6g}


def upright(qpos):
    \"\"\"1 where the base stands as it should, 0 where it lies on its side.\"\"\"
{upright}


def reward(data, action, after, dt):
    \"\"\"Forward speed, in m/s, and standing upright, less a little for effort. Here is most of what to change: another
    direction, a speed to keep (`-abs(forward - 1.0)`), a weight for each part.\"\"\"
    forward = (after.qpos[X] - data.qpos[X]) / dt
    standing = upright(after.qpos)
    effort = -1e-3 * jnp.sum(jnp.square(action))
    parts = {{{{"reward_forward": forward, "reward_upright": standing, "reward_effort": effort}}}}
    return forward + standing + effort, parts


def terminated(data):
    \"\"\"Fallen: too low, or tilted by more than 60 degrees.\"\"\"
    return (data.qpos[Z] < LOWEST) | (upright(data.qpos) < 0.5)
"""


_ABOUT = '''
"""{name}: a task for {model_said}, to be changed as you like.

python -m experiments.pretrain --task {file}:{name} --kind MS
python -m experiments.sweep --task {file}:{name}Target --method direct MPGE-MS target

All functions are pure and for one simulation: `data` has qpos [nq] and qvel [nv], as MuJoCo's.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import envs
'''

_MODEL = """
MODEL = Path(__file__).resolve().parent / {model}
"""

_ABOUT_CORRECTED = '''
"""{name}: the machine as a diagnosis corrected it, as an environment for policies; change reward and reset as you like.

python {file}    # one step, to see that it runs

    import {module}
    {module}.env()           # pure reset(key) and step(state, action), for jit and vmap
    {module}.playground()    # MuJoCo Playground's MjxEnv (pip install playground)
    {module}.brax()          # a brax.envs.Env

`{model_said}` is the machine as it was given, `effects.json` what is added to it: elements of MuJoCo where it has them
(those are in `corrected.xml` too), equations around its steps where it has none. All functions are pure and for one
simulation: `data` has qpos [nq] and qvel [nv], as MuJoCo's.
"""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import envs
from mpge_jax.diagnosis import load_effects
from mpge_jax.diagnosis.corrected.tasks import corrected_env
'''

_MODEL_CORRECTED = """
FOLDER = Path(__file__).resolve().parent
MODEL = FOLDER / {model}
EFFECTS = json.loads((FOLDER / "effects.json").read_text(encoding="utf-8"))["effects"]
for effect in EFFECTS:
    if "file" in effect:  # of your own
        load_effects(effect["file"])
"""

_HEAD = '''
# Physics steps of {physics} s in one step of the policy, which so lasts {dt} s.
FRAME_SKIP = {frame_skip}
# Where episodes start: {pose}.
START = np.array({start})
# Columns of qpos that move at random at the start, and that a policy sees: all{but}.
JOINTS = np.array({joints}, int)
SEEN = np.array({seen}, int)


def spec():
    """The model, read anew at every call."""
    out = mujoco.MjSpec.from_file(str(MODEL))
{ranges}    return out


def reset(key):
    """Near START and nearly at rest. A wider spread makes policies that cope with more."""
    key_qpos, key_qvel = jax.random.split(key)
    qpos = jnp.asarray(START, jnp.result_type(float))
    noise = jax.random.uniform(key_qpos, JOINTS.shape, qpos.dtype, -0.05, 0.05)
    return qpos.at[JOINTS].add(noise), 0.01 * jax.random.normal(key_qvel, ({nv},), qpos.dtype)


def observe(data):
    """What a policy sees. Leave out what your robot cannot measure."""
    return jnp.concatenate([data.qpos[SEEN], data.qvel])


def to_state(obs):
    """The inverse of `observe`: qpos and qvel. Some methods need it; None in the task below does without."""
    qpos = jnp.zeros(len(START), obs.dtype).at[SEEN].set(obs[: len(SEEN)])
    return qpos, obs[len(SEEN) :]
'''

_FIXED = '''
# The pose to hold: the one at the start. Change it, or give it to the policy as part of the observation.
GOAL = START


def reward(data, action, after, dt):
    """Near 1 in the pose GOAL and less away from it, less a little for effort. Here is most of what to change."""
    del data, dt
    near = jnp.exp(-jnp.mean(jnp.square(after.qpos - jnp.asarray(GOAL, after.qpos.dtype))))
    effort = -1e-3 * jnp.sum(jnp.square(action))
    return near + effort, {{"reward_near": near, "reward_effort": effort}}


def terminated(data):
    """Never: an episode ends by its time. Return True where going on would be of no use, or would break the robot."""
    return jnp.zeros((), bool)
'''

_TASK = """
TASK = envs.Task(
    name="{name}",
    spec=spec,
    frame_skip=FRAME_SKIP,
    reset=reset,
    observe=observe,
    reward=reward,
    terminated=terminated,
    to_state={to_state}
    max_steps=1000,
)
"""

_TARGET = """
# A target to try methods on: all parts heavier by a third. What your real robot has otherwise goes here: `spec` changes
# the model, `action` what becomes of a command.
TARGET = envs.Variant("{name}Target", "{name}", "all parts heavier by a third", total_mass=4 / 3 * {mass})
"""

_CORRECTED = '''

def env(backend="auto"):
    """The task in the corrected machine. backend: `c`, `mjx`, or `auto` (`c` on a CPU, else `mjx`)."""
    return corrected_env(spec(), EFFECTS, TASK, backend)


def playground(backend="auto"):
    """The same for MuJoCo Playground, whose wrapper for training takes `episode_length=TASK.max_steps`."""
    return envs.as_playground(env(backend))


def brax(backend="auto"):
    """The same for brax, whose `EpisodeWrapper` takes the time limit, `TASK.max_steps`."""
    return envs.as_brax(env(backend))


if __name__ == "__main__":
    machine = env()
    state = jax.jit(machine.reset)(jax.random.key(0))
    state = jax.jit(machine.step)(state, jnp.zeros(machine.action_size))
    print(f"{{machine.name}}: {{len(EFFECTS)}} effects, a step of {{machine.dt:g}} s, reward {{state.reward:.4g}}")
'''

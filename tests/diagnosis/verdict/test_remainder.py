"""Where and when something acts that nothing explains."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.missing_force import Probed
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.verdict.judgement import struck
from mpge_jax.diagnosis.verdict.remainder_description import _likeliest
from tests.diagnosis.machines import FINE_ARM, record

CORNERS = {"fl": (0.1, 0.1, 1), "fr": (0.1, -0.1, -1), "rl": (-0.1, 0.1, -1), "rr": (-0.1, -0.1, 1)}
QUAD = f"""<mujoco><option timestep="0.004" gravity="0 0 0" integrator="implicitfast"/><worldbody><body name="frame">
<freejoint name="float"/><geom type="box" size=".1 .1 .03" mass=".5" contype="0" conaffinity="0"/>
{"".join(f'<site name="{k}" pos="{x} {y} 0"/>' for k, (x, y, _) in CORNERS.items())}</body></worldbody><actuator>
{"".join(f'<motor name="rotor_{k}" site="{k}" gear="0 0 1 0 0 {0.02 * s}"/>' for k, (_, _, s) in CORNERS.items())}
</actuator></mujoco>"""


def _flights(rotor: int) -> list[Recording]:
    """Open loop; the gain of one rotor falls and rises with time."""
    rng, out = np.random.default_rng(0), []
    model = mujoco.MjModel.from_xml_string(QUAD)
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        for i in range(400):
            t = 0.01 * i
            u = 0.08 * np.sin((5 + np.arange(4)) * t + k + np.arange(4)) * np.cos(0.7 * t)
            felt = u.copy()
            felt[rotor] *= 1.0 + 0.4 * np.sin(2.0 * t + k)
            rows.append((t, data.qpos.copy(), u))
            data.ctrl[:] = felt
            for _ in range(5):
                model.opt.timestep = 0.002
                mujoco.mj_step(model, data)
        time, q, u = (np.array(x) for x in zip(*rows, strict=True))
        q[:, :3] += 1e-5 * rng.standard_normal((len(q), 3))
        out.append(Recording(f"flight_{k}", time, q, None, u))
    return out


@pytest.mark.parametrize(
    ("missing", "at"),
    [((0.1, 10.0, 0.1), [1]), ((10.0, 0.1, 0.1), [0]), ((5.0, 7.0, 0.0), [0])],
    ids=["at the base", "at the joint", "at the base, but by no means more so than at the joint"],
)
def test_a_floating_base_is_the_place_where_force_there_explains_far_more_than_at_any_joint(missing, at):
    """One joint, and two degrees of freedom of a body; force at one of them does nothing to the others."""
    push = np.tile(missing, (4, 1))
    probed = Probed(np.tile(np.eye(3), (4, 1, 1)), push, np.ones(3))
    assert _likeliest((probed, probed), [0]) == at


@pytest.mark.parametrize(
    ("joint", "width", "at"),
    [
        pytest.param("shoulder", 0.08, ["shoulder"], marks=pytest.mark.slow),
        # it lasts a fraction of a window: a constant force at the other joint does nearly as well
        ("elbow", 0.08, ["elbow", "shoulder"]),
    ],
)
def test_a_rough_spot_is_placed_where_force_at_one_joint_alone_explains_most(joint, width, at, left_alone):
    def spot(m: mujoco.MjModel, d: mujoco.MjData) -> None:
        dof = m.joint(joint).dofadr[0]
        d.qfrc_applied[dof] = -np.tanh(20.0 * d.qvel[dof]) * np.exp(-(((d.qpos[dof] - 0.1) / width) ** 2))

    recordings = record(FINE_ARM, [4.0, 0.8], force=spot, count=5, seconds=4.0)
    found = diagnose(
        mujoco.MjSpec.from_string(FINE_ARM), recordings, Config(effects=("gravity_tilt",), jobs=1)
    )
    assert found.verdict == "unexplained" and found.unexplained is not None
    assert found.unexplained["at"] == at


@pytest.mark.parametrize("rotor", [0, 2])
def test_what_acts_along_one_rotors_force_is_placed_at_that_rotor(rotor):
    found = diagnose(
        mujoco.MjSpec.from_string(QUAD), _flights(rotor), Config(effects=("gravity_tilt",), jobs=1)
    )
    name = list(CORNERS)[rotor]
    assert found.verdict == "unexplained"
    assert found.unexplained is not None
    assert found.unexplained["at"] == [f"rotor_{name}"]
    table = found.to_json()
    assert any(row["at"] == f"rotor_{name}" and row["kind"] == "actuator" for row in table["location"]), (
        table["location"]
    )


def test_what_impacts_leave_is_told_beside_what_they_leave_of_the_models_own_recordings():
    recording = SimpleNamespace(log="drop")
    windows = SimpleNamespace(
        start=np.array([0.5, 1.25]), source=[0, 0], sources=[SimpleNamespace(recording=recording)]
    )
    errors = SimpleNamespace(rms=0.008, window=np.array([0.001, 0.011]))
    held = SimpleNamespace(after=errors, floor=0.001, windows=windows)
    found = SimpleNamespace(fit=NOTHING, noise=Floor(missed=7.5))
    strikes, free = (SimpleNamespace(ctx=SimpleNamespace(contacts=x)) for x in (((0, 1),), ()))
    (said,) = struck(strikes, found, held)
    assert "missed by 8 times what noise alone leaves (most 1.25 s into drop)" in said
    assert "the model makes itself" in said and "by 7.5 times" in said
    assert struck(free, found, held) == []
    assert struck(strikes, found, SimpleNamespace(after=errors, floor=0.005, windows=windows)) == []

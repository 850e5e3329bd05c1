"""A payload carried over to another body."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place, Samples, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.rigid_equivalence import carried_over

ARM = """<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size=".1"/>
<body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/><geom size=".1"/></body></body></worldbody>
</mujoco>"""


def test_a_payload_is_carried_over_to_the_same_point_in_the_usual_pose():
    """With the elbow at a right angle (about -y: x turns to z), 0.2 m along the forearm is 0.3 m out and 0.2 m up."""
    model = mujoco.MjModel.from_xml_string(ARM)
    ctx = nominal_context(model)
    # once in three rows it was elsewhere; the shoulder's angle turns both
    q = np.array([[0.7, -np.pi / 2], [0.7, -np.pi / 2], [0.0, 1.0]])
    samples = Samples(q, 0 * q, 0 * q, np.ones_like(q))
    upper, fore, drag = (
        Term("payload_mass", Place("body", "upper", 1)),
        Term("payload_mass", Place("body", "fore", 2)),
        Term("viscous_damping", Place("joint", "elbow", 1)),
    )
    h = Hypothesis.of(fore, drag)
    theta = h.gather(ctx, {fore: np.array([0.4, 0.2, 0.05, 0.0]), drag: np.array([0.03])})
    f = Fitted(h, theta, theta)
    moved = carried_over(replace(ctx, samples=samples), f, fore, upper)
    parts = moved.hypothesis.split(ctx, moved.theta)
    assert parts[upper] == pytest.approx([0.4, 0.3, 0.05, 0.2], abs=1e-12) and parts[drag] == [0.03]
    assert set(parts) == {upper, drag}
    assert carried_over(replace(ctx, samples=samples), f, drag, upper) is None
    assert carried_over(ctx, f, fore, upper) is None

"""Contracts over the whole vocabulary: parameters, reports, exports, and C against JAX against the batch."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from envs._mjx import mjx
from mpge_jax.diagnosis import REGISTRY, VOCABULARY, InputError
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel, CStepper
from mpge_jax.diagnosis.corrected.jax_engine import CorrectedEngine
from mpge_jax.diagnosis.effects.base import register
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context, Place, nominal_context
from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.screening import ELABORATE
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection.alternatives import PLAIN_LAWS, SPECIAL_CASES
from mpge_jax.diagnosis.simulation.single_step import Machine
from tests.diagnosis.machines import BOX, FINE_ARM, FINE_PENDULUM
from tests.diagnosis.searches import exported

VALUES = {
    "viscous_damping": [0.08], "coulomb_friction": [0.05], "stribeck_friction": [0.03, 0.04, 0.4],
    "load_dependent_friction": [0.02, 0.1], "asymmetric_friction": [0.03, 0.06, 0.02, 0.05],
    "quadratic_drag": [0.05], "joint_stiffness": [0.6, 0.1], "cogging_torque": [0.05, 0.03, 7.0],
    "backlash": [0.05, 0.3], "joint_flexibility": [30.0, 0.05], "armature": [0.01], "actuator_gain": [0.7],
    "dead_actuator": [], "actuator_bias": [0.2], "torque_saturation": [0.3], "actuator_deadzone": [0.1],
    "actuator_delay": [0.011], "actuator_lag": [0.03], "back_emf": [0.05],
    "payload_mass": [0.2, 0.02, 0.01, -0.3], "mass_scale": [1.3], "com_offset": [0.02, 0.0, 0.03],
    "gravity_tilt": [0.1, -0.05], "external_force": [0.4, 0.0, -0.3], "contact_friction": [0.3],
    "load_dependent_friction:gear": [0.02, 0.1], "viscous_damping:explicit": [0.08], "viscous_damping:servo": [0.08],
    "actuator_bias:reclipped": [0.2],
    "actuator_gain:limited": [1.6], "actuator_bias:limited": [0.2], "actuator_deadzone:limited": [0.1],
    "contact_stiffness": [0.05], "encoder_offset": [0.04], "sensor_delay": [0.005],
    "coulomb_friction:creeping": [0.06], "coulomb_friction:behind_gap": [0.05, 0.01, 0.004],
    "given_inertias:0.03": [1.06, 0.95],
    "coulomb_friction:elastic": [0.05, 0.4, 0.3], "stribeck_friction:elastic": [0.03, 0.04, 0.4, 0.4, 0.3],
    "load_dependent_friction:elastic": [0.02, 0.1, 0.4, 0.3],
    "load_dependent_friction:gear:elastic": [0.02, 0.1, 0.4, 0.3],
    "load_dependent_friction:falling": [0.02, 0.1, 0.4, 0.3],
    "load_dependent_friction:gear:falling": [0.02, 0.1, 0.4, 0.3],
    "joint_stiffness:hardening": [0.6, 0.1, 0.3], "payload_mass:extended": [0.2, 0.02, 0.01, -0.3, 0.1],
    "asymmetric_friction:elastic": [0.03, 0.06, 0.02, 0.05, 0.4, 0.3], "torque_saturation:soft": [0.3, 0.2],
    "joint_flexibility:damped_motor": [30.0, 0.05, 0.7], "coulomb_friction:gradual": [0.05, 0.3],
}  # fmt: skip
# Where the native element differs by a fraction of a step: filters and delays act at whole steps, the integrator
# takes polynomial damping implicitly, and contact solvers start from another guess.
EXPORTED = {
    "actuator_lag": 2e-3, "actuator_delay": 2e-3, "quadratic_drag": 2e-4, "contact_friction": 1e-4,
    "contact_stiffness": 1e-4, "viscous_damping:explicit": 1e-2,
}  # fmt: skip
EVERY = tuple(VALUES)
"""The vocabulary, the second forms of some of its effects, and what corrects the given model."""
CONTACT = ("contact_friction", "contact_stiffness")


def model_for(effect_id: str) -> str:
    """A machine on which the effect can act."""
    if effect_id == "viscous_damping:explicit":
        return FINE_PENDULUM.replace('timestep="0.002"', 'timestep="0.008"')
    if effect_id == "viscous_damping:servo":
        # MJX takes a clipped servo's braking implicitly too, C does not
        explicit = FINE_PENDULUM.replace("implicitfast", "Euler")
        return explicit.replace("<motor ", '<position kp="3" kv="0.2" forcerange="-0.5 0.5" ')
    if effect_id.endswith(":limited"):
        return FINE_PENDULUM.replace("<motor ", '<motor forcerange="-0.5 0.5" ')
    return BOX if effect_id in CONTACT else FINE_PENDULUM


def machine(effect_id: str, xml: str | None = None) -> Machine:
    xml = xml or model_for(effect_id)
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    effect = REGISTRY[effect_id]
    term = Term(effect_id, effect.places(ctx)[0])
    return Machine.build(ctx, (term,), (np.array(VALUES[effect_id]),))


def command(k: int) -> np.ndarray:
    return np.array([0.5 * np.sin(0.15 * k) + 0.3 * np.sign(np.sin(0.4 * k))])


def test_the_vocabulary_is_complete():
    assert set(VOCABULARY) <= set(REGISTRY) and len(VOCABULARY) == 28
    unlisted = {"given_inertias:0.03", *(i + ending for i, e in REGISTRY.items() for ending in e.closer)}
    assert set(VALUES) == {*REGISTRY, *unlisted} and not unlisted & set(REGISTRY)


@pytest.mark.parametrize("effect_id", EVERY)
def test_parameters_have_units_bounds_and_survive_a_report(effect_id):
    m = machine(effect_id)
    term, theta = m.terms[0], m.thetas[0]
    params = term.params(m.ctx)
    assert len(params) == theta.size
    for p, start in zip(params, term.effect.starts(m.ctx, term.place).T, strict=True):
        assert p.unit and p.low < p.high and p.scale > 0
        assert (start >= p.low).all() and (start <= p.high).all()
    values = term.effect.report(m.ctx, term.place, theta)
    assert set(values) == set(term.effect.units(m.ctx, term.place))
    back = term.effect.from_report(m.ctx, term.place, values)
    np.testing.assert_allclose(back, theta, rtol=1e-9, atol=1e-12)
    assert term.effect.equation and term.effect.sentence(term.place, {k: "1" for k in values})


def trajectory(stepper: CStepper, steps: int, contact: bool) -> np.ndarray:
    model = stepper.model
    stepper.reset(np.array([0.0, 0.001]) if contact else np.full(model.nq, 0.4), np.full(model.nv, 0.3))
    out = []
    for k in range(steps):
        stepper.step(4.0 * command(k) if contact else command(k))
        out.append(stepper.measured())
    return np.array(out)


@pytest.mark.parametrize("effect_id", EVERY)
def test_every_effect_changes_the_motion(effect_id):
    m, contact = machine(effect_id), effect_id in CONTACT
    nominal = Machine.build(m.ctx, (), ())
    a, b = trajectory(CStepper(m), 60, contact), trajectory(CStepper(nominal), 60, contact)
    assert np.abs(a - b).max() > 1e-5


COARSE = FINE_PENDULUM.replace('timestep="0.002"', 'timestep="0.008"')
"""Where damping has both of its forms."""


def _plainer(effect_id: str) -> dict[str, np.ndarray]:
    """Parameters [k, p] at which a law of friction does what plainer ones do, whose own are as in `VALUES`."""
    m = machine(effect_id, COARSE)
    term = m.terms[0]
    found = {
        name: term.effect.containing(m.ctx, term.place, name, np.array(VALUES[name])) for name in PLAIN_LAWS
    }
    return {name: starts for name, starts in found.items() if len(starts)}


@pytest.mark.parametrize("effect_id", ELABORATE)
def test_an_effect_does_what_those_do_that_it_contains(effect_id):
    contained = _plainer(effect_id)
    assert contained
    for name, starts in contained.items():
        m, plain = machine(effect_id, COARSE), machine(name, COARSE)
        params = m.terms[0].params(m.ctx)
        want = trajectory(CStepper(plain), 60, False)
        for theta in starts:
            assert all(p.low <= x <= p.high for p, x in zip(params, theta, strict=True))
            same = Machine.build(m.ctx, m.terms, (theta,))
            # damping that MuJoCo integrates implicitly is explicit in a law of friction
            atol = 0.02 if name == "viscous_damping" else 1e-9
            np.testing.assert_allclose(trajectory(CStepper(same), 60, False), want, atol=atol)


def test_what_is_never_a_rival_of_a_plain_law_contains_it():
    contained = {
        name: {effect_id for effect_id in ELABORATE if name in _plainer(effect_id)} for name in PLAIN_LAWS
    }
    # how plain dry friction sets in makes no other law of it
    contained[CREEPING] = contained["coulomb_friction"]
    assert contained == {name: set(SPECIAL_CASES[name]) for name in PLAIN_LAWS}


@pytest.mark.parametrize("effect_id", EVERY)
def test_native_export_moves_like_the_effect(effect_id):
    m = machine(effect_id)
    spec = mujoco.MjSpec.from_string(model_for(effect_id))
    spec.compile()
    if not m.terms[0].effect.export(spec, m.ctx, m.terms[0].place, m.thetas[0]):
        assert effect_id in (
            "stribeck_friction", "load_dependent_friction", "load_dependent_friction:gear", "asymmetric_friction",
            "coulomb_friction:behind_gap",
            *(i for i in EVERY if i.endswith((":damped_motor", ":elastic", ":falling", ":gradual", ":hardening"))),
            "torque_saturation:soft",
            "cogging_torque", "backlash", "actuator_bias:reclipped", "actuator_deadzone:limited",
            "joint_flexibility", "actuator_deadzone", "external_force", "encoder_offset", "sensor_delay",
        )  # fmt: skip
        return
    spec.compile()
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    contact = effect_id in CONTACT
    data = mujoco.MjData(again)
    data.qpos[:], data.qvel[:] = ([0.0, 0.001] if contact else 0.4), 0.3
    want = trajectory(CStepper(m), 60, contact)
    for k in range(60):
        data.ctrl[:] = 4.0 * command(k) if contact else command(k)
        mujoco.mj_step(again, data)
        np.testing.assert_allclose(data.qpos, want[k], atol=EXPORTED.get(effect_id, 1e-6))


# A single step, called twice: what takes the time is its compilation.
@jax.jit
def _plain_step(model, data, u):
    with jax.numpy_rank_promotion("allow"):
        return mjx.step(model, data.replace(ctrl=u))


def _of_one_structure(model: mujoco.MjModel) -> mujoco.MjModel:
    """The same machine with what MJX compiles or leaves out by a model's values: limits, biases and dry friction."""
    alike = copy.copy(model)
    alike.actuator_forcerange[alike.actuator_forcelimited == 0] = -1e6, 1e6
    alike.actuator_forcelimited[:] = True
    alike.actuator_biasprm[alike.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE] = 0.0
    alike.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    alike.dof_frictionloss[:] = np.maximum(alike.dof_frictionloss, 1e-9)
    return alike


def _compare_with_c(m: Machine, contact: bool, step, data, of_batch=...) -> None:
    stepper = CStepper(m)
    q0 = np.array([0.0, 0.001]) if contact else np.full(m.model.nq, 0.4)
    stepper.reset(q0, np.full(m.model.nv, 0.3))
    for k in range(25):
        u = 4.0 * command(k) if contact else command(k)
        stepper.step(u, 2)
        data = step(data, jnp.array(u, jnp.float32))
        np.testing.assert_allclose(np.asarray(data.qpos)[of_batch], stepper.measured(), atol=3e-4)


def _in_steps(effect_id: str) -> bool:
    e = REGISTRY[effect_id]
    return e.runtime or e.commands or e.senses


def _start(m: Machine, contact: bool):
    return jnp.array([0.0, 0.001]) if contact else jnp.full(m.model.nq, 0.4), jnp.full(m.model.nv, 0.3)


@pytest.mark.parametrize("effect_id", [i for i in EVERY if not _in_steps(i)])
def test_native_effects_agree_in_c_and_mjx(effect_id):
    """The model alone carries these effects, so one compiled step serves all of a machine."""
    m, contact = machine(effect_id), effect_id in CONTACT
    model = m.model if contact else _of_one_structure(m.model)
    put = mjx.put_model(model)
    qpos, qvel = _start(m, contact)
    data = mjx.make_data(model).replace(qpos=qpos, qvel=qvel)
    _compare_with_c(m, contact, lambda d, u: _plain_step(put, _plain_step(put, d, u), u), data)


@pytest.mark.slow
@pytest.mark.parametrize("effect_id", [i for i in EVERY if _in_steps(i)])
def test_effects_computed_each_step_agree_in_c_and_jax(effect_id):
    _agrees(machine(effect_id), "mjx")


def test_effects_of_every_stage_of_a_step_agree_in_c_and_jax():
    """Of commands, of forces with and without a memory, and of what is measured: in one machine, compiled once."""
    ids = ("actuator_delay", "stribeck_friction", "joint_flexibility", "sensor_delay")
    alone = [machine(i) for i in ids]
    terms, thetas = zip(*((m.terms[0], m.thetas[0]) for m in alone), strict=True)
    _agrees(Machine.build(alone[0].ctx, terms, thetas), "mjx")


@pytest.mark.parametrize("effect_id", [i for i in EVERY if _in_steps(i)])
def test_effects_computed_each_step_agree_on_the_c_engine_of_environments(effect_id):
    _agrees(machine(effect_id), "c")


def _agrees(m: Machine, backend: str) -> None:
    """Under `vmap`, beside a machine that starts elsewhere."""
    engine = CorrectedEngine(m, backend)
    qpos, qvel = (jnp.stack([-x, x]) for x in _start(m, False))
    step = jax.jit(jax.vmap(lambda d, u: engine.step(d, u, 2), (0, None)))
    _compare_with_c(m, False, step, jax.jit(jax.vmap(engine.init))(qpos, qvel), 1)


@pytest.mark.parametrize("effect_id", [i for i in EVERY if i not in CONTACT])
def test_batched_windows_agree_with_single_steps(effect_id):
    """The simulator of the fit and the stepper of the corrected machine are two implementations of one effect."""
    from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
    from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
    from mpge_jax.diagnosis.simulation.windows import Windows

    m = machine(effect_id, FINE_ARM if REGISTRY[effect_id].kinds == ("body",) else None)
    model, steps = m.ctx.model, 40
    dt, nu = float(model.opt.timestep), model.nu
    q0, v0 = np.full(model.nq, 0.4), np.full(model.nv, 0.3)
    u = np.array([np.resize(command(k), nu) for k in range(steps)])
    stepper = CStepper(m)
    stepper.reset(q0, v0)
    want = []
    for k in range(steps):
        stepper.step(u[k])
        want.append(stepper.measured() if effect_id == "encoder_offset" else stepper.data.qpos.copy())
    from mpge_jax.diagnosis import Recording
    from mpge_jax.diagnosis.recordings.states import States

    time = dt * np.arange(steps + 1)
    record = Recording("r", time, np.tile(q0, (steps + 1, 1)), None, np.vstack([u, u[-1:]]))
    states = States(
        record.qpos, np.tile(v0, (steps + 1, 1)), 0 * record.qpos, np.zeros((steps + 1, model.nv, 2, 2))
    )
    source = Source.build(record, states, record.ctrl)
    history = 150
    timeline = np.concatenate([np.repeat(u[:1], history, 0), u])[None]
    start = q0 + (0.04 if effect_id == "encoder_offset" else 0.0)
    w = Windows(
        (source,), np.zeros(1, int), np.zeros(1), dt, steps, start[None], v0[None],
        np.zeros((1, model.nv, 2, 2)), np.zeros((1, 0)), timeline, time[None, 1:], np.ones((1, steps), bool),
        np.array(want)[None], np.full((1, steps, model.nv), np.nan), np.zeros((1, model.nv, 2)),
        np.zeros((1, steps), bool), *np.zeros((2, 1, steps, model.nv)),
    )  # fmt: skip
    sim = Simulator(model, dataclasses.replace(m.ctx))
    residual = sim.residuals([Run(Hypothesis.of(*m.terms), m.thetas[0])], w)[0, 0, :, : model.nv]
    if effect_id == "sensor_delay":
        return
    np.testing.assert_allclose(residual, 0, atol=1e-6)


def test_vectors_are_reported_as_one_parameter():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(FINE_ARM)))
    payload, fore = REGISTRY["payload_mass"], Place("body", "fore", 2)
    values = payload.report(ctx, fore, np.array([[0.2, 1.0, 2.0, 3.0]]))
    assert set(values) == {"mass", "position"} and values["position"].tolist() == [[1.0, 2.0, 3.0]]
    assert payload.units(ctx, fore) == {"mass": "kg", "position": "m"}
    assert payload.naming(ctx, fore) == [0]
    assert REGISTRY["com_offset"].naming(ctx, fore) == [0, 1, 2]
    entry = {"id": "payload_mass", "at": "fore", "parameters": {"mass": 0.2, "position": [1.0, 2.0]}}
    with pytest.raises(InputError, match="effects"):
        CorrectedModel.build(mujoco.MjSpec.from_string(FINE_ARM), [entry])


def test_an_effect_of_ones_own_in_a_few_lines():
    from mpge_jax.diagnosis.effects.base import REGISTRY as table
    from mpge_jax.diagnosis.effects.base import Effect
    from mpge_jax.diagnosis.effects.context import Param
    from mpge_jax.diagnosis.effects.step import Forces

    try:

        @register
        class Magnet(Effect):
            id, kinds, runtime = "test_magnet", ("joint",), True
            equation = "-k sin(2 q)"

            def params(self, ctx: Context, place: Place):
                return (Param("strength", "N m", -5.0, 5.0, 0.05),)

            def force(self, xp, ctx, place, theta, s, memory):
                return Forces(joint=-theta[..., 0] * xp.sin(2 * s.q[..., ctx.qadr(place)])), memory

        ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(FINE_PENDULUM)))
        term = Term("test_magnet", table["test_magnet"].places(ctx)[0])
        m = Machine.build(ctx, (term,), (np.array([0.3]),))
        entries = [{"id": "test_magnet", "at": "hinge", "parameters": {"strength": 0.3}}]
        rebuilt = CorrectedModel.build(mujoco.MjSpec.from_string(FINE_PENDULUM), entries)
        a, b = trajectory(CStepper(m), 30, False), trajectory(rebuilt.c_stepper(), 30, False)
        np.testing.assert_array_equal(a, b)
        assert "test magnet" in term.effect.sentence(term.place, {"strength": "0.3 N m"})

        @register
        class Glue(Effect):
            id, kinds, fields = "test_glue", ("joint",), ("dof_damping",)
            equation = "-g v"
            says = "The {at} is glued with {glue}."

            def params(self, ctx: Context, place: Place):
                return (Param("glue", "N m s/rad", 0.0, 5.0, 0.05),)

            def model(self, f, ctx, place, theta):
                f.add("dof_damping", ctx.dof(place), theta[..., 0])

        model, m = exported(FINE_PENDULUM, {"test_glue": ("hinge", [0.3])})
        assert model.dof_damping[0] == m.model.dof_damping[0] == pytest.approx(0.32)
        glue = table["test_glue"].sentence(Place("joint", "hinge", 0), {"glue": "0.30 N m s/rad"})
        assert glue == "The hinge is glued with 0.30 N m s/rad."
    finally:
        table.pop("test_magnet", None)
        table.pop("test_glue", None)


def test_a_sensor_delay_is_looked_for_below_the_sample_time():
    ctx = nominal_context(mujoco.MjModel.from_xml_string(FINE_PENDULUM), period=0.02)
    effect = REGISTRY["sensor_delay"]
    (place, *_) = effect.places(ctx)
    assert effect.starts(ctx, place).min() <= 0.005


def test_a_servo_at_its_limit_does_not_brake():
    """Known answers: as the joint's own damping within the limit, nothing at it; at most what the servo has is lost."""
    form, plain = (
        machine(i, model_for("viscous_damping:servo")) for i in ("viscous_damping:servo", "viscous_damping")
    )
    for target, alike in ((0.05, True), (3.0, False)):
        ends = []
        for m in (form, plain):
            stepper = CStepper(m)
            stepper.reset(np.array([0.0]), np.array([0.3]))
            for _ in range(20):
                stepper.step(np.array([target]))
            ends.append(float(stepper.data.qvel[0]))
        given = CStepper(Machine.build(form.ctx, (), ()))
        given.reset(np.array([0.0]), np.array([0.3]))
        for _ in range(20):
            given.step(np.array([target]))
        free = float(given.data.qvel[0])
        if alike:
            assert ends[0] == pytest.approx(ends[1], rel=0.01) and ends[0] < 0.9 * free
        else:
            assert ends[0] == free and ends[1] < 0.95 * free
    (place,) = form.terms[0].effect.places(form.ctx)
    assert form.terms[0].effect.params(form.ctx, place)[0].low == pytest.approx(-0.2)
    less, _ = exported(model_for("viscous_damping:servo"), {"viscous_damping:servo": ("hinge", [-0.15])})
    assert less.actuator_biasprm[0, 2] == pytest.approx(-0.05) and less.dof_damping[0] == pytest.approx(0.02)
    assert not compatible(Hypothesis.of(Term("viscous_damping", place)), form.terms[0])
    assert form.terms[0].name == "viscous_damping"
    unlimited = model_for("viscous_damping:servo").replace('forcerange="-0.5 0.5"', "")
    assert not form.terms[0].effect.places(nominal_context(mujoco.MjModel.from_xml_string(unlimited)))


def test_damping_has_an_explicit_form_where_the_timestep_is_coarse():
    form, plain = REGISTRY["viscous_damping:explicit"], REGISTRY["viscous_damping"]
    coarse = model_for("viscous_damping:explicit")

    def context(xml: str) -> Context:
        return nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))

    ctx = context(coarse)
    (place,) = form.places(ctx)
    assert not form.places(context(FINE_PENDULUM.replace('timestep="0.002"', 'timestep="0.0002"')))
    assert not form.places(context(coarse.replace("implicitfast", "RK4")))
    explicit = (
        '<option><flag eulerdamp="disable"/></option>' + '<option timestep="0.008" integrator="Euler"/>'
    )
    assert not form.places(
        context(coarse.replace('<option timestep="0.008" integrator="implicitfast"/>', explicit))
    )
    # one name in reports, never both at a joint, and at most half of the speed is lost in a step
    assert Term(form.id, place).name == plain.id
    assert not compatible(Hypothesis.of(Term(plain.id, place)), Term(form.id, place))
    inertia = float(ctx.model.dof_M0[0])
    assert form.params(ctx, place)[0].high * 0.008 / inertia == pytest.approx(0.5)
    assert plain.params(ctx, place)[0].high > form.params(ctx, place)[0].high


def test_a_lag_smooths_what_the_limits_let_through():
    """MuJoCo clips a command before its filter."""
    m = machine("actuator_lag")
    spec = mujoco.MjSpec.from_string(FINE_PENDULUM)
    spec.compile()
    assert m.terms[0].effect.export(spec, m.ctx, m.terms[0].place, m.thetas[0])
    model = spec.compile()
    data, stepper = mujoco.MjData(model), CStepper(m)
    stepper.reset(np.zeros(1), np.zeros(1))
    for k in range(40):
        # before the stepper's first step its filter holds the first command
        u = np.array([10.0 if k else 0.0])
        stepper.step(u)
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
    assert data.actuator_force[0] < 1.9
    np.testing.assert_allclose(stepper.data.qpos, data.qpos, rtol=0.05)


def test_what_a_dead_zone_lets_through_is_no_force_of_its_own():
    """Of a servo on a tendon only the last step's force is known, which is what the dead zone left."""
    tendon = '<tendon><fixed name="t"><joint joint="hinge" coef="1"/></fixed></tendon><actuator>'
    xml = FINE_PENDULUM.replace("<actuator>", tendon).replace("<motor", '<position kp="2"')
    xml = xml.replace('joint="hinge" ctrlrange', 'tendon="t" ctrlrange')
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    assert REGISTRY["actuator_deadzone"].places(ctx) == []
    filtered = FINE_PENDULUM.replace("<motor", '<general dyntype="filterexact" dynprm=".03"')
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(filtered)))
    assert len(REGISTRY["actuator_deadzone"].places(ctx)) == 1

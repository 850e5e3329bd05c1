"""The paper's four targets: 500 steps in each name what was changed. The slow test writes the page."""

from __future__ import annotations

import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from mpge_jax.diagnosis import Config, Diagnosis, diagnose
from mpge_jax.diagnosis.corrected.tasks import nominal_spec, recordings_of
from mpge_jax.diagnosis.report.markdown_page import markdown
from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.policies import shipped
from mpge_jax.rollouts.target_log import TargetLog

ROOT = Path(__file__).parents[2]
BUDGET = 500
TRUTH: dict[str, tuple[str, str, dict[str, float]]] = {
    "SkewedPendulum": ("actuator_bias", "slide", {"bias": 1.5}),
    "BrokenHopper": ("dead_actuator", "thigh_joint", {}),
    "BrokenCheetah": ("dead_actuator", "bthigh", {}),
    "HeavyCheetah": ("mass_scale", "world", {"factor": 20 / 14}),
}


def rollout_log(target: str) -> TargetLog:
    policies, _ = shipped(envs.source_of(target), "MS")
    return target_log.collect(jax.random.key(0), envs.make(target), policies.rollout, BUDGET)


def random_log(target: str) -> TargetLog:
    """The same number of steps under uniformly random actions."""
    env = envs.AutoReset(inner := envs.make(target))
    low, high = inner.action_low, inner.action_high

    def body(carry, key):
        state, episode = carry
        action = jax.random.uniform(key, low.shape, minval=low, maxval=high)
        after = env.step(state, action)
        row = (state.obs, action, after.info["next_obs"], after.info["terminated"], episode)
        return (after, episode + (after.done > 0)), row

    start = (env.reset(jax.random.key(1)), jnp.zeros((), jnp.int32))
    rows = jax.lax.scan(body, start, jax.random.split(jax.random.key(2), BUDGET))[1]
    return TargetLog(*(x[None] for x in rows), jnp.asarray([BUDGET]))


def diagnosed(target: str, log: TargetLog) -> Diagnosis:
    return diagnose(nominal_spec(target), recordings_of(log, target), Config(jobs=os.cpu_count() or 1))


def check(target: str, d: Diagnosis) -> None:
    found = d.to_json()
    effect, place, values = TRUTH[target]
    assert (d.verdict, [(e["id"], e["at"]) for e in found["effects"]]) == ("effects", [(effect, place)])
    for name, value in values.items():
        assert found["effects"][0]["parameters"][name]["value"] == pytest.approx(value, rel=0.01)


def test_a_log_becomes_one_recording_for_each_episode():
    log = rollout_log("HeavyCheetah")
    recordings = recordings_of(log, "HeavyCheetah")
    assert [r.time.size for r in recordings] == [101] * 5
    assert np.isnan(recordings[0].qpos[:, 0]).all() and not np.isnan(recordings[0].qpos[:, 1:]).any()
    np.testing.assert_array_equal(recordings[2].qpos[7, 1:], np.asarray(log.observation)[2, 7, :8])
    np.testing.assert_array_equal(recordings[2].ctrl[7], np.asarray(log.action)[2, 7])


def test_velocities_on_the_observations_bound_are_left_out():
    for r in recordings_of(rollout_log("BrokenHopper"), "BrokenHopper"):
        assert np.nanmax(np.abs(r.qvel)) < 10


@pytest.mark.slow
def test_skewed_pendulum_from_the_rollout_policies():
    log = rollout_log("SkewedPendulum")
    d = diagnosed("SkewedPendulum", log)
    check("SkewedPendulum", d)
    env, rows = d.corrected_env("InvertedPendulum"), log.rows()
    start = jax.vmap(env.state_from_obs)(jnp.asarray(rows["observation"]))
    after = jax.vmap(env.step)(start, jnp.asarray(rows["action"]))
    np.testing.assert_allclose(after.obs, rows["next_observation"], atol=1e-4)


@pytest.mark.slow
def test_all_targets_from_rollout_policies_and_from_random_actions():
    found, parts = [], []
    for target in TRUTH:
        for name, log in (("rollout policies", rollout_log(target)), ("random actions", random_log(target))):
            d = diagnosed(target, log)
            found.append((target, d))
            call = f"diagnose(nominal_spec({target!r}), recordings_of(log, {target!r}))"
            parts.append(markdown(d, f"{target}, {BUDGET} steps of {name}", call))
    page = ROOT / "docs" / "machines" / "paper_targets.md"
    page.write_text("\n".join(parts), encoding="utf-8")
    for target, d in found:
        check(target, d)

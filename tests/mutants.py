"""Plants faults in the code of MPGE, one at a time, and counts those that the tests let live.

python -m tests.mutants --out mutants.md --state mutants.jsonl

Works in a copy of the tree. Each fault is one line, a mistake that somebody may make: a sign, a stale value, a label,
an axis, a key used twice. One that lives is a gap in the tests. With `--state` an interrupted run goes on where it
stopped; what has been found out counts as long as the fault, its file and its tests are the same.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

ROOT = Path(__file__).resolve().parents[1]
# What the tests never read, or would take long to copy.
LEFT_OUT = (".*", "__pycache__", "results", "runs", "build", "dist", "*.egg-info")
SECONDS = 600


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
      about: what is wrong, in a clause.
      file: where.
      old: text that occurs there exactly once.
      new: what stands in its place.
      tests: test files or node ids that should notice.
    """

    about: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


_UPDATE = "tests/grounding/test_grounding_update.py"
_GROUNDING = "tests/grounding/test_grounding.py"
_METHODS = "tests/experiments/test_methods.py"
_HANDED = f"{_METHODS}::test_a_grounding_method_gets_its_policies_its_logs_and_keys_of_its_own"
_PRESETS = "tests/experiments/test_presets.py"
_BONUS = (
    "tests/experiments/test_pretrain.py::test_er_policies_are_rewarded_for_the_entropy_of_those_before_them"
)
_SWEEP = "tests/experiments/test_sweep.py"
_EDGES = "tests/test_edges.py"
_CELLS = "tests/experiments/test_cells.py"

MUTANTS = (
    Mutant(
        "a draw's advantage over its siblings negated",
        "mpge_jax/grounding/adversarial.py",
        "return (of_state - others).reshape(-1)",
        "return (others - of_state).reshape(-1)",
        (f"{_UPDATE}::test_the_advantage_is_the_reward_less_its_baseline[vine]",),
    ),
    Mutant(
        "all members of a seed get one key",
        "experiments/methods/grounded.py",
        "return jax.vmap(lambda key: jax.random.split(key, members))(cell.keys(stage))",
        "return jax.vmap(lambda key: jnp.stack([key] * members))(cell.keys(stage))",
        (f"{_HANDED}[MPGE-MS]",),
    ),
    Mutant(
        "all members of an ensemble start from the first one's key",
        "mpge_jax/grounding/ensemble.py",
        "state = jax.jit(jax.vmap(first))(keys, start, *data)",
        "state = jax.jit(jax.vmap(first))(jnp.repeat(keys[:1], members, axis=0), start, *data)",
        ("tests/grounding/test_ensemble.py::test_a_key_a_log_and_policies_each_make_a_difference",),
    ),
    Mutant(
        "agents train in the bare simulator",
        "experiments/methods/grounded.py",
        "lambda members: GroundedEnv(work.source, members)",
        "lambda members: work.source",
        (f"{_METHODS}::test_agents_train_behind_the_transformers_and_in_the_target_only_where_asked",),
    ),
    Mutant(
        "the target log is recorded in the source",
        "experiments/methods/run.py",
        "recording.record(cell, method, target, sets, folder)",
        "recording.record(cell, method, source, sets, folder)",
        (f"{_HANDED}[SPG]",),
    ),
    Mutant(
        "MPGE+ keeps the worse transformer",
        "mpge_jax/grounding/early_stop.py",
        "better = error < state.error",
        "better = error > state.error",
        ("tests/grounding/test_early_stop.py::test_the_better_one_is_kept_whichever_it_is",),
    ),
    Mutant(
        "ER policies are punished for entropy",
        "mpge_jax/rollouts/policies.py",
        "return lambda obs: coefficient * mean_entropy(earlier, weights, obs)",
        "return lambda obs: -coefficient * mean_entropy(earlier, weights, obs)",
        (_BONUS,),
    ),
    Mutant(
        "preset release updates D first",
        "experiments/presets.py",
        "discriminator_first=False,",
        "discriminator_first=True,",
        (f"{_PRESETS}::test_where_the_release_goes_its_own_way",),
    ),
    Mutant(
        "SPG is given K policies",
        "experiments/methods/recording.py",
        "return cell.preset.policies if method.several_policies else 1",
        "return cell.preset.policies",
        (f"{_HANDED}[SPG]",),
    ),
    Mutant(
        "seeds do not rotate the policies",
        "experiments/methods/recording.py",
        "rotation = [[(seed + k) % full.size",
        "rotation = [[k % full.size",
        (f"{_HANDED}[SPG]",),
    ),
    Mutant(
        "agents are evaluated in the source",
        "experiments/methods/run.py",
        "returns = training.evaluate(cell, target, agents)",
        "returns = training.evaluate(cell, source, agents)",
        (f"{_CELLS}::test_agents_are_evaluated_in_the_target",),
    ),
    Mutant(
        "a partial last iteration of an agent is dropped",
        "experiments/presets.py",
        "return -(-self.agent_updates // self.agent.updates_per_iteration)",
        "return self.agent_updates // self.agent.updates_per_iteration",
        (f"{_PRESETS}::test_what_paper_and_release_share",),
    ),
    Mutant(
        "an ER policy's bonus counts a policy that is not there yet",
        "experiments/pretrain.py",
        "weights = (jnp.arange(args.count) < index).astype(jnp.float32)",
        "weights = (jnp.arange(args.count) <= index).astype(jnp.float32)",
        (_BONUS,),
    ),
    Mutant(
        "a failed cell counts as done",
        "experiments/runners/dispatch.py",
        "if job.result.exists():",
        "if job.result.parent.exists():",
        (f"{_SWEEP}::test_a_failed_cell_is_recorded_the_others_go_on_and_it_is_tried_again",),
    ),
    Mutant(
        "the spread over seeds is the population's",
        "experiments/report.py",
        "np.std(values, ddof=1)",
        "np.std(values, ddof=0)",
        (f"{_SWEEP}::test_tables_show_mean_spread_and_the_papers_number",),
    ),
    Mutant(
        "every seed is charged the seconds of all seeds",
        "experiments/sweep.py",
        "round(value / len(outcome.rows), 1)",
        "round(value, 1)",
        (f"{_CELLS}::test_seconds_of_a_cell_are_shared_by_its_seeds",),
    ),
    Mutant(
        "the last branch is followed, not the first",
        "mpge_jax/grounding/collect.py",
        "after = jax.tree.map(lambda x: x[0], reached)",
        "after = jax.tree.map(lambda x: x[-1], reached)",
        (f"{_GROUNDING}::test_branches_share_their_state_and_the_first_is_followed",),
    ),
    Mutant(
        "D sees the transformed action",
        "mpge_jax/grounding/collect.py",
        "row = Rows(at, asked, finite_or(",
        "row = Rows(at, executed, finite_or(",
        (f"{_UPDATE}::test_rows_are_the_sources_and_residuals_are_what_the_draw_did[paper]",),
    ),
    Mutant(
        "episodes begin anew only where all end at once",
        "mpge_jax/grounding/collect.py",
        "some = lockstep.largest(jnp.any(ended))",
        "some = lockstep.largest(jnp.all(ended))",
        (_GROUNDING,),
    ),
    Mutant(
        "D's inputs are normalised by stale statistics",
        "mpge_jax/grounding/discriminator.py",
        "inputs = network_inputs(stats, both, config)",
        "inputs = network_inputs(state.stats, both, config)",
        ("tests/grounding/test_discriminator.py::test_interpolation",),
    ),
    Mutant(
        "a network's last, smaller minibatch is skipped",
        "mpge_jax/learning/value.py",
        "self.order.shape[0] * -(-self.rows // self.share)",
        "self.order.shape[0] * (self.rows // self.share)",
        ("tests/learning/test_value.py::test_every_network_goes_through_all_its_own_rows_once_an_epoch",),
    ),
    Mutant(
        "a row is answered as the next one of its group",
        "mpge_jax/learning/grouped.py",
        "rank = jnp.sum(member * jnp.cumsum(member, axis=0), axis=1) - 1",
        "rank = jnp.sum(member * jnp.cumsum(member, axis=0), axis=1)",
        ("tests/learning/test_grouped.py::test_every_row_has_the_answer_of_its_own_group",),
    ),
    Mutant(
        "the quadratic model of the KL without its half",
        "mpge_jax/learning/trpo.py",
        "model_kl = 0.5 * jnp.vdot(direction, fisher(direction))",
        "model_kl = jnp.vdot(direction, fisher(direction))",
        ("tests/learning/test_trpo.py::test_step_is_the_scaled_natural_gradient",),
    ),
    Mutant(
        "PPO takes the more hopeful side of the clip",
        "mpge_jax/learning/ppo.py",
        "return jnp.minimum(ratio * advantages",
        "return jnp.maximum(ratio * advantages",
        ("tests/learning/test_ppo.py::test_clipped_objective_by_hand",),
    ),
    Mutant(
        "the transformed action is not clipped to the box",
        "mpge_jax/grounding/transformer.py",
        "return jnp.clip(action + jnp.clip(delta, -span, span), low, high)",
        "return action + jnp.clip(delta, -span, span)",
        ("tests/grounding/test_transformer.py::test_transform_by_hand",),
    ),
    Mutant(
        "differences taken inwards at the edge of the box get the wrong sign",
        "mpge_jax/grounding/inversion.py",
        "/ signed[:, :, None]",
        "/ delta[None, :, None]",
        (f"{_EDGES}::test_an_action_at_the_edge_of_the_box_is_inverted_too",),
    ),
    Mutant(
        "rows held out stay in the log to learn from",
        "mpge_jax/grounding/prediction.py",
        "return log.replace(count=kept), HeldOut(",
        "return log, HeldOut(",
        ("tests/grounding/test_prediction.py::test_the_last_rows_of_every_policy_are_held_out",),
    ),
    Mutant(
        "grounding learns from the rows that judge it",
        "mpge_jax/grounding/ensemble.py",
        "data = (rollout_policies, learned_from, held_out)",
        "data = (rollout_policies, logs, held_out)",
        (f"{_EDGES}::test_grounding_learns_nothing_from_the_rows_that_judge_it",),
    ),
    Mutant(
        "a target log calls a time limit a termination",
        "mpge_jax/rollouts/target_log.py",
        'after.info["next_obs"], after.info["terminated"], episode)',
        'after.info["next_obs"], after.done, episode)',
        (f"{_EDGES}::test_a_time_limit_ends_a_logged_episode_and_is_no_termination",),
    ),
    Mutant(
        "deterministic evaluations are stochastic",
        "mpge_jax/learning/agent.py",
        "sac.act(actor, env_state.obs, key if stochastic else None)",
        "sac.act(actor, env_state.obs, key)",
        ("tests/learning/test_agent.py::test_evaluate_is_a_plain_loop_over_episodes",),
    ),
    Mutant(
        "tau of the target critics swapped with 1 - tau",
        "mpge_jax/learning/sac.py",
        "optax.incremental_update(critic, state.target_critic, config.tau)",
        "optax.incremental_update(state.target_critic, critic, config.tau)",
        ("tests/learning/test_sac.py::TestLosses",),
    ),
    Mutant(
        "batches are drawn from rows not yet written",
        "mpge_jax/learning/buffer.py",
        "index = jax.random.randint(key, (batch_size,), 0, buffer.size)",
        "index = jax.random.randint(key, (batch_size,), 0, buffer.capacity)",
        ("tests/learning/test_buffer.py::test_samples_are_whole_transitions_from_the_valid_rows_only",),
    ),
    Mutant(
        "merged variances forget the distance of the means",
        "mpge_jax/learning/normalise.py",
        "variance=within + new_weight * (1.0 - new_weight) * gap**2,",
        "variance=within,",
        ("tests/learning/test_normalise.py::test_merge_by_hand",),
    ),
    Mutant(
        "policies whose actions have another size are let through",
        "mpge_jax/rollouts/rollout.py",
        "if shape != (env.action_size,):",
        "if shape is not None and len(shape) != 1:",
        ("tests/rollouts/test_rollout.py::test_policies_that_do_not_fit_are_told_in_one_sentence",),
    ),
    Mutant(
        "transformers of another task are let through",
        "mpge_jax/grounding/grounded_env.py",
        "if inputs != size:",
        "if inputs < 0:",
        ("tests/grounding/test_grounded_env.py",),
    ),
    Mutant(
        "the unit of a title is not converted",
        "mpge_jax/diagnosis/recordings/formats/plain.py",
        'value = table[:, column] * SIZES.get(unit or "", 1.0)',
        "value = table[:, column]",
        ("tests/diagnosis/recordings/test_recordings.py",),
    ),
    Mutant(
        "quaternions with the real part last are not told",
        "mpge_jax/diagnosis/recordings/validation.py",
        "return likeness(quat) < UNLIKE and likeness(np.roll(quat, 1, axis=1)) > ALIKE",
        "return False",
        ("tests/diagnosis/recordings/test_recordings.py",),
    ),
    Mutant(
        "positions in degrees under a motor that could not turn so far are not told by inspect",
        "mpge_jax/diagnosis/inspection/doubts.py",
        "far = _beyond_torque(recording, model, names) if not out else {}",
        "far = {}",
        ("tests/diagnosis/inspection/test_inspection.py",),
    ),
    Mutant(
        "the agent pays for the transformed action",
        "mpge_jax/grounding/grounded_env.py",
        "return self._env.step(state, executed, charged=action)",
        "return self._env.step(state, executed)",
        ("tests/grounding/test_grounded_env.py::test_the_agent_pays_for_the_action_it_asked_for",),
    ),
    Mutant(
        "the transformer's error is measured along the bare simulator",
        "mpge_jax/grounding/transform_error.py",
        "return jax.vmap(wrapped.step)(state, given), mean_error(",
        "return jax.vmap(wrapped.step)(state, action), mean_error(",
        (f"{_EDGES}::test_the_error_along_rollouts_is_of_the_states_that_the_transformer_leads_to",),
    ),
    Mutant(
        "a run is one iteration too long",
        "mpge_jax/loop.py",
        "finished = len(rows) + 1 == iterations",
        "finished = len(rows) == iterations",
        ("tests/test_loop.py::test_the_curve_holds_every_iteration_and_the_state_is_the_last",),
    ),
    Mutant(
        "next_obs is that of the episode after",
        "envs/wrappers.py",
        'kept["next_obs"] = finite_or(after.info["next_obs"], state.obs)',
        'kept["next_obs"] = select(after.done > 0, first.obs, after.obs)',
        ("tests/envs/test_envs_wrappers.py::test_auto_reset_keeps_the_true_next_observation",),
    ),
    Mutant(
        "select picks the other side",
        "envs/select.py",
        "(jnp.ndim(new) - mask.ndim)), new, old)",
        "(jnp.ndim(new) - mask.ndim)), old, new)",
        ("tests/envs/test_envs_select.py::test_every_leaf_is_picked_copy_by_copy",),
    ),
    Mutant(
        "an episode goes on in NaN",
        "envs/env.py",
        "terminated = (self.task.terminated(data) | lost).astype(obs.dtype)",
        "terminated = self.task.terminated(data).astype(obs.dtype)",
        (f"{_EDGES}::test_a_lost_state_ends_its_episode",),
    ),
    Mutant(
        "another motor is dead",
        "envs/variants/paper.py",
        "return action.at[0].set(0.0)",
        "return action.at[1].set(0.0)",
        ("tests/envs/test_envs_variants.py::test_broken",),
    ),
    Mutant(
        "a diverged simulation goes on from MuJoCo's initial state",
        "envs/c_engine.py",
        "lost = ~sound | (batch.native.warning[:, _DIVERGED, 1].sum(axis=1) > before)",
        "lost = ~sound",
        ("tests/envs/test_envs_engines.py::test_a_diverged_simulation_is_lost_and_alone",),
    ),
    Mutant(
        "DARC rewards what the target lacks",
        "mpge_jax/learning/darc.py",
        "jnp.clip(long - short,",
        "jnp.clip(short - long,",
        ("tests/learning/test_darc.py",),
    ),
    Mutant(
        "DARC pays from the first update on",
        "mpge_jax/learning/darc.py",
        "jnp.where(learner.step >= warm_up, added, 0.0)",
        "jnp.where(learner.step >= 0, added, 0.0)",
        ("tests/learning/test_darc.py",),
    ),
    Mutant(
        "late commands come at once",
        "envs/env.py",
        'data = self.engine.step(data, info["command"], self._delay)',
        "data = self.engine.step(data, command, self._delay)",
        ("tests/envs/test_envs_hidden.py::test_late_commands_by_hand",),
    ),
    Mutant(
        "delta is subtracted where the agent trains",
        "mpge_jax/grounding/delta_action.py",
        "jnp.clip(asked + delta(",
        "jnp.clip(asked - delta(",
        ("tests/grounding/test_delta_action.py",),
    ),
    Mutant(
        "every episode has the same drawn machine",
        "envs/randomised.py",
        "jnp.asarray(values, kind)[machine]",
        "jnp.asarray(values, kind)[0]",
        ("tests/envs/test_envs_randomised.py",),
    ),
    Mutant(
        "every seed is corrected by the first one's log",
        "experiments/methods/cell.py",
        "lambda x: x[i : i + 1]",
        "lambda x: x[:1]",
        ("tests/experiments/methods/test_diagnosed.py",),
    ),
    Mutant(
        "a fall back to the plain simulator is not told",
        "experiments/methods/diagnosed.py",
        '"simulator": "corrected" if found["effects"] else "plain"',
        '"simulator": "corrected"',
        ("tests/experiments/methods/test_diagnosed.py",),
    ),
    Mutant(
        "finetuning spends its first steps at random",
        "experiments/methods/baselines.py",
        'first="policy"',
        'first="uniform"',
        ("tests/experiments/methods/test_finetune.py",),
    ),
)


@dataclass(frozen=True)
class Args:
    """Plants faults in the code of MPGE one at a time, and reports how many the tests let live."""

    only: Annotated[
        tuple[int, ...], tyro.conf.arg(help="numbers of the faults to plant; all where none")
    ] = ()
    out: Annotated[Path | None, tyro.conf.arg(help="Markdown table to write")] = None
    state: Annotated[Path | None, tyro.conf.arg(help="JSON lines of what is known; goes on from there")] = (
        None
    )


def planted(mutant: Mutant, text: str) -> str:
    """The text of the mutant's file with the fault in it.

    Raises:
      ValueError: the old text does not occur exactly once, or what comes out is no Python.
    """
    count = text.count(mutant.old)
    if count != 1:
        raise ValueError(f"{mutant.file}: {mutant.old!r} ({mutant.about}) occurs {count} times, not once")
    changed = text.replace(mutant.old, mutant.new)
    try:
        compile(changed, mutant.file, "exec")
    except SyntaxError as error:
        raise ValueError(f"{mutant.file}: {mutant.new!r} is no Python ({error})") from error
    return changed


def identity(mutant: Mutant, tree: Path) -> str:
    """Tells whether what was found out still counts: the fault, the file that it is in, and its tests."""
    parts = [json.dumps([mutant.file, mutant.old, mutant.new, mutant.tests])]
    files = sorted({mutant.file, *(test.partition("::")[0] for test in mutant.tests)})
    parts += [(tree / file).read_text() for file in files]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def union(mutants: list[Mutant]) -> list[str]:
    """All tests concerned, each once; a whole file stands for what is in it."""
    tests = dict.fromkeys(test for mutant in mutants for test in mutant.tests)
    return [test for test in tests if test.partition("::")[0] == test or test.partition("::")[0] not in tests]


def environment(tree: Path) -> dict[str, str]:
    """Imports from `tree`, in the processes that tests start too; compiled fast rather than well."""
    return {
        **os.environ,
        "JAX_PLATFORMS": "cpu",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": str(tree),
    }


def run_tests(tree: Path, tests: list[str], seconds: float | None) -> tuple[int | None, str]:
    """Exit status of pytest (None where it took too long) and what it said."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    process = subprocess.Popen(
        command,
        cwd=tree,
        env=environment(tree),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        # A group of its own, so that processes which a test has started end with it.
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=seconds)
        return process.returncode, said
    except subprocess.TimeoutExpired:
        return None, ""
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def killer(status: int | None, said: str) -> str | None:
    """What noticed the fault; None where nothing did.

    Raises:
      RuntimeError: pytest could not do what it was asked.
    """
    if status is None:
        return f"nothing came back in {SECONDS} s"
    if status == 0:
        return None
    found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", said, re.MULTILINE)
    if status not in (1, 2) or found is None:
        raise RuntimeError(f"pytest ended with status {status}:\n{said[-3000:]}")
    return found[1]


@contextlib.contextmanager
def copy_of_the_tree() -> Iterator[Path]:
    """The checkout in a temporary folder, where imports come from it."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*LEFT_OUT))
        packages = ("envs", "experiments", "mpge_jax")
        code = f"from importlib.util import find_spec; print(*(find_spec(p).origin for p in {packages}), sep='\\n')"
        asked = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tree,
            env=environment(tree),
            capture_output=True,
            text=True,
            check=True,
        )
        for file in asked.stdout.splitlines():
            if not Path(file).is_relative_to(tree):
                raise RuntimeError(f"{file} would be imported, not what is in {tree}")
        yield tree


def known(path: Path | None) -> dict[str, dict[str, Any]]:
    """Records of an earlier run, by identity."""
    if path is None or not path.is_file():
        return {}
    records = [json.loads(line) for line in path.read_text().splitlines() if line]
    return {record["identity"]: record for record in records}


def table(records: list[tuple[int, Mutant, dict[str, Any]]]) -> str:
    """Markdown."""
    lines = ["| | fault | file | killed by |", "|---|---|---|---|"]
    for number, mutant, record in records:
        by = f"`{record['by']}`" if record["by"] else "**lives**"
        lines.append(f"| {number} | {mutant.about} | `{mutant.file}` | {by} |")
    dead = sum(record["by"] is not None for _, _, record in records)
    return "\n".join([*lines, "", f"{dead} of {len(records)} die."]) + "\n"


def main(args: Args) -> int:
    """Plants, tests, reports; status 1 where more than one in ten live."""
    numbers = args.only or tuple(range(1, len(MUTANTS) + 1))
    if not all(1 <= number <= len(MUTANTS) for number in numbers):
        raise ValueError(f"--only: faults are numbered 1 to {len(MUTANTS)}, got {numbers}")
    chosen = [(number, MUTANTS[number - 1]) for number in numbers]
    found = known(args.state)
    # All is read in the copy: the checkout may go on changing.
    with copy_of_the_tree() as tree:
        for _, mutant in chosen:
            planted(mutant, (tree / mutant.file).read_text())
        todo = [mutant for _, mutant in chosen if identity(mutant, tree) not in found]
        if todo:
            started = time.monotonic()
            status, said = run_tests(tree, union(todo), None)
            if status != 0:
                raise RuntimeError(f"the tests fail without a fault (status {status}):\n{said[-3000:]}")
            print(f"without a fault: all pass, {time.monotonic() - started:.0f} s", flush=True)
        records = []
        for number, mutant in chosen:
            name = identity(mutant, tree)
            if name not in found:
                file = tree / mutant.file
                text = file.read_text()
                started = time.monotonic()
                try:
                    file.write_text(planted(mutant, text))
                    by = killer(*run_tests(tree, list(mutant.tests), SECONDS))
                finally:
                    file.write_text(text)
                seconds = round(time.monotonic() - started, 1)
                found[name] = {"identity": name, "about": mutant.about, "by": by, "seconds": seconds}
                if args.state is not None:
                    with args.state.open("a") as lines:
                        lines.write(json.dumps(found[name]) + "\n")
            record = found[name]
            verdict = f"killed by {record['by']}" if record["by"] else "LIVES"
            print(f"{number:2} {mutant.about}: {verdict} ({record['seconds']:.0f} s)", flush=True)
            records.append((number, mutant, record))
    if args.out is not None:
        args.out.write_text(table(records))
    dead = sum(record["by"] is not None for _, _, record in records)
    print(f"{dead} of {len(records)} die")
    return 0 if 10 * dead >= 9 * len(records) else 1


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(Args, prog="python -m tests.mutants", description=Args.__doc__)))
    except (ValueError, RuntimeError) as error:
        print(f"mutants: {error}", file=sys.stderr)
        sys.exit(2)

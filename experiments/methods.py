"""What each method of the comparison does, for all seeds of a cell at once.

Shapes: `S` seeds, `K` rollout policies, `N` transformers of a seed.
"""

import dataclasses
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import envs
from experiments.presets import Preset
from mpge_jax import loop
from mpge_jax.grounding import ensemble, transform_error
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.grounded_env import GroundedEnv
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning import agent
from mpge_jax.learning.sac import SACState
from mpge_jax.loop import Curve
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.policies import PolicySet
from mpge_jax.rollouts.target_log import TargetLog


@dataclass(frozen=True)
class Method:
    """One way to carry a policy to the target.

    Attributes:
      name: as on the command line and in tables.
      kind: set of rollout policies, MS or ER.
      grounding: how transformers are learned, `adversarial` being the paper's way; None learns none.
      several_policies: K of the preset, or one.
      ensemble: N of the preset, or one.
      about: one line for `--help` and reports.
    """

    name: str
    about: str
    kind: str = "MS"
    grounding: Literal["adversarial", "vine", "inversion", "inversion+vine"] | None = None
    several_policies: bool = True
    ensemble: bool = False

    @property
    def uses_samples(self) -> bool:
        """Whether the method learns from target transitions of a metered budget."""
        return self.grounding is not None


METHODS = {
    method.name: method
    for method in (
        Method("direct", "the source policy, as it is"),
        Method(
            "SPG",
            "one rollout policy, one transformer (GARAT)",
            grounding="adversarial",
            several_policies=False,
        ),
        Method("MPG-MS", "several seeds, one transformer", grounding="adversarial"),
        Method("MPG-ER", "entropy-regularised policies, one transformer", kind="ER", grounding="adversarial"),
        Method("MPGE-MS", "several seeds, an ensemble", grounding="adversarial", ensemble=True),
        Method(
            "MPGE-ER",
            "entropy-regularised policies, an ensemble",
            kind="ER",
            grounding="adversarial",
            ensemble=True,
        ),
        Method(
            "Vine",
            "this project's: an ensemble, from several draws at every state and a discriminator of residuals",
            grounding="vine",
            ensemble=True,
        ),
        Method(
            "GAT", "the simulator inverted on the target's transitions, then regressed", grounding="inversion"
        ),
        Method(
            "MPGE+",
            "this project's: an ensemble from the inversion, then Vine's grounding from logged states",
            grounding="inversion+vine",
            ensemble=True,
        ),
        Method("target", "trained on in the target itself, within the preset's budget"),
    )
}


@dataclass(frozen=True)
class Cell:
    """One entry of the comparison: everything that decides its result."""

    task: str
    method: str
    samples: int
    seeds: tuple[int, ...]
    preset: Preset
    backend: str
    dynamics: str

    def keys(self, stage: str, *shared: str) -> jax.Array:
        """A key for each seed, `[S]`, for one stage of the work.

        It depends on `shared` and not on the method where given: methods with the same policies get the same log.
        """
        label = "/".join((stage, *(shared or (self.method,)), str(self.samples)))
        root = jax.random.key(zlib.crc32(label.encode()))
        return jnp.stack([jax.random.fold_in(root, seed) for seed in self.seeds])


@dataclass(frozen=True)
class Outcome:
    """What a cell gave.

    Attributes:
      rows: one dict of results for each seed.
      grounding_seconds: what making the transformers took, of all seeds together.
      curve: of the grounding, every metric `[iterations, S, N]`, or empty.
      transformers: every leaf `[S, N, ...]`, or None.
      agents: the deployed policies, S of them.
    """

    rows: list[dict[str, Any]]
    grounding_seconds: float
    curve: Curve
    transformers: Transformer | None
    agents: PolicySet


def run(cell: Cell, folder: Path, quiet: bool = False) -> Outcome:
    """Runs a cell; what it needs to be resumed is kept in `folder`."""
    method = METHODS[cell.method]
    target = envs.make(cell.task, cell.backend, cell.dynamics)
    source = envs.make(envs.source_of(cell.task), cell.backend, cell.dynamics)
    full = _policy_set(source.name, method.kind, cell.preset)
    rotation = [[(seed + k) % full.size for k in range(_policies(cell, method))] for seed in cell.seeds]
    sets = jax.tree.map(lambda *x: jnp.stack(x), *(full.select(indices) for indices in rotation))

    transformers: Transformer | None = None
    curve: Curve = {}
    extra: list[dict[str, Any]] = [{} for _ in cell.seeds]
    grounding_seconds = 0.0
    target_steps = [0] * len(cell.seeds)
    if method.uses_samples:
        logs = _record(cell, method, target, sets, folder)
        target_steps = [int(np.sum(np.asarray(count))) for count in logs.count]
        started = time.monotonic()
        transformers, curve, simulated = _ground(cell, method, source, target, sets, logs, folder, quiet)
        grounding_seconds = time.monotonic() - started
        extra = [
            {"grounding_simulator_steps": steps, **error}
            for steps, error in zip(simulated, _errors(cell, source, target, transformers), strict=True)
        ]
    elif method.name == "target":
        settings = cell.preset.tasks[source.name]
        target_steps = [settings.agent.env_steps(settings.agent_iterations)] * len(cell.seeds)
    learners = _train(cell, method, source, target, sets, transformers, folder, quiet)
    agents = policies.from_learners(learners)
    returns = _evaluate(cell, target, agents)
    rows = [
        {
            "task": cell.task,
            "method": cell.method,
            "samples": cell.samples,
            "seed": seed,
            "target_steps": target_steps[i],
            **{name: float(np.mean(values[i])) for name, values in returns.items()},
            **{f"{name}_std": float(np.std(values[i])) for name, values in returns.items()},
            **extra[i],
        }
        for i, seed in enumerate(cell.seeds)
    ]
    return Outcome(rows, grounding_seconds, curve, transformers, agents)


def _policies(cell: Cell, method: Method) -> int:
    return cell.preset.policies if method.several_policies else 1


def _policy_set(source: str, kind: str, preset: Preset) -> PolicySet:
    """The rollout policies of a preset.

    Raises:
      FileNotFoundError: there is no set of that kind and entropy coefficient.
      ValueError: the set was made with another coefficient than it should.
    """
    full, about = policies.shipped(source, kind, preset.entropy_coefficient)
    made_with = about.get("entropy_coefficient", preset.entropy_coefficient)
    if kind == "ER" and made_with != preset.entropy_coefficient:
        raise ValueError(
            f"the ER set of {source} was made with an entropy coefficient of {made_with}, "
            f"preset {preset.name} wants {preset.entropy_coefficient}"
        )
    return full


def _record(cell: Cell, method: Method, target: envs.Env, sets: PolicySet, folder: Path) -> TargetLog:
    """The target logs, every leaf `[S, ...]`; recorded once, then read: a resumed cell takes no more target steps."""
    paths = [folder / f"target_log_{seed}.npz" for seed in cell.seeds]
    if all(path.is_file() for path in paths):
        return jax.tree.map(lambda *x: jnp.stack(x), *map(target_log.load, paths))
    collect = jax.vmap(lambda key, one: target_log.collect(key, target, one, cell.samples))
    logs = collect(cell.keys("log", method.kind, str(_policies(cell, method))), sets.rollout)
    for i, path in enumerate(paths):
        target_log.save(path, jax.tree.map(lambda x, i=i: x[i], logs))
    return logs


def grounding_config(method: Method, preset: Preset, source: str) -> GroundingConfig | None:
    """How `method` grounds adversarially in a preset; None where it does not."""
    base = preset.tasks[source].grounding
    match method.grounding:
        case "adversarial":
            return base
        case "vine":
            return preset.vine.grounding(base)
        case "inversion+vine":
            return preset.plus.grounding(preset.vine.grounding(base))
        case _:
            return None


def _ground(
    cell: Cell,
    method: Method,
    source: envs.Env,
    target: envs.Env,
    sets: PolicySet,
    logs: TargetLog,
    folder: Path,
    quiet: bool,
) -> tuple[Transformer, Curve, list[int]]:
    """Transformers `[S, N, ...]`, the curve `[iterations, S, N]`, and the simulator steps of each seed."""
    seeds, members = len(cell.seeds), cell.preset.members if method.ensemble else 1
    config = grounding_config(method, cell.preset, source.name)
    plus = cell.preset.plus if method.grounding == "inversion+vine" else None
    rows = [int(np.sum(np.asarray(count))) for count in logs.count]
    simulated = [0] * seeds

    @jax.jit
    def repeat(tree: Any) -> Any:
        return jax.tree.map(lambda x: jnp.repeat(x, members, axis=0), tree)

    def fold(tree: Any) -> Any:
        return jax.tree.map(lambda x: x.reshape(seeds, members, *x.shape[1:]), tree)

    def keys(stage: str) -> jax.Array:
        return jax.vmap(lambda key: jax.random.split(key, members))(cell.keys(stage))

    start: Transformer | None = None
    if method.grounding in ("inversion", "inversion+vine"):
        learned_from = logs if plus is None else jax.vmap(lambda log: plus.stopping.hold_out(log)[0])(logs)
        inversion = cell.preset.inversion
        inverted, _ = ensemble.invert_ensemble(source, learned_from, inversion, keys("inversion"))
        simulated = [inversion.simulator_steps(count, source.action_size) for count in rows]
        if config is None:
            return inverted, {}, simulated
        start = jax.tree.map(lambda x: x.reshape(seeds * members, *x.shape[2:]), inverted)
        narrow = jnp.full_like(start.params["log_std"], config.transformer.init_log_std)
        start = start.replace(params={**start.params, "log_std": narrow})
    assert config is not None
    transformers, curve = ensemble.ground_ensemble(
        source,
        repeat(sets.rollout),
        repeat(logs),
        config,
        keys("grounding").reshape(-1),
        truth=transform_error.truth_of(target),
        start=start,
        stopping=None if plus is None else plus.stopping,
        folder=folder / "grounding",
        quiet=quiet,
        title=f"{cell.method} {cell.samples}: grounding {seeds} x {members}",
    )
    iterations = len(curve["reward"])
    simulated = [
        before
        + members
        * (
            iterations * config.simulator_steps
            + (count if config.needs_expected else 0)
            + ((iterations + 1) * min(plus.stopping.rows, count) if plus is not None else 0)
        )
        for before, count in zip(simulated, rows, strict=True)
    ]
    folded = {name: values.reshape(len(values), seeds, members) for name, values in curve.items()}
    return fold(transformers), folded, simulated


def _errors(
    cell: Cell, source: envs.Env, target: envs.Env, transformers: Transformer
) -> list[dict[str, Any]]:
    """The action-transformation error of each seed along random rollouts, as in the paper; mean over members."""
    truth = transform_error.truth_of(target)
    if truth is None:
        return [{} for _ in cell.seeds]

    def one(key: jax.Array, members: Transformer) -> jax.Array:
        size = members.input_mean.shape[0]
        measure = jax.vmap(lambda k, m: transform_error.in_rollouts(k, m, source, truth))
        return jnp.mean(measure(jax.random.split(key, size), members))

    errors = jax.jit(jax.vmap(one))(cell.keys("error"), transformers)
    return [{"transform_error": float(error)} for error in errors]


def _train(
    cell: Cell,
    method: Method,
    source: envs.Env,
    target: envs.Env,
    sets: PolicySet,
    transformers: Transformer | None,
    folder: Path,
    quiet: bool,
) -> SACState:
    """Agents that start from the first policy of each seed's set, every leaf `[S, ...]`."""
    settings = cell.preset.tasks[source.name]
    config = settings.agent
    first = [jax.tree.map(lambda x, i=i: x[i], sets).learner(0, config.sac) for i in range(len(cell.seeds))]
    learners = jax.tree.map(lambda *x: jnp.stack(x), *first)
    if method.name == "direct":
        return learners

    def env_of(members: Transformer | None) -> envs.Environment:
        return target if members is None else GroundedEnv(source, members)

    init = jax.jit(jax.vmap(lambda key, learner, members: agent.init(key, env_of(members), config, learner)))
    step = jax.jit(
        jax.vmap(lambda state, members: agent.iterate(state, env_of(members), config)), donate_argnums=0
    )
    state, _ = loop.run(
        lambda s: step(s, transformers),
        init(cell.keys("agent"), learners, transformers),
        settings.agent_iterations,
        title=f"{cell.method} {cell.samples}: training {len(cell.seeds)} agents",
        folder=folder / "agent",
        identity={
            "cell": [cell.task, cell.method, cell.samples, cell.seeds, cell.backend, cell.dynamics],
            "config": dataclasses.asdict(config),
        },
        note=lambda metrics: (
            f"return there {np.nanmean(np.append(metrics['return'], np.nan)):.0f}"
            if np.isfinite(metrics["return"]).any()
            else ""
        ),
        quiet=quiet,
    )
    return state.learner


def _evaluate(cell: Cell, target: envs.Env, agents: PolicySet) -> dict[str, np.ndarray]:
    """Returns in the target, `[S, episodes]`, for reporting only."""
    episodes = cell.preset.episodes
    return {
        name: np.asarray(
            jax.jit(jax.vmap(lambda k, actor, s=stochastic: agent.evaluate(k, target, actor, episodes, s)))(
                cell.keys(f"evaluation {name}"), agents.actor
            )
        )
        for name, stochastic in (("return_stochastic", True), ("return_deterministic", False))
    }


def known_samples(samples: Sequence[int], method: str) -> list[int]:
    """The sample sizes that a method has cells for: 0 alone where it uses none."""
    return list(samples) if METHODS[method].uses_samples else [0]

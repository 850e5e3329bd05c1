"""Methods that ground the simulator: transformers from the log, agents in the simulator behind them."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from experiments.methods.cell import Method, Trained, Work
from experiments.methods.logged import in_logged_states, prediction_error
from experiments.methods.training import train
from experiments.presets import Preset
from mpge_jax.grounding import ensemble, prediction, transform_error
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.grounded_env import GroundedEnv
from mpge_jax.grounding.transform_error import Truth
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.loop import Curve


def grounded(work: Work) -> Trained:
    """Grounds the simulator as `work.method` says, and trains agents in it."""
    started = time.monotonic()
    transformers, curve, simulated = ground(work)
    seconds = time.monotonic() - started
    extra = [
        {"grounding_simulator_steps": steps, **error, **held_out}
        for steps, error, held_out in zip(
            simulated, errors(work, transformers), held_out_errors(work, transformers), strict=True
        )
    ]
    learners = train(work, lambda members: GroundedEnv(work.source, members), transformers)
    return Trained(learners, work.log_sizes, extra, seconds, curve, transformers)


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


def ground(work: Work) -> tuple[Transformer, Curve, list[int]]:
    """Transformers `[S, N, ...]`, the curve `[iterations, S, N]`, and the simulator steps of each seed."""
    cell, method, source, sets, logs = work.cell, work.method, work.source, work.sets, work.recorded
    seeds, members = len(cell.seeds), cell.preset.members if method.ensemble else 1
    config = in_logged_states(work, grounding_config(method, cell.preset, source.name))
    actors = sets.rollout if work.behaviour is None else work.behaviour
    plus = cell.preset.plus if method.grounding == "inversion+vine" else None
    rows = work.log_sizes
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
        repeat(actors),
        repeat(logs),
        config,
        keys("grounding").reshape(-1),
        truth=work.truth,
        start=start,
        stopping=None if plus is None else plus.stopping,
        folder=work.folder / "grounding",
        quiet=work.quiet,
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


def held_out_errors(work: Work, transformers: Transformer) -> list[dict[str, Any]]:
    """How well each seed's grounded simulator predicts transitions held out; mean over members."""

    def one(i: int) -> dict[str, Any]:
        members = jax.tree.map(lambda x: x[i], transformers)
        return prediction_error(
            work, lambda rows: jax.vmap(lambda m: prediction.one_step_error(work.source, m, rows))(members)
        )

    return [one(i) for i in range(len(work.cell.seeds))]


def errors(work: Work, transformers: Transformer) -> list[dict[str, Any]]:
    """The action-transformation error of each seed along random rollouts, as in the paper; mean over members."""

    def one(key: jax.Array, members: Transformer, truth: Truth) -> jax.Array:
        size = members.input_mean.shape[0]
        measure = jax.vmap(lambda k, m: transform_error.in_rollouts(k, m, work.source, truth))
        return jnp.mean(measure(jax.random.split(key, size), members))

    return transform_errors(work, transformers, one)


def transform_errors(
    work: Work, models: Any, one: Callable[[jax.Array, Any, Truth], jax.Array]
) -> list[dict[str, Any]]:
    """What `one` gives for each seed's key and model; nothing where the target is no change of actions.

    Args:
      models: every leaf `[seeds, ...]`.
    """
    truth = work.truth
    if truth is None:
        return [{} for _ in work.cell.seeds]
    found = jax.jit(jax.vmap(lambda key, model: one(key, model, truth)))(work.cell.keys("error"), models)
    return [{"transform_error": float(error)} for error in found]

"""Where each preset follows the paper, where its authors' code, and where neither: `python -m experiments.facts`.

One entry for each thing that the paper's text or its authors' release settles and that a preset sets. The page
docs/presets.md is written from the presets themselves.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from experiments.ending import exit_status
from experiments.presets import PAPER, PRESETS, Preset, TaskSettings
from mpge_jax import files
from mpge_jax.learning.trpo import TRPOConfig

TASKS = tuple(PAPER.tasks)

Read = Callable[[Preset, TaskSettings], Any]


@dataclass(frozen=True)
class Fact:
    """One thing that was settled.

    Attributes:
      what: it, in words.
      read: what a preset has, for one source task.
      paper: what the paper's text has: one value, or one for each of `TASKS`; None where it says nothing.
      release: likewise, its authors' code.
    """

    what: str
    read: Read
    paper: Any
    release: Any

    def of(self, preset: Preset) -> tuple[Any, ...]:
        """What `preset` has, for each of `TASKS`."""
        return tuple(self.read(preset, preset.tasks[task]) for task in TASKS)


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) and len(value) == len(TASKS) else (value,) * len(TASKS)


def _trpo(settings: TaskSettings) -> TRPOConfig:
    assert isinstance(settings.grounding.policy, TRPOConfig)
    return settings.grounding.policy


def _layers(sizes: tuple[int, ...]) -> str:
    return "-".join(map(str, sizes))


def _grounding_steps(preset: Preset, settings: TaskSettings) -> int:
    return settings.grounding.iterations * settings.grounding.simulator_steps


MILLION = 1_000_000

FACTS = (
    Fact(
        "pi_g: hidden layers, tanh",
        lambda p, t: _layers(t.grounding.transformer.hidden),
        "64-64",
        "64-64",
    ),
    Fact(
        "pi_g: log standard deviation at the start", lambda p, t: t.grounding.transformer.init_log_std, 0, 0
    ),
    Fact(
        "pi_g: draws at a state (several need a simulator that can be reset)",
        lambda p, t: t.grounding.branches,
        1,
        1,
    ),
    Fact(
        "pi_g that is kept: the last iterate (0), or a decaying average",
        lambda p, t: t.grounding.averaging,
        0,
        0,
    ),
    Fact(
        "grounding: simulator steps",
        _grounding_steps,
        (5 * MILLION, 20 * MILLION, 20 * MILLION),
        20 * MILLION,
    ),
    Fact("grounding: steps of one policy update", lambda p, t: t.grounding.batch_size, 2048, 2048),
    Fact("grounding: parallel simulators", lambda p, t: t.grounding.num_envs, 1, 1),
    Fact(
        "grounding: episodes from the task's own starts",
        lambda p, t: not t.grounding.restart_steps,
        True,
        True,
    ),
    Fact("TRPO: max KL", lambda p, t: _trpo(t).max_kl, 0.01, 0.01),
    Fact(
        "TRPO: conjugate-gradient steps, damping, Fisher rows, halvings",
        lambda p, t: (
            f"{_trpo(t).cg_iterations}, {_trpo(t).damping}, every {_trpo(t).fisher_stride}th, "
            f"{_trpo(t).line_search_steps}"
        ),
        "15, 0.1, every 5th, 10",
        "15, 0.1, every 5th, 10",
    ),
    Fact(
        "values: K networks, or one that sees k", lambda p, t: t.grounding.value_heads, "separate", "one_hot"
    ),
    Fact(
        "values: Adam's rate",
        lambda p, t: t.grounding.value_learning_rate,
        (3e-4, 1e-3, 1e-3),
        (3e-4, 1e-3, 1e-3),
    ),
    Fact(
        "values: epochs, minibatch",
        lambda p, t: f"{t.grounding.value_epochs}, {t.grounding.value_minibatch}",
        "5, 128",
        "5, 128",
    ),
    Fact(
        "order: D before pi_g (Algorithm 1), or after",
        lambda p, t: "before" if t.grounding.discriminator_first else "after",
        "before",
        "after",
    ),
    Fact(
        "D: hidden layers, tanh",
        lambda p, t: _layers(t.grounding.discriminator.hidden),
        "256-256",
        "256-256",
    ),
    Fact("D: Adam's rate", lambda p, t: t.grounding.discriminator.learning_rate, 3e-4, 3e-4),
    Fact(
        "D: labels, grounded 1 (paper) or 0 (release); the reward is the same",
        lambda p, t: t.grounding.discriminator.labels,
        "paper",
        "release",
    ),
    Fact(
        "D: s' as it is, or less the simulator's step",
        lambda p, t: t.grounding.discriminator.next_as,
        "observation",
        "observation",
    ),
    Fact(
        "D: weights of entropy and gradient penalty, its target",
        lambda p, t: (
            f"{t.grounding.discriminator.entropy_coefficient}, {t.grounding.discriminator.penalty_coefficient:g}, "
            f"{t.grounding.discriminator.penalty_target:g}"
        ),
        "0.001, 10, 1",
        "0.001, 10, 1",
    ),
    Fact(
        "D: interpolation weight of the penalty",
        lambda p, t: t.grounding.discriminator.interpolation,
        "per_sample",
        "constant",
    ),
    Fact("D: updates an iteration", lambda p, t: t.grounding.discriminator_updates, 4, 8),
    Fact("D: rows of each side in an update", lambda p, t: t.grounding.discriminator_batch, 512, 256),
    Fact(
        "D: floor of the standard deviation of inputs",
        lambda p, t: t.grounding.discriminator.std_floor,
        0.1,
        0.1,
    ),
    Fact("rollout policies K, transformers N", lambda p, t: f"{p.policies}, {p.members}", "5, 5", "5, 5"),
    Fact("ER policies: entropy coefficient", lambda p, t: p.entropy_coefficient, 0.1, 0.01),
    Fact(
        "agent: environment steps",
        lambda p, t: t.agent.env_steps(t.agent_iterations),
        (2 * MILLION, 3 * MILLION, 3 * MILLION),
        (2 * MILLION, 3 * MILLION, 3 * MILLION),
    ),
    Fact(
        "agent: uniform random steps at first",
        lambda p, t: t.agent.random_steps,
        (1_000, 1_000, 10_000),
        (1_000, 1_000, 10_000),
    ),
    Fact(
        "agent: steps, then updates, in turn",
        lambda p, t: (
            f"{t.agent.num_envs * t.agent.steps_per_iteration // t.agent.alternations}, "
            f"{t.agent.updates_per_iteration // t.agent.alternations}"
        ),
        "1, 1",
        "1, 1",
    ),
    Fact(
        "SAC: hidden layers, ReLU",
        lambda p, t: _layers(t.agent.sac.hidden),
        "256-256",
        "256-256",
    ),
    Fact("SAC: Adam's rate", lambda p, t: t.agent.sac.actor_lr, 3e-4, 3e-4),
    Fact("SAC: batch", lambda p, t: t.agent.sac.batch_size, 256, 256),
    Fact(
        "SAC: discount, rate of the target critics",
        lambda p, t: f"{t.agent.sac.gamma}, {t.agent.sac.tau}",
        "0.99, 0.005",
        "0.99, 0.005",
    ),
    Fact("SAC: replay buffer", lambda p, t: t.agent.buffer_capacity, None, None),
    Fact("evaluation episodes", lambda p, t: p.episodes, 50, 50),
)

# What no setting of a preset changes.
ALWAYS = (
    (
        "the agent's own policy is among those that ground (experiment i has policies i, i + 1, ...)",
        "as both",
    ),
    ("a rollout policy, and in the agent's training a transformer, is drawn at every reset", "as both"),
    ("pi_g is deterministic while the agent learns, stochastic while grounding", "as both"),
    ("the warm start restores actor, critics and temperature; the replay buffer is empty", "as both"),
    (
        "target rows of D: as many of each policy as there are grounded rows of it",
        "as the release; the paper is silent",
    ),
    (
        "the control cost in the grounded simulator is of the action asked for; the Broken targets charge the dead "
        "motor's action as 0",
        "as the release",
    ),
    (
        "each experiment has a log of its own on one metered budget, which its N transformers share, and keys and "
        "transformers of its own; the release shares transformers between experiments, and gives each its own ER set",
        "neither: stricter",
    ),
    (
        "in the target every rollout policy starts from its own draws; in the release all K share one seed",
        "as the paper; the release differs",
    ),
    (
        "budgets below 1M steps are those of the first table; every episode's last s' is the true one",
        "as both",
    ),
)


def verdict(fact: Fact, preset: Preset) -> str:
    """With whom a preset agrees: `both`, `paper`, `release`, `own`; `silent` where neither says anything."""
    if fact.paper is None and fact.release is None:
        return "silent"
    found = fact.of(preset)
    agrees = [
        name
        for name, said in (("paper", fact.paper), ("release", fact.release))
        if said is not None and _near(found, _each(said), fact)
    ]
    return "both" if len(agrees) == 2 else agrees[0] if agrees else "own"


def _near(found: tuple[Any, ...], said: tuple[Any, ...], fact: Fact) -> bool:
    """Equal, or, of a number of steps, the next that is made of whole iterations."""
    if "steps" in fact.what and all(isinstance(x, int) for x in (*found, *said)):
        return all(0 <= a - b < 2_048 for a, b in zip(found, said, strict=True))
    return found == said


def _shown(values: tuple[Any, ...]) -> str:
    words = [_word(x) for x in values]
    return words[0] if len(set(words)) == 1 else " / ".join(words)


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def markdown() -> str:
    """The page."""
    lines = [
        "# Presets, fact by fact",
        "",
        "Written by `python -m experiments.facts` from the presets themselves (`experiments/presets.py`). `SPG`, `MPG` "
        "and `MPGE` have the paper's structure in every preset: one draw of pi_g at a state, a value function for "
        "each rollout policy, D(s, a, s'), episodes from the task's own starts, the last iterate. `quick` and "
        "`standard` have other rates and smaller budgets, chosen on tasks that no table shows "
        "([tuning.md](tuning.md)). What `Vine` and `MPGE+` change is in [grounding.md](grounding.md).",
        "",
        f"Where a value depends on the source task, three stand for {', '.join(TASKS)}. **Bold**: neither the "
        "paper's nor the release's. A dash: says nothing.",
        "",
        f"| | paper's text | authors' code | {' | '.join(f'`{name}`' for name in PRESETS)} |",
        f"|---|---|---|{'---|' * len(PRESETS)}",
    ]
    for fact in FACTS:
        said = ["-" if x is None else _shown(_each(x)) for x in (fact.paper, fact.release)]
        cells = []
        for preset in PRESETS.values():
            text = _shown(fact.of(preset))
            cells.append(f"**{text}**" if verdict(fact, preset) == "own" else text)
        lines.append(f"| {' | '.join([fact.what, *said, *cells])} |")
    lines += ["", "In every preset:", "", "| | |", "|---|---|", *(f"| {a} | {b} |" for a, b in ALWAYS)]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Args:
    """Writes the page that says where each preset follows the paper."""

    out: Annotated[Path, tyro.conf.arg(help="the page")] = Path("docs/presets.md")


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        args = tyro.cli(Args, prog="python -m experiments.facts", description=Args.__doc__)
        files.write_text(args.out, markdown())
        print(f"written: {args.out}")
        return 0

    return exit_status("facts", work, goes_on=False)


if __name__ == "__main__":
    sys.exit(main())

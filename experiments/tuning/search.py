"""Where the presets `quick` and `standard` were chosen: two targets that no table shows.

Each candidate differs from a base in the settings that it is named by; all ground one transformer with five policies
(MPG-MS) from the same logs. Judged is the action-transformation error (uniform random actions, logged states). Writes
docs/tuning.md. A candidate that is done is not run again.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.ending import exit_status
from experiments.presets import STANDARD, VineSettings
from experiments.storage import plain
from experiments.tuning.trial import spread, trial
from mpge_jax import files
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.trpo import TRPOConfig

SAMPLES = 1_000
SEEDS = 2
ITERATIONS = {"InvertedPendulum": 100, "HalfCheetah": 400}


def _lazy(action: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    return jnp.clip(0.6 * action - 1.0, low, high)


def _limp(action: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    del low, high
    return action.at[4].multiply(0.3).at[2].multiply(-1.0)


VARIANTS = (
    envs.Variant("TuningPendulum", "InvertedPendulum", "0.6 of the command, less 1", action=_lazy),
    envs.Variant(
        "TuningCheetah", "HalfCheetah", "the front shin at 0.3, the back foot reversed", action=_limp
    ),
)

Change = Callable[[GroundingConfig], GroundingConfig]


_VINE = VineSettings(
    branches=8,
    max_kl=0.03,
    learning_rate=1e-3,
    penalty_coefficient=5.0,
    memory=0.05,
)


def base(source: str) -> GroundingConfig:
    """Where the search began."""
    return GroundingConfig(
        iterations=ITERATIONS[source],
        transformer=TransformerConfig(init_log_std=-0.5 if source == "InvertedPendulum" else -1.5),
        policy=TRPOConfig(max_kl=0.03),
        discriminator=DiscriminatorConfig(learning_rate=1e-3),
        discriminator_updates=12,
    )


def chosen(source: str, method: str) -> GroundingConfig:
    """What `quick` and `standard` have, at the length of the search."""
    grounding = replace(STANDARD.tasks[source].grounding, iterations=ITERATIONS[source])
    return grounding if method == "MPG-MS" else STANDARD.vine.grounding(grounding)


@dataclass(frozen=True)
class Candidate:
    """One configuration.

    Attributes:
      method: whose structure it has, `MPG-MS` or `Vine`.
      what: how it differs from the base, or "base".
      change: from the base's grounding of the paper's structure to what is tried.
    """

    method: str
    what: str
    change: Change

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.method}-{self.what}".replace(" ", "_")


def _trpo(kl: float) -> Change:
    return lambda c: replace(c, policy=TRPOConfig(max_kl=kl))


def _spread(log_std: float) -> Change:
    return lambda c: replace(c, transformer=replace(c.transformer, init_log_std=log_std))


def _judge(**settings: Any) -> Change:
    return lambda c: replace(c, discriminator=replace(c.discriminator, **settings))


def _updates(count: int) -> Change:
    return lambda c: replace(c, discriminator_updates=count)


def _vine(**settings: Any) -> Change:
    return lambda c: replace(_VINE, **settings).grounding(c)


def candidates() -> list[Candidate]:
    """All that is tried: the base of each structure first."""
    paper: Mapping[str, Change] = {
        "base": lambda c: c,
        "max KL 0.01": _trpo(0.01),
        "spread exp(0)": _spread(0.0),
        "spread exp(-0.5)": _spread(-0.5),
        "spread exp(-1.5)": _spread(-1.5),
        "D rate 3e-4": _judge(learning_rate=3e-4),
        "D penalty 5": _judge(penalty_coefficient=5.0),
        "D updates 8": _updates(8),
        "D updates 24": _updates(24),
        "average of a twentieth": lambda c: replace(c, averaging=1.0 - 20.0 / c.iterations),
        "D updates 24, spread exp(-1.5)": lambda c: _updates(24)(_spread(-1.5)(c)),
    }
    vine: Mapping[str, Change] = {
        "base": _vine(),
        "max KL 0.01": _vine(max_kl=0.01),
        "branches 4": _vine(branches=4),
        "D rate 3e-4": _vine(learning_rate=3e-4),
        "D penalty 10": _vine(penalty_coefficient=10.0),
        "D updates 24": lambda c: _vine()(_updates(24)(c)),
        "D updates 24, spread exp(-1.5)": lambda c: _vine()(_updates(24)(_spread(-1.5)(c))),
    }
    return [
        Candidate(method, what, change)
        for method, changes in (("MPG-MS", paper), ("Vine", vine))
        for what, change in changes.items()
    ]


def tried(source: str) -> list[Candidate]:
    """The candidates that differ from those before them."""
    configs: list[GroundingConfig] = []
    found = []
    for candidate in candidates():
        config = candidate.change(base(source))
        if config not in configs:
            configs.append(config)
            found.append(candidate)
    return found


@dataclass(frozen=True)
class Args:
    """Grounds in the tuning tasks with every candidate, and writes the page."""

    out: Annotated[Path, tyro.conf.arg(help="folder of the results")] = Path("results/tuning")
    page: Annotated[Path, tyro.conf.arg(help="the page")] = Path("docs/tuning.md")
    task: Annotated[tuple[str, ...], tyro.conf.arg(help="tuning tasks")] = tuple(v.name for v in VARIANTS)


def run(task: str, candidate: Candidate) -> dict[str, Any]:
    """What a candidate's grounding came to."""
    title = f"{task} {candidate.method} {candidate.what}"
    found = trial(task, candidate.change(base(envs.source_of(task))), SAMPLES, SEEDS, title)
    return {"method": candidate.method, "what": candidate.what, **found}


def markdown(rows: list[dict[str, Any]]) -> str:
    """The page."""
    lines = [
        "# Where the presets were tuned",
        "",
        "Written by `python -m experiments.tuning`. The presets `quick` and `standard` are chosen on two targets that "
        "no table of results shows, then frozen: what the tables show was never tuned on. (It was until version 0.1: "
        "the figures of that time have been taken out of the results.)",
        "",
        *(f"- `{v.name}`: {v.task}, {v.about}." for v in VARIANTS),
        "",
        f"One transformer, five policies (`MS`), {SAMPLES:,} target transitions, {SEEDS} seeds. Figures: "
        "action-transformation error under uniform random actions on logged states, mean of the last five iterations "
        "up to a quarter, a half and all of the run; mean (least to most) over seeds. `MPG-MS` has the paper's "
        "structure, `Vine` is this project's ([grounding.md](grounding.md)). **Bold**: what the presets have. "
        "A setting is taken over where it is better than the base on its source task by more than the seeds differ and "
        "costs no more than twice the time. A candidate without a row has not been run.",
        "",
        "What this does not settle: the base is what the presets had before, and that had been chosen on tasks of the "
        "tables; Hopper has HalfCheetah's settings; SAC's were chosen by training in the source tasks.",
    ]
    for task in dict.fromkeys(row["task"] for row in rows):
        of = [row for row in rows if row["task"] == task]
        lines += [
            "",
            f"## {task}",
            "",
            "| structure | setting | iterations | simulator steps | error at 25 % | 50 % | 100 % |",
            "|---|---|--:|--:|--:|--:|--:|",
        ]
        for row in of:
            errors = " | ".join(spread(row["errors"][share]) for share in ("0.25", "0.5", "1.0"))
            picked = row["config"] == plain(chosen(envs.source_of(task), row["method"]))
            what = f"**{row['what']}**" if picked else row["what"]
            lines.append(
                f"| {row['method']} | {what} | {row['iterations']:,} | {row['simulator_steps']:,} | {errors} |"
            )
    if rows:
        lines += ["", f"Machine: {rows[0]['versions']['machine']}."]
    return "\n".join(lines) + "\n"


def register() -> None:
    """Makes the tuning tasks known to `envs.make`."""
    for variant in VARIANTS:
        if variant.name not in envs.names():
            envs.register(variant)


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("tuning", _tune)


def _tune() -> int:
    args = tyro.cli(Args, prog="python -m experiments.tuning", description=Args.__doc__)
    register()
    every = records(args.out)
    for task in args.task:
        for candidate, record in every[task]:
            if not record.is_file():
                files.write_text(record, json.dumps(run(task, candidate), indent=1))
    lacking = [task for task, found in every.items() if not all(record.is_file() for _, record in found)]
    if lacking:
        print(f"not written: {args.page} holds all tuning tasks, and {', '.join(lacking)} lacks results")
        return 0
    rows = [json.loads(record.read_text()) for found in every.values() for _, record in found]
    files.write_text(args.page, markdown(rows))
    print(f"written: {args.page}")
    return 0


def records(folder: Path) -> dict[str, list[tuple[Candidate, Path]]]:
    """Tuning task to its candidates, each with the file of its result."""
    return {
        v.name: [(c, folder / v.name / f"{c.name}.json") for c in tried(envs.source_of(v.name))]
        for v in VARIANTS
    }

"""What the presets hold, fact by fact, written out here once more by hand."""

import dataclasses
from pathlib import Path

import pytest

from experiments import facts
from experiments.methods import METHODS, grounding_config
from experiments.presets import PAPER, PRESETS, QUICK, RELEASE, STANDARD, VineSettings
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.sac import SACConfig
from mpge_jax.learning.trpo import TRPOConfig

TASKS = ("InvertedPendulum", "Hopper", "HalfCheetah")
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("preset", [PAPER, RELEASE], ids=lambda p: p.name)
def test_what_paper_and_release_share(preset):
    assert (preset.policies, preset.members, preset.episodes) == (5, 5, 50)
    for task in TASKS:
        settings = preset.tasks[task]
        grounding, agent = settings.grounding, settings.agent
        assert (grounding.num_envs, grounding.steps_per_iteration, grounding.branches) == (1, 2048, 1)
        assert (grounding.restart_steps, grounding.averaging) == (0, 0.0)
        assert grounding.transformer == TransformerConfig(hidden=(64, 64), init_log_std=0.0)
        assert grounding.policy == TRPOConfig(
            max_kl=0.01,
            cg_iterations=15,
            damping=0.1,
            fisher_stride=5,
            line_search_steps=10,
            accept_kl_ratio=1.5,
        )
        value = grounding.value(5)
        assert (value.epochs, value.minibatch_size, value.hidden) == (5, 128, (64, 64))
        assert value.learning_rate == (3e-4 if task == "InvertedPendulum" else 1e-3)
        judge = grounding.discriminator
        assert (judge.hidden, judge.learning_rate, judge.std_floor) == ((256, 256), 3e-4, 0.1)
        assert (judge.entropy_coefficient, judge.penalty_coefficient, judge.penalty_target) == (1e-3, 10, 1)
        assert judge.next_as == "observation"
        assert agent.sac == SACConfig(
            hidden=(256, 256),
            actor_lr=3e-4,
            critic_lr=3e-4,
            alpha_lr=3e-4,
            tau=0.005,
            gamma=0.99,
            batch_size=256,
            target_entropy=None,
            init_alpha=1.0,
        )
        assert (agent.num_envs, agent.buffer_capacity) == (1, 1_000_000)
        # One step, one update.
        assert agent.steps_per_iteration == agent.updates_per_iteration == agent.alternations
        assert agent.random_steps == (10_000 if task == "HalfCheetah" else 1_000)
        wanted = 2_000_000 if task == "InvertedPendulum" else 3_000_000
        assert 0 <= agent.env_steps(settings.agent_iterations) - wanted < agent.steps_per_iteration


def test_where_the_paper_goes_its_own_way():
    assert PAPER.entropy_coefficient == 0.1
    for task, steps in zip(TASKS, (5_000_000, 20_000_000, 20_000_000), strict=True):
        grounding = PAPER.tasks[task].grounding
        assert (grounding.discriminator_updates, grounding.discriminator_batch) == (4, 512)
        assert grounding.discriminator_first
        assert grounding.value_heads == "separate"
        assert grounding.discriminator.labels == "paper"
        assert grounding.discriminator.interpolation == "per_sample"
        assert 0 <= grounding.iterations * 2048 - steps < 2048


def test_where_the_release_goes_its_own_way():
    assert RELEASE.entropy_coefficient == 0.01
    for task in TASKS:
        grounding = RELEASE.tasks[task].grounding
        assert (grounding.discriminator_updates, grounding.discriminator_batch) == (8, 256)
        assert not grounding.discriminator_first
        assert grounding.value_heads == "one_hot"
        assert grounding.discriminator.labels == "release"
        assert grounding.discriminator.interpolation == "constant"
        assert 0 <= grounding.iterations * 2048 - 20_000_000 < 2048


@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
@pytest.mark.parametrize("task", TASKS)
def test_spg_mpg_and_mpge_have_the_papers_structure_in_every_preset(preset, task):
    for name in ("SPG", "MPG-MS", "MPG-ER", "MPGE-MS", "MPGE-ER"):
        config = grounding_config(METHODS[name], preset, task)
        assert config is preset.tasks[task].grounding
        assert (config.branches, config.restart_steps, config.averaging) == (1, 0, 0.0)
        assert config.discriminator.next_as == "observation"
        assert config.batch_size == config.simulator_steps == 2048
        assert isinstance(config.policy, TRPOConfig)
    assert [METHODS[n].several_policies for n in ("SPG", "MPG-MS", "MPGE-MS")] == [False, True, True]
    assert [METHODS[n].ensemble for n in ("SPG", "MPG-MS", "MPGE-MS")] == [False, False, True]
    assert [METHODS[n].kind for n in ("SPG", "MPG-MS", "MPG-ER", "MPGE-MS", "MPGE-ER")] == [
        "MS",
        "MS",
        "ER",
        "MS",
        "ER",
    ]


@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
def test_our_methods_are_told_apart_and_say_what_they_simulate(preset):
    base = preset.tasks["HalfCheetah"].grounding
    vine = grounding_config(METHODS["Vine"], preset, "HalfCheetah")
    assert (vine.branches, vine.discriminator.next_as) == (8, "residual")
    assert vine.batch_size == base.batch_size == 2048
    # 256 states, at each the untouched simulator once more.
    assert vine.simulator_steps == 2048 + 256
    assert vine.averaging == pytest.approx(1 - 20 / base.iterations)
    plus = grounding_config(METHODS["MPGE+"], preset, "HalfCheetah")
    assert (plus.restart_steps, plus.branches) == (2, 8)
    assert plus.iterations == preset.plus.iterations < base.iterations
    assert plus.transformer.init_log_std == -3.0
    assert grounding_config(METHODS["GAT"], preset, "HalfCheetah") is None
    assert grounding_config(METHODS["target"], preset, "HalfCheetah") is None


def test_branches_that_do_not_divide_the_steps_are_refused():
    with pytest.raises(ValueError, match="30 steps an iteration cannot be divided into 8 branches"):
        VineSettings().grounding(GroundingConfig(steps_per_iteration=30))


def test_every_fact_of_paper_and_release_is_followed_by_its_preset():
    for fact in facts.FACTS:
        assert facts.verdict(fact, PAPER) in ("both", "paper", "silent"), fact.what
        assert facts.verdict(fact, RELEASE) in ("both", "release", "silent"), fact.what


def test_the_page_says_where_a_preset_differs():
    assert (ROOT / "docs" / "presets.md").read_text() == facts.markdown(), "run python -m experiments.facts"
    by_name = {fact.what: fact for fact in facts.FACTS}
    steps = by_name["grounding: simulator steps"]
    assert [facts.verdict(steps, p) for p in (QUICK, STANDARD, PAPER, RELEASE)] == [
        "own",
        "own",
        "paper",
        "release",
    ]
    # A setting that strays is seen.
    task = PAPER.tasks["HalfCheetah"]
    wide = dataclasses.replace(task.grounding, discriminator=DiscriminatorConfig(learning_rate=1e-3))
    strayed = dataclasses.replace(
        PAPER, tasks={**PAPER.tasks, "HalfCheetah": dataclasses.replace(task, grounding=wide)}
    )
    assert facts.verdict(by_name["D: Adam's rate"], strayed) == "own"

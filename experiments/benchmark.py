"""Measures this machine: simulation, grounding and SAC, as rates and as ratios. `--help` lists what is allowed.

Every rate is amount / median duration of repeated calls, compilation excluded and reported apart.
"""

import importlib.util
import json
import os
import shlex
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from rich.console import Console
from rich.markdown import Markdown

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs.tasks import gymnasium_spec
from experiments.storage import versions
from mpge_jax import files
from mpge_jax.grounding import adversarial, collect, transformer
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.learning import buffer, sac, trpo, value
from mpge_jax.learning.policy_gradient import PolicyBatch
from mpge_jax.learning.sac import SACConfig
from mpge_jax.rollouts import policies, target_log

PARTS = ("envs", "grounding", "stages", "sac")
STAGES = ("collection", "discriminator", "values", "TRPO")
SOURCE, TARGET = "HalfCheetah", "BrokenCheetah"
SAMPLES = 5_000
SAC_UPDATES = 64
# Environment steps a second of the paper's released code while it grounds, learning included, on two CPU cores.
REFERENCE = 676.0

Row = dict[str, Any]


@dataclass(frozen=True)
class Args:
    """Measures simulation, grounding and SAC on this machine."""

    part: Annotated[tuple[str, ...], tyro.conf.arg(help="what to measure: " + ", ".join(PARTS))] = PARTS
    backend: Annotated[
        tuple[str, ...], tyro.conf.arg(help="physics: c, mjx, warp (default: all that run here)")
    ] = ()
    copies: Annotated[
        tuple[int, ...],
        tyro.conf.arg(help="parallel environments of part envs (default: by backend and device)"),
    ] = ()
    members: Annotated[
        tuple[int, ...], tyro.conf.arg(help="transformers grounded, and SAC agents trained, at once")
    ] = (1, 5)
    seconds: Annotated[float, tyro.conf.arg(help="how long each measurement repeats its call")] = 3.0
    out: Annotated[Path, tyro.conf.arg(help="folder of benchmark.json and benchmark.md")] = Path(
        "results/benchmark"
    )


def available() -> tuple[str, ...]:
    """The physics backends that run on this machine."""
    nvidia = jax.default_backend() in ("gpu", "cuda") and importlib.util.find_spec("warp")
    return ("c", "mjx", "warp") if nvidia else ("c", "mjx")


def check(args: Args) -> None:
    """Raises ValueError, one sentence, for what cannot be measured."""
    for part in args.part:
        if part not in PARTS:
            raise ValueError(f"--part {part} is not known (allowed: {', '.join(PARTS)})")
    for backend in args.backend:
        if backend not in ("c", "mjx", "warp"):
            raise ValueError(f"--backend {backend} is not known (allowed: c, mjx, warp)")
        if backend not in available():
            raise ValueError(
                f"--backend {backend} needs an NVIDIA GPU and `make cuda`; JAX runs on {_device()}"
            )
    for option in ("copies", "members"):
        if any(number < 1 for number in getattr(args, option)):
            raise ValueError(f"--{option} must be at least 1, got {min(getattr(args, option))}")
    if not args.members:
        raise ValueError("--members needs at least one number")
    if not args.seconds > 0:
        raise ValueError(f"--seconds must be positive, got {args.seconds}")
    if args.out.exists() and not args.out.is_dir():
        raise ValueError(f"--out {args.out} is a file; give a folder")


def _device() -> str:
    return jax.devices()[0].device_kind


def measure(call: Callable[[], Any], amount: float, seconds: float) -> Row:
    """Calls `call` once to compile, then for `seconds` (at least three times): `rate` is amount / median duration."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    first = time.perf_counter() - start
    durations: list[float] = []
    while len(durations) < 3 or sum(durations) < seconds:
        start = time.perf_counter()
        jax.block_until_ready(call())
        durations.append(time.perf_counter() - start)
    return {
        "rate": amount / statistics.median(durations),
        "calls": len(durations),
        "first_call_seconds": round(first, 1),
    }


def _stepper(step: Callable[[Any], Any], state: Any) -> Callable[[], Any]:
    """`step`, each call on the state that the last one returned."""
    held = [state]

    def call() -> Any:
        held[0] = step(held[0])
        return held[0]

    return call


def measure_gymnasium(seconds: float) -> Row:
    """One environment of Gymnasium in a Python loop: what the others are compared with."""
    with tempfile.TemporaryDirectory() as folder:
        # Without the deprecated attribute, of which MuJoCo would leave a log file in the working folder.
        model = Path(folder) / "model.xml"
        model.write_text(gymnasium_spec("half_cheetah.xml").to_xml())
        env = gymnasium.make(f"{SOURCE}-v5", xml_file=str(model))
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, *(env.action_space.shape or ())))

    def call() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    row = measure(call, len(actions), seconds)
    env.close()
    return {"backend": "gymnasium", "copies": 1, **row}


def measure_env(backend: str, copies: int, seconds: float) -> Row:
    """Steps a second of `copies` environments under uniform random actions, auto-reset included."""
    env = envs.AutoReset(envs.make(SOURCE, backend))
    steps = max(4, min(100, 4_096 // copies)) if backend == "c" else 8
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)

    def body(state: envs.State, key: jax.Array) -> tuple[envs.State, None]:
        action = jax.random.uniform(key, (copies, env.action_size), minval=low, maxval=high)
        return jax.vmap(env.step)(state, action), None

    @jax.jit
    def roll(carry: tuple[envs.State, jax.Array]) -> tuple[envs.State, jax.Array]:
        state, key = carry
        key, key_steps = jax.random.split(key)
        return jax.lax.scan(body, state, jax.random.split(key_steps, steps))[0], key

    first = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), copies))
    row = measure(_stepper(roll, (first, jax.random.key(1))), copies * steps, seconds)
    return {"backend": backend, "copies": copies, **row}


def measure_grounding(backend: str, members: int, config: GroundingConfig, seconds: float) -> Row:
    """Simulator steps a second of `members` transformers together: collection and every update of an iteration."""
    source = envs.make(SOURCE, backend)
    rollout, _ = policies.shipped(SOURCE, "MS")
    target = envs.make(TARGET, "c" if jax.default_backend() == "cpu" else backend)
    log = target_log.collect(jax.random.key(0), target, rollout.rollout, SAMPLES)
    keys = jax.random.split(jax.random.key(1), members)
    state = jax.jit(jax.vmap(lambda key: adversarial.init(key, source, rollout.rollout, log, config)))(keys)
    step = jax.jit(
        jax.vmap(lambda s: adversarial.update(s, source, rollout.rollout, log, config)[0]), donate_argnums=0
    )
    row = measure(_stepper(step, state), members * config.batch_size, seconds)
    return {
        "backend": backend,
        "members": members,
        "copies": config.num_envs,
        "batch": config.batch_size,
        **row,
    }


def measure_stage(stage: str, members: int, config: GroundingConfig, seconds: float) -> Row:
    """Iterations a second of one stage of grounding on the C engine, for `members` transformers together."""
    source = envs.make(SOURCE, "c")
    rollout = policies.shipped(SOURCE, "MS")[0].rollout
    log = target_log.collect(jax.random.key(0), envs.make(TARGET, "c"), rollout, SAMPLES)

    @jax.jit
    @jax.vmap
    def begin(key: jax.Array) -> Any:
        state = adversarial.init(key, source, rollout, log, config)
        begun = state.env_state, state.rollout_policy
        return state, collect.collect(key, state.current, begun, source, rollout, log, config)[1]

    keys = jax.random.split(jax.random.key(1), members)
    state, rows = begin(keys)

    def run(key: jax.Array, state: adversarial.GroundingState, rows: collect.Rows) -> Any:
        if stage == "collection":
            begun = state.env_state, state.rollout_policy
            return collect.collect(key, state.current, begun, source, rollout, log, config)
        if stage == "discriminator":
            return adversarial.update_discriminator(
                key, state.discriminator, rows.transitions, rows.rollout_policy, log, state.expected, config
            )
        inputs = transformer.network_inputs(state.transformer, rows.observation, rows.action)
        # Any numbers will do for rewards: the work is the same.
        if stage == "values":
            value_config = config.value(rollout.size)
            return value.update(state.value, inputs, rows.rollout_policy, rows.log_prob, key, value_config)
        batch = PolicyBatch(inputs, rows.delta, rows.log_prob, rows.log_prob)
        learner = trpo.TRPOState(state.policy.params)
        return trpo.update(learner, batch, key, transformer.apply, trpo.TRPOConfig())

    compiled = jax.jit(jax.vmap(run))
    row = measure(lambda: compiled(keys, state, rows), members, seconds)
    return {"stage": stage, "members": members, **row}


def measure_sac(members: int, config: SACConfig, seconds: float) -> Row:
    """SAC updates a second of `members` agents together, on random transitions of HalfCheetah's sizes."""
    obs_size, action_size, rows = 17, 6, 10_000
    key_init, key_rows = jax.random.split(jax.random.key(0))

    def draw(stream: int, *shape: int) -> jax.Array:
        return jax.random.normal(jax.random.fold_in(key_rows, stream), shape)

    data = buffer.Transition(
        obs=draw(0, rows, obs_size),
        action=jnp.tanh(draw(1, rows, action_size)),
        reward=draw(2, rows),
        next_obs=draw(3, rows, obs_size),
        terminated=jnp.zeros(rows),
    )
    memory = buffer.add_batch(buffer.init(rows, obs_size, action_size), data)
    learners = jax.jit(jax.vmap(lambda k: sac.init(k, obs_size, action_size, jnp.ones(action_size), config)))(
        jax.random.split(key_init, members)
    )

    def one(learner: sac.SACState, key: jax.Array) -> sac.SACState:
        return sac.update_many(learner, memory, key, SAC_UPDATES, config)[0]

    @jax.jit
    def step(carry: tuple[sac.SACState, jax.Array]) -> tuple[sac.SACState, jax.Array]:
        learners, key = carry
        key, *each = jax.random.split(key, members + 1)
        return jax.vmap(one)(learners, jnp.stack(each)), key

    row = measure(_stepper(step, (learners, jax.random.key(1))), members * SAC_UPDATES, seconds)
    return {"members": members, "batch": config.batch_size, **row}


def _copies(args: Args, backend: str) -> tuple[int, ...]:
    if args.copies:
        return args.copies
    if backend == "c":
        return (1, 64, 1_024)
    return (16,) if jax.default_backend() == "cpu" else (4_096,)


def plan(args: Args) -> Iterator[tuple[str, str, Callable[[], Row]]]:
    """What will be measured: part, label and the measurement."""
    backends = args.backend or available()
    on_cpu = jax.default_backend() == "cpu"
    if "envs" in args.part:
        yield "envs", "gymnasium, 1 copy", partial(measure_gymnasium, args.seconds)
        for backend in backends:
            for copies in _copies(args, backend):
                label = f"{backend}, {copies} copies"
                yield "envs", label, partial(measure_env, backend, copies, args.seconds)
    if "grounding" in args.part:
        # The paper's batch of 2,048 and networks either way; an accelerator prefers it as copies.
        config = GroundingConfig() if on_cpu else GroundingConfig(num_envs=2_048, steps_per_iteration=1)
        # MJX on a CPU is for tests: it is grounded there only where asked for.
        chosen = args.backend or (("c",) if on_cpu else tuple(b for b in backends if b != "c"))
        for backend in chosen:
            for members in args.members:
                label = f"{backend}, {members} at once"
                yield "grounding", label, partial(measure_grounding, backend, members, config, args.seconds)
    if "stages" in args.part:
        for stage in STAGES:
            for members in args.members:
                yield (
                    "stages",
                    f"{stage}, {members} at once",
                    partial(measure_stage, stage, members, GroundingConfig(), args.seconds),
                )
    if "sac" in args.part:
        for members in args.members:
            yield "sac", f"{members} at once", partial(measure_sac, members, SACConfig(), args.seconds)


def ratios(rows: list[Row]) -> list[Row]:
    """`rows` with `ratio`: simulation to Gymnasium, grounding to the reference, SAC to its first row.

    Grounding and SAC of several members get `cost`, how much longer a round of theirs takes than one of one member.
    """
    gym = next((row["rate"] for row in rows if row.get("backend") == "gymnasium"), None)
    done = []
    for row in rows:
        base = {"envs": gym, "grounding": REFERENCE}.get(row["part"])
        extra = {} if base is None else {"ratio": row["rate"] / base}
        for one in rows:
            same = all(one.get(name) == row.get(name) for name in ("part", "backend", "stage"))
            if same and "members" in row and one.get("members") == 1 and row["members"] > 1:
                extra["cost"] = row["members"] * one["rate"] / row["rate"]
        done.append({**row, **extra})
    return done


def markdown(record: Row) -> str:
    """The record of a run as Markdown: how it was made, and one table for each part."""
    load = ", ".join(f"{x:.1f}" for x in record["load_average"])
    lines = [
        f"`{record['command']}` on {record['versions']['machine']}; load average before: {load}"
        " (numbers of a busy machine are too low)."
    ]
    of = {part: [row for row in record["rows"] if row["part"] == part] for part in PARTS}
    if of["envs"]:
        lines += [
            "",
            f"Simulation ({SOURCE}, uniform random actions; beside one Gymnasium environment in a Python loop):",
            "",
            "| engine | copies | steps a second | times Gymnasium | first call, compilation included |",
            "|---|--:|--:|--:|--:|",
        ]
        lines += [
            f"| {row['backend']} | {row['copies']:,} | {row['rate']:,.0f} | {_of(row, 'ratio')} "
            f"| {row['first_call_seconds']:.1f} s |"
            for row in of["envs"]
        ]
    if of["grounding"]:
        lines += [
            "",
            f"Grounding, learning included ({SOURCE} in {TARGET}'s log of {SAMPLES:,} transitions, five policies, "
            f"the paper's networks; the paper's released code makes {REFERENCE:,.0f} steps a second):",
            "",
            "| engine | transformers at once | copies | batch | steps a second, all | times the reference "
            "| time against one transformer |",
            "|---|--:|--:|--:|--:|--:|--:|",
        ]
        lines += [
            f"| {row['backend']} | {row['members']} | {row['copies']:,} | {row['batch']:,} | {row['rate']:,.0f} "
            f"| {_of(row, 'ratio')} | {_of(row, 'cost')} |"
            for row in of["grounding"]
        ]
    if of["stages"]:
        lines += [
            "",
            "Where that time goes (C engine; a round is one iteration's share of every transformer):",
            "",
            "| stage | transformers at once | milliseconds a round | time against one transformer |",
            "|---|--:|--:|--:|",
        ]
        lines += [
            f"| {row['stage']} | {row['members']} | {1e3 * row['members'] / row['rate']:,.0f} | {_of(row, 'cost')} |"
            for row in of["stages"]
        ]
    if of["sac"]:
        lines += [
            "",
            "SAC (256-256 networks, HalfCheetah's sizes):",
            "",
            "| agents at once | batch | updates a second, all | time against one agent |",
            "|--:|--:|--:|--:|",
        ]
        lines += [
            f"| {row['members']} | {row['batch']} | {row['rate']:,.0f} | {_of(row, 'cost')} |"
            for row in of["sac"]
        ]
    return "\n".join(lines) + "\n"


def _of(row: Row, name: str) -> str:
    return f"{row[name]:.3g}" if name in row else ""


def benchmark(args: Args) -> Row:
    """Measures, writes `benchmark.json` and `benchmark.md` after every measurement, and returns the record.

    Raises:
      ValueError: options that cannot be (one sentence).
    """
    check(args)
    console = Console(stderr=True)
    record: Row = {
        "command": shlex.join(["python", "-m", "experiments.benchmark", *sys.argv[1:]]),
        "versions": versions(),
        "load_average": [round(x, 1) for x in os.getloadavg()],
        "rows": [],
    }
    rows: list[Row] = []
    planned = list(plan(args))
    for number, (part, label, call) in enumerate(planned, 1):
        console.print(f"[{number}/{len(planned)}] {part}: {label} ...", highlight=False, markup=False)
        rows.append({"part": part, **call()})
        console.print(
            f"    {rows[-1]['rate']:,.0f} a second (first call {rows[-1]['first_call_seconds']:.1f} s)",
            highlight=False,
        )
        record["rows"] = ratios(rows)
        files.write_text(args.out / "benchmark.json", json.dumps(record, indent=1))
        files.write_text(args.out / "benchmark.md", markdown(record))
    return record


def main() -> int:
    """The command; returns its exit status."""
    args = tyro.cli(Args, prog="python -m experiments.benchmark", description=Args.__doc__)
    try:
        record = benchmark(args)
    except (ValueError, FileNotFoundError) as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("benchmark: interrupted", file=sys.stderr)
        return 130
    Console().print(Markdown(markdown(record)))
    print(f"written: {args.out / 'benchmark.json'} and {args.out / 'benchmark.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

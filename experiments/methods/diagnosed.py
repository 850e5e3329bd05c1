"""Methods that put into the simulator what the diagnosis names in the log, and train in that: alone, or grounded.

One diagnosis for each seed, from its own log. Where it names nothing (verdict `none`, or `unexplained` without any
named part) the agent trains in the plain simulator, and the seed's row says so: `verdict`, `named` and `simulator`.
"""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import mujoco

import envs
from envs.legacy import use_legacy_inertia
from experiments.methods.cell import Trained, Work
from experiments.methods.grounded import grounded
from experiments.methods.logged import prediction_error
from experiments.methods.training import train
from mpge_jax import files
from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.corrected.tasks import corrected_env, nominal_spec, recordings_of
from mpge_jax.grounding import prediction


def diagnosed(work: Work) -> Trained:
    """Agents trained in the simulator as each seed's diagnosis corrects it."""
    return _each(work, _in_simulator)


def diagnosed_and_grounded(work: Work) -> Trained:
    """The corrected simulator grounded as `work.method` says, and agents trained in that."""
    return _each(work, grounded)


def _in_simulator(work: Work) -> Trained:
    error = prediction_error(work, lambda rows: prediction.error_under(work.source, rows, rows.action))
    return Trained(train(work, lambda _: work.source), work.log_sizes, [error])


def _each(work: Work, method: Callable[[Work], Trained]) -> Trained:
    """A method in the corrected simulator of each seed, one after the other: corrected models differ in structure."""
    parts = []
    for i, seed in enumerate(work.cell.seeds):
        one = work.only(i)
        started = time.monotonic()
        found = _diagnosis(one)
        seconds = time.monotonic() - started
        about = {
            "verdict": found["verdict"],
            "named": "; ".join(f"{effect['id']} at {effect['at']}" for effect in found["effects"]),
            "simulator": "corrected" if found["effects"] else "plain",
        }
        if not work.quiet:
            print(f"seed {seed}: {about['verdict']}, {about['named'] or 'nothing named'}", flush=True)
        if found["effects"]:
            source = corrected_env(_nominal(one), found["effects"], one.source.name, one.cell.backend)
            assert isinstance(source, envs.Env)
            one = replace(one, source=source, truth=None)
        made = method(one)
        extra = [{**about, "diagnosis_seconds": found["seconds"], **row} for row in made.extra]
        parts.append(replace(made, extra=extra, seconds=made.seconds + seconds))
    return Trained.joined(parts)


def _nominal(work: Work) -> mujoco.MjSpec:
    """The simulator's description."""
    spec = nominal_spec(work.source.name)
    if work.cell.dynamics == "legacy":
        use_legacy_inertia(spec)
    return spec


def _diagnosis(work: Work) -> dict[str, Any]:
    """Verdict, effects and seconds of one seed's diagnosis; made once, then read."""
    # Beside the folder of the seed, which is removed with its checkpoints.
    path = work.folder.with_name(f"diagnosis_{work.cell.seeds[0]}.json")
    if path.is_file():
        return dict(json.loads(path.read_text()))
    log = jax.tree.map(lambda x: x[0], work.recorded)
    search = work.folder / "search.json"
    search.parent.mkdir(parents=True, exist_ok=True)
    d = diagnose(
        _nominal(work),
        recordings_of(log, work.source.name),
        Config(quiet=True, jobs=work.threads),
        progress=search,
    )
    found = {"verdict": d.verdict, "effects": d.effects()["effects"], "seconds": round(d.seconds, 1)}
    files.write_text(path, json.dumps({**found, "diagnosis": d.to_json()}, indent=1))
    return found

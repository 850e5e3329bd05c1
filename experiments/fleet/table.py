"""The contents of `fleet.json`, and what of an earlier one is needed again."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from experiments.fleet.comparison import Effect, Fleet, Parameter
from experiments.fleet.found import Estimate, Found, Key

NAME = "fleet.json"


def fleet_table(fleet: Fleet, identity: dict[str, Any], changes: dict[str, Any] | None) -> dict[str, Any]:
    """The contents of `fleet.json`.

    Args:
      identity: what decides the results, of all robots.
      changes: what changed since an earlier fleet.
    """
    return {
        "schema": 1,
        "identity": identity,
        "odd": [{"robot": robot, "reasons": list(reasons)} for robot, reasons in fleet.odd.items()],
        "failed": [{"robot": robot, "reason": reason} for robot, reason in fleet.failed.items()],
        "effects": [_effect(effect) for effect in fleet.effects],
        "robots": {robot: _robot(robot, each, fleet) for robot, each in fleet.found.items()},
        "changes": changes,
    }


def _effect(effect: Effect) -> dict[str, Any]:
    return {
        "id": effect.key[0],
        "at": effect.key[1],
        "shared": effect.shared,
        "robots": list(effect.robots),
        "without": list(effect.without),
        "parameters": {p.name: _parameter(p) for p in effect.parameters},
    }


def _parameter(p: Parameter) -> dict[str, Any]:
    out: dict[str, Any] = {"unit": p.unit, "value": None, "low": None, "high": None, "spread": None}
    if p.pooled is not None:
        low, high = Estimate(p.pooled.value, p.pooled.error, p.unit).interval
        out |= {"value": p.pooled.value, "low": low, "high": high, "spread": p.pooled.spread}
        if p.pooled.spread_interval is not None:
            out["spread_low"], out["spread_high"] = p.pooled.spread_interval
    return out | {"stand_out": dict(p.odd)}


def _robot(robot: str, found: Found, fleet: Fleet) -> dict[str, Any]:
    shrunk = {
        (effect.key, p.name): p.shrunk[robot]
        for effect in fleet.effects
        for p in effect.parameters
        if robot in p.shrunk
    }
    return {
        "verdict": found.verdict,
        "explanation": found.explanation,
        "effects": [
            {
                "id": key[0],
                "at": key[1],
                "decided_by_the_fleet": key in found.read_as,
                "parameters": {
                    name: {
                        "value": e.value,
                        "standard_error": None if math.isnan(e.error) else e.error,
                        "unit": e.unit,
                        "given_the_fleet": shrunk[key, name],
                    }
                    for name, e in parameters.items()
                },
            }
            for key, parameters in found.effects.items()
        ],
    }


def read(folder: Path) -> tuple[dict[str, Found], dict[str, str]]:
    """The robots of a fleet that ran before, and those that failed.

    Raises:
      ValueError: there is none, or it cannot be read.
    """
    path = folder / NAME
    try:
        table = json.loads(path.read_text())
        found = {robot: _found(each) for robot, each in table["robots"].items()}
        failed = {each["robot"]: each["reason"] for each in table["failed"]}
    except FileNotFoundError:
        raise ValueError(
            f"{folder} holds no finished fleet ({NAME}); give the --out of an earlier one"
        ) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error})") from error
    return found, failed


def _found(robot: dict[str, Any]) -> Found:
    effects: dict[Key, dict[str, Estimate]] = {
        (row["id"], row["at"]): {
            name: Estimate(
                p["value"], math.nan if p["standard_error"] is None else p["standard_error"], p["unit"]
            )
            for name, p in row["parameters"].items()
        }
        for row in robot["effects"]
    }
    return Found(robot["verdict"], robot["explanation"], effects)

"""A fleet as pages for people: Markdown, and HTML in one file."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from experiments.fleet.comparison import Effect, Fleet, Parameter, named
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.quantities import digits
from mpge_jax.diagnosis.report.html_sections import table as html_table

SHOWN = 200
"""Rows of a table at most; `fleet.json` has them all."""
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1b1b1b;background:#fff;margin:0}
main{max-width:64rem;margin:0 auto;padding:2rem 1.25rem 4rem}
h1{font-size:1.4rem}h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
table{border-collapse:collapse;width:100%;font-size:.94rem}
th,td{text-align:left;padding:.35rem .7rem .35rem 0;border-bottom:1px solid #ddd;vertical-align:top}
img{max-width:100%;height:auto}.overflow{overflow-x:auto}
"""


class Section(NamedTuple):
    """A part of a page: a title, a sentence, and a table. The first column of robots is a link to their reports."""

    title: str
    text: str
    head: list[str]
    rows: list[list[str]]
    robots: bool = False


def sections(fleet: Fleet, changes: Mapping[str, Any] | None) -> list[Section]:
    """What there is to say, odd robots first."""
    out = [_failed(fleet), _odd(fleet), *_changes(changes), _shared(fleet), _own(fleet)]
    return [section for section in out if section.rows or section.text]


def lead(fleet: Fleet) -> str:
    """The fleet in a sentence."""
    if not fleet.found:
        return f"None of {len(fleet.failed)} robots could be diagnosed."
    shared = [named(e.key) for e in fleet.effects if e.shared]
    what = f"Most have {', '.join(shared)}." if shared else "They share no effect."
    failed = f", {len(fleet.failed)} could not be" if fleet.failed else ""
    odd = f"{len(fleet.odd)} {'is' if len(fleet.odd) == 1 else 'are'} odd"
    return f"{len(fleet.found)} robots were diagnosed{failed}; {odd}. {what}"


def _failed(fleet: Fleet) -> Section:
    rows = [[robot, reason] for robot, reason in fleet.failed.items()]
    return Section("Robots without a diagnosis", "", ["robot", "why"], rows)


def _odd(fleet: Fleet) -> Section:
    rows = [[robot, fleet.found[robot].verdict, "; ".join(why)] for robot, why in fleet.odd.items()]
    text = "" if rows else "No robot is unlike the others."
    return Section("Odd robots, the oddest first", text, ["robot", "verdict", "what is odd"], rows, True)


def _shared(fleet: Fleet) -> Section:
    rows = [
        [named(e.key) if i == 0 else "", f"{len(e.robots)} of {len(e.robots) + len(e.without)}", *_cells(p)]
        for e in fleet.effects
        if e.shared
        for i, p in enumerate(e.parameters or (None,))
    ]
    text = (
        "Value and spread over the robots that do not stand out, each with a 95 % interval (a random-effects model: a "
        "robot's estimate scatters by its own error and by the spread of the robots)."
    )
    head = ["effect", "robots", "parameter", "shared value", "spread (standard deviation)", "stand out"]
    return Section("What the fleet shares", text if rows else "", head, rows)


def _cells(p: Parameter | None) -> list[str]:
    if p is None:
        return ["", "", "", ""]
    if p.pooled is None:
        return [p.name, "without intervals", "", ""]
    half = WITHIN * p.pooled.error
    ends = (p.pooled.value - half, p.pooled.value + half)
    value = f"{_span(p.pooled.value, *ends)} {p.unit}"
    spread = "" if p.pooled.spread_interval is None else _span(p.pooled.spread, *p.pooled.spread_interval)
    return [p.name, value, spread, ", ".join(list(p.odd)[:10]) + (" ..." if len(p.odd) > 10 else "")]


def _span(value: float, low: float, high: float) -> str:
    width = high - low
    return f"{digits(value, width)} ({digits(low, width)} to {digits(high, width)})"


def _own(fleet: Fleet) -> Section:
    rows = [[named(e.key), ", ".join(e.robots[:10]), _values(e)] for e in fleet.effects if not e.shared]
    return Section("What only some robots have", "", ["effect", "robots", "parameters"], rows)


def _values(effect: Effect) -> str:
    return "; ".join(
        f"{p.name} {', '.join(f'{e.value:.3g}' for e in list(p.estimates.values())[:10])} {p.unit}"
        for p in effect.parameters
    )


def _changes(changes: Mapping[str, Any] | None) -> list[Section]:
    if changes is None:
        return []
    rows = [["all robots", _step(step)] for step in changes["fleet"]]
    for r in changes["robots"]:
        told = [_step(step) for step in r["parameters"]]
        told += [f"new: {named(tuple(key))}" for key in r["new"]]
        told += [f"gone: {named(tuple(key))}" for key in r["gone"]]
        if r["verdict"][0] != r["verdict"][1]:
            told.append(f"verdict {r['verdict'][0]}, now {r['verdict'][1]}")
        rows.append([r["robot"], "; ".join(told)])
    for what, text in (
        ("failing_now", "had a diagnosis, has none now"),
        ("diagnosed_again", "had no diagnosis, has one now"),
        ("joined", "is new"),
        ("left", "is no longer there"),
    ):
        rows += [[robot, text] for robot in changes[what]]
    compared = changes["compared"]
    text = f"{compared['robots']} robots and {compared['parameters']} parameters were compared." + (
        "" if rows else " Nothing changed by more than chance explains."
    )
    return [Section("What changed", text, ["robot", "change"], rows)]


def _step(step: Mapping[str, Any]) -> str:
    what = named((step["id"], step["at"]))
    return (
        f"{step['parameter']} of {what} from {step['before']:.3g} to {step['now']:.3g} {step['unit']} "
        f"(by chance once in {1 / max(step['chance'], 1e-99):.0e})"
    )


def markdown(fleet: Fleet, changes: Mapping[str, Any] | None, picture: bool) -> str:
    """The page in Markdown, its picture beside it."""
    lines = ["# Fleet", "", lead(fleet), ""]
    for section in sections(fleet, changes):
        lines += [f"## {section.title}", ""] + ([section.text, ""] if section.text else [])
        if section.rows:
            lines += [f"| {' | '.join(section.head)} |", "|---" * len(section.head) + "|"]
            cells = [[cell.replace("|", "\\|") for cell in row] for row in section.rows[:SHOWN]]
            if section.robots:
                cells = [[f"[{row[0]}]({_report(row[0])})", *row[1:]] for row in cells]
            lines += [f"| {' | '.join(row)} |" for row in cells] + ["", *_more(section)]
    return "\n".join([*lines, *(["![Each robot's estimates](fleet.png)"] if picture else [])]) + "\n"


def _report(robot: str) -> str:
    return f"robots/{quote(robot)}/report.html"


def _more(section: Section) -> list[str]:
    left = len(section.rows) - SHOWN
    return [f"And {left} more, in fleet.json.", ""] if left > 0 else []


def html(fleet: Fleet, changes: Mapping[str, Any] | None, picture: Path | None) -> str:
    """The page in HTML, picture included; names and reasons are escaped."""
    parts = [f"<h1>Fleet</h1><p>{escape(lead(fleet))}</p>"]
    for section in sections(fleet, changes):
        parts.append(f"<h2>{escape(section.title)}</h2>")
        parts += [f"<p>{escape(section.text)}</p>"] if section.text else []
        rows = [[escape(cell) for cell in row] for row in section.rows[:SHOWN]]
        if section.robots:
            links = [_report(row[0]) for row in section.rows]
            rows = [
                [f'<a href="{link}">{row[0]}</a>', *row[1:]] for link, row in zip(links, rows, strict=False)
            ]
        parts += [html_table(section.head, rows)] if rows else []
        parts += [f"<p>{text}</p>" for text in _more(section) if text]
    if picture is not None:
        data = base64.b64encode(picture.read_bytes()).decode()
        parts.append(
            f'<h2>Each robot</h2><img alt="each robot\'s estimates" src="data:image/png;base64,{data}">'
        )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Fleet</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">'
        f"<style>{_STYLE}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )

"""Tables and pictures of a sweep."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from scipy import stats

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from experiments import paper
from mpge_jax.loop import Curve

Rows = list[dict[str, Any]]

# Okabe and Ito's colours, then some of Tol's: both stay apart for colour-blind readers.
_COLOURS = {
    "SPG": "#E69F00",
    "MPG-MS": "#56B4E9",
    "MPG-ER": "#CC79A7",
    "MPGE-MS": "#0072B2",
    "MPGE-ER": "#D55E00",
    "Vine": "#000000",
    "GAT": "#999999",
    "MPGE+": "#009E73",
    "diagnosed": "#882255",
    "diagnosed+MPGE": "#332288",
    "finetune": "#999933",
    "delta": "#44AA99",
    "DARC": "#DDCC77",
}


def _groups(rows: Rows) -> dict[tuple[str, int], Rows]:
    groups: dict[tuple[str, int], Rows] = {}
    for row in rows:
        groups.setdefault((row["method"], row["samples"]), []).append(row)
    return groups


def _cells(rows: Rows, order: list[str]) -> Iterator[tuple[str, int, Rows, Callable[[str], list[Any]]]]:
    """Method, samples and rows of every cell in the order of the methods, and what a column of these holds."""
    groups = _groups(rows)

    def column_of(group: Rows) -> Callable[[str], list[Any]]:
        return lambda name: [row[name] for row in group if row.get(name) is not None]

    for method, samples in sorted(groups, key=lambda cell: (order.index(cell[0]), cell[1])):
        group = groups[method, samples]
        yield method, samples, group, column_of(group)


def _deviation(values: list[float]) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")


def spread(values: list[float], digits: int = 0) -> str:
    """Mean ± standard deviation (ddof 1) as a table shows them; empty without values."""
    if not values:
        return ""
    half = f" ± {_deviation(values):.{digits}f}" if len(values) > 1 else ""
    return f"{np.mean(values):.{digits}f}{half}"


def interval(values: list[float]) -> tuple[float, float] | None:
    """The 95 % interval of the mean over seeds (Student's t); None of one seed."""
    if len(values) < 2:
        return None
    half = float(stats.t.ppf(0.975, len(values) - 1)) * _deviation(values) / len(values) ** 0.5
    return float(np.mean(values)) - half, float(np.mean(values)) + half


def _interval(values: list[float]) -> str:
    ends = interval(values)
    return "" if ends is None else f"{ends[0]:.0f} to {ends[1]:.0f}"


def in_short(rows: Rows) -> str:
    """What a cell gave, in a few words: the mean over its seeds."""
    named = {
        "return_stochastic": "return {:.0f} in the target",
        "simulator_error": "held-out error {:.3f} of the simulator as given",
        "held_out_error": "{:.3f} as it was made",
    }
    found = {name: [row[name] for row in rows if row.get(name) is not None] for name in named}
    said = [text.format(np.mean(found[name])) for name, text in named.items() if found[name]]
    return ", ".join(said) or "trained"


def markdown(rows: Rows, order: list[str], failures: dict[str, str]) -> str:
    """The results as a Markdown table: mean ± std over seeds (ddof 1), the paper's mean beside."""
    table = _from_log if any("held_out_transitions" in row for row in rows) else _returns
    lines = table(rows, order)
    lines += _diagnoses(rows, order)
    for cell, error in failures.items():
        lines.append(f"\n{cell} failed: {error}")
    return "\n".join(lines) + "\n"


def _from_log(rows: Rows, order: list[str]) -> list[str]:
    """What was learned from a recorded log: how well simulators predict the rest of it, and where the policies are."""
    lines = [
        "Learned from a recorded log: nothing was run in the target, so there is no return there, and methods that act "
        "in it (`direct`, `target`, `finetune`) or learn nothing from a log (`DR`) are left out. The errors are root "
        "mean square errors of one control step, predicted from the state before it, on transitions that nothing was "
        "learned from, in standard deviations of the change of each number; mean ± standard deviation over seeds.",
        "",
        "| method | transitions used | seeds | error of the simulator as given | as the method made it "
        "| transitions held out | simulator steps to ground, a seed | policies |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method, samples, group, column in _cells(rows, order):
        given, made = column("simulator_error"), column("held_out_error")
        simulated = sorted(set(column("grounding_simulator_steps")))
        lines.append(
            f"| {method} | {'/'.join(f'{x:,}' for x in sorted(set(column('target_steps'))))} | {len(group)} "
            f"| {spread(given[:1], 3) or 'not known'} | {spread(made, 3) or '-'} "
            f"| {column('held_out_transitions')[0]:,} "
            f"| {'/'.join(f'{x:,}' for x in simulated)} | `cells/{method}-{samples}/policy` |"
        )
    return [
        *lines,
        "",
        "A folder of policies is an orbax checkpoint, one policy for each seed. To act with that of seed 0:",
        "",
        "```python",
        "from mpge_jax.rollouts import policies",
        "",
        'policy = policies.controller("cells/METHOD-SAMPLES/policy", 0)',
        "action = policy(observation)  # the observation of the task [O], the action [A] in the actuators' units",
        "```",
    ]


def _returns(rows: Rows, order: list[str]) -> list[str]:
    lines = [
        "| method | samples | seeds | return, stochastic | 95 % interval of its mean | return, deterministic | paper "
        "| transform error | target steps a seed | simulator steps to ground, a seed |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method, samples, group, column in _cells(rows, order):
        published = paper.mean_return(group[0]["task"], method, samples)
        steps = sorted({row["target_steps"] for row in group})
        simulated = sorted(
            {row["grounding_simulator_steps"] for row in group if "grounding_simulator_steps" in row}
        )
        lines.append(
            f"| {method} | {samples or '-'} | {len(group)} | {spread(column('return_stochastic'), 0)} "
            f"| {_interval(column('return_stochastic'))} "
            f"| {spread(column('return_deterministic'), 0)} | {'' if published is None else f'{published:.0f}'} "
            f"| {spread(column('transform_error'), 3)} | {'/'.join(f'{x:,}' for x in steps)} "
            f"| {'/'.join(f'{x:,}' for x in simulated)} |"
        )
    return lines


def _diagnoses(rows: Rows, order: list[str]) -> list[str]:
    """What each diagnosis came to, and where none corrected the simulator."""
    told = [row for row in rows if "verdict" in row]
    if not told:
        return []
    lines = [
        "",
        "What the diagnoses named, and what the agents trained in (`plain`: nothing was named, the simulator is as it "
        "was):",
        "",
        "| method | samples | seed | verdict | named | simulator |",
        "|---|---|---|---|---|---|",
    ]
    for row in sorted(told, key=lambda r: (order.index(r["method"]), r["samples"], r["seed"])):
        lines.append(
            f"| {row['method']} | {row['samples']} | {row['seed']} | {row['verdict']} | {row['named'] or '-'} "
            f"| {row['simulator']} |"
        )
    return lines


def returns_figure(rows: Rows, path: Path, task: str) -> None:
    """Mean return in the target against samples, one line a method; those without samples as levels."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    groups = _groups(rows)
    shown = [method for method in _COLOURS if any(name == method for name, _ in groups)]
    for place, (method, colour) in enumerate((m, _COLOURS[m]) for m in shown):
        sizes = sorted(samples for name, samples in groups if name == method)
        values = [[row["return_stochastic"] for row in groups[method, samples]] for samples in sizes]
        means = [float(np.mean(v)) for v in values]
        errors = [_deviation(v) if len(v) > 1 else 0.0 for v in values]
        # Side by side, or methods of one return would hide each other.
        beside = np.array(sizes) * 1.02 ** (place - (len(shown) - 1) / 2)
        axes.errorbar(beside, means, errors, color=colour, marker="o", capsize=3, label=method)
    for method, style in (("direct", ":"), ("DR", "-."), ("target", "--")):
        if (method, 0) in groups:
            level = float(np.mean([row["return_stochastic"] for row in groups[method, 0]]))
            axes.axhline(level, color="black", linestyle=style, label=method)
    axes.set(
        xscale="log", xlabel="transitions recorded in the target", ylabel="return in the target", title=task
    )
    budgets = sorted({samples for _, samples in groups if samples})
    if budgets:
        axes.set_xlim(budgets[0] / 1.3, budgets[-1] * 1.3)
    axes.set_xticks(budgets, [f"{samples:,}" for samples in budgets])
    axes.set_xticks([], minor=True)
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path)


def errors_figure(
    curves: dict[tuple[str, int], Curve], path: Path, task: str, steps_of: dict[str, int]
) -> None:
    """Action-transformation error (uniform actions, logged states) against simulator steps of one transformer.

    Args:
      curves: by method and samples.
      path: the picture.
      task: its title.
      steps_of: simulator steps of one iteration, by method.
    """
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    styles = {
        samples: style
        for samples, style in zip(sorted({s for _, s in curves}), ("-", "--", ":", "-."), strict=False)
    }
    for (method, samples), curve in curves.items():
        if "error_uniform" not in curve:
            continue
        error = curve["error_uniform"].reshape(len(curve["error_uniform"]), -1)
        steps = steps_of[method] * (1 + np.arange(len(error)))
        style = styles.get(samples, "-")
        colour = _COLOURS.get(method, "black")
        axes.plot(steps, error.mean(axis=1), color=colour, linestyle=style, label=f"{method}, {samples}")
        axes.fill_between(steps, error.min(axis=1), error.max(axis=1), color=colour, alpha=0.12, linewidth=0)
    axes.set(
        xlabel="simulator steps of one transformer",
        ylabel="action-transformation error",
        title=task,
        ylim=(0, None),
    )
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path)


def save_figure(figure: Any, path: Path) -> None:
    """Writes a picture in one step, and closes it."""
    partial = path.with_name(path.name + ".partial")
    figure.savefig(partial, format="png", dpi=150)
    plt.close(figure)
    partial.replace(path)

"""What `python -m experiments.benchmark` measured, as Markdown."""

from experiments.benchmark.clock import Row
from experiments.benchmark.grounding import REFERENCE, SAMPLES, SOURCE, TARGET

PARTS = ("envs", "grounding", "stages", "sac")


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
    made = (
        f"`{record['command']}` on {record['versions']['machine']}; load average before: {load}"
        " (numbers of a busy machine are too low)."
    )
    return "\n".join([made, *tables(record["rows"])]) + "\n"


def tables(rows: list[Row]) -> list[str]:
    """Lines of one table for each part that was measured."""
    lines: list[str] = []
    of = {part: [row for row in rows if row["part"] == part] for part in PARTS}
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
    return lines


def _of(row: Row, name: str) -> str:
    return f"{row[name]:.3g}" if name in row else ""

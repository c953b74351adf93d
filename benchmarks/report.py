"""The comparison as Markdown and JSON; tools/fill_documents.py copies its tables to the docs."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks.lines import SCHEMA, Figure, Line
from benchmarks.questions import module_of

__all__ = ["as_json", "check_writable", "from_json", "markdown", "summary", "table", "written"]

_HEADINGS = (
    "case", "precision", "cores", "peer", "polywigner", "peer's", "ratio", "error", "peer's error",
    "",
)  # fmt: skip
_FACTS = ("processor", "instructions", "cores", "system", "python", "compiler", "llvm")


def as_json(lines: Iterable[Line], facts: dict[str, Any]) -> dict[str, Any]:
    """Return facts (date, machine, versions) and lines; see ``lines.Line`` for the fields."""
    return {"schema": SCHEMA, **facts, "lines": [line.as_json() for line in lines]}


def from_json(report: dict[str, Any]) -> list[Line]:
    """Return the lines of a report; raise ValueError for another schema."""
    if report.get("schema") != SCHEMA:
        raise ValueError(f"expected schema {SCHEMA}, got {report.get('schema')!r}")
    return [Line.from_json(line) for line in report["lines"]]


def check_writable(folder: Path) -> None:
    """Create the folder if it does not exist; raise OSError if it is not writable."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass


def written(folder: Path, lines: Sequence[Line], facts: dict[str, Any]) -> list[Path]:
    """Write comparison.json and comparison.md, each completely or not at all."""
    check_writable(folder)
    texts = {
        "comparison.json": json.dumps(as_json(lines, facts), indent=1) + "\n",
        "comparison.md": f"# Results of make bench\n\n{markdown(lines, facts)}",
    }
    paths = []
    for name, text in texts.items():
        partial = folder / f"{name}.partial"
        partial.write_text(text)
        partial.replace(folder / name)
        paths.append(folder / name)
    return paths


def markdown(lines: Sequence[Line], facts: dict[str, Any]) -> str:
    """Return the facts about the machine, and a table for each question."""
    parts = [introduction(facts)]
    for question, group in groupby(lines, key=lambda line: line.question):
        name = question.replace(" ", "_")
        result = list(group)
        parts.append(f"## {module_of(name).QUESTION}\n")
        if question == "wigner":
            parts.append(f"{summary(result)}\n\nAll of it:\n")
        parts.append(f"{table(result)}\n")
    missed = [line for line in lines if line.reached is False]
    asked = sum(line.reached is not None for line in lines)
    parts.append(f"{asked - len(missed)} of {asked} targets were reached.\n")
    return "\n".join(parts)


def introduction(facts: dict[str, Any]) -> str:
    """Return date, machine, and an explanation of the tables."""
    machine = facts["machine"]
    named = [f"{name} {machine[name]}" for name in _FACTS[1:] if machine.get(name) is not None]
    libraries = [
        f"{name} {value}"
        for name, value in machine.items()
        if name in facts["libraries"] and value is not None
    ]
    load, quick = machine.get("load before"), bool(facts.get("quick"))
    busy = f", load before {load:g}" if load is not None else ""
    return (
        f"{facts['date']}, {machine['processor']} ({', '.join(named)}{busy}); "
        f"{', '.join(libraries)}.\n\n"
        "Figures are best (median) of the rounds, in which all take turns; on one core in CPU "
        "time, on more by the clock. A ratio above 1 says how many times better polywigner is.\n"
        + ("A quick run: of less than the headings say, too short to judge by.\n" * quick)
    )


def table(lines: Sequence[Line]) -> str:
    """Return the Markdown table of a question."""
    rows = [[*_HEADINGS], ["---"] * len(_HEADINGS)]
    rows += [_row(line) for line in lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def summary(lines: Sequence[Line]) -> str:
    """Return a Markdown table with the rate of each case and ratios to the peers."""
    peers = list(dict.fromkeys(line.peer for line in lines))
    rows = [["case", "precision", "cores", "polywigner", *(f"/ {peer}" for peer in peers), "error"]]
    rows.append(["---"] * len(rows[0]))
    for _, group in groupby(lines, key=lambda line: (line.case, line.precision, line.threads)):
        result = {line.peer: line for line in group}
        one = next(iter(result.values()))
        ratios = [_ratio(result[peer]) if peer in result else "" for peer in peers]
        cells = [one.case, one.precision, str(one.threads), _figure(one.ours, one.unit)]
        error = "" if one.ours is None or one.ours.error is None else f"{one.ours.error:.0e}"
        rows.append([*cells, *ratios, error])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _ratio(line: Line) -> str:
    if line.ratio is None:
        return "-"
    return f"{_number(line.ratio)} ({_number(line.ratio_median)})"


def _row(line: Line) -> list[str]:
    notes = [line.note] if line.note else []
    if line.target is not None:
        reached = {True: "reached", False: "missed", None: "not measured"}[line.reached]
        either = "" if line.enough is None else f" or {line.enough:,.3g} {line.unit}"
        notes.insert(0, f"asked: {line.target:,.3g}{either}, {reached}")
    return [
        line.case,
        line.precision,
        str(line.threads),
        line.peer,
        _figure(line.ours, line.unit),
        _figure(line.theirs, line.unit),
        _ratio(line),
        _error(line.ours, line.error_unit),
        _error(line.theirs, line.error_unit),
        "; ".join(notes),
    ]


def _figure(figure: Figure | None, unit: str) -> str:
    if figure is None:
        return ""
    return f"{_number(figure.best)} ({_number(figure.median)}) {unit}"


def _error(figure: Figure | None, unit: str) -> str:
    if figure is None or figure.error is None:
        return ""
    return f"{figure.error:.1e} {unit}".strip()


def _number(value: float | None) -> str:
    """Format a number with three digits."""
    if value is None:
        return ""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"

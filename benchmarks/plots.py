"""Figures of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.lines import Line
from benchmarks.questions import module_of

__all__ = ["drawn"]

_COLOURS = ("#0b5394", "#cc4125", "#6aa84f", "#e69138", "#674ea7", "#45818e")


def drawn(folder: Path, lines: Sequence[Line]) -> list[Path]:
    """Write rates.png and ratios.png, without empty figures."""
    folder.mkdir(parents=True, exist_ok=True)
    return [path for path in (_rates(folder, lines), _ratios(folder, lines)) if path is not None]


def _rates(folder: Path, lines: Sequence[Line]) -> Path | None:
    """Draw samples of W per second on one core by shape and peer."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    chosen = [line for line in lines if line.question == "wigner" and line.threads == 1]
    if not any(line.ours for line in chosen):
        return None
    cases = list(dict.fromkeys(line.case for line in chosen))
    peers = list(dict.fromkeys(line.peer for line in chosen if line.theirs))
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
    width = 0.8 / (1 + len(peers))
    for panel, precision in zip(axes, ("single", "double"), strict=True):
        here = {(line.case, line.peer): line for line in chosen if line.precision == precision}
        for k, name in enumerate(["polywigner, arrays in the engine", *peers]):
            places, heights = [], []
            for n, case in enumerate(cases):
                result = [
                    line for (c, p), line in here.items() if c == case and (not k or p == name)
                ]
                side = (result[0].theirs if k else result[0].ours) if result else None
                if side is not None:
                    places.append(n + (k - len(peers) / 2) * width)
                    heights.append(side.best * 1e6)
            panel.bar(places, heights, width, label=name, color=_COLOURS[k % len(_COLOURS)])
        panel.set_yscale("log")
        panel.set_xticks(range(len(cases)), cases, rotation=25, ha="right")
        panel.set_title(f"{precision} precision, one core")
        panel.grid(axis="y", linewidth=0.4)
        panel.set_axisbelow(True)
    axes[0].set_ylabel("samples of $W$ per second")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small")
    return _saved(figure, folder / "rates.png")


def _ratios(folder: Path, lines: Sequence[Line]) -> Path | None:
    """Draw ratios to each peer on one core, with a dot for a case and a row for a peer."""
    import matplotlib.pyplot as plt

    skipped = ("peak", "memory")
    chosen = [
        line
        for line in lines
        if line.ratio and line.threads == 1 and line.question not in skipped
        if not line.peer.startswith("our ")
    ]
    if not chosen:
        return None
    rows = list(dict.fromkeys((line.question, _row(line)) for line in chosen))
    height = 1.4 + 0.24 * len(rows)
    figure, axes = plt.subplots(figsize=(8, height), layout="constrained")
    for k, question in enumerate(dict.fromkeys(line.question for line in chosen)):
        mine = [line for line in chosen if line.question == question]
        label = module_of(question.replace(" ", "_")).QUESTION
        places = [rows.index((question, _row(line))) for line in mine]
        colour = _COLOURS[k % len(_COLOURS)]
        ratios = [line.ratio for line in mine]
        axes.plot(ratios, places, "o", color=colour, label=label, ms=5, alpha=0.7)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [row for _, row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.grid(linewidth=0.4)
    axes.set_axisbelow(True)
    axes.set_xlabel("times faster than the peer, one dot for each case and precision")
    figure.legend(loc="outside upper center", ncols=2, fontsize="x-small")
    return _saved(figure, folder / "ratios.png")


def _row(line: Line) -> str:
    if line.question != "latency":
        return line.peer
    _, _, which = line.case.partition(", ")
    return f"{line.peer}, {which}" if which else line.peer


def _saved(figure: object, path: Path) -> Path:
    import matplotlib.pyplot as plt

    partial = path.with_suffix(".partial.png")
    figure.savefig(partial, dpi=150)  # type: ignore[attr-defined]
    plt.close(figure)  # type: ignore[arg-type]
    partial.replace(path)
    return path

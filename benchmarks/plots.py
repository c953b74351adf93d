"""Pictures of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.lines import Line
from benchmarks.questions import module_of

__all__ = ["drawn"]

_COLOURS = ("#0b5394", "#cc4125", "#6aa84f", "#e69138", "#674ea7", "#45818e")


def drawn(folder: Path, lines: Sequence[Line]) -> list[Path]:
    """Writes rates.png and ratios.png; a picture without anything to show is left out."""
    folder.mkdir(parents=True, exist_ok=True)
    return [path for path in (_rates(folder, lines), _ratios(folder, lines)) if path is not None]


def _rates(folder: Path, lines: Sequence[Line]) -> Path | None:
    """Samples of W a second on one core by shape, ours and the peers'."""
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
                found = [
                    line for (c, p), line in here.items() if c == case and (not k or p == name)
                ]
                side = (found[0].theirs if k else found[0].ours) if found else None
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
    """How many times faster than each peer, one row for a line; a tick where a target is."""
    import matplotlib.pyplot as plt

    skipped = ("peak", "memory")
    chosen = [
        line
        for line in lines
        if line.ratio and line.question not in skipped and not line.peer.startswith("our ")
    ]
    if not chosen:
        return None
    figure, axes = plt.subplots(figsize=(8, 1.2 + 0.19 * len(chosen)), layout="constrained")
    questions = list(dict.fromkeys(line.question for line in chosen))
    for k, question in enumerate(questions):
        rows = [n for n, line in enumerate(chosen) if line.question == question]
        label = module_of(question.replace(" ", "_")).QUESTION
        colour = _COLOURS[k % len(_COLOURS)]
        axes.plot([chosen[n].ratio for n in rows], rows, "o", color=colour, label=label, ms=4)
    for n, line in enumerate(chosen):
        if line.target:
            axes.plot(line.target, n, "|", color="black", markersize=9)
    axes.axvline(1.0, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_yticks(range(len(chosen)), [_label(line) for line in chosen], fontsize=6)
    axes.invert_yaxis()
    axes.margins(y=0.5 / len(chosen))
    axes.grid(axis="x", linewidth=0.4)
    axes.set_xlabel("times faster than the peer (|: asked for)")
    figure.legend(loc="outside upper center", ncols=2, fontsize="x-small")
    return _saved(figure, folder / "ratios.png")


def _label(line: Line) -> str:
    cores = "" if line.threads == 1 else f", {line.threads} cores"
    precision = "" if line.precision in ("-", "double") else f", {line.precision}"
    return f"{line.case}{precision}{cores}: {line.peer}"


def _saved(figure: object, path: Path) -> Path:
    import matplotlib.pyplot as plt

    partial = path.with_suffix(".partial.png")
    figure.savefig(partial, dpi=150)  # type: ignore[attr-defined]
    plt.close(figure)  # type: ignore[arg-type]
    partial.replace(path)
    return path

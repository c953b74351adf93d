"""How fast do transforms of an n-gon converge to transforms of a disc of equal area?

Run ``python benchmarks/disc_convergence.py``; ``--plot FILE`` draws the table. References are exact
(``tests/oracles/disc.py``): Bessel functions, and the transforms of lenses. Errors are the largest
of a few directions and arguments, relative to the disc's area; "inscribed" is the regular polygon
with its corners on the circle.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles.disc import QUANTITIES, errors, orders

__all__ = ["SIDES"]

SIDES = (8, 16, 32, 64, 128, 256, 512, 1024)


def _plot(path: str, table: dict[str, np.ndarray]) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    for (name, error), marker in zip(table.items(), "osDx^v", strict=True):
        label = name.replace("A(0, xi)", r"A(0, $\xi$)")
        axes.loglog(SIDES, error, marker + "-", markersize=4, linewidth=1, label=label)
    n = np.array(SIDES, float)
    for order, anchor in ((2, 30.0), (3, 30.0), (4, 2.0)):
        axes.loglog(n, anchor * n**-order, "k:", linewidth=0.8)
        end = (n[-1], anchor * n[-1] ** -order)
        axes.annotate(f"$n^{{-{order}}}$", end, (4, -3), textcoords="offset points", fontsize=9)
    axes.set_xticks(SIDES, [str(s) for s in SIDES])
    axes.minorticks_off()
    axes.set_xlim(6.5, 1700)
    axes.set_xlabel("sides $n$")
    axes.set_ylabel("largest error / area")
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plot", metavar="FILE")
    arguments = parser.parse_args()
    table = {name: errors(name, SIDES) for name in QUANTITIES}
    print("| n |", " | ".join(table), "|")
    print("|--:|" + "--:|" * len(table))
    for k, n in enumerate(SIDES):
        print(f"| {n} |", " | ".join(f"{error[k]:.1e}" for error in table.values()), "|")
    last = (f"{orders(error)[-3:].mean():.2f}" for error in table.values())
    print("| order |", " | ".join(last), "|")
    if arguments.plot:
        _plot(arguments.plot, table)


if __name__ == "__main__":
    main()

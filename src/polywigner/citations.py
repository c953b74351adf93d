"""Citations for work made with polywigner, from the bibliography of the documentation."""

from __future__ import annotations

import re
from importlib.resources import files

from polywigner.errors import ArgumentError

_ALWAYS = ("mackay2022polygons", "polywigner")

METHODS: dict[str, tuple[str, ...]] = {
    "fourier": ("lee1983polygonal",),
    "wigner": ("walther1968radiometry",),
    "ambiguity": ("brenner1983ambiguity",),
    "otf": ("brenner1983ambiguity",),
    "radiometry": ("walther1968radiometry",),
    "propagation": ("walther1968radiometry", "miyamoto1962generalization"),
    "rendering": ("walther1968radiometry", "jakob2022mitsuba", "jakob2022drjit"),
    "range": ("jakob2022mitsuba", "jakob2022drjit", "royo2025mitransient"),
    "llvm": ("jakob2022drjit",),
    "tapers": ("taylor1955line",),
    "arrays": ("skolnik1964statistically", "barnett2019nufft"),
}
"""Bibliography keys of the publications on the formulas or the software of each method."""


def cite(*methods: str) -> str:
    """Return the BibTeX entries to cite in work that used polywigner and some of its methods.

    Parameters
    ----------
    *methods : str
        "fourier", "wigner", "ambiguity", "otf", "radiometry", "propagation", "rendering", "range"
        (profiles and frames), "llvm" (the compiled engine), "tapers" (Taylor), "arrays" (thinned
        arrays; interpolation of weights). Without methods, the result contains only the paper and
        polywigner.

    Returns
    -------
    str
        The entries of the paper, of this software and of the methods, without repetitions,
        separated by empty lines.

    Raises
    ------
    ArgumentError
        If a method is unknown.

    Examples
    --------
    >>> import polywigner as pw
    >>> "2202.02676" in pw.cite("rendering")
    True
    """
    for method in methods:
        if not isinstance(method, str) or method not in METHODS:
            names = ", ".join(METHODS)
            raise ArgumentError(f"expected each method to be one of {names}, got {method!r}")
    keys = dict.fromkeys((*_ALWAYS, *(key for method in methods for key in METHODS[method])))
    bibliography = files("polywigner").joinpath("references.bib").read_text(encoding="utf-8")
    matches = re.finditer(r"^@\w+\{([\w-]+),\n.*?^\}", bibliography, re.MULTILINE | re.DOTALL)
    entries = {entry[1]: entry[0] for entry in matches}
    return "\n\n".join(entries[key] for key in keys) + "\n"

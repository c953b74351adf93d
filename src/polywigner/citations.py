"""Citations for work made with polywigner, from the bibliography that the docs show too."""

from __future__ import annotations

import re
from functools import lru_cache
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
"""From methods to keys of the bibliography: works whose formulas or software they rest on."""


def cite(*methods: str) -> str:
    """BibTeX entries for work made with some methods: the paper first, then this software.

    Parameters
    ----------
    methods : "fourier", "wigner", "ambiguity", "otf", "radiometry", "propagation", "rendering",
        "range" (profiles and pictures), "llvm" (the compiled engine), "tapers" (Taylor), "arrays"
        (thinned ones; the interpolation of weights); none: the paper and polywigner alone.

    Returns
    -------
    str, the entries with an empty line between them, each once; ``print(pw.cite("rendering"))``.

    Raises
    ------
    ArgumentError for a method that is none of these.

    >>> import polywigner as pw
    >>> "2202.02676" in pw.cite("rendering")
    True
    """
    for method in methods:
        if not isinstance(method, str) or method not in METHODS:
            names = ", ".join(METHODS)
            raise ArgumentError(f"expected methods among {names}, got {method!r}")
    keys = dict.fromkeys((*_ALWAYS, *(key for method in methods for key in METHODS[method])))
    entries = _entries()
    return "\n\n".join(entries[key] for key in keys) + "\n"


@lru_cache(maxsize=1)
def _entries() -> dict[str, str]:
    """The text of each entry of the bibliography by its key."""
    text = files("polywigner").joinpath("references.bib").read_text(encoding="utf-8")
    found = re.finditer(r"^@\w+\{([\w-]+),\n.*?^\}", text, flags=re.MULTILINE | re.DOTALL)
    return {entry[1]: entry[0] for entry in found}

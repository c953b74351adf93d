"""Fourier, autocorrelation, Wigner and ambiguity transforms of polygons, in closed form.

``import polywigner`` and the command line's ``--help`` import no other library: each public name is
loaded on first use. The names and their modules are listed in ``__init__.pyi``, which type checkers
read.
"""

import importlib

__version__ = "0.1.0"

# `open` is used because the import of pathlib would take longer than the import of this module.
with open(__file__.removesuffix("c") + "i", encoding="utf-8") as stub:  # noqa: PTH123
    _IMPORTS = [line.split() for line in stub if line.startswith("from ")]
_HOMES = {name: home for _, home, _, name, *_ in _IMPORTS}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> object:
    home = _HOMES.get(name)
    if home is None:
        import difflib

        near = difflib.get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'polywigner' has no attribute {name!r}{hint}")
    if home == __name__:
        value: object = importlib.import_module(f"{home}.{name}")
    else:
        value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

"""Form factors of polyhedra by libformfactor, a part of BornAgain.

The Python interface has one frequency per call, which dominates the time, so a loop in C++ calls
the same library function as well.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from importlib.metadata import files
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.peers import cpp

__all__ = ["available", "body", "from_cpp", "from_python"]

LIBRARY = "libformfactor"
# ff::IBody::formfactor(const C3& q) const, as mangled by compilers of Linux and macOS.
FUNCTION = "_ZNK2ff5IBody10formfactorERK4Vec3ISt7complexIdEE"


def available() -> bool:
    return find_spec("bornagain") is not None


def body(kind: str, *sizes: float) -> Any:
    """Return a body of BornAgain with its bottom at z = 0."""
    import bornagain

    return getattr(bornagain, kind)(*sizes)


def from_python(shape: Any, nu: np.ndarray) -> np.ndarray:
    """Return F at nu (n, 3) by single calls; BornAgain has exp(+i q.r)."""
    from bornagain import C3

    form_factor = shape.formfactorAtBottom
    return np.array([form_factor(C3(*q)) for q in (-2 * np.pi * nu).tolist()])


def from_cpp(shape: Any, centre: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a compiled loop for F at nu (n, 3); ``centre`` is the height of the centre of mass.

    Raises
    ------
    RuntimeError
        Without a compiler, or if the library lacks this function.
    """
    function = _function()
    loop = cpp.compiled("form_factor.cpp", "double").form_factor
    # SWIG's pointer to a std::shared_ptr, which begins with a pointer to the body.
    handle = shape.getPolyhedron()
    address = ctypes.c_void_p.from_address(int(handle)).value
    handle.disown()  # prevents a warning at exit

    def form_factor(nu: np.ndarray) -> np.ndarray:
        nu, values = np.ascontiguousarray(nu), np.empty(len(nu), complex)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (nu, values))
        loop(
            function,
            ctypes.c_void_p(address),
            ctypes.c_double(centre),
            ctypes.c_size_t(len(nu)),
            *pointers,
        )
        return values

    form_factor.shape = shape  # type: ignore[attr-defined]  # which owns the body
    return form_factor


def _function() -> ctypes.c_void_p:
    """Return the function of the library."""
    result = [file for file in files("bornagain") or () if file.name.startswith(LIBRARY)]
    try:
        library = ctypes.CDLL(str(result[0].locate()))
        return ctypes.cast(library[FUNCTION], ctypes.c_void_p)
    except (IndexError, OSError, AttributeError):
        raise RuntimeError("BornAgain's library has no function that C++ can call") from None

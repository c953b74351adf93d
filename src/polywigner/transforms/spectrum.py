"""The Fourier transform of sources in one, two and three dimensions."""

from __future__ import annotations

from typing import Any

from polywigner.engines import Engine, Precision
from polywigner.geometry import Aperture
from polywigner.transforms.arguments import Source, in_plane, transform

__all__ = ["fourier"]


def fourier(
    source: Source, nu: Any, *, precision: Precision = None, engine: Engine = "auto"
) -> Any:
    """Fourier transform (SFT) of a source: F(nu) = integral of exp(-2 pi i nu.x) over it.

    Closed form, at any nu, zero included (docs/theory.md, (F2), (F3), (S1)). Differs from the
    paper's eq. (FVT), which prints the exp(+) kernel and is singular at nu = 0; its factor
    (nu/|nu|).n for collections is an obliquity and not part of the transform. Cost: linear in the
    edges, or in the triangles of a polyhedron's faces.

    Parameters
    ----------
    source : Aperture, Slits, placed aperture or Polyhedron; |u| = 1 on it.
    nu : (..., d) spatial frequencies in 1/m, real or complex (evanescent or absorbed waves). d = 1
        for Slits, 3 for polyhedra and placed apertures, 2 for an Aperture, or 3, of which the last
        component does not matter: without a pose it lies in the plane z = 0.
    precision : "double", "single", or None: double for NumPy input, its own for Dr.Jit input.
    engine : "auto", "numpy", "llvm" or "cuda".

    Returns
    -------
    (...) complex, in m^d; complex64 for single precision. Dr.Jit input gives ``Complex2f``, or
    for tensors a tensor (..., 2) of real and imaginary parts.

    Raises
    ------
    ArgumentError for arguments of the wrong type or shape; EngineError without the engine.
    """
    if isinstance(source, Aperture):
        nu = in_plane(nu)
    return transform("fourier", source, [("nu", nu)], precision, engine, outputs=2)

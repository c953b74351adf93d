"""Explanation of calls: the plan behind a transform, without computing it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from polywigner import execution, kernels
from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture, Polyhedron, Wavefront
from polywigner.illumination import Array
from polywigner.kernels.functions.separable import is_separable
from polywigner.plans import Plan
from polywigner.transforms.arguments import PhaseSpaceSource, checked_call, in_plane
from polywigner.transforms.calls import TRANSFORMS, as_flat


def explain(
    source: PhaseSpaceSource | Polyhedron,
    *arguments: ArrayLike,
    function: str = "wigner",
    engine: execution.Engine = "auto",
    precision: execution.Precision = None,
) -> Plan:
    """Explain the way that a call would take, its reason and cost, and the alternatives.

    Estimates are those of the table of costs by which calls are planned (docs/performance.md). They
    follow from sizes alone: the same call goes the same way at every repetition.

    Parameters
    ----------
    source : as the function takes it. For ``"fourier"`` an Aperture, Slits or Polyhedron: that of
        an Array is a sum of several calls. One with a curved wave is explained as what is computed
        of its flat source; its F is always a sum over nodes along edges.
    arguments : those of the function, as NumPy arrays: x and nu for ``"wigner"``.
    function : "wigner", "ambiguity", "autocorrelation", "fourier", "position_marginal" or
        "lag_marginal".
    engine, precision : see :func:`fourier`.

    Returns
    -------
    A plan, whose ``str()`` is five lines of text. Its ``way`` has a ``name``, an ``engine``, and
    the seconds that it takes: ``shared``, once for all sources; ``setup``, once for this one; and
    ``run``, in each call. ``others`` are the ways not taken, by cost.

    Raises
    ------
    ArgumentError for a function that is not one of these, Dr.Jit arrays, and what the function
    itself would refuse; EngineError without the engine.

    For example, ``print(pw.explain(pw.shapes.square(0.01), (0.0, 0.0), (10.0, 20.0)))``.

    >>> import polywigner as pw
    >>> square = pw.shapes.square(1.0)
    >>> print(pw.explain(square, (0.0, 0.0), (1.0, 0.0), engine="numpy").way.name)
    edges one by one, on NumPy
    """
    if not isinstance(function, str) or function not in TRANSFORMS:
        known = ", ".join(f'"{name}"' for name in TRANSFORMS)
        raise ArgumentError(f"expected function to be one of {known}, got {function!r}")
    names = TRANSFORMS[function].points
    if len(arguments) != len(names):
        raise ArgumentError(
            f"expected {' and '.join(names)} for {function}, got {len(arguments)} arguments"
        )
    if any(map(execution.is_drjit, arguments)):
        raise ArgumentError(
            "expected NumPy arrays, got Dr.Jit arrays, which are computed where they are: there is "
            "no choice to explain"
        )
    name = function
    if function == "fourier" and isinstance(source, Array):
        raise ArgumentError(
            "expected one element for fourier, got an Array, of which F is a sum of several calls; "
            "explain that of an element"
        )
    if function == "fourier":
        arguments = (in_plane(arguments[0]),) if isinstance(source, Aperture) else arguments
        if isinstance(source, Aperture) and is_separable(source):
            name = "fourier of waves"
    points: Mapping[str, Any] = dict(zip(names, arguments, strict=True))
    if isinstance(source, Wavefront):
        width = source.coherence_width
        coherent = Wavefront(source.source, source.curvature, source.centre)
        source, name, points = as_flat(coherent, function, points)
        if width < math.inf and name == "wigner":
            source = Wavefront(source, coherence_width=width)
            if kernels.partly_coherent_kernel(source, precision != "single") is None:
                raise ArgumentError(
                    f"expected a source with a closed form of W in light that is coherent over "
                    f"{width:g} m, got an array or distant parts, whose W is a mean over tilts of "
                    "coherent light; explain its .coherent"
                )
    kernel, components, _ = checked_call(name, source, list(points.items()), precision, engine)
    return execution.explained(
        kernel, source, components, double=precision != "single", engine=engine
    )

"""Evaluation of kernels: on NumPy, or on Dr.Jit with LLVM or CUDA.

===================  ==========================================================================
module               content
===================  ==========================================================================
``operations``       the operations namespaces that kernels are written over: NumPy, Python floats
``drjit_operations`` and Dr.Jit arrays
``choice``           the plan of a call: engine and strategy
``evaluation``       NumPy arrays in and out, on any engine; sums over points; F on a grid of
                     frequencies, from its axes
``chunks``           samples chunk by chunk, threads, aligned memory for Dr.Jit
``progress``         progress bars on a terminal
``on_drjit``         compiled kernels: with an outline as code, or with outlines as data
``points``           Dr.Jit arrays of callers as component arrays, and results of their kind
``traced``           component arrays in and out, traced, with derivatives in closed form
===================  ==========================================================================
"""

# ruff: noqa: F401
from polywigner.execution.choice import (
    Engine,
    Precision,
    checked_engine,
    checked_precision,
    uncompiled,
)
from polywigner.execution.chunks import MOST_THREADS, kernel_threads
from polywigner.execution.drjit_operations import DrjitOperations, ops_for
from polywigner.execution.evaluation import (
    Shear,
    evaluate,
    evaluate_on_grid,
    evaluate_rows,
    evaluate_sums,
    explained,
)
from polywigner.execution.on_drjit import without_collection
from polywigner.execution.operations import Drjit, NumpyOperations, ScalarOperations
from polywigner.execution.points import (
    columns_of,
    components_of,
    entries,
    has_drjit,
    is_drjit,
    joined,
    matrix_times,
    numbers_of,
    on_components,
    shifted,
    sibling,
    split,
    times_complex,
    unit_wave,
)
from polywigner.execution.traced import (
    Differentiable,
    Traced,
    evaluate_traced,
    kernel_with_derivatives,
    site_sum,
    with_jacobian,
)

"""Evaluation of kernels with NumPy, or with Dr.Jit on LLVM or CUDA.

===================  ==========================================================================
module               content
===================  ==========================================================================
``operations``       operations of kernels on NumPy arrays and Python floats
``drjit_operations`` operations of kernels on Dr.Jit arrays
``choice``           choice of the engine and the strategy for a call
``evaluation``       evaluation of kernels at NumPy points; Fourier transforms on grids
``chunks``           chunks of samples, threads, aligned memory for Dr.Jit
``progress``         progress bars on a terminal
``on_drjit``         kernels that Dr.Jit compiles, with outlines as code or as data
``points``           conversion between the Dr.Jit arrays of callers and component arrays
``traced``           evaluation of kernels at Dr.Jit points, with closed-form derivatives
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
from polywigner.execution.operations import Drjit, NumpyOperations, has_drjit, is_drjit
from polywigner.execution.points import (
    columns_of,
    component_arrays,
    components_of,
    entries,
    joined,
    matrix_times,
    numbers_of,
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

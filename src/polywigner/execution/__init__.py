"""Where kernels run: NumPy, or Dr.Jit on LLVM or CUDA.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``operations``       the operations namespaces that kernels are written over: NumPy, Python floats
``drjit_operations`` and Dr.Jit arrays
``choice``           which engine and precision a call uses, and which strategy
``evaluation``       NumPy arrays in and out, on any engine; a kernel by NumPy; sums over places
``chunks``           samples chunk by chunk, threads, and NumPy memory as Dr.Jit takes it
``progress``         bars on a terminal for work that takes long
``frequency_grids``  F on a grid of frequencies, from its axes
``on_drjit``         a compiled kernel, traced once: of one outline, or of all, which are data
``points``           Dr.Jit arrays of any kind: points, numbers of sources, and results
``traced``           Dr.Jit arrays in and out, traced, with derivatives in closed form; sums over
                     sites
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
from polywigner.execution.chunks import (
    MOST_THREADS,
    kernel_threads,
)
from polywigner.execution.drjit_operations import DrjitOperations, UnrolledOperations, ops_for
from polywigner.execution.evaluation import Shear, evaluate, evaluate_rows, evaluate_sums, explained
from polywigner.execution.frequency_grids import evaluate_on_grid
from polywigner.execution.on_drjit import without_collection
from polywigner.execution.operations import NumpyOperations, ScalarOperations
from polywigner.execution.points import (
    Drjit,
    Parameter,
    Parameters,
    Traced,
    checked_float,
    complex_numbers,
    components_of_all,
    host_points,
    in_plane,
    is_drjit,
    matrix_times,
    plane_points,
    product_of_complex,
    shifted_points,
    tensor_of,
    times_complex,
)
from polywigner.execution.traced import (
    evaluate_traced,
    kernel_with_derivatives,
    site_sum,
    with_end_slopes,
)

"""Where kernels run: NumPy, or Dr.Jit on LLVM or CUDA.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``operations``       the operations namespaces that kernels are written over, one for each engine
``ranges``           their loops over parts of tables; ``drjit_ranges`` those of Dr.Jit
``choice``           which engine and precision a call runs on; what is counted for its plan
``evaluation``       NumPy arrays in and out, in chunks, on any engine; sums over places
``chunks``           samples chunk by chunk, threads, and NumPy memory as Dr.Jit takes it
``on_numpy``         a kernel on NumPy arrays; ``on_drjit`` a compiled one; ``on_drjit_data`` one
                     for all outlines
``frozen``           kernels traced once
``grids``            frequencies on a grid, from its axes
``drjit_arrays``     Dr.Jit arrays in and out, traced and differentiable
``drjit_points``     components of points of any kind, and results of that kind
``hosted``           Dr.Jit arrays in and out of functions that the host computes
``gradients``        kernels with derivatives in closed form, as one custom operation
``parameters``       numbers of sources that are Dr.Jit arrays, and tables as data of a kernel
``traced_sums``      sums with derivatives: over slits, array factors, rays
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
    check_not_stopped,
    kernel_threads,
    stop_this_thread_when,
)
from polywigner.execution.drjit_arrays import (
    PointKind,
    checked_float,
    components_of_all,
    evaluate_traced,
    matrix_times,
)
from polywigner.execution.drjit_points import (
    host_points,
    in_plane,
    is_drjit,
    product_of_complex,
    shifted_points,
    times_complex,
)
from polywigner.execution.evaluation import Shear, evaluate, evaluate_sums, explained
from polywigner.execution.gradients import kernel_with_derivatives
from polywigner.execution.grids import evaluate_on_grid
from polywigner.execution.hosted import (
    TracedField,
    evaluate_hosted,
    hosted_field,
    hosted_poses,
    hosted_values,
)
from polywigner.execution.operations import (
    DrjitOperations,
    NumpyOperations,
    ScalarOperations,
    ops_for,
)
from polywigner.execution.parameters import (
    Parameter,
    Parameters,
    Traced,
    UnrolledOperations,
    complex_numbers,
    plane_points,
    tensor_of,
)
from polywigner.execution.traced_sums import (
    float_of,
    has_gradient,
    ray_sum,
    site_sum,
    traced_sums,
    values_of,
    with_end_slopes,
    with_slopes,
)

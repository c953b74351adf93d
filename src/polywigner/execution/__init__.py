"""Where kernels run: NumPy, or Dr.Jit on LLVM or CUDA.

===================  ==========================================================================
module               what is in it
===================  ==========================================================================
``operations``       the operations namespaces that kernels are written over, one for each engine
``ranges``           their loops over parts of tables; ``drjit_ranges`` those of Dr.Jit
``aligned``          NumPy memory copied so that Dr.Jit does not compile anew for it
``choice``           which engine and precision a call runs on
``evaluation``       NumPy arrays in and out, in chunks, on any engine
``chunks``           samples chunk by chunk
``on_numpy``         a kernel on NumPy arrays; ``on_drjit`` a compiled one; ``on_drjit_shared``
                     places that meet many frequencies; ``on_drjit_data`` one for all outlines
``by_cell``          samples in the order of their cells; ``frozen`` kernels traced once
``table_data``       tables as data of a kernel; ``listed_sums`` sums of some rows
``pairs``            every position with every frequency
``sums``             weighted sums over places, for many points
``grids``            frequencies on a grid, from its axes
``drjit_arrays``     Dr.Jit arrays in and out, traced and differentiable
``drjit_linear``     components of several points, and points of components
``drjit_points``     components of points of any kind, and ``drjit_results`` results of that kind
``drjit_hosted``     Dr.Jit arrays in and out of sums that the host adapts to each point
``hosted_slopes``    the same with derivatives that the host computes as well
``hosted_values``    real values of several arguments with derivatives that the host computes
``pose_slopes``      values of poses with derivatives that the host computes
``derivatives``      functions with known derivatives as one custom operation
``gradients``        kernels with derivatives in closed form
``accumulators``     what derivatives in vertices and fields are added up in
``end_slopes``       derivatives in the ends of slits
``parameters``       vertices, weights and amplitudes of sources that are Dr.Jit arrays
``ray_sums``         sums over rays, with derivatives
``site_sums``        array factors with differentiable weights
``threads``          how many threads compiled kernels run on
``requests``         what a call asks for, counted
===================  ==========================================================================
"""

from polywigner.execution.choice import (
    Engine,
    Precision,
    checked_engine,
    checked_precision,
    uncompiled,
)
from polywigner.execution.drjit_arrays import checked_float, evaluate_traced
from polywigner.execution.drjit_hosted import evaluate_hosted
from polywigner.execution.drjit_linear import PointKind, components_of_all, matrix_times
from polywigner.execution.drjit_points import (
    host_points,
    in_plane,
    is_drjit,
    shifted_points,
)
from polywigner.execution.drjit_results import product_of_complex, times_complex
from polywigner.execution.end_slopes import with_end_slopes
from polywigner.execution.evaluation import Shear, evaluate, explained
from polywigner.execution.gradients import kernel_with_derivatives
from polywigner.execution.grids import evaluate_on_grid
from polywigner.execution.hosted_slopes import TracedField, hosted_field
from polywigner.execution.hosted_values import hosted_values
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
    complex_numbers,
    plane_points,
    tensor_of,
)
from polywigner.execution.pose_slopes import hosted_poses
from polywigner.execution.ray_sums import (
    float_of,
    has_gradient,
    ray_sum,
    traced_sums,
    values_of,
    with_slopes,
)
from polywigner.execution.site_sums import site_sum
from polywigner.execution.sums import evaluate_sums
from polywigner.execution.table_data import UnrolledOperations
from polywigner.execution.threads import (
    MOST_THREADS,
    check_not_stopped,
    kernel_threads,
    stop_this_thread_when,
)

__all__ = [
    "MOST_THREADS",
    "DrjitOperations",
    "Engine",
    "NumpyOperations",
    "Parameter",
    "Parameters",
    "PointKind",
    "Precision",
    "ScalarOperations",
    "Shear",
    "Traced",
    "TracedField",
    "UnrolledOperations",
    "check_not_stopped",
    "checked_engine",
    "checked_float",
    "checked_precision",
    "complex_numbers",
    "components_of_all",
    "evaluate",
    "evaluate_hosted",
    "evaluate_on_grid",
    "evaluate_sums",
    "evaluate_traced",
    "explained",
    "float_of",
    "has_gradient",
    "host_points",
    "hosted_field",
    "hosted_poses",
    "hosted_values",
    "in_plane",
    "is_drjit",
    "kernel_threads",
    "kernel_with_derivatives",
    "matrix_times",
    "ops_for",
    "plane_points",
    "product_of_complex",
    "ray_sum",
    "shifted_points",
    "site_sum",
    "stop_this_thread_when",
    "tensor_of",
    "times_complex",
    "traced_sums",
    "uncompiled",
    "values_of",
    "with_end_slopes",
    "with_slopes",
]

"""Plans of calls: the way is chosen once, before any work, from counted sizes and costs.

``costs`` says what each step takes in seconds and which benchmark tells, and ``plan`` makes a
`Plan` of a `Request` by it; scenes and kernels ask it for single choices. Nothing here
computes, imports an engine, or looks at an array: equal requests have equal plans.
"""

# ruff: noqa: F401
from polywigner.plans.costs import COSTS, Cost
from polywigner.plans.plan import (
    Outline,
    Plan,
    Request,
    cut_for,
    exposes_numbers,
    forced,
    has_own_factor,
    launch_for,
    loops_over_edges,
    plan,
    shifts_samples,
    sums_over_lattice,
    sums_over_places,
    sums_over_points,
    tabulates_products,
    unrolls_cuts,
    unrolls_steps,
    unrolls_terms,
    waves_fit_code,
)

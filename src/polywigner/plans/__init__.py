"""Which way a call is carried out: chosen once, before any work, from counted sizes and costs.

``request`` says what is asked for as plain numbers, ``costs`` what each step takes in seconds and
which benchmark tells, and ``plan`` turns one into a `Plan` by the other. Dr.Jit arrays and scenes
ask ``cuts`` and ``traced``; kernels of arrays ask ``arrays``. Nothing here computes, imports an
engine, or looks at an array: equal requests have equal plans.
"""

from polywigner.plans.arrays import (
    has_own_factor,
    sums_over_lattice,
    sums_over_places,
    tabulates_products,
)
from polywigner.plans.costs import COSTS, Cost
from polywigner.plans.cuts import cut_for, forced, loops_over_edges, waves_fit_code
from polywigner.plans.plan import Plan, plan
from polywigner.plans.request import Outline, Request
from polywigner.plans.traced import (
    exposes_numbers,
    launch_for,
    shifts_samples,
    unrolls_cuts,
    unrolls_steps,
    unrolls_terms,
)

__all__ = [
    "COSTS",
    "Cost",
    "Outline",
    "Plan",
    "Request",
    "cut_for",
    "exposes_numbers",
    "forced",
    "has_own_factor",
    "launch_for",
    "loops_over_edges",
    "plan",
    "shifts_samples",
    "sums_over_lattice",
    "sums_over_places",
    "tabulates_products",
    "unrolls_cuts",
    "unrolls_steps",
    "unrolls_terms",
    "waves_fit_code",
]

"""Which way a call is carried out: chosen once, before any work, from counted sizes and costs.

``request`` says what is asked for as plain numbers, ``costs`` what each step takes in seconds and
which benchmark tells, and ``plan`` turns one into a `Plan` by the other. Dr.Jit arrays and scenes
ask ``cuts`` and ``traced``. Nothing here computes, imports an engine, or looks at an array: equal
requests have equal plans.
"""

from polywigner.plans.costs import COSTS, Cost
from polywigner.plans.cuts import cut_for, forced, loops_over_edges
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
    "launch_for",
    "loops_over_edges",
    "plan",
    "shifts_samples",
    "unrolls_cuts",
    "unrolls_steps",
    "unrolls_terms",
]

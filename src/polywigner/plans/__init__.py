"""Which way a call is carried out: chosen once, before any work, from counted sizes and costs.

``request`` says what is asked for as plain numbers, ``costs`` what each step takes in seconds and
which benchmark tells, and ``plan`` turns one into a `Plan` by the other. Nothing here computes,
imports an engine, or looks at an array: equal requests have equal plans.
"""

from polywigner.plans.costs import COSTS, Cost
from polywigner.plans.cuts import cut_for, forced, loops_over_edges
from polywigner.plans.plan import Plan, plan
from polywigner.plans.request import Outline, Request
from polywigner.plans.traced import (
    compiles_outline,
    exposes_numbers,
    is_recorded,
    shifts_samples,
    sorts_samples,
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
    "compiles_outline",
    "cut_for",
    "exposes_numbers",
    "forced",
    "is_recorded",
    "loops_over_edges",
    "plan",
    "shifts_samples",
    "sorts_samples",
    "unrolls_cuts",
    "unrolls_steps",
    "unrolls_terms",
]

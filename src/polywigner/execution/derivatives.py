"""Functions of Dr.Jit arrays whose derivatives are known: one custom operation for all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

__all__ = ["DerivativeRule", "with_derivatives"]


@dataclass(frozen=True, eq=False)
class DerivativeRule:
    """A function of some inputs, and how changes go forward through it and gradients back.

    An input is an array, a tuple of arrays, or None; the functions get all of them without
    derivatives.
    """

    name: str
    value: Callable[..., Any]
    """(*inputs) -> a tuple of arrays, or one array."""
    forward: Callable[[Any, Any], Any]
    """(inputs, their changes) -> the change of the value."""
    reverse: Callable[[Any, Any], tuple[Any, ...]]
    """(inputs, the gradient in the value) -> that in each input, None where it has none."""


def with_derivatives(rule: DerivativeRule, *inputs: Any) -> Any:
    """The value of a function, which Dr.Jit then differentiates by its rule."""
    import drjit

    return drjit.custom(_operation(), rule, inputs)


@cache
def _operation() -> Any:
    import drjit

    class Operation(drjit.CustomOp):
        """A function and its derivatives, by a rule."""

        def eval(self, rule: DerivativeRule, inputs: Any) -> Any:
            self.rule, self.inputs = rule, inputs
            return rule.value(*inputs)

        def forward(self) -> None:
            self.set_grad_out(self.rule.forward(self.inputs, self.grad_in("inputs")))

        def backward(self) -> None:
            self.set_grad_in("inputs", self.rule.reverse(self.inputs, self.grad_out()))

        def name(self) -> str:
            return f"polywigner {self.rule.name}"

    return Operation

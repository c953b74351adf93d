"""``frequency=`` in place of a wavelength, wherever a public function takes one."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from numbers import Real
from typing import Any, ParamSpec, Protocol, TypeVar, cast, overload

from polywigner.errors import ArgumentError
from polywigner.geometry.arguments import checked_number
from polywigner.geometry.plausibility import is_called_by_user, warn_of_wavelength
from polywigner.quantities import SPEED_OF_LIGHT

__all__ = ["takes_frequency"]

# Hz: a wavelength of a thousand kilometres; less is in GHz.
_LEAST = 300.0

P = ParamSpec("P")
R = TypeVar("R", covariant=True)


class _WithFrequency(Protocol[P, R]):
    """A function as it is written, or without its wavelength and with a frequency in Hz."""

    __name__: str

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R: ...

    @overload
    def __call__(self, *args: Any, frequency: float, **kwargs: Any) -> R: ...


def takes_frequency(function: Callable[P, R]) -> _WithFrequency[P, R]:
    """The function with a keyword ``frequency`` (Hz), which its ``wavelength`` (m) follows from.

    With it the wavelength is left out, among positional arguments too:
    ``radiation_pattern(source, theta, phi, frequency=77e9)``.
    """
    signature = inspect.signature(function)
    names = list(signature.parameters)
    place = names.index("wavelength")
    following = list(signature.parameters.values())[place + 1 :]
    # what follows has a default: a number in its place is a wavelength
    is_last = not following or following[0].default is not inspect.Parameter.empty

    @functools.wraps(function)
    def wrapper(*args: Any, frequency: float | None = None, **kwargs: Any) -> Any:
        if frequency is None:
            if is_called_by_user():
                warn_of_wavelength(
                    args[0] if args else kwargs.get("source"),
                    args[place] if len(args) > place else kwargs.get("wavelength"),
                )
            return function(*args, **kwargs)
        length = SPEED_OF_LIGHT / _checked(frequency)
        has_both = is_last and len(args) > place and isinstance(args[place], Real)
        if kwargs.get("wavelength") is None and not has_both:
            kwargs.pop("wavelength", None)
            given = (*args[:place], length, *args[place:])
            if len(args) < place:  # arguments before it are named
                given, kwargs = args, {**kwargs, "wavelength": length}
            try:
                signature.bind(*given, **kwargs)
            except TypeError as error:
                if "too many" not in str(error):
                    raise
            else:
                if is_called_by_user():
                    warn_of_wavelength(given[0] if given else kwargs.get("source"), length)
                return function(*given, **kwargs)
        raise ArgumentError("expected a wavelength or a frequency, got both; leave one of them out")

    extra = inspect.Parameter("frequency", inspect.Parameter.KEYWORD_ONLY, default=None)
    kept = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    rest = [p for p in signature.parameters.values() if p.kind is p.VAR_KEYWORD]
    wrapper.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*kept, extra.replace(annotation="float | None"), *rest]
    )
    return cast("_WithFrequency[P, R]", wrapper)


def _checked(frequency: Any) -> float:
    number = checked_number(frequency, "frequency", "a number in Hz above zero")
    if not number > 0:
        raise ArgumentError(f"expected frequency as a number in Hz above zero, got {frequency!r}")
    if number < _LEAST:
        raise ArgumentError(
            f"expected frequency in Hz, got {number:g}, a wavelength of "
            f"{SPEED_OF_LIGHT / number:.3g} m; write 94e9 for 94 GHz"
        )
    return number

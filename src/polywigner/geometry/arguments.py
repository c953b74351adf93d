"""Checks of arguments: numbers, arrays, wavelengths or frequencies, poses, and plausible units."""

from __future__ import annotations

import functools
import inspect
import math
import os
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from contextvars import ContextVar
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, Protocol, TypeAlias, TypeVar, cast, overload

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import (
    ArgumentError,
    GeometryError,
    PolywignerError,
    PolywignerWarning,
    value_text,
)
from polywigner.interruption import atomic_path
from polywigner.quantities import SPEED_OF_LIGHT


class DrJitArray(Protocol):
    """A Dr.Jit array or tensor, such as ``Array2f``; this room does not import Dr.Jit."""

    @property
    def index_ad(self) -> int:
        """Number of the variable in the graph of derivatives."""
        ...

    def __dlpack__(self, stream: object | None = None) -> Any: ...


Points: TypeAlias = ArrayLike | DrJitArray
"""Numbers with their components along the last axis: whatever NumPy takes, ``xarray.DataArray``
among it, or a Dr.Jit array, which has its components first unless it is a tensor."""

Outline: TypeAlias = (
    ArrayLike | shapely.Polygon | shapely.MultiPolygon | Sequence[ArrayLike | shapely.Polygon]
)
"""One ring (n, 2), several of different lengths, or shapely polygons."""


def real_numbers(values: Any) -> NDArray[np.float64]:
    """A float64 copy.

    ValueError for complex numbers, texts, and arrays with masked elements, which NumPy would
    convert.
    """
    if np.ma.is_masked(values):
        raise ValueError("masked elements; leave them out")
    try:
        raw = np.asarray(values)
    except ValueError:
        raise ValueError("lists of different lengths") from None
    try:
        if raw.dtype.kind not in "iufO":
            raise TypeError
        return np.array(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(type(values).__name__) from None


def shape_of(value: Any) -> str:
    """The shape of an array or of nested lists, for messages."""
    try:
        return str(np.shape(value))
    except ValueError:
        return "of lists of different lengths"


# Products of a few larger numbers overflow.
_LARGEST = 1e100


def _has_length(length: int, expected: int | None) -> bool:
    return expected in (None, length)


def finite_array(
    values: Any,
    expected: str,
    *shapes: tuple[int | None, ...],
    error: type[PolywignerError] = ArgumentError,
) -> NDArray[np.float64]:
    """Return a float64 copy of real numbers below 1e100 that has one of some shapes.

    In ``shapes`` None stands for any length above zero. The message of the error starts with
    ``expected``.
    """

    def fits(array: NDArray[np.float64]) -> bool:
        same_axes = [shape for shape in shapes if len(shape) == array.ndim]
        return array.size > 0 and any(all(map(_has_length, array.shape, s)) for s in same_axes)

    array = _real_array(values, expected, fits, error)
    is_finite = (np.abs(np.atleast_1d(array)) < _LARGEST).reshape((*array.shape[:1], -1))
    if not is_finite.all():
        row = int(is_finite.all(axis=-1).argmin())
        got = f"{array[row].tolist()} in row {row}" if array.ndim else array.item()
        raise error(f"{expected}, got {got}; numbers must be finite and below {_LARGEST:g}")
    return array


def unchangeable(self: Any, name: str, value: object = None) -> NoReturn:
    """Refuse to set or delete an attribute of a value."""
    raise AttributeError(f"{type(self).__name__} cannot be changed ({name}); build a new one")


# Most vertices, as of a file; a slip of a few zeros would fill the memory.
_MOST = 1_000_000


def checked_number(value: Any, name: str, meaning: str) -> float:
    """A finite number, or ArgumentError: expected `name` as `meaning`."""
    try:
        refused = isinstance(value, (str, bytes, bool)) or np.iscomplexobj(value)
        refused |= np.ma.is_masked(value)
        number = math.nan if refused else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise ArgumentError(f"expected {name} as {meaning}, got {value_text(value)}")
    return number


def checked_choice(value: Any, name: str, choices: Collection[str]) -> str:
    """One of some names, or ArgumentError."""
    if not isinstance(value, str) or value not in choices:
        known = ", ".join(f'"{choice}"' for choice in choices)
        raise ArgumentError(f"expected {name} to be one of {known}, got {value_text(value)}")
    return value


def checked_flag(value: Any, name: str) -> bool:
    """True or False, or ArgumentError: arrays and texts have no truth to tell."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"expected {name} to be True or False, got {value_text(value)}")
    return bool(value)


def _real_array(
    values: Any,
    expected: str,
    fits: Callable[[NDArray[np.float64]], bool],
    error: type[PolywignerError] = ArgumentError,
) -> NDArray[np.float64]:
    """Return a float64 copy of real numbers whose shape fits; an error starts with `expected`."""
    try:
        array = real_numbers(values)
    except ValueError as reason:
        raise error(f"{expected}, got {reason}") from None
    if not fits(array):
        raise error(f"{expected}, got shape {shape_of(values)}")
    return array


def checked_row(values: Any, expected: str) -> NDArray[np.float64]:
    """Real numbers (k,), one or more; ArgumentError that begins with ``expected``."""
    return np.atleast_1d(_real_array(values, expected, lambda row: row.ndim < 2 and row.size > 0))


def checked_vectors(
    values: Any, expected: str, last: tuple[int, ...], error: type[PolywignerError] = ArgumentError
) -> NDArray[np.float64]:
    """Real numbers whose last axes are ``last``; an error that begins with ``expected``."""
    axes = len(last)
    return _real_array(
        values, expected, lambda a: a.ndim >= axes and a.shape[a.ndim - axes :] == last, error
    )


def checked_array(values: Any, name: str, dimension: int) -> NDArray[np.float64]:
    """Real numbers with ``dimension`` axes, none of them empty, or ArgumentError."""
    expected = f"expected {name} as an array of real numbers with {dimension} axes and some entries"
    return _real_array(values, expected, lambda a: a.ndim == dimension and a.size > 0)


def checked_callable(value: Any, name: str) -> Any:
    """A function or None, or ArgumentError."""
    if value is not None and not callable(value):
        raise ArgumentError(f"expected {name} as a function or None, got {value_text(value)}")
    return value


def checked_length(value: Any, name: str, zero: bool = False, meaning: str = "") -> float:
    """A finite number above zero (or zero, if allowed), or ArgumentError."""
    meaning = meaning or ("a length of at least zero" if zero else "a length above zero")
    number = checked_number(value, name, meaning)
    if not number > 0 and not (zero and number == 0):
        raise ArgumentError(f"expected {name} as {meaning}, got {value_text(value)}")
    return number


def checked_wavelength(value: Any) -> float:
    """Return a wavelength in m, above zero; ArgumentError for anything else."""
    if isinstance(value, str):
        raise ArgumentError(
            f"expected a wavelength as a number in metres, got the text {value[:40]!r}; quantities "
            "with units are for files and the command line, here write 3e-3 or 299792458 / 94e9"
        )
    return checked_length(value, "wavelength")


def checked_generator(seed: Any) -> np.random.Generator:
    """Return NumPy's generator of a seed; ArgumentError for anything but a seed."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"expected seed as a whole number of at least zero or a Generator, "
            f"got {value_text(seed)}"
        ) from None


def checked_count(value: Any, name: str, least: int, most: int | None = None) -> int:
    """A whole number within bounds, or ArgumentError."""
    if most is None and isinstance(value, (int, np.integer)) and value > _MOST:
        raise ArgumentError(f"expected {name} as a whole number up to {_MOST}, got {value}")
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise ArgumentError(f"expected {name} as a whole number {bounds}, got {value_text(value)}")
    return int(value)


def checked_path(path: Any) -> Path:
    """An absolute path; ArgumentError for anything that is none."""
    try:
        text = os.fspath(path)
    except TypeError:
        text = None
    if not isinstance(text, str) or not text or "\0" in text:
        raise ArgumentError(f"expected a path of a file or folder, got {value_text(path)}")
    return Path(os.path.abspath(text))  # noqa: PTH100 (a pathlib path keeps the "..")


# Metres: no wave of an antenna is so long, and frequencies in Hz are such numbers.
_LIKE_A_FREQUENCY = 1e6, 1e17
# A source that is a point, in effect.
_LONGEST = 1e4
# A slip between mm and m is a factor of a thousand: beyond so many wavelengths a source may be one
# that has one. Of radio waves few sources are that large, of light nearly all; there up to a metre.
_MOST_OF_RADIO, _MOST_OF_LIGHT = 1e3, 1e6
_SHORTEST_RADIO = 1e-4
# Lenses are wider than so many wavelengths, and their images within so many pupils: pinholes are at
# f/300, and mm for m would make f/1000 of f/1.
_NARROWEST_LENS, _LONGEST_FOCUS = 10.0, 500.0
# A link over so many sizes and wavelengths: a hundred times that of a radar on the road.
_LONGEST_LINK = 1e5


def doubt_of_wavelength(wavelength: float, diameter: float) -> str | None:
    """Return the doubt about a wavelength for a source of this size, both in m, or None."""
    ratio = diameter / wavelength
    most = _MOST_OF_RADIO if wavelength >= _SHORTEST_RADIO else _MOST_OF_LIGHT
    if 1 / _LONGEST <= ratio <= most:
        return None
    size = f"a source of {diameter:.3g} m at a wavelength of {wavelength:.3g} m"
    if ratio < 1:
        return f"{size}, {1 / ratio:.3g} times as long: did you mean GHz for the frequency?"
    return f"{size}, {ratio:.3g} wavelengths across: is a unit wrong, mm for m?"


def warn_of_wavelength(source: Any, wavelength: Any, stacklevel: int) -> None:
    """Warn of a wavelength like a frequency, or one that hardly belongs to the source."""
    try:
        length = float(wavelength) if isinstance(wavelength, Real) else 0.0
    except OverflowError:  # of a large int
        return
    if not 0 < length < math.inf:
        return  # the function says what it expects
    if _LIKE_A_FREQUENCY[0] < length < _LIKE_A_FREQUENCY[1]:
        warn_caller(
            f"got a wavelength of {length:g} m: a frequency? Then write frequency={length:g} in "
            "its place",
            stacklevel,
        )
        return
    diameter = _diameter(source)
    doubt = None if diameter is None else doubt_of_wavelength(length, diameter)
    if doubt is not None:
        warn_caller(f"got {doubt}", stacklevel)


def warn_of_lens(pupil: Any, wavelength: float, focal_length: float) -> None:
    """Ask about a lens of a few wavelengths, or one whose focus is hundreds of pupils away."""
    diameter = _diameter(pupil)
    if diameter is None:
        return
    if diameter < _NARROWEST_LENS * wavelength:
        warn_caller(
            f"got a pupil of {diameter:.3g} m at a wavelength of {wavelength:.3g} m: micrometres "
            "for m? Then write 0.55e-6 for 0.55 micrometres"
        )
    elif focal_length > _LONGEST_FOCUS * diameter:
        warn_caller(
            f"got a focal length of {focal_length:.3g} m, {focal_length / diameter:.3g} times the "
            f"pupil of {diameter:.3g} m: is a unit wrong, mm for m?"
        )


def warn_of_distance(sources: Any, places: NDArray[np.float64], wavelength: float) -> None:
    """Ask about links to places (n, 3) that are farther than links of such sources are."""
    distance = float(np.linalg.norm(places, axis=-1).max(initial=0.0))
    size = max(_diameter(source) or 0.0 for source in sources)
    if distance > _LONGEST_LINK * max(size, wavelength):
        warn_caller(
            f"got a link of {distance:.6g} m, {distance / size:.3g} times the size of its sources: "
            "is a unit wrong, mm for m?"
        )


def _diameter(source: Any) -> float | None:
    """Diagonal of the bounds of a source, in m; None for anything else."""
    outline = getattr(source, "source", source)  # of a differentiable one
    try:
        bounds = getattr(getattr(outline, "aperture", outline), "bounds", None)
    except PolywignerError:
        return None
    if bounds is None:
        return None
    middle = len(bounds) // 2
    return math.dist(bounds[:middle], bounds[middle:])


def warn_caller(message: str, stacklevel: int = 3) -> None:
    """Issue a :class:`PolywignerWarning`, by default at the caller of the calling function."""
    warnings.warn(message, PolywignerWarning, stacklevel=stacklevel)


# Whether the call is made by another function with a wavelength, which has warned already.
_is_nested: ContextVar[bool] = ContextVar("_is_nested", default=False)
# Stack level of the caller of a function with a wavelength, seen from `warn_caller`.
_CALLER = 5

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

    def at_wavelength(length: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        if not _is_nested.get():
            warn_of_wavelength(args[0] if args else kwargs.get("source"), length, _CALLER)
        token = _is_nested.set(True)
        try:
            return function(*_at_wavelength(length, args), **_at_wavelength(length, kwargs))
        finally:
            _is_nested.reset(token)

    @functools.wraps(function)
    def wrapper(*args: Any, frequency: float | None = None, **kwargs: Any) -> Any:
        if frequency is None:
            length = args[place] if len(args) > place else kwargs.get("wavelength")
            return at_wavelength(length, args, kwargs)
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
                return at_wavelength(length, given, kwargs)
        raise ArgumentError("expected a wavelength or a frequency, got both; leave one of them out")

    extra = inspect.Parameter("frequency", inspect.Parameter.KEYWORD_ONLY, default=None)
    kept = [p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
    rest = [p for p in signature.parameters.values() if p.kind is p.VAR_KEYWORD]
    wrapper.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*kept, extra.replace(annotation="float | None"), *rest]
    )
    return cast("_WithFrequency[P, R]", wrapper)


def _at_wavelength(length: Any, arguments: Any) -> Any:
    """Arguments, in a tuple or dict, whose sources have their phases at a wavelength in m.

    Other values of ``length`` than a number above zero are left to the checks of the function.
    """
    try:
        is_length = isinstance(length, Real) and 0.0 < float(length) < math.inf
    except OverflowError:
        is_length = False
    if not is_length:
        return arguments
    if isinstance(arguments, dict):
        return {name: _at_wavelength(length, value) for name, value in arguments.items()}
    if isinstance(arguments, tuple | list):
        if not any(hasattr(value, "at_wavelength") for value in arguments):
            return arguments
        return type(arguments)([_at_wavelength(length, value) for value in arguments])
    if hasattr(type(arguments), "at_wavelength"):
        return arguments.at_wavelength(length)
    return arguments


def _checked(frequency: Any) -> float:
    number = checked_number(frequency, "frequency", "a number in Hz above zero")
    if not number > 0:
        raise ArgumentError(
            f"expected frequency as a number in Hz above zero, got {value_text(frequency)}"
        )
    if number < _LEAST:
        raise ArgumentError(
            f"expected frequency in Hz, got {number:g}, a wavelength of "
            f"{SPEED_OF_LIGHT / number:.3g} m; write 94e9 for 94 GHz"
        )
    return number


# Scene files give angles in single precision: a product of a few such rotations departs from a
# rotation by some 1e-6. A scale that anybody wants differs by more than this.
RIGID_TOLERANCE = 1e-4


def rigid_pose(to_world: Any) -> NDArray[np.float64]:
    """A read-only (4, 4) pose: the nearest rotation, and the translation.

    Raises GeometryError for anything but rotations and translations: a scaled or sheared aperture
    would be another aperture, whose transforms this one's are not.
    """
    expected = "expected to_world as a (4, 4) matrix"
    pose = rigid_poses(finite_array(to_world, expected, (4, 4), error=GeometryError), "to_world")
    pose.flags.writeable = False
    return pose


def rigid_poses(values: Any, name: str) -> NDArray[np.float64]:
    """Rigid poses (..., 4, 4): the nearest rotations, and the translations.

    Raises GeometryError for anything else.
    """
    expected = f"expected {name} as rigid poses (..., 4, 4), rotations and translations only"
    poses = checked_vectors(values, expected, (4, 4), GeometryError)
    if not np.isfinite(poses).all():
        raise GeometryError(f"{expected}, got numbers that are not finite")
    rotation = poses[..., :3, :3]
    left, scales, right = np.linalg.svd(rotation)
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    last_row = np.isclose(poses[..., 3, :], (0.0, 0.0, 0.0, 1.0))
    faults = {
        "a last row other than (0, 0, 0, 1)": ~last_row.all(axis=-1),
        "one that scales by {}; scale the source itself": (
            np.abs(gram - np.eye(3)) > RIGID_TOLERANCE
        ).any(axis=(-2, -1)),
        "a mirror image; mirror the source itself": np.linalg.det(rotation) < 0,
    }
    for fault, at in faults.items():
        if at.any():
            sizes = ", ".join(f"{scale:.6g}" for scale in scales[at][0])
            raise GeometryError(f"{expected}, got {fault.format(sizes)}")
    poses[..., :3, :3], poses[..., 3, :] = left @ right, (0.0, 0.0, 0.0, 1.0)
    return poses


def write_lines(file: Path, lines: Iterable[str]) -> None:
    """Write lines, without their ends, to a file in UTF-8; one that is there is replaced.

    What ``lines`` raises leaves no file behind. Raises ArgumentError where it cannot be written.
    """
    text = "".join(f"{line}\n" for line in lines)
    try:
        with atomic_path(file) as scratch:
            scratch.write_text(text, encoding="utf-8", newline="\n")
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise ArgumentError(f"expected to write {file}, got: {error}") from None

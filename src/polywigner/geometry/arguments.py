"""Argument checks: numbers, arrays, wavelengths and frequencies, poses, and plausible units."""

from __future__ import annotations

import functools
import inspect
import math
import os
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn, ParamSpec, Protocol, Self, TypeAlias, TypeVar, cast, overload

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

T = TypeVar("T")


class DrJitArray(Protocol):
    """A Dr.Jit array or tensor, such as ``Array2f``; Dr.Jit is not imported here."""

    @property
    def index_ad(self) -> int:
        """Index of the variable in Dr.Jit's graph of automatic differentiation."""
        ...

    def __dlpack__(self, stream: object | None = None) -> Any: ...


Points: TypeAlias = ArrayLike | DrJitArray
"""Coordinates with the components of each point along the last axis.

Any array-like object is accepted, such as an ``xarray.DataArray``. Dr.Jit arrays other than tensors
have the components along the first axis.
"""

Outline: TypeAlias = (
    ArrayLike | shapely.Polygon | shapely.MultiPolygon | Sequence[ArrayLike | shapely.Polygon]
)
"""One ring of vertices (n, 2), several rings of different lengths, or shapely polygons."""


def real_numbers(values: Any) -> NDArray[np.float64]:
    """Return a float64 copy of real numbers, which may be NaN or infinite.

    Raise ValueError for complex numbers, booleans, strings, None, masked elements and lists of
    different lengths.
    """
    if np.ma.is_masked(values):
        raise ValueError("masked elements; remove them")
    try:
        raw = np.asarray(values)
    except ValueError:
        raise ValueError("lists of different lengths") from None
    if raw.dtype.kind == "c":
        raise ValueError("complex numbers")
    try:
        if raw.dtype.kind not in "iufO" or (raw.dtype == object and None in raw.ravel().tolist()):
            raise TypeError
        return np.array(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(type(values).__name__) from None


def shape_of(value: Any) -> str:
    """Return the shape of an array or of nested lists as text, for messages."""
    try:
        return str(np.shape(value))
    except ValueError:
        return "of lists of different lengths"


# Upper limit on the absolute value of an argument; products of a few larger values would overflow.
_LARGEST = 1e100


def _matches_shape(shape: tuple[int, ...], pattern: tuple[Any, ...]) -> bool:
    """Return whether the shape of an array matches a pattern of :func:`real_array`."""
    if pattern[:1] == (...,):
        pattern = pattern[1:]
        shape = shape[max(len(shape) - len(pattern), 0) :]
    return len(shape) == len(pattern) and all(
        k > 0 if n is None else n == k for n, k in zip(pattern, shape, strict=True)
    )


def real_array(
    values: Any,
    expected: str,
    *shapes: tuple[Any, ...],
    error: type[PolywignerError] = ArgumentError,
) -> NDArray[np.float64]:
    """Return a float64 copy of real numbers, whose shape must match one of ``shapes``.

    In a shape, None matches any length above zero, and a leading ``...`` any number of axes. NaN
    and infinite numbers are accepted. Other values raise ``error``, with ``expected`` as the
    beginning of the message.
    """
    try:
        array = real_numbers(values)
    except ValueError as reason:
        raise error(f"{expected}, got {reason}") from None
    if not any(_matches_shape(array.shape, shape) for shape in shapes):
        raise error(f"{expected}, got shape {shape_of(values)}")
    return array


def finite_array(
    values: Any,
    expected: str,
    *shapes: tuple[Any, ...],
    error: type[PolywignerError] = ArgumentError,
) -> NDArray[np.float64]:
    """Return a :func:`real_array` whose numbers are finite and smaller than 1e100 in magnitude."""
    array = real_array(values, expected, *shapes, error=error)
    is_finite = np.abs(array) < _LARGEST
    if not is_finite.all():
        row = np.argwhere(~is_finite)[0].tolist()[: max(array.ndim - 1, 1)]
        where = f" in row {', '.join(map(str, row))}" if row else ""
        got = f"{array[tuple(row)].tolist()}{where}"
        raise error(f"{expected}, got {got}; numbers must be finite and below {_LARGEST:g}")
    return array


def complex_array(
    values: Any,
    expected: str,
    *shapes: tuple[Any, ...],
    error: type[PolywignerError] = ArgumentError,
) -> NDArray[np.complex128]:
    """Return finite complex numbers as a copy; shapes and errors as in :func:`real_array`."""
    try:
        if np.ma.is_masked(values) or np.asarray(values).dtype.kind in "US":
            raise TypeError
        array = np.array(values, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise error(f"{expected}, got {value_text(values)}") from None
    if not any(_matches_shape(array.shape, shape) for shape in shapes):
        raise error(f"{expected}, got an array of shape {array.shape}")
    if not np.isfinite(array).all():
        raise error(f"{expected}, got {value_text(values)}; numbers must be finite")
    return array


def checked_row(values: Any, expected: str) -> NDArray[np.float64]:
    """Return a real number or a non-empty row of them as an array (k,).

    Numbers may be NaN or infinite. Raises ArgumentError for other values. ``expected``:
    beginning of the error message.
    """
    return np.atleast_1d(real_array(values, expected, (), (None,)))


def checked_vectors(
    values: Any, expected: str, last: tuple[int, ...], error: type[PolywignerError] = ArgumentError
) -> NDArray[np.float64]:
    """Return an array of real numbers, possibly NaN or infinite, of shape (..., *last).

    Raises ``error`` for other values. ``expected``: beginning of the error message.
    """
    return real_array(values, expected, (..., *last), error=error)


def checked_array(values: Any, name: str, dimension: int) -> NDArray[np.float64]:
    """Return a non-empty array with ``dimension`` axes; raise ArgumentError for others.

    NaN and infinite numbers are accepted.
    """
    expected = (
        f"expected {name} to be a non-empty array of real numbers with {dimension} dimensions"
    )
    return real_array(values, expected, (None,) * dimension)


def broadcast_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the common shape of array arguments; raise ArgumentError if there is none."""
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        got = ", ".join(map(str, shapes))
        raise ArgumentError(
            f"expected shapes that broadcast against each other, got {got}; add axes of length 1"
        ) from None


def frozen(value: T) -> T:
    """Make all arrays in a value, including nested tuples, read-only and contiguous.

    Arrays that are already contiguous are not copied but made read-only in place.
    """
    result: Any = value
    if isinstance(value, tuple):
        result = tuple(map(frozen, value))
    elif isinstance(value, np.ndarray):
        result = np.ascontiguousarray(value)
        result.setflags(write=False)
    return result


class Immutable:
    """Base class of read-only objects; equality compares the class and ``_key``."""

    _key: Any

    @classmethod
    def _of(cls, **fields: Any) -> Self:
        """Make an object from valid fields, without checks; arrays become read-only in place."""
        new = object.__new__(cls)
        new._set(**fields)
        return new

    def _set(self, **fields: Any) -> None:
        """Set attributes while an object is constructed; arrays become read-only in place."""
        self.__dict__.update(frozen(tuple(fields.items())))

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes to be pickled: the annotated ones, without cached values."""
        return {name: getattr(self, name) for name in type(self).__annotations__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the attributes of an unpickled object."""
        self._set(**state)

    def __eq__(self, other: object) -> bool:
        """Return whether another object has the same class and an equal ``_key``."""
        if not isinstance(other, Immutable) or type(other) is not type(self):
            return NotImplemented
        return bool(self._key == other._key)

    def __hash__(self) -> int:
        """Return the hash of ``_key``."""
        return hash(self._key)

    def __setattr__(self, name: str, value: object = None) -> NoReturn:
        """Raise AttributeError, because attributes cannot be changed or deleted."""
        raise AttributeError(
            f"{type(self).__name__} objects cannot be changed (attribute {name}); build a new one"
        )

    __delattr__ = __setattr__


# Default upper limit on counts; larger counts would exhaust the memory.
_LARGEST_COUNT = 1_000_000


def checked_number(
    value: Any, name: str, meaning: str, is_valid: Callable[[float], bool] = math.isfinite
) -> float:
    """Return a finite number that satisfies ``is_valid``; raise ArgumentError for other values.

    Booleans, strings and complex numbers are rejected too. The error message is "expected ``name``
    to be ``meaning``".
    """
    try:
        refused = isinstance(value, (str, bytes, bool)) or np.iscomplexobj(value)
        refused |= np.ma.is_masked(value)
        number = math.nan if refused else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not (math.isfinite(number) and is_valid(number)):
        raise ArgumentError(f"expected {name} to be {meaning}, got {value_text(value)}")
    return number


def checked_choice(value: Any, name: str, choices: Collection[str]) -> str:
    """Return a value if it is one of the names in ``choices``, else raise ArgumentError."""
    if not isinstance(value, str) or value not in choices:
        known = ", ".join(f'"{choice}"' for choice in choices)
        raise ArgumentError(f"expected {name} to be one of {known}, got {value_text(value)}")
    return value


def checked_type(value: Any, expected: str, *kinds: Any, advice: str = "") -> Any:
    """Return a value of one of the given types; raise ArgumentError for other values."""
    if not isinstance(value, kinds):
        got = f"got {type(value).__name__}{advice and f'; {advice}'}"
        raise ArgumentError(f"expected {expected}, {got}")
    return value


def check_options(options: Collection[str], known: type) -> None:
    """Raise ArgumentError unless all option names are keys of the TypedDict ``known``."""
    names = known.__annotations__
    for name in options:
        if name not in names:
            raise ArgumentError(f"expected one of the options {', '.join(names)}, got {name!r}")


def checked_flag(value: Any, name: str) -> bool:
    """Return True or False as a bool; raise ArgumentError for other values."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"expected {name} to be True or False, got {value_text(value)}")
    return bool(value)


def checked_callable(value: T, name: str) -> T:
    """Return a function or None; raise ArgumentError for other values."""
    if value is not None and not callable(value):
        raise ArgumentError(f"expected {name} to be a function or None, got {value_text(value)}")
    return value


def checked_length(value: Any, name: str, zero: bool = False, meaning: str = "") -> float:
    """Return a finite length above zero, or zero if allowed; raise ArgumentError for others.

    ``zero``: whether zero is allowed. ``meaning``: expected value, for the error message.
    """
    meaning = meaning or ("a length of at least zero" if zero else "a length above zero")
    return checked_number(value, name, meaning, lambda x: x > 0 or (zero and x == 0))


def checked_wavelength(value: Any) -> float:
    """Return a wavelength in m, above zero; raise ArgumentError for others, such as "3 mm"."""
    if isinstance(value, str):
        raise ArgumentError(
            f"expected a wavelength as a number in metres, got the string {value[:40]!r}; "
            "write 3e-3 or 299792458 / 94e9, because only files and the command line accept "
            "units"
        )
    return checked_length(value, "wavelength")


def checked_generator(seed: Any) -> np.random.Generator:
    """Return NumPy's generator for a seed; raise ArgumentError for an invalid seed.

    A generator is returned unchanged. None results in a different generator at each call.
    """
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise ArgumentError(
            "expected seed to be a whole number of at least zero or a numpy.random.Generator, "
            f"got {value_text(seed)}"
        ) from None


def checked_count(value: Any, name: str, least: int, most: int = _LARGEST_COUNT) -> int:
    """Return an integer from ``least`` to ``most``; raise ArgumentError for others, such as 3.0."""
    is_integer = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not is_integer or not least <= value <= most:
        raise ArgumentError(
            f"expected {name} to be a whole number from {least} to {most}, got {value_text(value)}"
        )
    return int(value)


def only_given(
    values: Mapping[str, Any], error: type[PolywignerError] = ArgumentError, purpose: str = ""
) -> str:
    """Return the name of the only value that is not None; raise an error for none or several."""
    given = [name for name, value in values.items() if value is not None]
    if len(given) != 1:
        got = " and ".join(given) or "none"
        raise error(f"expected exactly one of {', '.join(values)}{purpose}, got {got}")
    return given[0]


def check_most(
    count: float,
    most: float,
    things: str,
    remedy: str,
    error: type[PolywignerError] = ArgumentError,
) -> None:
    """Raise an error if the number of ``things`` is NaN or exceeds ``most``."""
    if not count <= most:
        raise error(f"expected at most {most:.7g} {things}, got {count:.7g}; {remedy}")


def checked_path(path: Any) -> Path:
    """Return a path, which need not exist, as an absolute path.

    Raises ArgumentError unless the value is a nonempty string or a path-like object.
    """
    try:
        text = os.fspath(path)
    except TypeError:
        text = None
    if not isinstance(text, str) or not text or "\0" in text:
        raise ArgumentError(f"expected the path of a file or folder, got {value_text(path)}")
    return Path(os.path.abspath(text))  # noqa: PTH100 (pathlib does not resolve "..")


# Range of wavelengths [m] in which a value is probably a frequency in Hz.
_LIKE_A_FREQUENCY = 1e6, 1e17
# Largest plausible ratio of wavelength to source diameter.
_LONGEST = 1e4
# Largest plausible source diameter in wavelengths, for radio and for optical sources.
_WIDEST_RADIO, _WIDEST_OPTICAL = 1e3, 1e6
# Shortest radio wavelength [m].
_SHORTEST_RADIO = 1e-4
# Largest plausible ratio of link length to source diameter; automotive radar reaches 1e3.
_LONGEST_LINK = 1e5


def warn_of_wavelength(source: Any, wavelength: float) -> None:
    """Warn if a wavelength in m is implausible for a source, or is probably a frequency in Hz."""
    diameter = _bounding_diagonal(source)
    ratio = 1.0 if diameter is None else diameter / wavelength
    widest = _WIDEST_RADIO if wavelength >= _SHORTEST_RADIO else _WIDEST_OPTICAL
    size = f"a source of {diameter or 0.0:.3g} m at a wavelength of {wavelength:.3g} m"
    if _LIKE_A_FREQUENCY[0] < wavelength < _LIKE_A_FREQUENCY[1]:
        doubt = (
            f"{wavelength:g} m looks like a frequency in Hz; pass it as frequency={wavelength:g}, "
            "or check whether the frequency should be in GHz"
        )
    elif ratio < 1 / _LONGEST:
        doubt = (
            f"{size}, which is {1 / ratio:.3g} times longer than the source; check whether the "
            "frequency should be in GHz"
        )
    elif ratio > widest:
        doubt = (
            f"{size}, which is {ratio:.3g} wavelengths across; check whether mm were passed as m"
        )
    else:
        return
    warn_caller(f"implausible wavelength: {doubt}", stacklevel=4)


def warn_of_distance(sources: Any, points: NDArray[np.float64], wavelength: float) -> None:
    """Warn if a point (n, 3) in m is implausibly far from the origin.

    The limit is 1e5 times the size of the largest source or the wavelength, whichever is larger.
    """
    distance = float(np.linalg.norm(points, axis=-1).max(initial=0.0))
    size = max(_bounding_diagonal(source) or 0.0 for source in sources)
    if distance > _LONGEST_LINK * max(size, wavelength):
        warn_caller(
            f"implausible distance: a link of {distance:.6g} m is {distance / size:.3g} times the "
            "size of its sources; check whether mm were passed as m"
        )


def _bounding_diagonal(source: Any) -> float | None:
    """Return the diagonal of a source's bounding box in m; None if the source has no bounds."""
    outline = getattr(source, "source", source)
    try:
        bounds = getattr(getattr(outline, "aperture", outline), "bounds", None)
    except PolywignerError:
        return None
    if bounds is None:
        return None
    d = len(bounds) // 2
    return math.dist(bounds[:d], bounds[d:])


def warn_caller(message: str, stacklevel: int = 3) -> None:
    """Issue a :class:`PolywignerWarning` at the line that called the public function.

    ``stacklevel``: as for :func:`warnings.warn`; 3 is the line that called the caller of this
    function.
    """
    warnings.warn(message, PolywignerWarning, stacklevel=stacklevel)


# Whether a public function is running, so that public functions inside it do not repeat warnings.
_is_nested: ContextVar[bool] = ContextVar("_is_nested", default=False)

# Lowest accepted frequency [Hz]; smaller values are probably in GHz.
_LOWEST_FREQUENCY = 300.0

P = ParamSpec("P")
R = TypeVar("R", covariant=True)


class _WithFrequency(Protocol[P, R]):
    """Type of a function with the additional keyword ``frequency``."""

    __name__: str

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R: ...

    @overload
    def __call__(self, *args: Any, frequency: float, **kwargs: Any) -> R: ...


def takes_frequency(function: Callable[P, R]) -> _WithFrequency[P, R]:
    """Decorate a function of ``wavelength`` in m: add an alternative keyword ``frequency`` in Hz.

    Calls with this keyword omit the wavelength, even if the other arguments are positional:
    ``radiation_pattern(source, theta, phi, frequency=77e9)``. Calls with both raise ArgumentError.
    The sources among the arguments are converted to the wavelength, and implausible wavelengths
    cause a warning.
    """
    parameters = list(inspect.signature(function).parameters.values())
    position = [parameter.name for parameter in parameters].index("wavelength")
    positional = sum(p.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD for p in parameters)
    # In calls with `frequency`, a number in the position of the wavelength belongs to the next
    # argument if that argument is required.
    following = parameters[position + 1 : position + 2]
    is_last = all(p.default is not inspect.Parameter.empty for p in following)

    @functools.wraps(function)
    def wrapper(*args: Any, frequency: float | None = None, **kwargs: Any) -> R:
        """Call the function at the wavelength that corresponds to ``frequency``."""
        length: Any = args[position] if len(args) > position else kwargs.get("wavelength")
        if frequency is not None:
            is_number = is_last and len(args) > position and isinstance(length, Real)
            if kwargs.pop("wavelength", None) is not None or is_number or len(args) >= positional:
                raise ArgumentError(
                    "expected a wavelength or a frequency, got both; remove one of them"
                )
            length = SPEED_OF_LIGHT / _checked_frequency(frequency)
            if len(args) < position:
                kwargs["wavelength"] = length
            else:
                args = (*args[:position], length, *args[position:])
        is_nested, token = _is_nested.get(), _is_nested.set(True)
        try:
            if isinstance(length, Real) and 0 < float(length) < math.inf:
                if not is_nested:
                    warn_of_wavelength(args[0] if args else kwargs.get("source"), float(length))
                args, kwargs = (
                    _at_wavelength(args, float(length)),
                    _at_wavelength(kwargs, float(length)),
                )
            return function(*args, **kwargs)
        finally:
            _is_nested.reset(token)

    extra = inspect.Parameter(
        "frequency", inspect.Parameter.KEYWORD_ONLY, default=None, annotation="float | None"
    )
    wrapper.__signature__ = inspect.signature(function).replace(  # type: ignore[attr-defined]
        parameters=sorted([*parameters, extra], key=lambda parameter: parameter.kind)
    )
    return cast("_WithFrequency[P, R]", wrapper)


def _at_wavelength(value: T, wavelength: float) -> T:
    """Return an argument of a call, with the sources in it converted to a wavelength in m.

    The method ``at_wavelength`` of a source converts it. Sources in lists, tuples and dictionaries
    are converted too. Other arguments stay unchanged.
    """
    result: Any = value
    if isinstance(value, dict):
        result = {name: _at_wavelength(item, wavelength) for name, item in value.items()}
    elif isinstance(value, tuple | list):
        if any(hasattr(item, "at_wavelength") for item in value):
            result = type(value)([_at_wavelength(item, wavelength) for item in value])
    elif hasattr(type(value), "at_wavelength"):
        result = result.at_wavelength(wavelength)
    return result


def _checked_frequency(frequency: Any) -> float:
    """Return a frequency of at least 300 Hz as a float; raise ArgumentError for other values."""
    number = checked_length(frequency, "frequency", meaning="a number in Hz above zero")
    if number < _LOWEST_FREQUENCY:
        raise ArgumentError(
            f"expected frequency in Hz, got {number:g} Hz, which corresponds to a wavelength "
            f"of {SPEED_OF_LIGHT / number:.3g} m; write 94e9 for 94 GHz"
        )
    return number


# Largest deviation from a rotation that counts as rounding error; scene files have float32 angles.
RIGID_TOLERANCE = 1e-4


def rigid_pose(to_world: Any) -> NDArray[np.float64]:
    """Return the rigid pose (4, 4) nearest to a matrix: a rotation and a translation.

    Deviations from a rotation up to 1e-4 are removed. The result is read-only. Raises GeometryError
    if the matrix scales, shears or mirrors.
    """
    expected = "expected to_world to be a (4, 4) matrix"
    pose = rigid_poses(finite_array(to_world, expected, (4, 4), error=GeometryError), "to_world")
    pose.flags.writeable = False
    return pose


def rigid_poses(values: Any, name: str) -> NDArray[np.float64]:
    """Return the rigid poses (..., 4, 4) nearest to matrices; raise GeometryError if not rigid.

    Deviations from a rotation up to 1e-4 are removed. ``name``: argument name for the message.
    """
    expected = (
        f"expected {name} to be rigid poses of shape (..., 4, 4), "
        "with rotation and translation only"
    )
    poses = finite_array(values, expected, (..., 4, 4), error=GeometryError)
    rotation = poses[..., :3, :3]
    left, scales, right = np.linalg.svd(rotation)
    gram = np.swapaxes(rotation, -1, -2) @ rotation
    last_row = np.isclose(poses[..., 3, :], (0.0, 0.0, 0.0, 1.0))
    faults = {
        "a last row other than (0, 0, 0, 1)": ~last_row.all(axis=-1),
        "a matrix that scales by {}; scale the source itself": (
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


@contextmanager
def in_place(path: Path) -> Iterator[Path]:
    """Yield a temporary path, whose file or folder replaces ``path`` at the end of the block.

    If the block raises an exception, ``path`` stays unchanged. Missing parent folders are created.
    Raises ArgumentError if the path cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as scratch:
            yield scratch
    except PolywignerError:
        raise
    except OSError as error:
        raise ArgumentError(
            f"cannot write {path}: {error.strerror or error}; choose another location"
        ) from error


def write_lines(file: Path, lines: Iterable[str]) -> None:
    """Write lines to a file in UTF-8, completely or not at all; an existing file is replaced.

    A line feed is added to each line. Raise ArgumentError if the file cannot be written.
    """
    with in_place(file) as scratch:
        scratch.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")

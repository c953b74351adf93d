"""Responses of arrays to clouds of scatterers, and files of clouds for other programs."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polywigner.errors import ArgumentError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_path, checked_type, in_place, rigid_pose
from polywigner.geometry.io.limits import checked_suffix
from polywigner.mitsuba.plugins.mixtures import norm_of, support_of
from polywigner.mitsuba.plugins.placement import PlacedSource
from polywigner.mitsuba.radar.range_profile import checked_ranges
from polywigner.numerics import Complex, Floats
from polywigner.propagation.amplitudes import amplitude
from polywigner.propagation.stores import write_netcdf
from polywigner.source import Array
from polywigner.transforms.xarray_arguments import arrays_of

# Number of scatterers per block; the responses to a block take tens of megabytes.
_CHUNK = 1 << 16
# Relative tolerance of fields at scatterers.
_TOLERANCE = 1e-6


def element_responses(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
) -> Complex:
    """Return the complex response of each element of a receiving array to each scatterer.

    The response of element k to scatterer n is ``e_kn = lambda U_k(y_n)/sqrt(N_k)``. U_k is the
    exact field in (RX8) of docs/received_power.md, which the element would transmit to the position
    y_n, with the obliquity of the cloud's receiver. N_k is the power that the element would
    radiate, or the integral of abs(u_k)^2 over the element, according to the ``normalise`` of the
    receiver.

    By reciprocity, the element receives the power ``intensity_n abs(e_kn)^2``. For a random
    amplitude of the element (speckle), multiply ``sqrt(intensity_n) e_kn`` by a complex random
    number of variance 1. The response contains the phase exp(+ikR) of the path of length R from the
    scatterer to the element.

    Parameters
    ----------
    cloud : xarray.Dataset
        Cloud of :func:`scatterers`.
    elements : Array, Aperture or sequence of Aperture
        Elements with their illumination. The weights of an Array are ignored.
    to_world : array_like, shape (4, 4), optional
        Pose of the plane of the elements, with the translation in m. Default: the pose of the
        cloud's receiver.

    Returns
    -------
    ndarray of complex, shape (elements, scatterers)
        Responses in m. The squared modulus of a response times a radiant intensity in W/sr is a
        power in W. The response is zero for scatterers behind the plane of the elements, and in
        directions of zero obliquity.

    Raises
    ------
    ArgumentError
        If ``cloud`` or ``elements`` is of another type.
    GeometryError
        If ``to_world`` is not a rigid pose.
    SceneError
        If an element cannot radiate.
    """
    positions, _, attrs = _contents_of(cloud)
    return _responses(positions, _checked_elements(elements), to_world, attrs)


def covariance(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
    ranges: ArrayLike | None = None,
) -> Complex:
    """Return the covariance matrix of the signals of an array's elements, for each range gate.

    The covariance of the elements k and l is ``R_kl = sum_n intensity_n e_kn conj(e_ln)``, with the
    responses e of :func:`element_responses` to the scatterers n. It is the mean of
    ``a_k conj(a_l)`` over random amplitudes a of the elements (speckle). R_kk is the power in W
    that element k receives. An array of equal elements with the weights w receives the power
    ``w^T R conj(w) / sum(abs(w)^2)``. The cloud should belong to a receiver whose source is similar
    to one element, so that the scatterers sample the beam of an element.

    Parameters
    ----------
    cloud, elements, to_world
        As in :func:`element_responses`.
    ranges : array_like, shape (gates + 1,), optional
        Ascending edges of range gates in m, where range is half of ``path_length``. Default: a
        single gate for the entire cloud.

    Returns
    -------
    ndarray of complex, shape (elements, elements) or (gates, elements, elements)
        Hermitian matrix in W. With ``ranges``, there is one matrix for each gate.

    Raises
    ------
    ArgumentError
        As in :func:`element_responses`, or if ``ranges`` does not ascend.
    """
    positions, intensity, attrs = _contents_of(cloud)
    sources = _checked_elements(elements)
    count = 1
    gates = np.zeros(len(intensity), np.intp)
    if ranges is not None:
        edges = checked_ranges(ranges)
        count = len(edges) - 1
        half = np.asarray(cloud["path_length"].values) / 2
        gates = np.searchsorted(edges, half, side="right") - 1
        gates[half == edges[-1]] = count - 1
    order = np.argsort(gates, kind="stable")
    order = order[(gates[order] >= 0) & (gates[order] < count)]
    result = np.zeros((count, len(sources), len(sources)), np.complex128)
    for start in range(0, len(order), _CHUNK):
        part = order[start : start + _CHUNK]
        responses = _responses(positions[part], sources, to_world, attrs)
        bounds = np.searchsorted(gates[part], np.arange(count + 1))
        for gate in np.flatnonzero(np.diff(bounds)):
            within = slice(bounds[gate], bounds[gate + 1])
            in_gate = responses[:, within]
            result[gate] += (in_gate * intensity[part][within]) @ in_gate.conj().T
    return result[0] if ranges is None else result


def _responses(
    positions: Floats, sources: Sequence[Any], to_world: Any, attrs: dict[str, Any]
) -> Complex:
    """Return the complex responses of sources to scatterers in m, shape (sources, n).

    The scatterers are at ``positions`` (n, 3) in the scene, in m. ``to_world`` is the pose of the
    sources, by default the pose in ``attrs``.
    """
    pose = rigid_pose(np.reshape(attrs["to_world"], (4, 4)) if to_world is None else to_world)
    local = (positions - pose[:3, 3]) @ pose[:3, :3]
    front = local[:, 2] > 0.0
    result = np.zeros((len(sources), len(positions)), np.complex128)
    if not front.any():
        return result
    wavelength, obliquity = attrs["wavelength"], attrs["obliquity"]
    for row, source in zip(result, sources, strict=True):
        support_of(source, obliquity)  # Raises SceneError for sources that cannot radiate.
        norm = norm_of(source, wavelength, obliquity, normalise=attrs["normalise"])
        field = amplitude(source, local[front], wavelength, obliquity, tolerance=_TOLERANCE)
        row[front] = field * (wavelength / math.sqrt(norm))
    return result


def end_responses(cloud: Any, ends: Sequence[PlacedSource]) -> Complex:
    """Return the complex responses of sources and receivers to scatterers in m.

    The shape is (ends, scatterers). Each of the ``ends`` has its own pose, wavelength, obliquity
    and norm.
    """
    positions, _, attrs = _contents_of(cloud)
    rows = []
    for end in ends:
        settings = {"wavelength": end.wavelength, "obliquity": end.obliquity}
        about = attrs | settings | {"normalise": end.normalise}
        rows.append(_responses(positions, [end.source], end.pose, about)[0])
    return np.array(rows)


def _contents_of(cloud: Any) -> tuple[Floats, Floats, dict[str, Any]]:
    """Return positions (n, 3) in m, intensities in W/sr, and attributes of a cloud."""
    names = "wavelength", "obliquity", "to_world", "normalise"
    arrays = dict.fromkeys(("position", "intensity"), "")
    positions, intensity, *values = arrays_of(
        cloud, arrays, "polywigner.mitsuba.scatterers", *names
    )
    return positions, intensity, dict(zip(names, values, strict=True))


def _checked_elements(elements: Any) -> list[Aperture]:
    """Return the elements of an array, without weights; raise ArgumentError for other objects."""
    if isinstance(elements, Array):
        return list(elements.elements_in_plane)
    expected = "elements to be an Array or a sequence of Apertures"
    parts = checked_type(elements, expected, Aperture, Sequence)
    parts = [parts] if isinstance(parts, Aperture) else parts
    return [checked_type(part, expected, Aperture) for part in parts]


def write_scatterers(cloud: Any, path: str | os.PathLike[str]) -> None:
    """Write a cloud of scatterers to a file; after an error, no file remains.

    Parameters
    ----------
    cloud : xarray.Dataset
        Cloud of :func:`scatterers`.
    path : str or path-like
        ``.csv``: one row per scatterer with the columns position_x, position_y, position_z, ...;
        ``.nc``: NetCDF, which requires the extra ``datasets``. An existing file is replaced.

    Raises
    ------
    ArgumentError
        If ``cloud`` is not a cloud, the suffix is unknown, or the file cannot be written.
    MissingExtraError
        If the library for NetCDF is not installed.
    """
    file = checked_path(path)
    _contents_of(cloud)
    if checked_suffix(file, (".csv", ".nc"), error=ArgumentError) == ".nc":
        write_netcdf(cloud, file)
        return
    columns: dict[str, list[Any]] = {}
    for name, array in cloud.data_vars.items():
        if array.ndim == 2:
            columns |= {f"{name}_{a}": array.values[:, k].tolist() for k, a in enumerate("xyz")}
        else:
            columns[str(name)] = array.values.tolist()
    with in_place(file) as scratch, scratch.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))

"""Responses of arrays to clouds of scatterers, and clouds as files for other programs."""

from __future__ import annotations

import csv
import math
import os
from base64 import b64encode
from collections.abc import Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polywigner.errors import ArgumentError, GeometryError
from polywigner.geometry import Aperture
from polywigner.geometry.arguments import checked_path, checked_row, real_numbers, rigid_pose
from polywigner.mitsuba.plugins.source_parameters import norm_of, region_of
from polywigner.propagation.amplitudes import amplitude
from polywigner.propagation.stores import in_place, write_netcdf
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array

Complexes = NDArray[np.complex128]

# Places at a time: the responses of all elements to them take some tens of megabytes.
_CHUNK = 1 << 16
# Fields are those of float32 sensors, but finer: 1e-6 of the incident field.
_TOLERANCE = 1e-6


def element_responses(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
) -> Complexes:
    """Return the complex response of each element of a receiving array to each scatterer.

    e_kn = lambda U_k(y_n)/sqrt(N_k), with U_k the exact field (docs/received_power.md, (RX8)) that
    element k would send to the scatterer's place y_n, by the obliquity of the cloud's receiver, and
    N_k the power that it would radiate, or int abs(u_k)^2 if the receiver counts by it. By
    reciprocity the element receives the power intensity_n abs(e_kn)^2 of the scatterer, and
    sqrt(intensity_n) e_kn times a random number of variance 1 is a draw of its amplitude: speckle.
    The phase is that of the way from the first surface, exp(+ikR).

    Parameters
    ----------
    cloud : a dataset of :func:`scatterers`.
    elements : an Array, each element of which counts alone and with its own illumination but
        without its weight; or a sequence of apertures.
    to_world : (4, 4) pose of the plane of the elements, translation in m; default: that of the
        receiver of the cloud.

    Returns
    -------
    (elements, scatterers) complex, in m: its squared modulus times W/sr is W.

    Scatterers behind the plane, or that the obliquity leaves in the dark, have responses of zero.

    Raises
    ------
    ArgumentError : no cloud, no elements, no pose; SceneError for elements that cannot radiate.
    """
    places, _, attrs = _checked(cloud)
    return _responses(places, _sources(elements), to_world, attrs)


def covariance(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
    ranges: ArrayLike | None = None,
) -> Complexes:
    """Return the covariance of the elements' signals of an array in a scene, by range gates.

    R_kl = sum_n intensity_n e_kn conj(e_ln) with the responses e of :func:`element_responses`: the
    mean of a_k conj(a_l) over draws of speckle a. R_kk is the power that element k receives in W
    and the trace that of all of them; an array with weights w receives, of one field,
    w^T R conj(w) / sum(abs(w)^2), if its elements are alike.

    Parameters
    ----------
    cloud, elements, to_world : as for :func:`element_responses`.
    ranges : (gates + 1,) edges of the gates in m of range, half of ``path_length``, ascending;
        None: all of the cloud.

    Returns
    -------
    (elements, elements) complex, Hermitian, in W; with ``ranges`` (gates, elements, elements).

    A cloud that was drawn for a receiver like one element serves best: scatterers are where that
    one receives from.

    Raises
    ------
    ArgumentError : as :func:`element_responses`, and for ranges that do not ascend.
    """
    places, intensity, attrs = _checked(cloud)
    sources = _sources(elements)
    if ranges is None:
        gates, count = np.zeros(len(intensity), np.intp), 1
    else:
        edges = _edges(ranges)
        count = len(edges) - 1
        # the last gate has both of its edges
        half = np.asarray(cloud["path_length"].values) / 2
        gates = np.searchsorted(edges, half, side="right") - 1
        gates[half == edges[-1]] = count - 1
        inside = (gates >= 0) & (gates < count)
        places, intensity, gates = places[inside], intensity[inside], gates[inside]
    order = np.argsort(gates, kind="stable")
    result = np.zeros((count, len(sources), len(sources)), np.complex128)
    for start in range(0, len(order), _CHUNK):
        part = order[start : start + _CHUNK]
        found = _responses(places[part], sources, to_world, attrs)
        bounds = np.searchsorted(gates[part], np.arange(count + 1))
        for gate in np.flatnonzero(np.diff(bounds)):
            within = slice(bounds[gate], bounds[gate + 1])
            own = found[:, within]
            result[gate] += (own * intensity[part][within]) @ own.conj().T
    return result[0] if ranges is None else result


def _responses(
    places: Any, sources: list[Aperture], to_world: Any, attrs: dict[str, Any]
) -> Complexes:
    pose = _pose(attrs["to_world"] if to_world is None else to_world)
    own = (places - pose[:3, 3]) @ pose[:3, :3]
    front = own[:, 2] > 0.0
    result = np.zeros((len(sources), len(places)), np.complex128)
    if not front.any():
        return result
    wavelength, obliquity = attrs["wavelength"], attrs["obliquity"]
    for row, source in zip(result, sources, strict=True):
        region_of(source, obliquity)  # or its error
        norm = norm_of(source, wavelength, obliquity, normalise=attrs["normalise"])
        field = amplitude(source, own[front], wavelength, obliquity, tolerance=_TOLERANCE)
        row[front] = field * (wavelength / math.sqrt(norm))
    return result


def _checked(cloud: Any) -> tuple[NDArray[np.float64], NDArray[np.float64], dict[str, Any]]:
    """Places, intensities and attributes of a cloud."""
    names = ("position", "intensity", "path_length")
    try:
        places, intensity, _ = (np.asarray(cloud[name].values, np.float64) for name in names)
        attrs = {name: cloud.attrs[name] for name in ("wavelength", "obliquity", "to_world")}
        attrs["normalise"] = cloud.attrs.get("normalise", NORMALISATIONS[0])
    except (AttributeError, KeyError, TypeError, IndexError, ValueError):
        raise ArgumentError(
            f"expected a cloud of polywigner.mitsuba.scatterers, got {type(cloud).__name__} "
            "without its variables and attributes"
        ) from None
    return places, intensity, attrs


def _sources(elements: Any) -> list[Aperture]:
    if isinstance(elements, Array):
        return list(elements.elements_in_plane)
    found = [elements] if isinstance(elements, Aperture) else elements
    if (
        not isinstance(found, Sequence)
        or not found
        or not all(isinstance(element, Aperture) for element in found)
    ):
        raise ArgumentError(
            f"expected elements as an Array or a sequence of apertures, got {elements!r}"
        )
    return list(found)


def _pose(value: Any) -> NDArray[np.float64]:
    try:
        given = real_numbers(value)
        return rigid_pose(given.reshape(4, 4) if given.shape == (16,) else given)
    except GeometryError as error:
        raise ArgumentError(str(error)) from None
    except ValueError:
        raise ArgumentError(
            f"expected to_world as a rigid (4, 4) pose in m, got {value!r:.200}"
        ) from None


def _edges(ranges: Any) -> NDArray[np.float64]:
    expected = "expected ranges as two or more ascending edges in m"
    found = checked_row(ranges, expected)
    if len(found) < 2 or not (np.diff(found) > 0.0).all():
        raise ArgumentError(f"{expected}, got {ranges!r}")
    return found


SUFFIXES = (".vtp", ".csv", ".nc")


def write_scatterers(cloud: Any, path: str | os.PathLike[str]) -> None:
    """Write a cloud of scatterers to a file, whole or not at all.

    Parameters
    ----------
    cloud : a dataset of :func:`scatterers`.
    path : ``.vtp``, points with their values for ParaView, VisIt and PyVista (ids of shapes and
        emitters as numbers, and their names in the order of these); ``.csv``, a row each with
        position_x, position_y, position_z, ... ; ``.nc``, NetCDF, which needs the extra
        ``volume``. A file that is there is replaced.

    Raises
    ------
    ArgumentError : no cloud, another suffix, a place that cannot be written to;
        MissingExtraError without what NetCDF needs.
    """
    place = checked_path(path)
    columns = _columns(cloud)
    kind = place.suffix.lower()
    if kind not in SUFFIXES:
        raise ArgumentError(
            f"expected a file of {', '.join(SUFFIXES)} for scatterers, got {str(place)!r}"
        )
    if kind == ".nc":
        write_netcdf(cloud, place)
        return
    with in_place(place) as scratch:
        (_write_points if kind == ".vtp" else _write_table)(columns, scratch)


def _columns(cloud: Any) -> dict[str, NDArray[Any]]:
    """(n,) or (n, 3) values by their names."""
    _checked(cloud)
    return {str(name): np.asarray(array.values) for name, array in cloud.data_vars.items()}


def _write_table(columns: dict[str, NDArray[Any]], path: Path) -> None:
    flat: dict[str, list[Any]] = {}
    for name, values in columns.items():
        if values.ndim == 2:
            flat |= {f"{name}_{a}": values[:, k].tolist() for k, a in enumerate("xyz")}
        else:
            flat[name] = values.tolist()
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(flat)
        writer.writerows(zip(*flat.values(), strict=True))


def _write_points(columns: dict[str, NDArray[Any]], path: Path) -> None:
    count = len(columns["power"])
    texts = {name: values for name, values in columns.items() if values.dtype.kind in "UO"}
    of_points = {n: v for n, v in columns.items() if n != "position" and n not in texts}
    names = {}
    for name, values in texts.items():
        names[name], numbers = np.unique(values.astype(str), return_inverse=True)
        of_points[name] = numbers.reshape(-1)
    lines = ["<FieldData>"]
    for name, known in names.items():
        # VTK's texts: bytes that end with zero
        codes = " ".join(map(str, "".join(f"{word}\0" for word in known.tolist()).encode()))
        about = f'Name="{name}_names" type="String" NumberOfTuples="{len(known)}" format="ascii"'
        lines.append(f"<DataArray {about}>{codes}</DataArray>")
    lines += ["</FieldData>", f'<Piece NumberOfPoints="{count}" NumberOfVerts="{count}">']
    lines += ['<PointData Scalars="power" Normals="normal">', *starmap(_numbers, of_points.items())]
    lines += ["</PointData><Points>", _numbers("position", columns["position"])]
    lines += ["</Points><Verts>", _numbers("connectivity", np.arange(count))]
    lines += [_numbers("offsets", np.arange(1, count + 1)), "</Verts></Piece>"]
    text = "\n".join(lines)
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">\n'
        f"<PolyData>\n{text}\n</PolyData>\n</VTKFile>\n"
    )


def _numbers(name: str, values: NDArray[Any]) -> str:
    """An array, (n,) or (n, 3), of VTK's XML: its number of bytes, and these, in base64."""
    kind, dtype = ("Float64", "<f8") if values.dtype.kind == "f" else ("Int64", "<i8")
    parts = 1 if values.ndim == 1 else values.shape[1]
    content = values.astype(dtype).tobytes()
    text = b64encode(np.array(len(content), "<u8").tobytes() + content).decode()
    about = f'type="{kind}" NumberOfComponents="{parts}" format="binary"'
    return f'<DataArray Name="{name}" {about}>{text}</DataArray>'

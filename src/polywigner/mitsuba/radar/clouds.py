"""Responses of arrays to clouds of scatterers, and files of clouds for other programs."""

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
from polywigner.mitsuba.plugins.placement import PlacedSource
from polywigner.mitsuba.plugins.source_parameters import norm_of, region_of
from polywigner.propagation.amplitudes import amplitude
from polywigner.propagation.stores import in_place, write_netcdf
from polywigner.reception.norms import NORMALISATIONS
from polywigner.source import Array

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# Scatterers of one step: the responses of all elements take some tens of megabytes.
_CHUNK = 1 << 16
# Relative tolerance of fields.
_TOLERANCE = 1e-6


def element_responses(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
) -> Complexes:
    """Return the complex response of each element of a receiving array to each scatterer.

    e_kn = lambda U_k(y_n)/sqrt(N_k), with U_k the exact field (docs/received_power.md, (RX8)) that
    element k would transmit to the position y_n, with the obliquity of the cloud's receiver, and
    N_k the power that it would radiate, or int abs(u_k)^2 according to the receiver's
    ``normalise``. By reciprocity the element receives the power intensity_n abs(e_kn)^2, and
    sqrt(intensity_n) e_kn times a random number of variance 1 is a sample of its amplitude
    (speckle). The phase exp(+ikR) is the phase of the path from the first surface.

    Parameters
    ----------
    cloud : a dataset of :func:`scatterers`.
    elements : an Array, whose elements are used with their illuminations but without weights; or a
        sequence of apertures.
    to_world : (4, 4) pose of the plane of the elements, translation in m; default: the pose of the
        cloud's receiver.

    Returns
    -------
    (elements, scatterers) complex, in m: the squared modulus times W/sr gives W. Scatterers behind
    the plane, or at angles with zero obliquity, have responses of zero.

    Raises
    ------
    ArgumentError : other objects than a cloud, elements or a pose. SceneError : elements that
        cannot radiate.
    """
    positions, _, attrs = _checked(cloud)
    return _responses(positions, _sources(elements), to_world, attrs)


def covariance(
    cloud: Any,
    elements: Array | Aperture | Sequence[Aperture],
    *,
    to_world: ArrayLike | None = None,
    ranges: ArrayLike | None = None,
) -> Complexes:
    """Return the covariance matrix of the signals of an array's elements, by range gates.

    R_kl = sum_n intensity_n e_kn conj(e_ln) with the responses e of :func:`element_responses`: the
    mean of a_k conj(a_l) over samples of speckle a. R_kk is the power in W received by element k.
    An array of equal elements with weights w receives w^T R conj(w) / sum(abs(w)^2).

    Use a cloud of a receiver like one element, so that scatterers sample the element's beam.

    Parameters
    ----------
    cloud, elements, to_world : as for :func:`element_responses`.
    ranges : (gates + 1,) ascending edges of the gates in m of range, half of ``path_length``; None:
        the complete cloud.

    Returns
    -------
    (elements, elements) complex, Hermitian, in W; with ``ranges`` (gates, elements, elements).

    Raises
    ------
    ArgumentError : as for :func:`element_responses`; ranges that do not ascend.
    """
    positions, intensity, attrs = _checked(cloud)
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
        positions, intensity, gates = positions[inside], intensity[inside], gates[inside]
    order = np.argsort(gates, kind="stable")
    result = np.zeros((count, len(sources), len(sources)), np.complex128)
    for start in range(0, len(order), _CHUNK):
        part = order[start : start + _CHUNK]
        responses = _responses(positions[part], sources, to_world, attrs)
        bounds = np.searchsorted(gates[part], np.arange(count + 1))
        for gate in np.flatnonzero(np.diff(bounds)):
            within = slice(bounds[gate], bounds[gate + 1])
            some = responses[:, within]
            result[gate] += (some * intensity[part][within]) @ some.conj().T
    return result[0] if ranges is None else result


def _responses(
    positions: Floats, sources: Sequence[Any], to_world: Any, attrs: dict[str, Any]
) -> Complexes:
    pose = _pose(attrs["to_world"] if to_world is None else to_world)
    local = (positions - pose[:3, 3]) @ pose[:3, :3]
    front = local[:, 2] > 0.0
    result = np.zeros((len(sources), len(positions)), np.complex128)
    if not front.any():
        return result
    wavelength, obliquity = attrs["wavelength"], attrs["obliquity"]
    for row, source in zip(result, sources, strict=True):
        region_of(source, obliquity)  # raises SceneError for sources that cannot radiate
        norm = norm_of(source, wavelength, obliquity, normalise=attrs["normalise"])
        field = amplitude(source, local[front], wavelength, obliquity, tolerance=_TOLERANCE)
        row[front] = field * (wavelength / math.sqrt(norm))
    return result


def end_responses(cloud: Any, ends: Sequence[PlacedSource]) -> Complexes:
    """Return the responses (ends, scatterers) of placed sources or receivers, each as a whole."""
    positions, _, attrs = _checked(cloud)
    rows = []
    for end in ends:
        settings = {"wavelength": end.wavelength, "obliquity": end.obliquity}
        about = attrs | settings | {"normalise": end.normalise}
        rows.append(_responses(positions, [end.source], end.pose, about)[0])
    return np.array(rows)


def _checked(cloud: Any) -> tuple[Floats, Floats, dict[str, Any]]:
    """Return positions, intensities and attributes of a cloud."""
    names = ("position", "intensity", "path_length")
    try:
        positions, intensity, _ = (np.asarray(cloud[name].values, np.float64) for name in names)
        attrs = {name: cloud.attrs[name] for name in ("wavelength", "obliquity", "to_world")}
        attrs["normalise"] = cloud.attrs.get("normalise", NORMALISATIONS[0])
    except (AttributeError, KeyError, TypeError, IndexError, ValueError):
        raise ArgumentError(
            f"expected a cloud of polywigner.mitsuba.scatterers, got {type(cloud).__name__} "
            "without its variables and attributes"
        ) from None
    return positions, intensity, attrs


def _sources(elements: Any) -> list[Aperture]:
    if isinstance(elements, Array):
        return list(elements.elements_in_plane)
    parts = [elements] if isinstance(elements, Aperture) else elements
    if (
        not isinstance(parts, Sequence)
        or not parts
        or not all(isinstance(element, Aperture) for element in parts)
    ):
        raise ArgumentError(
            f"expected elements as an Array or a sequence of apertures, got {elements!r}"
        )
    return list(parts)


def _pose(value: Any) -> Floats:
    try:
        pose = real_numbers(value)
        return rigid_pose(pose.reshape(4, 4) if pose.shape == (16,) else pose)
    except GeometryError as error:
        raise ArgumentError(str(error)) from None
    except ValueError:
        raise ArgumentError(
            f"expected to_world as a rigid (4, 4) pose in m, got {value!r:.200}"
        ) from None


def _edges(ranges: Any) -> Floats:
    expected = "expected ranges as two or more ascending edges in m"
    edges = checked_row(ranges, expected)
    if len(edges) < 2 or not (np.diff(edges) > 0.0).all():
        raise ArgumentError(f"{expected}, got {ranges!r}")
    return edges


SUFFIXES = (".vtp", ".csv", ".nc")


def write_scatterers(cloud: Any, path: str | os.PathLike[str]) -> None:
    """Write a cloud of scatterers to a file; no file remains after an error.

    Parameters
    ----------
    cloud : a dataset of :func:`scatterers`.
    path : ``.vtp``: points with values for ParaView, VisIt and PyVista (ids of shapes and emitters
        as numbers, with a list of names); ``.csv``: one row per scatterer with position_x,
        position_y, position_z, ...; ``.nc``: NetCDF, which needs the extra ``datasets``. An
        existing file is replaced.

    Raises
    ------
    ArgumentError : other objects than a cloud, another suffix, a path that cannot be written.
        MissingExtraError : no library for NetCDF.
    """
    file = checked_path(path)
    _checked(cloud)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise ArgumentError(
            f"expected a file of {', '.join(SUFFIXES)} for scatterers, got {str(file)!r}"
        )
    if suffix == ".nc":
        write_netcdf(cloud, file)
        return
    columns = {str(name): np.asarray(array.values) for name, array in cloud.data_vars.items()}
    with in_place(file) as scratch:
        (_write_points if suffix == ".vtp" else _write_table)(columns, scratch)


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
        # texts in VTK are bytes that end with zero
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
    """Return an array (n,) or (n, 3) in VTK's XML: the number of bytes and the bytes in base64."""
    kind, dtype = ("Float64", "<f8") if values.dtype.kind == "f" else ("Int64", "<i8")
    parts = 1 if values.ndim == 1 else values.shape[1]
    content = values.astype(dtype).tobytes()
    text = b64encode(np.array(len(content), "<u8").tobytes() + content).decode()
    about = f'type="{kind}" NumberOfComponents="{parts}" format="binary"'
    return f'<DataArray Name="{name}" {about}>{text}</DataArray>'

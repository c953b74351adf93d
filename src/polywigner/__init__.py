"""Fourier, autocorrelation, Wigner and ambiguity transforms of polygons, in closed form.

The public names are loaded on first use, so that ``import polywigner`` and the command line's
``--help`` cost nothing.
"""

from __future__ import annotations

import importlib

# as type checkers know it: the module `typing` takes longer to import than all that is here
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from polywigner import rays
    from polywigner.citations import cite
    from polywigner.geometry import (
        Aperture,
        Polyhedron,
        Slits,
        Wavefront,
        automean,
        lag_slice,
        position_slice,
        read_aperture,
        read_polyhedron,
        shapes,
    )
    from polywigner.illumination import (
        Array,
        Illumination,
        arrays,
        cosine_taper,
        fit_illumination,
        fourier_taper,
        phased_array,
        read_source,
        steering,
        taylor_taper,
        te_mode,
        uniform,
        write_source,
    )
    from polywigner.optics import FirstOrder
    from polywigner.propagation import (
        AxisSampling,
        BeamMetrics,
        CutMetrics,
        PlaneWave,
        PointSource,
        Sampling,
        Screen,
        ambiguity_table,
        amplitude,
        beam_metrics,
        hemisphere,
        horns,
        irradiance,
        line,
        plane,
        psf,
        radiated_power,
        radiation_pattern,
        suggest_sampling,
        verify_store,
        volume,
        wigner_table,
        write_netcdf,
        write_pattern,
        write_vti,
    )
    from polywigner.quantities import SPEED_OF_LIGHT
    from polywigner.radiometry import (
        EnergyBudget,
        energy_budget,
        flux_vector,
        power,
        radiance,
        radiant_intensity,
    )
    from polywigner.rays import sample_rays
    from polywigner.reception import coupling
    from polywigner.scattering import rcs, rcs_pattern
    from polywigner.transforms import (
        ambiguity,
        array_factor,
        autocorrelation,
        differentiable,
        explain,
        fourier,
        lag_marginal,
        mtf,
        otf,
        position_marginal,
        projections,
        sample_automean,
        wigner,
    )

__version__ = "0.1.0"

_HOMES = {
    "Aperture": "polywigner.geometry",
    "Array": "polywigner.illumination",
    "FirstOrder": "polywigner.optics",
    "Illumination": "polywigner.illumination",
    "Polyhedron": "polywigner.geometry",
    "Slits": "polywigner.geometry",
    "Wavefront": "polywigner.geometry",
    "SPEED_OF_LIGHT": "polywigner.quantities",
    "automean": "polywigner.geometry",
    "cite": "polywigner.citations",
    "irradiance": "polywigner.propagation",
    "lag_slice": "polywigner.geometry",
    "phased_array": "polywigner.illumination",
    "position_slice": "polywigner.geometry",
    "read_aperture": "polywigner.geometry",
    "read_polyhedron": "polywigner.geometry",
    "shapes": "polywigner.geometry",
    "arrays": "polywigner.illumination",
    "cosine_taper": "polywigner.illumination",
    "fit_illumination": "polywigner.illumination",
    "fourier_taper": "polywigner.illumination",
    "steering": "polywigner.illumination",
    "taylor_taper": "polywigner.illumination",
    "te_mode": "polywigner.illumination",
    "uniform": "polywigner.illumination",
    "read_source": "polywigner.illumination",
    "write_source": "polywigner.illumination",
    "EnergyBudget": "polywigner.radiometry",
    "energy_budget": "polywigner.radiometry",
    "flux_vector": "polywigner.radiometry",
    "power": "polywigner.radiometry",
    "radiance": "polywigner.radiometry",
    "radiant_intensity": "polywigner.radiometry",
    "amplitude": "polywigner.propagation",
    "beam_metrics": "polywigner.propagation",
    "radiation_pattern": "polywigner.propagation",
    "radiated_power": "polywigner.propagation",
    "CutMetrics": "polywigner.propagation",
    "BeamMetrics": "polywigner.propagation",
    "write_pattern": "polywigner.propagation",
    "ambiguity_table": "polywigner.propagation",
    "wigner_table": "polywigner.propagation",
    "write_netcdf": "polywigner.propagation",
    "write_vti": "polywigner.propagation",
    "AxisSampling": "polywigner.propagation",
    "Sampling": "polywigner.propagation",
    "suggest_sampling": "polywigner.propagation",
    "horns": "polywigner.propagation",
    "line": "polywigner.propagation",
    "plane": "polywigner.propagation",
    "psf": "polywigner.propagation",
    "hemisphere": "polywigner.propagation",
    "PlaneWave": "polywigner.propagation",
    "PointSource": "polywigner.propagation",
    "Screen": "polywigner.propagation",
    "verify_store": "polywigner.propagation",
    "volume": "polywigner.propagation",
    "coupling": "polywigner.reception",
    "rays": "polywigner",
    "sample_rays": "polywigner.rays",
    "rcs": "polywigner.scattering",
    "rcs_pattern": "polywigner.scattering",
    "ambiguity": "polywigner.transforms",
    "array_factor": "polywigner.transforms",
    "autocorrelation": "polywigner.transforms",
    "differentiable": "polywigner.transforms",
    "explain": "polywigner.transforms",
    "fourier": "polywigner.transforms",
    "lag_marginal": "polywigner.transforms",
    "mtf": "polywigner.transforms",
    "otf": "polywigner.transforms",
    "position_marginal": "polywigner.transforms",
    "projections": "polywigner.transforms",
    "sample_automean": "polywigner.transforms",
    "wigner": "polywigner.transforms",
}

__all__ = [
    "SPEED_OF_LIGHT",
    "Aperture",
    "Array",
    "AxisSampling",
    "BeamMetrics",
    "CutMetrics",
    "EnergyBudget",
    "FirstOrder",
    "Illumination",
    "PlaneWave",
    "PointSource",
    "Polyhedron",
    "Sampling",
    "Screen",
    "Slits",
    "Wavefront",
    "__version__",
    "ambiguity",
    "ambiguity_table",
    "amplitude",
    "array_factor",
    "arrays",
    "autocorrelation",
    "automean",
    "beam_metrics",
    "cite",
    "cosine_taper",
    "coupling",
    "differentiable",
    "energy_budget",
    "explain",
    "fit_illumination",
    "flux_vector",
    "fourier",
    "fourier_taper",
    "hemisphere",
    "horns",
    "irradiance",
    "lag_marginal",
    "lag_slice",
    "line",
    "mtf",
    "otf",
    "phased_array",
    "plane",
    "position_marginal",
    "position_slice",
    "power",
    "projections",
    "psf",
    "radiance",
    "radiant_intensity",
    "radiated_power",
    "radiation_pattern",
    "rays",
    "rcs",
    "rcs_pattern",
    "read_aperture",
    "read_polyhedron",
    "read_source",
    "sample_automean",
    "sample_rays",
    "shapes",
    "steering",
    "suggest_sampling",
    "taylor_taper",
    "te_mode",
    "uniform",
    "verify_store",
    "volume",
    "wigner",
    "wigner_table",
    "write_netcdf",
    "write_pattern",
    "write_source",
    "write_vti",
]


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        import difflib

        near = difflib.get_close_matches(name, __all__, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'polywigner' has no attribute {name!r}{hint}")
    if home == __name__:  # a room of its own
        value: Any = importlib.import_module(f"{home}.{name}")
    else:
        value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

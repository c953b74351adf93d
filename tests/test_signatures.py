"""Signatures of public functions."""

import inspect
import re

import numpy as np
import pytest

import polywigner as pw

CLASSES = (pw.Aperture, pw.Array, pw.Slits, pw.Illumination, pw.Polyhedron, pw.FirstOrder)
OF_OPERATORS = {"__init__", "__call__"}


def functions_of(owner, names):
    for name in names:
        value = inspect.getattr_static(owner, name)
        function = getattr(value, "__func__", value)
        if inspect.isfunction(function):
            yield f"{owner.__name__}.{name}", function


def public_functions():
    for name in pw.__all__:
        getattr(pw, name)  # lazily imported
    for module in (pw, pw.shapes, pw.arrays):
        yield from functions_of(module, module.__all__)
    for owner in CLASSES:
        names = [n for n in dir(owner) if not n.startswith("_") or n in OF_OPERATORS]
        yield from functions_of(owner, names)


FUNCTIONS = dict(public_functions())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_say_what_they_are(name):
    for parameter in inspect.signature(FUNCTIONS[name]).parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        assert parameter.annotation is not parameter.empty, parameter
        assert not re.search(r"\bAny\b", str(parameter.annotation)), parameter


def test_functions_that_take_a_frequency_keep_the_types_of_their_arguments():
    result = inspect.signature(pw.amplitude).parameters
    assert result["points"].annotation == "ArrayLike"
    assert result["frequency"].annotation == "float | None"


def test_a_drjit_array_is_what_its_type_says():
    drjit = pytest.importorskip("drjit")
    assert all(hasattr(drjit.ArrayBase, name) for name in ("index_ad", "__dlpack__"))
    assert not hasattr(np.ndarray, "index_ad")

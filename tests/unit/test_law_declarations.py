"""Laws of one's own: what their classes declare."""

from __future__ import annotations

import pytest

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials import Law, Parameter
from dolfinmpm.materials.strength import weakened


def test_laws_of_ones_own_that_are_incomplete_are_refused():
    """They had ended in errors of Python, of attributes, lists and tuples."""
    modulus = {"E": Parameter("Pa", low=0.0)}
    for declared, told in (
        ({"parameters": modulus}, "kernel = None must be a function .*law_kernel"),
        ({"parameters": modulus, "kernel": print}, "kernel = .* must be a function .*law_kernel"),
        ({"parameters": ["E"]}, "must be a dictionary"),
        ({"parameters": {"E": 1.0}}, "must be a dictionary"),
        ({"parameters": modulus, "internal": {"a": 0.0}}, r"internal\['a'\] = 0.0 must be a unit"),
        (
            {"parameters": modulus, "internal": {"a": ("", float("nan"))}},
            "the value is a finite number",
        ),
        ({"parameters": modulus, "internal": ["a"]}, "internal = .* must be a dictionary"),
        ({"parameters": modulus, "internal": {"a": ("Pa", "c")}}, "one of the parameters E"),
    ):
        with pytest.raises(ParameterError, match=told):
            type("Own", (Law,), declared)(E=1.0).respond([[0.0, 0.0, 1.0]])


def test_a_strength_that_is_no_parameter_is_told():
    declared = {"parameters": {"E": Parameter("Pa", low=0.0)}, "strengths": ("cohesion",)}
    law = type("Own", (Law,), declared)(E=1.0)
    with pytest.raises(ParameterError, match="'cohesion', which is none of its parameters: E"):
        weakened(law, law.parameter_array(None), 1.2)

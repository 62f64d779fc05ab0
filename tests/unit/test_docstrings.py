"""Every public name shows how it is used: its docstring has a program, which pytest runs."""

from __future__ import annotations

import inspect

import pytest

import dolfinmpm as mpm

NAMES = [
    (module, name)
    for module in (mpm, mpm.materials, mpm.study)
    for name in module.__all__
    if not inspect.ismodule(getattr(module, name))
]


@pytest.mark.parametrize(("module", "name"), NAMES, ids=[name for _, name in NAMES])
def test_a_docstring_has_a_program(module, name):
    assert ">>> " in inspect.getdoc(getattr(module, name))

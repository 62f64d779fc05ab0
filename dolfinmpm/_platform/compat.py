"""Every branch on the version of DOLFINx, and the one ctypes bridge to PETSc; nowhere else."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import importlib.util
import inspect
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, graph, jit, mesh
from dolfinx.common import IndexMap
from ffcx.naming import compute_signature
from petsc4py import PETSc
from ufl.algorithms import apply_restrictions as restrictions
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinmpm._platform.jit import compiled_once

_reasons = PETSc.SNES.ConvergedReason
# SNES's reason where forces are no numbers, until PETSc 3.24 and later
DIVERGED_NAN: int = (
    _reasons.DIVERGED_FNORM_NAN
    if hasattr(_reasons, "DIVERGED_FNORM_NAN")
    else _reasons.DIVERGED_FUNCTION_NANORINF
)
_TAG = 1202  # of messages, which no other messages on the same communicator have


def geometry_dofmap(grid) -> npt.NDArray[np.int32]:
    """Vertices of every local cell, shape (cells, vertices of a cell)."""
    if hasattr(grid.geometry, "dofmaps"):  # 0.11: one for each type of cell
        return grid.geometry.dofmaps[0]
    dofmap = grid.geometry.dofmap
    return dofmap() if callable(dofmap) else dofmap


def geometry_degree(grid) -> int:
    """Polynomial degree of the grid's geometry."""
    return grid.ufl_domain().ufl_coordinate_element().embedded_superdegree


def _value(property_or_method) -> Any:
    """What was a method once and is a property now."""
    return property_or_method() if callable(property_or_method) else property_or_method


def geometric_dimension(domain: ufl.AbstractDomain) -> int:
    """Number of coordinates in a UFL domain; a method until UFL 2025.2."""
    return _value(domain.geometric_dimension)


def interpolation_points(element) -> npt.NDArray[np.float64]:
    """Points of an element's interpolation, shape (points, dimension); a method until 0.9."""
    return _value(element.interpolation_points)


def make_index_map(comm, owned: int, ghosts, owners) -> IndexMap:
    """Index map with `owned` indices here and the given ghosts. Collective."""
    ghosts, owners = np.asarray(ghosts, dtype=np.int64), np.asarray(owners, dtype=np.int32)
    try:
        return IndexMap(comm, owned, ghosts, owners)
    except TypeError:  # from 0.10 on with a tag of its messages
        return IndexMap(comm, owned, ghosts, owners, _TAG)


def restrict(form: ufl.Form) -> ufl.Form:
    """A form over interior facets with its terminals restricted, as FFCx restricts them.

    Raises:
        ValueError: Something is restricted twice, or not where it must be.
    """
    if hasattr(restrictions, "apply_default_restrictions"):  # until UFL 2024.2
        form = restrictions.apply_default_restrictions(form)
    if "default_restrictions" not in inspect.signature(restrictions.apply_restrictions).parameters:
        return restrictions.apply_restrictions(form)
    return ufl.Form(  # from UFL 2026.1 on for each integral and each domain
        [
            restrictions.apply_restrictions(integral, {integral.ufl_domain(): "+"})
            if integral.integral_type().startswith("interior_facet")
            else integral
            for integral in form.integrals()
        ]
    )


@functools.cache
def kernel_arguments() -> int:
    """Number of arguments of FFCx's kernels, from the declaration that FFCx compiles them with."""
    found = importlib.util.find_spec("ffcx")
    assert found is not None
    assert found.origin is not None
    header = Path(found.origin).parent / "codegeneration" / "ufcx.h"
    declared = re.search(
        r"typedef void ?\(ufcx_tabulate_tensor_float64\)\((.*?)\);", header.read_text(), re.DOTALL
    )
    assert declared is not None, f"{header} does not declare ufcx_tabulate_tensor_float64"
    return declared[1].count(",") + 1


def adjacency_list(links, offsets) -> Any:
    """The lists that DOLFINx's mesh creation takes from a partitioner.

    Args:
        links: Entries of all lists, one after the other, int32.
        offsets: Where each list begins, and the end, int32.
    """
    made = graph.adjacencylist(links, offsets)
    return getattr(made, "_cpp_object", made)  # wrapped from 0.10 on


def ghosted_partitioner() -> str:
    """What a user writes for a partitioner whose cells beside other ranks' are ghosts."""
    if inspect.isfunction(mesh.create_cell_partitioner):  # from 0.11 on
        arguments = "dolfinx.graph.partitioner(), dolfinx.mesh.GhostMode.shared_facet, 2"
    else:
        arguments = "dolfinx.mesh.GhostMode.shared_facet"
    return f"dolfinx.mesh.create_cell_partitioner({arguments})"


class _WithoutVariables(MultiFunction):
    """An expression without labels; unlike UFL's own, it meets what is shared only once."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, o, inner, label):
        return inner


def jit_expression(comm, expression, points) -> tuple[int, Any]:
    """Compile an expression through FFCx: address of its C function, and the module that holds it.

    Collective: rank 0 compiles, the others load what it built.
    """
    options = {"scalar_type": np.float64}
    # FFCx tells expressions apart by the labels of their variables, which no two have in common
    expression = map_expr_dag(_WithoutVariables(), expression)
    compiled, module, _ = compiled_once(
        comm,
        compute_signature([(expression, points)], ""),
        lambda: jit.ffcx_jit(comm, (expression, points), form_compiler_options=options),
    )
    function = compiled.tabulate_tensor_float64
    declared = len(module.ffi.typeof("ufcx_tabulate_tensor_float64 *").args)
    if declared != kernel_arguments():
        raise RuntimeError(
            f"FFCx compiled a kernel of {declared} arguments, where its header declares "
            f"{kernel_arguments()}: two versions of FFCx are installed; remove one, and the "
            f"folder {jit.get_options()['cache_dir']}"
        )
    return int(module.ffi.cast("uintptr_t", function)), (module, compiled)


def compile_form(comm, form: ufl.Form) -> Any:
    """Compile a form through FFCx without any data. Collective.

    What runs once a cell or facet and a step does not pay for more than a compiler's first
    level: on a ghost penalty of quadratic functions it takes a fifth of the second's time.
    """
    options = {"scalar_type": np.float64}
    flags = jit.get_options()["cffi_extra_compile_args"]
    quick = {"cffi_extra_compile_args": ["-O1" if flag == "-O2" else flag for flag in flags]}
    known = compiled_once(
        comm,
        compute_signature([form], ""),
        lambda: fem.compile_form(comm, form, form_compiler_options=options, jit_options=quick),
    )
    # the compiled function is the same, the coefficients are this form's
    return dataclasses.replace(known, ufl_form=form)


def create_form(compiled, spaces, grid, subdomains, coefficients, constants) -> fem.Form:
    """Attach spaces, entities, coefficients and constants to a compiled form."""
    return fem.create_form(
        compiled,
        spaces,
        grid,
        {kind: list(rows) for kind, rows in subdomains.items()},
        {c: c for c in coefficients},
        {c: c for c in constants},
    )


@functools.cache
def _libpetsc() -> ctypes.CDLL:
    import petsc4py.PETSc as module

    # the symbols of libpetsc are reached through the extension module that links it
    return ctypes.CDLL(module.__file__)


def option_was_read(name: str) -> bool:
    """Whether anybody has asked PETSc's database for an option, by its whole name."""
    read = ctypes.c_int(0)
    _libpetsc().PetscOptionsUsed(None, name.encode(), ctypes.byref(read))
    return bool(read.value)


def library_of(symbol: str) -> Path | None:
    """The file of the library in which PETSc's calls of a function end; None if not known."""
    # four pointers, the first of them to the path
    found = (ctypes.c_void_p * 4)()
    try:
        address = ctypes.cast(getattr(_libpetsc(), symbol), ctypes.c_void_p)
        known = ctypes.CDLL(None).dladdr(address, ctypes.byref(found))
    except (AttributeError, OSError):
        return None
    return Path(os.fsdecode(ctypes.string_at(found[0]))).resolve() if known and found[0] else None

"""DOLFINx 0.9, 0.10 and 0.11: each difference stands in one module, and each branch of it acts."""

from __future__ import annotations

import re
import types
import warnings
from pathlib import Path

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform import compat
from dolfinmpm._platform.startup import NEWEST, OLDEST, check_version

ROOT = Path(mpm.__file__).parent
# what other versions of DOLFINx, UFL, FFCx and PETSc have in another way
DIFFERENT = (
    r"apply_(default_)?restrictions", r"\.geometric_dimension\b", r"\.interpolation_points\b",
    r"\bIndexMap\(", r"adjacencylist\(", r"create_cell_partitioner\(", r"geometry\.dofmaps?\b",
    r"DIVERGED_FNORM_NAN|NANORINF", r"\.tabulate_tensor_", r"\.__version__ *[<>=!]",
)  # fmt: skip
TAKES = {(0, 9): 6, (0, 10): 7, (0, 11): 7}  # arguments of FFCx's kernels


def named(**members):
    return types.SimpleNamespace(**members)


@pytest.mark.parametrize("pattern", DIFFERENT)
def test_what_differs_stands_in_one_module(pattern):
    places = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        if re.search(pattern, path.read_text())
    }
    assert places <= {"_platform/compat.py"}


def test_versions():
    check_version(".".join(map(str, OLDEST)) + ".0", 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_version("{}.{}.0.post1".format(*NEWEST), 0)
        check_version("0.99.0.dev0", 1)
    with pytest.warns(UserWarning, match=r"0\.99\.0\.dev0 is newer than 0\.11"):
        check_version("0.99.0.dev0", 0)
    with pytest.raises(ImportError, match=r"0\.9 or newer, and this is 0\.8\.0: install"):
        check_version("0.8.0", 1)


def test_kernels_are_called_with_the_arguments_that_they_have():
    from dolfinx import __version__

    version = tuple(map(int, __version__.split(".")[:2]))
    assert compat.kernel_arguments() == TAKES.get(version, TAKES[NEWEST])
    grid = unit_grid("interval", 2)
    c = fem.Constant(grid, 3.0)
    _, (module, _) = compat.jit_expression(grid.comm, 2 * c, np.full((1, 1), 0.25))
    kind = module.ffi.typeof("ufcx_tabulate_tensor_float64 *")
    assert len(kind.args) == compat.kernel_arguments()


def test_a_kernel_of_other_arguments_is_refused(monkeypatch):
    monkeypatch.setattr(compat, "kernel_arguments", lambda: 5)
    grid = unit_grid("interval", 2)
    with pytest.raises(RuntimeError, match="header declares 5: two versions of FFCx"):
        compat.jit_expression(grid.comm, 2 * fem.Constant(grid, 3.0), np.full((1, 1), 0.25))


def test_the_mesh_in_each_version():
    rows = np.arange(4)
    assert compat.geometry_dofmap(named(geometry=named(dofmaps=[rows]))) is rows
    assert compat.geometry_dofmap(named(geometry=named(dofmap=rows))) is rows
    assert compat.geometry_dofmap(named(geometry=named(dofmap=lambda: rows))) is rows
    grid = unit_grid("quadrilateral", 2)
    assert compat.geometry_dofmap(grid).shape == (6, 4)
    assert compat.geometric_dimension(grid.ufl_domain()) == 2
    for dimension in (2, lambda: 2):
        assert compat.geometric_dimension(named(geometric_dimension=dimension)) == 2
    space = fem.functionspace(grid, ("DG", 1))
    assert compat.interpolation_points(space.element).shape == (4, 2)
    for points in (rows, lambda: rows):
        assert compat.interpolation_points(named(interpolation_points=points)) is rows


def test_index_maps_with_and_without_a_tag(monkeypatch):
    assert compat.make_index_map(MPI.COMM_SELF, 5, [], []).size_global == 5
    given = []

    def untagged(comm, owned, ghosts, owners):
        given.append((owned, ghosts.dtype, owners.dtype))

    def tagged(comm, owned, ghosts, owners, tag):
        given.append((owned, ghosts.dtype, owners.dtype, tag))

    for make in (untagged, tagged):
        monkeypatch.setattr(compat, "IndexMap", make)
        compat.make_index_map(MPI.COMM_SELF, 3, [], [])
    assert given == [(3, np.int64, np.int32), (3, np.int64, np.int32, compat._TAG)]


def test_lists_of_a_partitioner(monkeypatch):
    links, offsets = np.array([0, 1], np.int32), np.array([0, 1, 2], np.int32)
    made = compat.adjacency_list(links, offsets)
    assert not hasattr(made, "_cpp_object")
    np.testing.assert_array_equal(made.array, links)
    for result, kept in (("plain", "plain"), (named(_cpp_object="inner"), "inner")):
        monkeypatch.setattr(compat.graph, "adjacencylist", lambda *_, result=result: result)
        assert compat.adjacency_list(links, offsets) == kept


def test_what_a_user_is_told_of_ghost_cells_makes_a_partitioner(monkeypatch):
    import dolfinx.graph

    assert callable(eval(compat.ghosted_partitioner(), {"dolfinx": dolfinx}))
    for function, arguments in ((len, "(dolfinx.mesh.G"), (lambda: None, "(dolfinx.graph.p")):
        monkeypatch.setattr(compat.mesh, "create_cell_partitioner", function)
        assert arguments in compat.ghosted_partitioner()


def test_restrictions_of_this_version():
    grid = unit_grid("quadrilateral", 2)
    V = fem.functionspace(grid, ("Lagrange", 1))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    area = ufl.FacetArea(grid)
    form = compat.restrict(area * u("+") * v("-") * ufl.dS + u * v * ufl.dx)
    facets, cells = sorted(form.integrals(), key=lambda i: i.integral_type(), reverse=True)
    assert str(facets.integrand()).count("(+)") == 2  # the area's by default
    assert cells.integrand() == (u * v)
    for wrong in (u * v, u("+")("-") * v("+")):
        with pytest.raises(ValueError, match="restrict"):
            compat.restrict(wrong * ufl.dS)


@pytest.mark.parametrize("version", ["2024.2", "2025.2", "2026.1"])
def test_restrictions_in_each_version(version, monkeypatch):
    grid = unit_grid("quadrilateral", 2)
    seen = []

    def old(form):
        seen.append(form)
        return form

    def new(integral, default_restrictions=None):
        seen.append(default_restrictions)
        return integral

    members = {"apply_restrictions": new if version == "2026.1" else old}
    if version == "2024.2":
        members["apply_default_restrictions"] = old
    monkeypatch.setattr(compat, "restrictions", named(**members))
    one = fem.Constant(grid, 1.0)
    form = one * ufl.dS + one * ufl.dx
    assert compat.restrict(form) == form
    domain = grid.ufl_domain()
    assert seen == {"2024.2": [form, form], "2025.2": [form], "2026.1": [{domain: "+"}]}[version]


def test_forces_that_are_no_numbers_have_a_reason_in_each_version():
    assert compat.DIVERGED_NAN < 0


def test_a_form_that_was_compiled_before_has_its_own_coefficients():
    grid = unit_grid("interval", 2)
    space = fem.functionspace(grid, ("DG", 0))
    sums = []
    for value in (3.0, 5.0):
        c = fem.Constant(grid, value)
        compiled = compat.compile_form(grid.comm, c * ufl.TestFunction(space) * ufl.dx)
        form = compat.create_form(compiled, [space], grid, {}, (), [c])
        sums.append(fem.assemble_vector(form).array.sum())
    np.testing.assert_allclose(sums, [3.0, 5.0], rtol=1e-14)

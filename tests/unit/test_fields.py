"""A field is a block: fields of different bases, stabilisations and shapes in one problem."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, Linearised, unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import DolfinMPMError, ParameterError

PAIRS = [("bspline2", "linear"), ("gimp", "linear"), ("linear", "bspline2"), ("bspline3", "gimp")]


def mixed(points, V, Q, bulk=50.0, mu=10.0):
    """A nearly incompressible body: displacement and pressure, and all that can couple them."""
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    strain = ufl.sym(ufl.grad(u))
    F = ufl.inner(2 * mu * ufl.dev(strain) - p * ufl.Identity(points.gdim), ufl.grad(v)) * points.dX
    return F - (ufl.tr(strain) + p / bulk) * q * points.dX


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_tangent(one, other):
    """Both orders of the fields; terms of values and gradients on either side."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.7)), 2, 1.0)
    V, Q = mpm.Space(grid, one), mpm.Space(grid, other, shape=())
    u, p = V.increment, Q.increment
    for fields in ([u, p], [p, u]):
        F = mixed(points, V, Q) + p**2 * ufl.inner(u, V.test) * points.dX
        F += ufl.inner(ufl.grad(p), ufl.grad(Q.test)) * (1 + ufl.inner(u, u)) * points.dx
        problem = mpm.QuasiStatic(F, fields, points, mpm.fixed(V, "bottom"))
        linearised = Linearised(problem)
        rng = np.random.default_rng(1)
        start, way = rng.uniform(-0.1, 0.1, (2, linearised.size))
        linearised.tangent(start)
        exact, t = linearised.product(way), 1e-6
        ahead, behind = linearised.residual(start + t * way), linearised.residual(start - t * way)
        numerical = (ahead - behind) / (2 * t)
        np.testing.assert_allclose(exact, numerical, atol=2e-7 * np.abs(exact).max())


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_the_same_field_in_two_bases_is_two_blocks(one, other):
    """Without couplings each field comes to what it comes to alone."""
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 6, 6, mesh.CellType.quadrilateral)
    law = mpm.materials.Hencky(E=10.0, nu=0.2)
    found = {}
    for names in ((one,), (other,), (one, other)):
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.72)), 2, 1.0)
        spaces = [mpm.Space(grid, name) for name in names]
        g = fem.Constant(grid, (0.0, -1.0))
        F = sum(
            (ufl.inner(ufl.grad(V.increment), ufl.grad(V.test)) - ufl.inner(g, V.test)) * points.dX
            for V in spaces
        )
        bcs = [c for V in spaces for c in mpm.fixed(V, "bottom")]
        for k in range(len(names)):
            points.add_field(f"u{k}", (2,))
        updates = {f"u{k}": V.increment for k, V in enumerate(spaces)}
        stabilisations = ["aggregation", "extended"][: len(names)]
        if names == (other,):
            stabilisations = ["extended"]
        mpm.QuasiStatic(
            F,
            [V.increment for V in spaces],
            points,
            bcs,
            updates=updates,
            stabilisation=stabilisations,
        ).step()
        found[names] = [points[f"u{k}"].copy() for k in range(len(names))]
    both, scale = found[one, other], np.abs(found[(one,)][0]).max()
    assert law.E == 10.0
    np.testing.assert_allclose(both[0], found[(one,)][0], atol=1e-12 * scale)
    np.testing.assert_allclose(both[1], found[(other,)][0], atol=1e-12 * scale)


def test_stabilisations_are_each_fields_own():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.45)), 2, 1.0)
    V, Q = mpm.Space(grid, "bspline2"), mpm.Space(grid, "linear", shape=())
    u, p = V.increment, Q.increment
    F = mixed(points, V, Q) + mpm.momentum(mpm.materials.Hencky(10.0, 0.3), points, u, V.test)
    bcs = mpm.fixed(V, "bottom")

    def active(stabilisation):
        return mpm.QuasiStatic(F, [u, p], points, bcs, stabilisation=stabilisation).activate()

    plain, second = active("none"), active(["none", "aggregation"])
    assert second.fields[0].C is None
    assert second.fields[1].C is not None
    assert second.unknowns.fields[0].nodes.size == plain.unknowns.fields[0].nodes.size
    assert second.unknowns.fields[1].nodes.size < plain.unknowns.fields[1].nodes.size
    both = active("aggregation")
    assert both.fields[0].C is not None
    assert both.unknowns.total < second.unknowns.total
    stabilisation = mpm.Stabilisation("ghost", E=0.1)
    ghosts = active(["ghost", stabilisation])
    assert {(b.row_field, b.column_field) for b in ghosts.blocks_of("stiffness")} == {
        (0, 0),
        (1, 1),
    }
    with pytest.raises(ParameterError, match=r"field 2 needs a modulus"):
        active("ghost")
    with pytest.raises(ParameterError, match=r"has 1 entries for 2 fields"):
        active(["ghost"])


def test_facets_of_a_field_are_those_of_the_cells_that_it_sees():
    """Domains reach into cells in which no point is; a field without domains is not held there."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (4, 4)], (4, 4), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1.0)
    points["x"] = points["x"] + [0.0, 0.1]
    points.locate()
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
    F = mixed(points, V, Q)
    F += mpm.ghost(points, V.increment, V.test, 1.0) + mpm.ghost(points, Q.increment, Q.test, 1.0)
    here = mpm.QuasiStatic(F, [V.increment, Q.increment], points).activate()
    cells = [int(f.cells.sum()) for f in here.fields]
    assert cells == [12, 8]
    rows = [next(iter(f.entities.values())) for f in here.fields]
    assert not np.array_equal(rows[0], rows[1])


@pytest.mark.parametrize("wrong", ["negative", "equal"])
def test_numbers_of_points_are_different_and_not_negative(wrong):
    """Families read parents and places from the numbers: negative ones had never merged."""
    grid = mpm.create_lattice(COMM, [range(3), range(3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
    kept = points["id"].copy()
    with pytest.raises(ParameterError, match="'id' identifies the points, and must be 16 differ"):
        points["id"] = kept - 1 if wrong == "negative" else kept // 2
    assert np.array_equal(points["id"], kept)
    points["id"] = kept[::-1].copy()
    # a change within the array is told by the next step
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    for kind in (mpm.QuasiStatic, mpm.Explicit):
        problem = kind(F, V.increment, points, mpm.fixed(V, "bottom"))
        for t in (1e-4, 2e-4):
            problem.step(*([t] if kind is mpm.Explicit else []))
            kept = points["id"].copy()
            points["id"][:2] = 5
            with pytest.raises(ParameterError, match=r"within its array.*points\['id'\] = ids"):
                problem.step(*([2 * t] if kind is mpm.Explicit else []))
            points["id"] = kept


@pytest.mark.filterwarnings("ignore:the weight .* acts upward")
def test_positions_and_stresses_in_another_order_are_told():
    """Sums had been the same: points were computed by the functions of other cells."""
    grid = mpm.create_lattice(COMM, [range(3), range(3)])
    for name, text in (("x", r"is not in the cell .* points\.locate"), ("stress", "by hand")):
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
        F -= points.density * V.test[1] * points.dX
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        problem.step()
        points[name][:] = points[name][::-1].copy()
        with pytest.raises(DolfinMPMError, match=text):
            problem.step()

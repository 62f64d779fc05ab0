"""F-bar, whose means over cells couple points of several ranks."""

from __future__ import annotations

import numpy as np
import ufl
from conftest import Linearised
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

from .common import COMM, run, sums


def _fbar(
    basis, law=None, stabilisation="ghost", dimension=2, wide=False, kind=None, load=1.0,
    means=True, axisymmetric=False,
):  # fmt: skip
    """A nearly incompressible body that leans over, across rank borders."""
    law = law or mpm.materials.Hencky(E=100.0, nu=0.49)
    if dimension == 2:
        kind = kind or mesh.CellType.quadrilateral
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), kind)
        body = mpm.Box((1.3, 0), (6.2, 5.15)) if not wide else mpm.Box((1.3, 2), (6.2, 7.15))
    else:
        size = (6, 4, 4)
        grid = mesh.create_box(COMM, [(0, 0, 0), size], size, mesh.CellType.hexahedron)
        body = mpm.Box((0.3, 0.7, 0), (2.4, 3.1, 2.6))
    points = mpm.fill(grid, body, 2, 1.0, axisymmetric=axisymmetric)
    if wide:
        points["l0"] = points["l"] = 0.85, 0.8
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0,) * dimension)
    F = mpm.momentum(law, points, u, v, fbar=means) - ufl.inner(g, v) * points.dX
    bcs = mpm.fixed(V, "bottom" if not wide else lambda x: x[1] < 3)
    stabilisation = mpm.Stabilisation(stabilisation, E=100.0, nu=0.3)
    loads = [load * k * np.array([0.6, *(0.0,) * (dimension - 2), -0.8]) for k in range(1, 5)]
    # figures of ranks are compared to 1e-9, which must not be what Newton's method leaves
    problem, figures = run(
        points, V, F, bcs, loads, g, stabilisation=stabilisation, tolerance=1e-11
    )
    if wide:
        figures.pop("moved")
    return problem, figures | sums(points, "J_bar")


def fbar_bases():
    """F-bar in every basis of a lattice."""
    figures = {basis: _fbar(basis)[1] for basis in ("linear", "gimp", "bspline2", "bspline3")}
    return figures | {"centres": _fbar("gimp", means="centres")[1]}


def fbar_3d():
    """F-bar in 3D, with a law that yields."""
    law = mpm.materials.VonMises(100.0, 0.49, radius=6.0, hardening=80.0)
    problem, figures = _fbar("gimp", law, dimension=3, load=1.5)
    figures["plastic"] = sums(problem.points, "plastic_strain")
    assert problem.points.comm.allreduce(problem.points["plastic_strain"].sum()) > 0
    return figures


def fbar_triangles():
    """F-bar in cells that have no lattice, where hoop strains alone differ within a cell."""
    return _fbar("linear", kind=mesh.CellType.triangle, axisymmetric=True)[1]


def fbar_ties():
    """F-bar where nodes follow others across rank borders."""
    return {
        stabilisation: _fbar("gimp", stabilisation=stabilisation)[1]
        for stabilisation in ("aggregation", "extended")
    }


def fbar_tangent():
    """Domains that span many cells make the halo grow; the tangent fits the residual on any ranks.

    The tangent is compared with differences of the residual along a direction that
    does not depend on the ranks.
    """
    figures = {}
    for basis, stabilisation in (("gimp", "ghost"), ("gimp", "aggregation"), ("bspline3", "ghost")):
        problem, figures[basis + stabilisation] = _fbar(
            basis, stabilisation=stabilisation, wide=stabilisation == "ghost", load=0.3
        )
        linearised = Linearised(problem)
        here = linearised.operator.here
        field = here.unknowns.fields[0]
        nodes = field.owned_nodes
        x = here.fields[0].basis.node_coordinates()[nodes, :2]
        free = ~field.fixed[nodes]
        start = np.stack([np.sin(x @ (1.0, 0.7)), np.cos(x @ (0.4, 1.1))], axis=1)[free] * 0.02
        direction = np.stack([np.cos(x @ (2.0, 1.7)), np.sin(x @ (1.4, 2.1))], axis=1)[free]
        start, direction = (here.unknowns.shared_out(a) for a in (start, direction))
        residual, t = linearised.residual, 1e-6
        numerical = (residual(start + t * direction) - residual(start - t * direction)) / (2 * t)
        linearised.tangent(start)
        exact = linearised.product(direction)
        scale = COMM.allreduce(np.abs(exact).max(initial=0.0), op=MPI.MAX)
        error = COMM.allreduce(np.abs(exact - numerical).max(initial=0.0), op=MPI.MAX)
        assert error < 2e-6 * scale, (basis, stabilisation, error, scale)
        figures["norm " + basis + stabilisation] = COMM.allreduce(float(exact @ exact))
    return figures


def fbar_layers():
    """With the layers that means ask for, every rank knows what its couplings need at once."""
    figures = {}
    for basis in ("linear", "gimp", "bspline2", "bspline3"):
        for half in (0.25, 0.85):
            grid = mesh.create_rectangle(
                COMM, [(0, 0), (9, 9)], (9, 9), mesh.CellType.quadrilateral
            )
            points = mpm.fill(grid, mpm.Box((1.3, 2), (6.2, 7.15)), 2, 1.0)
            points["l"] = half, half
            V = mpm.Space(grid, basis)
            law = mpm.materials.Hencky(E=100.0, nu=0.3)
            F = mpm.momentum(law, points, V.increment, V.test, fbar=True)
            problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
            problem.activate()
            (region,) = problem.here.regions
            assert all(coupling.complete for coupling in region.couplings)
            means = region.couplings[0].averages
            squares = points["V"] @ means.mean(points["x"][:, 0]) ** 2
            figures[f"{basis} {half}"] = COMM.allreduce(float(squares), op=MPI.SUM)
    return figures

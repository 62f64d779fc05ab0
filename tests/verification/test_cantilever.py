"""The study `cantilever.py` against the elastica and against conforming elements."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import numpy as np
import pytest
import ufl
from conftest import figures_of
from dolfinx import fem, geometry, mesh
from mpi4py import MPI
from scipy.sparse.linalg import spsolve

ROOT = Path(__file__).parents[2]
# PL²/EI, u/L, v/L of a thin beam
ELASTICA = np.array(
    [
        (1, 0.05643, 0.30172),
        (2, 0.16064, 0.49346),
        (4, 0.32894, 0.66996),
        (6, 0.43459, 0.74457),
        (8, 0.50483, 0.78498),
        (10, 0.55500, 0.81061),
    ]
)


@functools.cache
def demo(*options: str, ranks: int = 1) -> dict:
    """Figures of the study, run by interpreters of its own."""
    return figures_of(
        "demos/studies/cantilever.py", "--json", "-", "--no-plot", *options, ranks=ranks
    )


def hencky_energy(F, E, nu):
    """½λ (ln J)² + μ (ε₁² + ε₂²), plane strain, smooth where the two stretches are equal.

    With d = ε₁ − ε₂ the sum of squares is ½ (ln J)² + ½ d², and tr FᵀF = 2 J cosh d.
    """
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    J = ufl.det(F)
    t = ufl.inner(F, F) / (2 * J) - 1  # cosh d − 1
    small = 1e-2
    s = ufl.max_value(t, small)
    far = ufl.ln(1 + s + ufl.sqrt(s * (s + 2))) ** 2
    near = 2 * t - t**2 / 3 + 4 * t**3 / 45 - t**4 / 35 + 16 * t**5 / 1575 - 8 * t**6 / 2079
    difference = ufl.conditional(ufl.lt(t, small), near, far)
    return 0.5 * lmbda * ufl.ln(J) ** 2 + 0.5 * mu * (ufl.ln(J) ** 2 + difference)


def balance(r, K, u, free, least):
    """Newton's method for the free values of u, until forces are smaller than `least` (N)."""
    for _ in range(20):
        f = fem.assemble_vector(r).array[free]
        if np.linalg.norm(f) < least:
            return
        u.x.array[free] -= spsolve(fem.assemble_matrix(K).to_scipy().tocsc()[free][:, free], f)
    raise AssertionError("no equilibrium in 20 iterations")


@functools.cache
def conforming(cells=(40, 4), degree=2, steps=25, back=0.0):
    """Displacements (PL²/EI, u/L, v/L) of the same beam by conforming elements, total Lagrangian.

    The same law, rollers and pin; the load is spread over the middle half of the end
    face. They are those of the point on the axis that is `back` (m) from the end.
    """
    length, depth, E, nu, load = 10.0, 1.0, 12e6, 0.2, 100e3
    corners = [(0, -depth / 2), (length, depth / 2)]
    grid = mesh.create_rectangle(MPI.COMM_SELF, corners, cells, mesh.CellType.quadrilateral)
    space = fem.functionspace(grid, ("Lagrange", degree, (2,)))
    u, v, du = fem.Function(space), ufl.TestFunction(space), ufl.TrialFunction(space)

    def middle(x):
        return np.isclose(x[0], length) & (np.abs(x[1]) < depth / 4 + 1e-9)

    facets = np.sort(mesh.locate_entities_boundary(grid, 1, middle))
    tags = mesh.meshtags(grid, 1, facets, np.ones(len(facets), np.int32))
    ds = ufl.Measure("ds", domain=grid, subdomain_data=tags)
    traction = fem.Constant(grid, (0.0, 0.0))
    F = ufl.Identity(2) + ufl.grad(u)
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 2})
    energy = hencky_energy(F, E, nu) * dx - ufl.inner(traction, u) * ds(1)
    residual = ufl.derivative(energy, u, v)
    r, K = fem.form(residual), fem.form(ufl.derivative(residual, u, du))

    x = space.tabulate_dof_coordinates()
    free = np.ones((len(x), 2), bool)
    free[np.isclose(x[:, 0], 0), 0] = False
    free[np.isclose(x[:, 0], 0) & np.isclose(x[:, 1], 0), 1] = False
    free = free.ravel()
    tip = np.array([[length - back, 0.0, 0.0]])
    found = geometry.compute_collisions_points(geometry.bb_tree(grid, 2), tip)
    cell = geometry.compute_colliding_cells(grid, found, tip).links(0)[:1]
    curve = []
    for k in range(1, steps + 1):
        traction.value[1] = -load * k / steps / (depth / 2)
        balance(r, K, u, free, 1e-8 * load)
        curve.append((10 * k / steps, *(-u.eval(tip, cell) / length)))
    return np.array(curve)


def test_the_elastica_is_the_known_one():
    figures = demo()
    np.testing.assert_allclose(figures["PL2_EI"], ELASTICA[:, 0])
    np.testing.assert_allclose(figures["u_L_elastica"], ELASTICA[:, 1], atol=6e-6)
    np.testing.assert_allclose(figures["v_L_elastica"], ELASTICA[:, 2], atol=6e-6)


@pytest.mark.parametrize(
    "options",
    [
        (),
        pytest.param(("--h", "0.125"), marks=pytest.mark.long),
        pytest.param(("--basis", "linear"), marks=pytest.mark.long),
        ("--ghost", "scaled"),
        pytest.param(("--points-per-cell", "4"), marks=pytest.mark.long),
        pytest.param(("--modulus", "6e6", "--load", "50e3"), marks=pytest.mark.long),
        ("--length", "5", "--depth", "0.5", "--h", "0.125", "--load", "50e3"),
    ],
)
def test_the_tip_follows_the_elastica(options):
    figures = demo(*options)
    np.testing.assert_allclose(figures["PL2_EI"][-1], 10.0)
    assert figures["max_v_L_difference"] <= 0.02
    assert figures["max_u_L_difference"] <= 0.01
    # without stabilisation rounding decides whether a step with thousands of cuts is taken at once
    assert figures["halvings"] <= (1 if options == ("--h", "0.125") else 0)
    assert figures["newton_iterations"] <= 220
    assert figures["last_residuals"][-1] <= 1e-9


@pytest.mark.parametrize(
    ("h", "bent", "all_loads"),
    [(0.25, 0.003, 0.015), pytest.param(0.125, 0.003, 0.006, marks=pytest.mark.long)],
)
def test_the_tip_follows_conforming_elements(h, bent, all_loads):
    """Quadratic elements, at the place of the loaded points: h/12 from the end."""
    figures = demo("--h", str(h)) if h != 0.25 else demo()
    reference = conforming(back=h / 12)
    sought = reference[np.searchsorted(reference[:, 0], np.array(figures["PL2_EI"][1:]) - 1e-9)]
    np.testing.assert_allclose(figures["v_L"][-1], sought[-1, 2], rtol=bent)
    np.testing.assert_allclose(figures["u_L"][-1], sought[-1, 1], rtol=2 * bent)
    np.testing.assert_allclose(figures["v_L"][1:], sought[:, 2], rtol=all_loads)


@pytest.mark.parametrize("scaling", ["scaled", "literal"])
@pytest.mark.parametrize(
    ("h", "points", "steps"),
    [
        pytest.param(0.5, 4, 25, marks=pytest.mark.long),
        pytest.param(0.5, 4, 50, marks=pytest.mark.long),
        pytest.param(0.5, 6, 100, marks=pytest.mark.long),
        (0.25, 3, 50),
        pytest.param(0.25, 4, 25, marks=pytest.mark.long),
    ],
)
def test_with_ghost_penalty_every_step_converges_at_once(h, points, steps, scaling):
    """Scenes that break off or halve their steps without it, for want of luck with the cuts."""
    options = "--h", str(h), "--points-per-cell", str(points), "--steps", str(steps)
    figures = demo(*options, "--ghost", scaling)
    assert figures["halvings"] == 0
    assert figures["max_newton_iterations"] <= 6
    assert figures["newton_iterations"] <= 5 * steps
    reference = conforming(back=h / (2 * points))
    np.testing.assert_allclose(figures["v_L"][-1], reference[-1, 2], rtol=0.015)


@pytest.mark.long
def test_conforming_elements_have_converged():
    """Between two meshes the tip moves by less than a tenth of the tolerance above."""
    coarse, fine = conforming(), conforming(cells=(80, 8))
    np.testing.assert_allclose(coarse[-1, 1:], fine[-1, 1:], rtol=1e-3)
    assert coarse[-1, 2] == pytest.approx(0.828, abs=1e-3)
    assert coarse[-1, 1] == pytest.approx(0.555, abs=1e-3)


def test_upwards_is_the_mirror_image_of_downwards():
    down, up = demo(), demo("--load=-100e3")
    np.testing.assert_allclose(up["u_L"], down["u_L"], rtol=1e-8)
    np.testing.assert_allclose(up["v_L"], down["v_L"], rtol=1e-8)


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.long
@pytest.mark.parametrize("ranks", [2, 3])
def test_figures_do_not_depend_on_the_ranks(ranks):
    short = "--ghost", "scaled", "--steps", "25", "--points-per-cell", "4"
    one, many = demo(*short), demo(*short, ranks=ranks)
    assert many["ranks"] == ranks
    assert many["migrated"] > 0
    assert many["points"] == one["points"] == 40 * 4 * 16
    assert many["unknowns"] == one["unknowns"]
    np.testing.assert_allclose(many["u_L"], one["u_L"], rtol=1e-8)
    np.testing.assert_allclose(many["v_L"], one["v_L"], rtol=1e-8)

"""What a weak form may contain, and the named refusal of what it may not."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, FieldShapeError, FormError, ParameterError


@pytest.fixture
def scene():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.7)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    return grid, points, V


LAW = mpm.materials.Hencky(E=10.0, nu=0.3)


def refused(scene, make, match):
    _, points, V = scene
    with pytest.raises(FormError, match=match):
        mpm.QuasiStatic(make(points, V.increment, V.test), V.increment, points)


def test_point_fields_over_the_grid(scene):
    refused(
        scene,
        lambda p, u, v: mpm.momentum(LAW, p, u, v) + p.density * v[0] * ufl.dx,
        "points.density.*integrated over the grid",
    )


def test_geometry_at_points(scene):
    grid = scene[0]
    n = ufl.FacetNormal(grid)
    refused(scene, lambda p, u, v: ufl.inner(u, v) * ufl.CellVolume(grid) * p.dX, "CellVolume")
    refused(scene, lambda p, u, v: ufl.inner(n, v) * p.dX, "FacetNormal")


def test_second_gradients_at_points(scene):
    refused(
        scene,
        lambda p, u, v: ufl.inner(ufl.grad(ufl.grad(u)), ufl.grad(ufl.grad(v))) * p.dX,
        "only a first gradient",
    )


def test_an_energy_that_is_not_derived(scene):
    refused(scene, lambda p, u, v: ufl.inner(u, u) * p.dX, "ufl.derivative")


def test_a_derivative_through_means_over_cells_and_a_second_one(scene):
    def energy(p, u, fbar=False):
        return ufl.inner(mpm.stress(LAW, p, u, fbar=fbar), ufl.grad(u)) * p.dX

    refused(scene, lambda p, u, v: ufl.derivative(energy(p, u, True), u, v), "means over cells")
    refused(
        scene,
        lambda p, u, v: ufl.derivative(ufl.derivative(energy(p, u), u, u), u, v),
        "the second derivative of the law",
    )


def test_other_points_and_other_test_functions(scene):
    grid = scene[0]
    other = mpm.fill(grid, mpm.Box((0, 0), (1, 0.7)), 2, 1.0)
    refused(scene, lambda p, u, v: ufl.inner(u, v) * other.dX, "does not move")
    refused(scene, lambda p, u, v: other.density * ufl.inner(u, v) * p.dX, "other material points")
    stranger = ufl.TestFunction(fem.functionspace(grid, ("Lagrange", 2, (2,))))
    refused(scene, lambda p, u, v: ufl.inner(u, stranger) * p.dX, "Space.test")


def test_restrictions_and_unbound_constants(scene):
    grid = scene[0]
    refused(scene, lambda p, u, v: ufl.inner(u("+"), v) * p.dX, "one side of a facet")
    refused(scene, lambda p, u, v: ufl.Constant(grid) * ufl.inner(u, v) * p.dX, "has no value")


def test_gradients_of_point_fields(scene):
    refused(scene, lambda p, u, v: ufl.inner(ufl.grad(p.density), v) * p.dX, "no gradient")
    refused(scene, lambda p, u, v: ufl.inner(ufl.div(p.F), v) * p.dX, "no gradient")


def test_measures_of_points_take_no_degree(scene):
    refused(scene, lambda p, u, v: ufl.inner(u, v) * p.dX(degree=2), "no quadrature degree")


def test_terms_that_are_not_linear_in_the_test_function(scene):
    refused(scene, lambda p, u, v: ufl.inner(v, v) * p.dX, "not linear")
    refused(scene, lambda p, u, v: ufl.sin(v[0]) * p.dX, "not linear")


def test_foreign_functions_in_ordinary_terms(scene):
    grid, points, V = scene
    c = fem.Constant(grid, (1.0, 2.0))
    stranger = ufl.TestFunction(fem.functionspace(grid, ("Lagrange", 2, (2,))))
    base = mpm.momentum(LAW, points, V.increment, V.test)
    refused(scene, lambda p, u, v: base + ufl.inner(c, stranger) * ufl.dx, "Space.test")
    trial = ufl.TrialFunction(V.function_space)
    refused(scene, lambda p, u, v: base + ufl.inner(trial, v) * ufl.dx, "Space.test")
    other = fem.Function(fem.functionspace(unit_grid("quadrilateral"), ("Lagrange", 1)))
    refused(scene, lambda p, u, v: base + other * v[0] * ufl.dx(grid), "another mesh")
    refused(scene, lambda p, u, v: base + v[0] * ufl.dP, "integrated over 'vertex'")


def test_two_taggings_of_one_kind(scene):
    grid = scene[0]
    facets = np.arange(4, dtype=np.int32)
    tags = [mesh.meshtags(grid, 1, facets, np.full(4, 7, np.int32)) for _ in range(2)]
    first, second = (ufl.Measure("ds", grid, subdomain_data=t) for t in tags)
    refused(
        scene,
        lambda p, u, v: ufl.inner(u, v) * p.dX + v[0] * first(7) + v[1] * second(7),
        "other subdomain data",
    )


def test_an_increment_that_is_not_solved_for(scene):
    other, match = mpm.Space(scene[0], "gimp").increment, "does not solve for"
    refused(scene, lambda p, u, v: mpm.momentum(LAW, p, other, v), match)
    base = mpm.momentum(LAW, scene[1], scene[2].increment, scene[2].test)
    refused(scene, lambda p, u, v: base + ufl.inner(other, v) * p.dC, match)
    refused(scene, lambda p, u, v: base + ufl.inner(other("+"), v("+")) * p.dS, match)


def test_a_law_of_a_field_that_moves_no_points(scene):
    grid, points, V = scene
    Q = mpm.Space(grid, "linear", shape=())
    F = mpm.momentum(LAW, points, V.increment, V.test) + Q.increment * Q.test * points.dX
    mpm.QuasiStatic(F, [V.increment, Q.increment], points)
    with pytest.raises(FormError, match="moves no points: the first field"):
        mpm.QuasiStatic(F, [Q.increment, V.increment], points)


@pytest.mark.parametrize("kind", ["ds", "dx", "dS", "points.dC", "points.dS"])
def test_subdomains_where_nothing_is(scene, kind):
    """Such terms vanished without a message."""
    grid, points, V = scene
    base = mpm.momentum(LAW, points, V.increment, V.test)
    v = V.test[0]("+") if kind.endswith("dS") else V.test[0]
    if kind.startswith("points"):
        refused(scene, lambda p, *_: base + v * getattr(p, kind[-2:])(3), f"restricts {kind}")
        return
    dim = 2 if kind == "dx" else 1
    tags = [
        mesh.meshtags(grid, d, np.arange(4, dtype=np.int32), np.full(4, 7, np.int32))
        for d in (dim, 3 - dim)
    ]
    right, wrong = (ufl.Measure(kind, grid, subdomain_data=t) for t in tags)
    refused(scene, lambda *_: base + v * ufl.Measure(kind, grid)(7), "no subdomain data tell")
    refused(scene, lambda *_: base + v * right((7, 8)), "nothing has the tag 8")
    refused(scene, lambda *_: base + v * wrong(7), f"tags of entities of dimension {3 - dim}")
    mpm.QuasiStatic(base + v * right(7), V.increment, points)


def test_functions_without_values_at_points(scene):
    """That of a quadrature element had ended the process."""
    cell = "quadrilateral"
    mixed = basix.ufl.mixed_element([basix.ufl.element("Lagrange", cell, 1)] * 2)
    for element in (basix.ufl.quadrature_element(cell, degree=2), mixed):
        w = fem.Function(fem.functionspace(scene[0], element), name="w")
        part = w if w.ufl_shape == () else w[0]
        refused(scene, lambda p, u, v, c=part: c * v[0] * p.dX, "'w' of a mixed or quadrature")


def test_not_a_form_and_not_an_increment(scene):
    _, points, V = scene
    with pytest.raises(FormError, match="must be a UFL form"):
        mpm.QuasiStatic(3.0, V.increment, points)
    w = fem.Function(V.function_space)
    with pytest.raises(FormError, match=r"not the increment of a dolfinmpm\.Space"):
        mpm.QuasiStatic(mpm.momentum(LAW, points, w, V.test), w, points)


def test_fields_of_different_configurations(scene):
    grid, points, V = scene
    Q = mpm.Space(grid, "linear", shape=(), configuration="total")
    F = mpm.momentum(LAW, points, V.increment, V.test) + Q.increment * Q.test * points.dX
    with pytest.raises(ParameterError, match="several configurations"):
        mpm.QuasiStatic(F, [V.increment, Q.increment], points)


def test_functions_at_points_are_exact_where_they_can_be(scene):
    """Values and gradients of a quadratic function, through the projection onto a point's field."""
    grid, points, V = scene
    w = fem.Function(fem.functionspace(grid, ("Lagrange", 2)))
    w.interpolate(lambda x: x[0] ** 2 + 3 * x[0] * x[1])
    points.add_field("value")
    points.add_field("slope", (2,))
    F = mpm.momentum(LAW, points, V.increment, V.test)
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), updates={"value": w, "slope": ufl.grad(w)}
    )
    problem.step()
    x, y = points["x"].T
    np.testing.assert_allclose(points["value"], x**2 + 3 * x * y, atol=1e-12)
    np.testing.assert_allclose(
        points["slope"], np.stack([2 * x + 3 * y, 3 * x], axis=1), atol=1e-11
    )


def test_updates_accumulate_and_have_the_right_shape(scene):
    grid, points, V = scene
    work = points.add_field("work")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    g = fem.Constant(grid, (0.0, 0.0))
    F -= ufl.inner(g, V.test) * points.dX
    updates = {"work": work + ufl.inner(g, V.increment)}
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), updates=updates)
    totals = []
    for k in range(3):
        g.value[1] = -0.1 * (k + 1)
        problem.step()
        totals.append(points["work"] @ points["V0"])
    assert 0 < totals[0] < totals[1] < totals[2]
    with pytest.raises(FieldShapeError, match="'work' has shape"):
        mpm.QuasiStatic(F, V.increment, points, updates={"work": V.increment})


def test_a_form_is_compiled_once(scene, monkeypatch):
    from dolfinmpm._platform import compat as _compat

    grid, points, V = scene
    count = 0
    for name in ("jit_expression", "compile_form"):
        original = getattr(_compat, name)

        def counted(*args, original=original):
            nonlocal count
            count += 1
            return original(*args)

        for module in ("dolfinmpm.forms.pointwise", "dolfinmpm.assembly.gridassembler"):
            monkeypatch.setattr(f"{module}.{name}", counted, raising=False)
    g = fem.Constant(grid, (0.0, -0.1))
    F = mpm.momentum(LAW, points, V.increment, V.test) - ufl.inner(g, V.test) * points.dX
    F += mpm.ghost(points, V.increment, V.test, gamma=1 / 3)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    assert count > 0
    problem.step()
    compiled = count
    for _ in range(3):
        problem.step()
    assert count == compiled


@pytest.mark.parametrize("nu", [0.5, 0.6, -1.0, float("nan")])
@pytest.mark.parametrize("law", [mpm.materials.Hencky, mpm.materials.NeoHookean])
def test_impossible_poisson_ratios(law, nu):
    with pytest.raises(ParameterError, match="nu = "):
        law(E=1.0, nu=nu)


def test_impossible_ghost_penalties(scene):
    _, points, V = scene
    u, v = V.increment, V.test
    with pytest.raises(ParameterError, match="gamma = -1"):
        mpm.ghost(points, u, v, gamma=-1)
    with pytest.raises(ParameterError, match="order = 0"):
        mpm.ghost(points, u, v, gamma=1.0, order=0)
    with pytest.raises(ParameterError, match="scaling = 'other'"):
        mpm.ghost(points, u, v, gamma=1.0, scaling="other")


@pytest.mark.parametrize("measure", ["cells", "facets"])
def test_grid_terms_keep_what_is_there_without_increments(measure):
    """(u − c)·v is u·v − c·v, though all of it varies with u."""

    def moved(joint):
        grid = mesh.create_rectangle(COMM, [(0, 0), (2, 4)], (2, 4), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 3)), 2, 1.0)
        V = mpm.Space(grid, "linear")
        u, v, c = V.increment, V.test, fem.Constant(grid, (0.2, -1.0))
        where = points.dC
        if measure == "facets":
            u, v, where = u("+"), v("+"), points.dS
        both = ufl.inner(u - c, v) * where
        parts = ufl.inner(u, v) * where - ufl.inner(c, v) * where
        F = ufl.inner(ufl.grad(V.increment), ufl.grad(V.test)) * points.dx
        F += both if joint else parts
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        problem.step()
        return points["x"] - points["x0"]

    expected = moved(joint=False)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(moved(joint=True), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("basis", "order"), [("linear", 2), ("gimp", 3), ("bspline2", 3)])
def test_derivatives_above_the_degree_are_zero(scene, basis, order):
    """Their jumps had counted as those of the highest derivative that is not zero."""
    grid = scene[0]
    V = mpm.Space(grid, basis)

    def settled(factor):
        body = mpm.fill(grid, mpm.Box((0, 0), (1, 0.7)), 2, 1.0)
        u, v, n = V.increment, V.test, ufl.FacetNormal(grid)

        def normal(w):
            for _ in range(order):
                w = ufl.dot(ufl.grad(w), n)
            return w

        F = mpm.momentum(LAW, body, u, v) - ufl.inner(ufl.as_vector((0.0, -1.0)), v) * body.dX
        F += factor * ufl.inner(ufl.jump(normal(u)), ufl.jump(normal(v))) * body.dS
        mpm.QuasiStatic(F, u, body, mpm.fixed(V, "bottom")).step()
        return body["x"]

    np.testing.assert_allclose(settled(1e3), settled(0.0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("resists", [False, True])
def test_a_term_that_is_not_finite_names_its_point(scene, resists):
    """The message had named the most compressed point."""
    grid, points, V = scene
    place = points["x"][5]
    distance = ufl.SpatialCoordinate(grid) - ufl.as_vector(place)
    strength = V.increment[1] if resists else 1.0
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F += 1e-3 * strength / ufl.dot(distance, distance) * V.test[1] * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), max_halvings=0)
    with pytest.raises(ConvergenceError, match="a term of the form is not finite") as told:
        problem.step()
    assert f"point {points['id'][5]} at {place} m" in str(told.value)


@pytest.mark.parametrize("kind", ["dS", "dC"])
def test_explicit_steps_refuse_penalties_on_increments(scene, kind):
    """They had done nothing, since forces are found at increments of zero."""
    _, points, V = scene
    side = "+" if kind == "dS" else None
    u, v = (w(side) if side else w for w in (V.increment, V.test))
    F = mpm.momentum(LAW, points, V.increment, V.test)
    mpm.Explicit(F + v[0] * getattr(points, kind), V.increment, points)
    with pytest.raises(FormError, match="so that it would do nothing; take Newmark"):
        mpm.Explicit(F + ufl.inner(u, v) * getattr(points, kind), V.increment, points)


@pytest.mark.parametrize("kind", [mpm.dirichlet, mpm.signorini])
def test_conditions_with_a_factor(scene, kind):
    """Nitsche's terms had been of another size than the stresses, and the force had been halved."""
    grid, points, V = scene
    side = mpm.Boundary.from_side(points, "bottom")
    F, two = mpm.momentum(LAW, points, V.increment, V.test), fem.Constant(grid, 2.0)
    condition = kind(side, V.increment, V.test, law=LAW)
    for factor in (2.0, 0.5, two):
        refused(scene, lambda *_, a=factor: F + a * condition, "is scaled in the weak form")
    mpm.QuasiStatic(F + 1 * condition, V.increment, points)

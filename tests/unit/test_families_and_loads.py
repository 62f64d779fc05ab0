"""What acts on points, and what watches them, when they split and merge between steps."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq

import dolfinmpm as mpm
from dolfinmpm.body.childvalues import child_values, children

HENCKY = mpm.materials.Hencky(E=1e5, nu=0.2)


def lattice(n=4):
    return mpm.create_lattice(COMM, [np.linspace(0, 1, n + 1)] * 2)


def block(axisymmetric=False, height=0.75, n=4):
    return mpm.fill(lattice(n), mpm.Box((0, 0), (1, height)), 2, 1e3, axisymmetric=axisymmetric)


def both(build, steps=5, every=None):
    """Figures of two runs, the second of which splits and merges its points.

    Args:
        build: Function that returns points, a function of a step's number, and one of figures.
        steps: Number of steps.
        every: Tolerance of the merge before the last step.
    """
    found = []
    for splits in (False, True):
        points, step, figures = build()
        for k in range(steps):
            if splits and k == 2:
                assert mpm.split(points, lambda x: x[0] + x[1] < 1.0).count
            if splits and k == 3:
                assert mpm.split(points, lambda x: x[1] > 0.5).count
            if splits and k == steps - 1:
                assert mpm.merge(points, every or 1e-2).count
            step(k)
        assert points.error_in_fields() is None
        found.append(np.ravel(figures()))
    return found


@pytest.mark.parametrize("axisymmetric", [False, True])
def test_pressure_and_faces_of_an_axisymmetric_body(axisymmetric):
    def build():
        points = block(axisymmetric)
        V = mpm.Space(points.grid, "gimp")
        top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.75), normal=(0, 1))
        p = fem.Constant(points.grid, 0.0)
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F += top.pressure(p, V.increment, V.test)
        problem = mpm.QuasiStatic(
            F, V.increment, points, mpm.rollers(V, "left", "right", "bottom")
        )  # fmt: skip

        def step(k):
            p.value = 2e3 * (k + 1)
            problem.step()

        def figures():
            size = np.linalg.norm(points[top.area.name], axis=1)
            # a half after the first split, a quarter after the second
            assert size.sum() == pytest.approx(top.total_area, rel=1e-13)
            return [top.mean_displacement()[1], points["V"].sum()]

        return points, step, figures

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=2e-3 if axisymmetric else 1e-9)


@pytest.mark.parametrize("rough", [False, True])
def test_a_footing_holds_on_to_the_faces_of_children(rough):
    def build():
        points = block()
        V = mpm.Space(points.grid, "gimp")
        top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.75) & (x[0] < 0.5), normal=(0, 1))
        s = fem.Constant(points.grid, 0.0)
        footing = mpm.RigidFooting(top, s, E=1e5, rough=rough)
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F += footing.contact(V.increment, V.test)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)

        def step(k):
            s.value = 0.002 * (k + 1)
            problem.step()

        return points, step, lambda: [footing.load(), np.abs(footing.gaps()).max() < 1e-3]

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=0.03)


def test_a_split_keeps_the_places_of_a_footing_s_faces():
    points = block()
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.75), normal=(0, 1))
    footing = mpm.RigidFooting(top, fem.Constant(points.grid, 0.0), E=1e5, rough=True)
    points["x"] += 0.01
    points.locate()
    load, gap = footing.reaction(), footing.gaps().max(axis=0)
    mpm.split(points, lambda x: x[0] < 0.6)
    np.testing.assert_allclose(footing.reaction(), load, rtol=1e-13)
    np.testing.assert_allclose(footing.gaps().max(axis=0), gap, rtol=1e-12)
    mpm.merge(points, 1e-3)
    np.testing.assert_allclose(footing.reaction(), load, rtol=1e-13)


def test_a_rigid_plate_goes_on_pressing_and_rubbing():
    def build():
        points = block()
        V = mpm.Space(points.grid, "gimp")
        plate = mpm.RigidBody(
            mpm.Plane((0, 0.75), (0, -1)), increment=(0.002, -0.004), name="plate"
        )
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F += mpm.contact(plate, points, V.increment, V.test, penalty=100.0, friction=0.3)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)
        return points, lambda k: problem.step(), lambda: plate.force

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=0.05)


@pytest.mark.parametrize("touching", [[0], [0, 1], [1, 3], [0, 3], [0, 1, 2, 3]])
def test_forces_of_contact_are_shared_along_a_face(touching):
    """A face between two touching corners is shared by the children along it."""
    points = block()
    rng = np.random.default_rng(0)
    points.add_field("plate_tangential_force", (4, 2), "N")
    points.add_field("weight", (2,), "N")
    points["plate_tangential_force"][:, touching] = rng.normal(size=(len(points), len(touching), 2))
    points["weight"] = rng.normal(size=points["weight"].shape)
    order = np.argsort(points["id"])
    force, weight = points["plate_tangential_force"][order], points["weight"][order]
    mpm.split(points, np.ones(len(points), bool))
    place = mpm.families(points).place
    for corner in range(4):
        at = points["plate_tangential_force"][:, corner]
        # children on the same side, or beside it along a face that touches
        beside = {corner} | {corner ^ bit for bit in (1, 2) if corner ^ bit in touching}
        beside |= set(range(4)) if len(touching) == 4 else set()
        there = np.isin(place, list(beside) if corner in touching else [])
        np.testing.assert_array_equal(at[~there], 0.0)
        if corner in touching:
            parts = np.abs(at[there]).reshape(len(force), -1, 2)
            np.testing.assert_allclose(parts.max(axis=1), parts.min(axis=1))
    np.testing.assert_allclose(points["weight"].sum(axis=0), weight.sum(axis=0), rtol=1e-13)
    mpm.merge(points, 1e-6)
    order = np.argsort(points["id"])
    np.testing.assert_allclose(points["plate_tangential_force"][order], force)
    np.testing.assert_allclose(points["weight"][order], weight)


def test_a_rank_without_points_that_split():
    points = block()
    points.add_field("plate_tangential_force", (4, 2), "N")
    points.add_field("plate_normal_force", (4,), "N")
    none = child_values(points, children(points, np.zeros(0, np.intp)))
    assert none["plate_tangential_force"].shape == (0, 4, 2)
    assert none["plate_normal_force"].shape == (0, 4)


def test_a_sliding_body_keeps_its_friction_where_points_split():
    """The friction of a plate that slides is μ times its pressure in the step after a split."""
    points = block()
    V = mpm.Space(points.grid, "gimp")
    plate = mpm.RigidBody(mpm.Plane((0, 0.75), (0, -1)), velocity=(2.0, -2.0), name="plate")
    F = mpm.momentum(HENCKY, points, V.increment, V.test)
    F += mpm.contact(plate, points, V.increment, V.test, friction=0.3)
    problem = mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation="ghost")
    for t in (0.002, 0.004, 0.006):
        problem.step(t)
    mpm.split(points, np.ones(len(points), bool))
    problem.step(0.008)
    assert abs(plate.force[0]) == pytest.approx(0.3 * abs(plate.force[1]), rel=1e-3)


def test_an_unfitted_boundary_goes_on():
    def build():
        corners = [(0.1, 0.1), (0.9, 0.1), (0.9, 0.7), (0.1, 0.7)]
        points = mpm.fill(lattice(8), mpm.Polygon(corners), 2, 1e3, exact=True)
        V = mpm.Space(points.grid, "gimp")
        edge = mpm.Boundary.from_polygon(points, corners)
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F += mpm.dirichlet(edge, V.increment, V.test, (0.0, 0.0), law=HENCKY)
        g = fem.Constant(points.grid, (0.0, 0.0))
        F -= ufl.inner(points.density * g, V.test) * points.dX
        problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")

        def step(k):
            g.value[1] = -2.0 * (k + 1)
            problem.step()

        return points, step, lambda: [points["stress"][:, 1, 1].min()]

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=0.05)


VON_MISES = mpm.materials.VonMises(E=1e5, nu=0.3, radius=lambda x: 600.0 + 100 * x[1])
MOHR_COULOMB = mpm.materials.MohrCoulomb(
    1e5, 0.3, cohesion=1e3, friction_angle=20.0, dilation_angle=0.0
)  # fmt: skip
NEO_HOOKEAN = mpm.materials.NeoHookean(E=1e5, nu=0.3)


@pytest.mark.parametrize(
    ("law", "fbar"),
    [
        (VON_MISES, False),
        (VON_MISES, True),
        (MOHR_COULOMB, False),
        (MOHR_COULOMB, True),
        (NEO_HOOKEAN, False),
    ],
    ids=lambda given: type(given).__name__ if not isinstance(given, bool) else f"fbar={given}",
)
def test_laws_go_on_with_their_state(law, fbar):
    def build():
        points = block()
        V = mpm.Space(points.grid, "gimp")
        g = fem.Constant(points.grid, (0.0, 0.0))
        F = mpm.momentum(law, points, V.increment, V.test, fbar=fbar)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")

        def step(k):
            g.value[:] = 0.2 * (k + 1), -1.0 * (k + 1)
            problem.step()

        return points, step, lambda: points["V0"] @ (points["x"] - points["x0"])[:, 1]

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=0.05)


def test_soil_with_water_goes_on():
    def build():
        points = block()
        V, Q = mpm.Space(points.grid, "gimp"), mpm.Space(points.grid, "linear", shape=())
        top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.75), (0, 1))
        F = mpm.poromechanics(
            HENCKY, points, (V.increment, Q.increment), (V.test, Q.test), permeability=1e-3,
            porosity=0.4, fluid=mpm.Fluid(gravity=10.0), drained=top,
        )  # fmt: skip
        F += top.traction((0.0, -2e3), V.test)
        bcs = mpm.rollers(V, "left", "right", "bottom")
        problem = mpm.Transient(
            F, [V.increment, Q.increment], points, bcs, stabilisation=["none", "none"]
        )
        return points, lambda k: problem.step(0.5 * (k + 1)), lambda: [
            top.mean_displacement()[1], points["V0"] @ points["pressure"],
        ]  # fmt: skip

    whole, split = both(build)
    np.testing.assert_allclose(split, whole, rtol=0.02)


# -- what watches the points --------------------------------------------------


def test_a_run_with_files_and_histories_goes_on_from_a_checkpoint(tmp_path):
    def made():
        points = block()
        V = mpm.Space(points.grid, "gimp")
        g = fem.Constant(points.grid, (0.0, 0.0))
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
        return points, g, mpm.QuasiStatic(F, V.increment, points, bcs)

    points, g, problem = made()
    curve = mpm.History()
    with mpm.ParaView(tmp_path / "block.pvd", points) as output:
        for k in range(4):
            g.value[1] = -1.0 * (k + 1)
            if k in (1, 2):
                mpm.split(points, lambda x: x[0] + x[1] < 0.9)
            problem.step()
            output.write(float(k))
            curve.record(points=points.total)
            if k == 2:
                problem.save(tmp_path / "block.npz")
                mpm.merge(points, 1e-2)
    counts = curve["points"]
    assert counts[0] < counts[1] < counts[2] > counts[3] == points.total
    again, g, other = made()
    other.load(tmp_path / "block.npz")
    assert mpm.families(again).level.max() == 2
    mpm.merge(again, 1e-2)
    g.value[1] = -4.0
    other.step()
    for name, values in points.fields.items():
        np.testing.assert_array_equal(again[name], values)


def column(n, way, steps=8):
    """Errors of displacement and stress of a column under its weight, which halves its height."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1 / n, 2), np.linspace(0, 1, n + 1)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1 / n, 1)), 4 if way == "fine" else 2, 1e3)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    for k in range(steps):
        if way == "split" and k == steps // 2:
            mpm.split(points, np.ones(len(points), bool))
        g.value[1] = -10.0 * (k + 1) / steps
        problem.step()
    # exactly: σ = −ρ0 g (1 − Y), and E ln λ = λ σ
    Y = np.linspace(0, 1, 401)
    stretch = [brentq(lambda s, y=y: 1e5 * np.log(s) / s + 1e4 * (1 - y), 0.3, 1.5) for y in Y]
    y, V0 = points["x0"][:, 1], points["V0"]
    u = np.interp(y, Y, cumulative_trapezoid(np.array(stretch) - 1, Y, initial=0))
    sigma = -1e4 * (1 - y)
    errors = points["x"][:, 1] - y - u, points["stress"][:, 1, 1] - sigma
    return [np.sqrt(V0 @ e**2 / (V0 @ s**2)) for e, s in zip(errors, (u, sigma))]


def test_a_column_split_halfway_converges_as_one_of_small_points():
    cells = (8, 16, 32)
    split, fine = (np.array([column(n, way) for n in cells]) for way in ("split", "fine"))
    orders = np.log2(split[:-1] / split[1:])
    assert (orders[:, 0] > 1.9).all(), orders
    assert (orders[:, 1] > 1.2).all(), orders
    np.testing.assert_allclose(split, fine, rtol=0.15)

"""The arc-length solver: a shallow arch that snaps through, limit loads, failures, errors."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import scenes
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.interpolate import CubicSpline

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, FormError, ParameterError
from dolfinmpm.materials.base import lame
from dolfinmpm.solve.arclength import Pace

COMM = MPI.COMM_WORLD
LOAD = 1e3


class Arch:
    """Half of a shallow arch, clamped, with a force at its crown; it snaps through."""

    def __init__(self, basis="gimp", law=None):
        rise, half, thick = 1.0, 10.0, 0.5
        kind = mesh.CellType.quadrilateral
        self.grid = mesh.create_rectangle(COMM, [(0, -3), (half, 2)], (40, 20), kind)

        def inside(x):
            return np.abs(x[1] - rise * np.sin(0.5 * np.pi * x[0] / half) ** 2) < 0.5 * thick

        self.points = points = mpm.fill(self.grid, mpm.Where(inside), 3, 1.0)
        self.V = mpm.Space(self.grid, basis)
        # the point nearest to the crown carries the load: its share of the body is one
        far = np.hypot(*(points["x0"] - (half, rise)).T)
        points.add_field("crown")
        points["crown"] = (far == far.min()) / points["V0"]
        law = law or mpm.materials.Hencky(E=1e6, nu=0.2)
        self.F = mpm.momentum(law, points, self.V.increment, self.V.test)
        self.bcs = mpm.fixed(self.V, "left") + mpm.rollers(self.V, "right")

    @property
    def deflection(self):
        """Of the crown, downwards (m)."""
        points = self.points
        return -float((points["crown"] * points["V0"]) @ (points["x"] - points["x0"])[:, 1])

    def down(self, w):
        """Of the crown, in UFL."""
        return -self.points.crown * w[1] * self.points.dX

    def path(self, control, until=2.4, **options):
        """Load factors and deflections from an arc-length solver."""
        P = fem.Constant(self.grid, LOAD)
        if control == "displacement":
            control, options = self.down(self.V.test), {"length": 0.1, "max_length": 0.1, **options}
        else:
            options = {"first": 0.03, "max_length": 0.07, **options}
        problem = mpm.ArcLength(
            self.F - P * self.down(self.V.test), self.V.increment, self.points, self.bcs, load=P,
            control=control, stabilisation="ghost", **options,
        )  # fmt: skip
        rows = [(0.0, 0.0)]
        while rows[-1][1] < until:
            record = problem.step()
            assert P.value == pytest.approx(LOAD * record.factor)
            rows.append((record.factor, self.deflection))
        return np.array(rows), problem


@functools.cache
def pushed(basis="gimp", steps=25):
    """The same path from a stiff spring that pushes the crown down by prescribed amounts."""
    arch = Arch(basis)
    points, stiffness = arch.points, 1e8
    s = fem.Constant(arch.grid, 0.0)
    gap = (points.x - points.x0 + arch.V.increment)[1] + s
    spring = points.crown * stiffness * gap * arch.V.test[1] * points.dX
    problem = mpm.QuasiStatic(
        arch.F + spring, arch.V.increment, points, arch.bcs, stabilisation="ghost"
    )
    rows = [(0.0, 0.0)]
    for k in range(1, steps + 1):
        s.value = 2.5 * k / steps
        problem.step()
        rows.append(((float(s.value) - arch.deflection) * stiffness / LOAD, arch.deflection))
    return np.array(rows)


@pytest.mark.parametrize("control", ["displacement", "spherical", "cylindrical"])
def test_snap_through_follows_displacement_control(control):
    reference = pushed()
    factor = CubicSpline(reference[:, 1], reference[:, 0])
    rows, problem = Arch().path(control)
    # up, down past the limit point, and up again
    turns = np.flatnonzero(np.diff(np.sign(np.diff(rows[:, 0]))))
    assert len(turns) == 2
    top, bottom = rows[turns + 1]
    assert top[0] > 3 * bottom[0] > 0
    assert rows[-1, 0] > 2 * top[0]
    tolerance = 1e-3 if control == "displacement" else 0.02
    assert np.abs(rows[:, 0] - factor(rows[:, 1])).max() < tolerance * top[0] + 0.01 * 0.07
    assert all(record.halvings == 0 for record in problem.history)
    assert max(record.iterations for record in problem.history) <= 5
    # of second order, the equation of the length included
    last = [record.residuals[-2:] for record in problem.history]
    assert all(b < 1e-9 for _, b in last)
    if control == "displacement":
        travelled = [record.displacement for record in problem.history]
        np.testing.assert_allclose(travelled, rows[1:, 1], rtol=1e-9)


@pytest.mark.parametrize("basis", ["linear", "bspline2"])
def test_snap_through_in_other_bases(basis):
    reference = pushed(basis)
    rows, _ = Arch(basis).path("displacement")
    factor = CubicSpline(reference[:, 1], reference[:, 0])
    assert np.abs(rows[:, 0] - factor(rows[:, 1])).max() < 2e-3 * 0.22


def test_unloading_along_the_same_path():
    _, problem = Arch().path("displacement", until=0.85)
    up = problem.factor
    problem.path.length *= -1
    for _ in range(9):
        problem.step()
    assert up > 0.1
    assert abs(problem.factor) < 0.01
    assert problem.history[-1].displacement == pytest.approx(0.0, abs=1e-12)


def test_neo_hookean_and_lengths_from_iterations():
    arch = Arch(law=mpm.materials.NeoHookean(E=1e6, nu=0.2))
    P = fem.Constant(arch.grid, LOAD)
    problem = mpm.ArcLength(
        arch.F - P * arch.down(arch.V.test), arch.V.increment, arch.points, arch.bcs,
        load=P, first=0.02, target_iterations=4, max_length=0.2,
        stabilisation=mpm.Stabilisation("ghost", E=1e6),
    )  # fmt: skip
    factors = [problem.step().factor for _ in range(25)]
    lengths = [record.length for record in problem.history]
    pace = Pace(4, 0.2)
    for a, b, record in zip(lengths[:-1], lengths[1:], problem.history):
        # of the attempt that succeeded
        expected = pace.next(a, len(record.residuals))
        assert b == pytest.approx(expected * 0.5 ** problem.history[lengths.index(b)].halvings)
    assert max(factors[:-1]) > 0.2
    assert min(np.diff(factors)) < 0


def test_two_loads_of_which_one_follows_the_face():
    """All around the block the follower pressure, and half of it again as dead traction."""
    kind = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 4)], (6, 4), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (6, 2.6)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2.6), (0, 1))
    p, t = fem.Constant(grid, 200.0), fem.Constant(grid, (0.0, -100.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, u, v)
    F += top.pressure(p, u, v) + top.traction(t, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.ArcLength(
        F, u, points, bcs, load=[p, t], control=top.mean((0, -1), v), length=0.1, max_length=0.1
    )
    assert (p.value, t.value[1]) == (0, 0)
    lmbda, mu = lame(1e3, 0.3)
    for k in range(1, 6):
        record = problem.step()
        stretch = 1 - 0.1 * k / 2.6
        nominal = -(lmbda + 2 * mu) * np.log(stretch) / stretch
        assert record.factor == pytest.approx(nominal / 300, rel=2e-3 if k > 1 else 1e-7)
    assert p.value == pytest.approx(200 * record.factor)
    assert t.value[1] == pytest.approx(-100 * record.factor)


def test_a_load_that_the_factor_enters_with_its_square():
    kind = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 4)], (4, 4), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2.6)), 2, 1.0)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2.6), (0, 1))
    p = fem.Constant(grid, 20.0)
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.0), points, u, v) + top.pressure(p**2, u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    # at a factor of 0 the load does not grow with it
    problem = mpm.ArcLength(F, u, points, bcs, load=p, first=0.2, factor=0.01)
    record = problem.step()
    stretch = points["F"][0, 1, 1]
    exact = -1e3 * np.log(stretch) / stretch
    assert (20 * record.factor) ** 2 == pytest.approx(exact, rel=1e-8)
    ahead, last = record.residuals[-2:]
    assert last < ahead**1.7


def test_load_on_the_boundary_of_the_grid():
    kind = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 4)], (4, 4), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), 2, 1.0)
    V = mpm.Space(grid)
    t = fem.Constant(grid, (0.0, -100.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.0), points, V.increment, V.test)
    top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(grid)[1], 3.9), 1.0, 0.0)
    F -= top * ufl.inner(t, V.test) * ufl.ds
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.ArcLength(F, V.increment, points, bcs, load=t, first=1.0, control="cylindrical")
    record = problem.step()
    stretch = points["F"][0, 1, 1]
    assert -1e3 * np.log(stretch) / stretch == pytest.approx(100 * record.factor, rel=1e-8)


def test_a_path_starts_where_another_solver_ended():
    arch = Arch()
    P = fem.Constant(arch.grid, 0.1 * LOAD)
    F = arch.F - P * arch.down(arch.V.test)
    u = arch.V.increment
    mpm.QuasiStatic(F, u, arch.points, arch.bcs, stabilisation="ghost").step()
    before = arch.deflection
    P.value = LOAD
    problem = mpm.ArcLength(
        F, u, arch.points, arch.bcs, load=P, factor=0.1, first=-0.02, stabilisation="ghost"
    )
    assert P.value == pytest.approx(0.1 * LOAD)
    assert problem.step().factor < 0.1
    assert arch.deflection < before


@pytest.mark.parametrize("share", [0.9, 0.99, 0.999])
@pytest.mark.parametrize("control", ["spherical", "cylindrical"])
def test_a_path_may_start_near_its_limit_point(share, control):
    """Loaded almost to the limit, from where the tangent's speed is no measure of a step."""
    reference = pushed()
    factor = CubicSpline(reference[:, 1], reference[:, 0])
    top = reference[: len(reference) // 2, 0].max()
    arch = Arch()
    P = fem.Constant(arch.grid, 0.0)
    F = arch.F - P * arch.down(arch.V.test)
    loaded = mpm.QuasiStatic(F, arch.V.increment, arch.points, arch.bcs, stabilisation="ghost")
    for k in range(1, 11):
        P.value = LOAD * top * share * k / 10
        loaded.step()
    P.value = LOAD
    problem = mpm.ArcLength(
        F, arch.V.increment, arch.points, arch.bcs, load=P, control=control, factor=top * share,
        first=0.03, stabilisation="ghost",
    )  # fmt: skip
    rows = []
    for _ in range(5):
        record = problem.step()
        assert record.halvings == 0
        assert record.iterations <= 5
        rows.append((record.factor, arch.deflection))
    rows = np.array(rows)
    assert rows[-1, 0] < 0.9 * top
    assert np.abs(rows[:, 0] - factor(rows[:, 1])).max() < 0.03 * top


def test_the_pace_does_not_crawl():
    """Where seven iterations are the least, lengths grow until it takes more, and stay there."""
    pace, length = Pace(5, 10.0), 1.0
    for _ in range(60):
        length = pace.next(length, 7 if length < 3.0 else 9)
    assert 2.0 < length < 5.0
    # after a failure, too
    length /= 64
    for _ in range(40):
        length = pace.next(length, 7 if length < 3.0 else 9)
    assert 2.0 < length < 5.0
    # and not beyond what is allowed, in either direction
    assert Pace(5, 10.0).next(-9.0, 2) == -10.0
    assert Pace(5, 10.0).next(1.0, 500) == pytest.approx(1.25)


# -- failures -----------------------------------------------------------------


def test_a_load_that_is_set_by_hand_is_told():
    arch = Arch()
    P = fem.Constant(arch.grid, LOAD)
    form, u = arch.F - P * arch.down(arch.V.test), arch.V.increment
    problem = mpm.ArcLength(form, u, arch.points, arch.bcs, load=P, stabilisation="ghost")
    problem.step()
    found = float(P.value)
    P.value = 0.5 * LOAD
    with pytest.raises(ParameterError, match=r"constant 0 of the load = .* was set by hand"):
        problem.step()
    P.value = found
    problem.step()


def test_a_failed_step_leaves_state_and_load():
    rows, problem = Arch().path("spherical", until=0.2)
    points, constant = problem.points, problem.path.load.constants[0]
    before = {name: values.copy() for name, values in points.fields.items()}
    factor, load, length = problem.factor, float(constant.value), problem.path.length
    problem.newton.max_iterations = 1
    problem.max_halvings = 2
    with pytest.raises(ConvergenceError, match=r"load factor 0\.\d+ with a length of") as caught:
        problem.step()
    assert "DIVERGED_MAX_IT" in str(caught.value)
    for name, values in points.fields.items():
        assert np.array_equal(values, before[name]), name
    assert (problem.factor, float(constant.value)) == (factor, pytest.approx(load))
    assert problem.path.length == length
    assert len(problem.history) == len(rows) - 1
    # one that fails once goes on with half the length
    problem.newton.max_iterations = 20
    problem.path.length = 40.0
    problem.max_halvings = 12
    record = problem.step()
    assert record.halvings > 0
    assert record.length == pytest.approx(40.0 * 0.5**record.halvings)


def test_errors():
    arch = Arch()
    u, v, points = arch.V.increment, arch.V.test, arch.points
    P, other = fem.Constant(arch.grid, LOAD), fem.Constant(arch.grid, 1.0)
    F = arch.F - P * arch.down(v)

    def make(form=F, bcs=(), **options):
        return mpm.ArcLength(form, u, points, bcs, **{"load": P, **options})

    with pytest.raises(FormError, match="constant 1 of the load is in no term"):
        make(load=[P, other])
    with pytest.raises(ParameterError, match="must be one or several"):
        make(load=3.0)
    with pytest.raises(ParameterError, match="control = 'arc' must be"):
        make(control="arc")
    with pytest.raises(ParameterError, match="length of its first step"):
        make(control=arch.down(v))
    with pytest.raises(FormError, match="a control must be a form over the points"):
        make(control=arch.down(v) + ufl.inner(u, v) * points.dX, length=1.0)
    with pytest.raises(ParameterError, match="prescribes an increment"):
        make(bcs=mpm.prescribed(arch.V, "left", 0, increment=0.1))
    with pytest.raises(ParameterError, match="must be positive; see `first`"):
        make(length=-1.0)
    with pytest.raises(ParameterError, match="length = 0"):
        make(length=0.0)
    with pytest.raises(ParameterError, match="first = 0"):
        make(first=0.0)
    with pytest.raises(ParameterError, match="factor = nan"):
        make(factor=np.nan)
    with pytest.raises(FormError, match="over cells or facets"):
        make(form=F + P * ufl.inner(u, v) * ufl.dx)
    P.value = 0.0
    with pytest.raises(ParameterError, match="all zero"):
        make()


@pytest.mark.parametrize("control", ["spherical", "displacement"])
@pytest.mark.parametrize("fails", [2, 4])
def test_a_step_whose_tangent_is_not_definite_begins_again_where_it_began(
    monkeypatch, control, fails
):
    """Factors that fail after the load has moved leave no trace in the path."""

    def path(failing):
        problem, step = scenes.arch(control)
        linear, calls = problem.newton.linear, 0
        solve, first = linear.solve, linear.choice.doubt.next

        def once(right):
            nonlocal calls
            calls += 1
            y = solve(right)
            # until the tangent is not taken for definite any more
            if 0 < failing <= calls and linear.choice.doubt.next == first:
                y, linear.stuck = np.full_like(y, np.inf), True
            return y

        monkeypatch.setattr(linear, "solve", once)
        return [step().factor for _ in range(3)], linear.choice.doubt.next > first

    (undisturbed, trust), (again, doubt) = path(0), path(fails)
    assert doubt
    assert not trust
    np.testing.assert_allclose(again, undisturbed, rtol=1e-9)

"""Arguments of the kinds that new users give: named errors, warnings, and one rule for all."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from badinputs import BAD, scene
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm._platform.argumentchecks import choice, number, shown, whole
from dolfinmpm._platform.errors import (
    ConvergenceError,
    DegreesWarning,
    DolfinMPMError,
    FormError,
    IdleConditionWarning,
    ParameterError,
)
from dolfinmpm.basis.conditionchecks import free_motions, idle
from dolfinmpm.forms.formchecks import check_signs

COMM = MPI.COMM_WORLD


@pytest.mark.parametrize("name", BAD)
def test_bad_inputs_end_in_errors_that_say_what_to_do(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, message = BAD[name]
    with pytest.raises(DolfinMPMError, match=message) as caught:
        call(scene())
    text = str(caught.value)
    assert 20 < len(text) < 700
    # no address, no inside of an object
    assert " object at 0x" not in text
    assert not any(tmp_path.iterdir()), "something was written all the same"


def test_options_that_are_refused_leave_nothing_behind():
    before = PETSc.Options().getAll()
    with pytest.raises(ParameterError, match="ksp_type = 'foo'"):
        scene().solver(petsc_options={"pc_type": "jacobi", "ksp_type": "foo"})
    assert PETSc.Options().getAll() == before
    scene().solver()


# -- words ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("weak-aggregation", "weak-aggregation"),
        ("weak_aggregation", "weak-aggregation"),
        ("Weak Aggregation", "weak-aggregation"),
        ("centre", "centre"),
        ("center", "centre"),
        ("stabilization", "stabilisation"),
        ("stabilized", "stabilised"),
        ("color", "colour"),
    ],
)
def test_spellings(given, meant):
    assert choice("word", given, ("weak-aggregation", "centre", "stabilisation", "stabilised",
                                  "colour")) == meant  # fmt: skip


def test_words_are_taken_in_other_spellings():
    s = scene()
    assert mpm.Space(s.grid, "BSpline2").basis is mpm.Space(s.grid, "bspline2").basis
    assert mpm.rollers(s.V, *[]) == mpm.fixed(s.V) == []
    assert mpm.rollers(s.V, "Left")[0].where == "left"
    law = mpm.materials.DruckerPrager(1e4, 0.3, 1.0, 20.0, dilation_angle=0.0, fit="plane-strain")
    assert law.fit == "plane strain"
    assert s.solver(stabilisation="weak_aggregation").stabilisation.kind == "weak-aggregation"


def test_numbers():
    assert number("a", np.float32(0.5), 0.0, 1.0) == 0.5
    assert number("a", np.array(2)) == 2.0
    assert number("a", np.inf, 0.0, np.inf, closed=True) == np.inf
    assert whole("n", np.int64(3), 1) == 3
    with pytest.raises(ParameterError, match=r"^a = 1 Pa must be above 0 and below 1$"):
        number("a", 1, 0.0, 1.0, "Pa")
    with pytest.raises(ParameterError, match=r"^a = inf must be finite$"):
        number("a", np.inf)
    with pytest.raises(ParameterError, match=r"^a = inf must be at least 0$"):
        number("a", np.inf, 0.0, closed=True)
    assert len(shown("x" * 500)) == 80


# -- signs of loads ------------------------------------------------------------


def test_what_acts_is_added_however_it_is_written():
    s = scene()
    load = s.top.traction((0.0, -1.0), s.v)
    footing = mpm.RigidFooting(s.top, s.c, E=1.0).contact(s.u, s.v)
    half = fem.Constant(s.grid, -0.5)
    for form in (
        s.F + load + footing,
        s.F - -load,
        s.F - (-1.0) * (load + footing),
        s.F + 0.5 * footing,
        # a constant is the user's, with a sign of its own
        s.F + half * load,
        -(-footing - s.F),
    ):
        check_signs(form)
    for form, name in (
        (s.F - load, "traction on 'top'"),
        (s.F + load - footing, "contact of a footing on 'top'"),
        (s.F + (load - footing), "contact"),
        (s.F - 0.5 * footing, "contact"),
        (s.F + (-1) * load, "traction"),
        (-1 * footing + s.F, "contact"),
    ):
        with pytest.raises(FormError, match=name):
            check_signs(form)
    side, wall = s.side, s.wall
    for load, name in (
        (side.traction((0.0, 1.0), s.v), "traction on 'side'"),
        (side.pressure(fem.Constant(s.grid, 1.0), s.u, s.v), "pressure on 'side'"),
    ):
        check_signs(s.F + load)
        with pytest.raises(FormError, match=f"{name} is subtracted"):
            check_signs(s.F + -load)
    for resistance, name in (
        (s.ghost(), r"mpm\.ghost"),
        (s.ghost(gamma=s.c, order=1, scaling="literal"), r"mpm\.ghost"),
        (mpm.dirichlet(side, s.u, s.v, law=s.law), r"mpm\.dirichlet\) at 'side'"),
        (mpm.dirichlet(side, s.u, s.v, method="penalty", stiffness_per_area=1.0), "at 'side'"),
        (mpm.signorini(wall, s.u, s.v, law=s.law, friction=0.3), r"mpm\.signorini\) at 'right'"),
    ):
        if "ghost" in name:
            check_signs(s.F + 0.5 * resistance)
        else:  # a condition is in balance with the stresses of the body
            for factor in (0.5, half):
                with pytest.raises(FormError, match=f"{name}.* is scaled"):
                    check_signs(s.F + factor * resistance)
        check_signs(s.F - -resistance)
        for wrong in (s.F - resistance, -0.5 * resistance + s.F, s.F + (load - 2 * resistance)):
            with pytest.raises(FormError, match=f"{name}.* is subtracted"):
                check_signs(wrong)
    # the sign of a scalar's equation is the user's, as with −q div u in it
    check_signs(s.F - mpm.ghost(s.points, s.S.increment, s.S.test, 1.0))
    # a mean is no load: it has no sign to mistake
    check_signs(s.top.mean((0, -1), s.v) + s.top.mean_normal(s.v))


def test_new_numbers_of_loads_compile_nothing(monkeypatch):
    """Areas, tractions and settlements are constants of the forms, not part of their code."""
    s = scene()

    def signature(force, settlement):
        c = fem.Constant(s.grid, settlement)
        foot = mpm.RigidFooting(s.top, c, E=1.0 + force)
        form = s.top.force((0.0, force), s.v) + foot.contact(s.u, s.v)
        literals = []
        for integral in form.integrals():
            for node in ufl.corealg.traversal.unique_pre_traversal(integral.integrand()):
                if isinstance(node, ufl.classes.FloatValue):
                    literals.append(float(node))
        return sorted(literals)

    assert signature(1.25, 0.0) == signature(7.5, 0.375)


# -- conditions ----------------------------------------------------------------


def block(high=(2.0, 1.0), basis="linear"):
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 2)], (8, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), high), 2, 1000.0)
    V = mpm.Space(grid, basis)
    g = fem.Constant(grid, (0.0, -0.1))
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    return points, V, F, g


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_conditions_that_hold_nothing_are_told(basis):
    points, V, F, _ = block(basis=basis)
    far = mpm.prescribed(V, lambda x: (x[0] > 3) & (x[1] > 1.5), 0)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom", "top") + far
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    match = r"conditions at 'right', 'top', 'nodes from \[3\.\d* .*\] to \[4\. 2\.\] m' hold no"
    with pytest.warns(IdleConditionWarning, match=match) as caught:
        problem.step()
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.step()  # once a problem


def test_idle_names_places_of_every_field():
    s = scene()
    everywhere = np.arange(s.V.basis.nodes.size, dtype=np.int32)
    none = everywhere[:0]
    bcs = [*s.bcs, *mpm.prescribed(s.S, "top", 0)]
    assert idle(bcs, [s.V, s.S], [everywhere, everywhere]) == []
    assert idle(bcs, [s.V, s.S], [none, everywhere]) == ["left", "bottom"]
    assert idle(bcs, [s.V, s.S], [everywhere, none]) == ["top"]
    assert idle([], [s.V], [none]) == []


def test_rigid_motions_that_are_free():
    s = scene()
    active = np.arange(s.V.basis.nodes.size, dtype=np.int32)

    def free(bcs):
        return free_motions(bcs, s.V, active)

    assert free([]) == ["along x", "along y", "1 with a turn"]
    assert free(mpm.rollers(s.V, "left")) == ["along y"]
    assert free(mpm.rollers(s.V, "bottom")) == ["along x"]
    assert free(mpm.rollers(s.V, "left", "bottom")) == []
    corner = mpm.fixed(s.V, lambda x: np.isclose(x[0] + x[1], 0))
    assert free(corner) == ["1 with a turn"]
    # held where the body is not
    assert free_motions(mpm.fixed(s.V, "right"), s.V, active[:1]) == [
        "along x", "along y", "1 with a turn",
    ]  # fmt: skip
    grid = mesh.create_unit_cube(COMM, 2, 2, 2, mesh.CellType.hexahedron)
    W = mpm.Space(grid)
    active = np.arange(W.basis.nodes.size, dtype=np.int32)
    assert free_motions([], W, active) == ["along x", "along y", "along z", "3 with a turn"]
    assert free_motions(mpm.rollers(W, "bottom"), W, active) == ["along x", "along y",
                                                                 "1 with a turn"]  # fmt: skip


def test_a_body_that_nothing_holds_says_so():
    points, V, F, _ = block()
    problem = mpm.QuasiStatic(F, V.increment, points, max_halvings=1)
    with pytest.raises(ConvergenceError, match=r"no boundary conditions .* rigid motions are free"):
        problem.step()
    bcs = mpm.rollers(V, "left")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, max_halvings=1, stabilisation="ghost")
    free = pytest.warns(mpm.errors.FreeMotionWarning, match="along y")
    with free, pytest.raises(ConvergenceError, match="rigid motions along y: add one") as caught:
        problem.step()
    assert "stabilisation" not in str(caught.value)


@pytest.mark.parametrize("sides", [1, 2])
def test_a_body_that_boundaries_hold_gets_no_advice_to_hold_it(sides):
    points, V, F, _ = block()
    law = mpm.materials.Hencky(1e5, 0.3)
    for line in ([(0, 0), (2, 0)], [(0, 1), (0, 0)])[:sides]:
        at = mpm.Boundary.from_polygon(points, line, closed=False)
        more = {"direction": "normal"} if sides == 2 else {}
        F += mpm.dirichlet(at, V.increment, V.test, law=law, **more)
    options = {"max_iterations": 1, "max_halvings": 0, "tolerance": 1e-14}
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost", **options)
    with pytest.raises(ConvergenceError) as caught:
        problem.step()
    assert "rigid motions" not in str(caught.value)
    assert str(caught.value).endswith("take smaller steps")


def test_advice_and_loads_of_a_failed_step():
    points, V, F, g = block()
    g.name = "gravity"
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1), (0, 1))
    settlement = fem.Constant(points.grid, 0.0)
    F += mpm.RigidFooting(top, settlement, E=1e5).contact(V.increment, V.test)
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    for options, stabilised in (({}, False), ({"stabilisation": "ghost"}, True)):
        problem = mpm.QuasiStatic(
            F, V.increment, points, bcs, max_iterations=1, max_halvings=0, **options
        )
        g.value[1], settlement.value = -10.0, 0.25
        with pytest.raises(ConvergenceError) as caught:
            problem.step()
        text = str(caught.value)
        assert "gravity = [  0. -10.]" in text
        assert f"{settlement} = 0.25" in text
        # the penalty and the size of cells are the library's own
        assert "constants gravity" in text or f"constants {settlement}" in text
        assert text.count(" = ") == text.split("with substeps")[0].count(" = ") + text.count("det")
        assert ("or add stabilisation" in text) is not stabilised
        g.value[1], settlement.value = -0.1, 0.0


# -- layout of coordinates -----------------------------------------------------


@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "hexahedron"])
def test_every_function_of_positions_gets_one_layout(kind):
    """One array of shape (gdim, n), wherever a user gives a function."""
    d = 3 if kind == "hexahedron" else 2
    make = mesh.create_unit_cube if d == 3 else mesh.create_unit_square
    grid = make(COMM, *(4,) * d, mesh.CellType[kind])
    seen = {}

    def told(name, answer):
        def function(x):
            seen[name] = x.shape[0], x.flags.c_contiguous, isinstance(x, np.ndarray)
            return answer(x)

        return function

    high = lambda x: x[-1] > 0.9  # noqa: E731
    whole = told("Where", lambda x: x[-1] < 2)
    points = mpm.fill(grid, mpm.Where(whole), 2, told("density", lambda x: 1 + x[-1]))
    np.testing.assert_allclose(points["density"], 1 + points["x"][:, -1])
    V = mpm.Space(grid)
    top = mpm.prescribed(V, told("place", high), 0, increment=told("value", lambda x: x[-1]))
    np.testing.assert_allclose(top[0].values, 1.0)
    law = mpm.materials.Hencky(told("parameter", lambda x: 1e3 * (1 + x[-1])), 0.3)
    mpm.QuasiStatic(mpm.momentum(law, points, V.increment, V.test), V.increment, points)
    np.testing.assert_allclose(points["hencky_parameters"][:, 0], 1e3 * (1 + points["x"][:, -1]))
    geostatic = mpm.geostatic_stress(1.0, told("weight", lambda x: 10 + 0 * x[-1]), 0.5)
    mpm.set_stress(law, points, told("stress", geostatic))
    np.testing.assert_allclose(points["stress"][:, d - 1, d - 1], -10 * (1 - points["x"][:, -1]))
    if kind != "triangle":
        face = told("face", lambda x: np.isclose(x[-1], 1))
        normal = (0,) * (d - 1) + (1,)
        assert mpm.Surface(points, face, normal).total_area == pytest.approx(1.0)
    expected = {"Where", "density", "place", "value", "parameter", "weight", "stress"}
    assert seen.keys() - {"face"} == expected
    assert set(seen.values()) == {(d, True, True)}


# -- laws ----------------------------------------------------------------------


def test_angles_below_a_degree_look_like_radians():
    MohrCoulomb, DruckerPrager = mpm.materials.MohrCoulomb, mpm.materials.DruckerPrager
    match = r"MohrCoulomb: friction_angle = 0\.52 degrees .* if radians were meant give 29\.79"
    with pytest.warns(DegreesWarning, match=match) as caught:
        MohrCoulomb(1e6, 0.3, 1e3, friction_angle=0.52, dilation_angle=0.0)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with pytest.warns(DegreesWarning, match="DruckerPrager: dilation_angle = 0.17"):
        DruckerPrager(1e6, 0.3, 1e3, friction_angle=30.0, dilation_angle=0.17)
    with pytest.warns(DegreesWarning, match="residual_friction_angle = 0.4"):
        MohrCoulomb(1e6, 0.3, 1e3, 30.0, dilation_angle=0.0, residual_friction_angle=0.4, rate=1.0)
    s = scene()
    varying = MohrCoulomb(1e6, 0.3, 1e3, lambda x: 0.3 + 0.1 * x[1], dilation_angle=0.0)
    with pytest.warns(DegreesWarning, match="friction_angle = 0.3"):
        varying.parameter_array(s.points["x0"])
    # degrees, none, and a flow that is next to isochoric on purpose
    MohrCoulomb(1e6, 0.3, 1e3, 30.0, dilation_angle=1.0)
    MohrCoulomb(1e6, 0.3, 1e3, 0.0, dilation_angle=0.0)
    DruckerPrager(1e6, 0.3, 1e3, 30.0, dilation_angle=1e-6)
    DruckerPrager(1e6, 0.3, 1e3, lambda x: 20 * x[1], dilation_angle=0.0).parameter_array(
        s.points["x0"]
    )


def test_accumulated_plastic_strain_has_one_name():
    laws = [
        mpm.materials.VonMises(1e6, 0.3, radius=1e3),
        mpm.materials.Tresca(1e6, 0.3, 1e3),
        mpm.materials.MohrCoulomb(1e6, 0.3, 1e3, 30.0),
        mpm.materials.DruckerPrager(1e6, 0.3, 1e3, 30.0, dilation_angle=0.0),
        mpm.materials.EnergyWithYield(
            lambda e, K: K * ufl.inner(e, e) / 2, K=1e6, yield_stress=1e3
        ),
    ]
    for law in laws:
        assert list(law.internal) == ["plastic_strain"]

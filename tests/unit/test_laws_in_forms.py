"""Laws in forms: nothing is changed by building one, and each law keeps to its own points."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem, jit, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.forms import declarations

Hencky, NeoHookean = mpm.materials.Hencky, mpm.materials.NeoHookean
VonMises, CamClay = mpm.materials.VonMises, mpm.materials.CamClay


GHOST = mpm.Stabilisation("ghost", E=1e3, nu=0.3)


def block(n=4, per_cell=2):
    """A block whose upper half has the tag 1."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (n, n), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.5, 1.6)), per_cell, 100.0)
    points["tag"][points["x"][:, 1] > 0.9] = 1
    return points, mpm.Space(grid, "gimp")


def settle(points, V, terms, load=1.0, steps=2, updates=None):
    """Steps of a block under its weight, with the given internal forces."""
    g = fem.Constant(points.grid, (0.0, 0.0))
    F = terms - ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, updates=updates, stabilisation=GHOST)
    for k in range(1, steps + 1):
        g.value[:] = 0.2 * load * k / steps, -load * k / steps
        problem.step()
    return problem


def agree(one, other, names=("x", "F", "stress", "V"), rtol=1e-12):
    for name in names:
        scale = np.abs(other[name]).max()
        np.testing.assert_allclose(one[name], other[name], atol=rtol * scale, err_msg=name)


def held(points):
    return {name: values.copy() for name, values in points.fields.items()}


@pytest.mark.parametrize(
    "law",
    [
        Hencky(1e3, 0.3),
        VonMises(1e3, 0.3, radius=lambda x: 10 + x[0]),
        NeoHookean(1e3, 0.3),
        NeoHookean(lambda x: 1e3 + x[0], 0.3),
    ],
)
def test_a_form_changes_no_body(law):
    points, V = block()
    before = held(points)
    form = mpm.momentum(law, points, V.increment, V.test, tag=1)
    form += ufl.inner(mpm.stress(law, points, V.increment, tag=1), ufl.grad(V.test)) * points.dX(1)
    if isinstance(law, Hencky):
        form += mpm.momentum(law, points, V.increment, V.test, fbar=True)
        form += mpm.momentum(law, points, V.increment, V.test, strain="small")
    assert form.integrals()
    assert points.fields.keys() == before.keys()
    for name, values in before.items():
        np.testing.assert_array_equal(points[name], values, err_msg=name)


def test_another_form_on_the_same_points_has_no_say():
    """It was the energy's stress that a body of another law reported."""
    alone, V = block()
    settle(alone, V, mpm.momentum(Hencky(1e3, 0.0), alone, V.increment, V.test))
    points, V = block()
    mpm.momentum(NeoHookean(1.0, 0.3), points, V.increment, V.test)
    mpm.momentum(Hencky(1.0, 0.3), points, V.increment, V.test, strain="small")
    settle(points, V, mpm.momentum(Hencky(1e3, 0.0), points, V.increment, V.test))
    agree(points, alone, rtol=0)
    assert points.fields.keys() == alone.fields.keys()


def test_the_same_arguments_share_one_operator():
    points, V = block()
    law, u, v = Hencky(1e3, 0.3), V.increment, V.test

    def operators(*forms):
        return {c for form in forms for c in form.coefficients() if hasattr(c, "operand")}

    one = mpm.momentum(law, points, u, v, tag=(1, 0))
    again = mpm.momentum(law, points, u, v, tag=[0, 1, 1])
    by_itself = ufl.inner(mpm.stress(law, points, u, tag=(0, 1)), ufl.grad(v)) * points.dX
    assert len(operators(one, again, by_itself)) == 1
    others = [
        mpm.momentum(Hencky(1e3, 0.3), points, u, v, tag=(0, 1)),
        mpm.momentum(law, points, u, v),
        mpm.momentum(law, points, u, v, tag=(0, 1), fbar=True),
        mpm.momentum(law, points, u, v, tag=(0, 1), strain="small"),
        mpm.momentum(law, points, mpm.Space(points.grid, "gimp").increment, v, tag=(0, 1)),
    ]
    assert len(operators(one, *others)) == 6


@pytest.mark.parametrize("kind", [Hencky, NeoHookean])
@pytest.mark.parametrize("fbar", [False, True])
def test_two_laws_are_one_whose_modulus_varies(kind, fbar):
    if fbar and kind is NeoHookean:
        pytest.skip("an energy takes no F-bar")
    whole, V = block()
    E = np.where(whole["tag"] == 1, 500.0, 2000.0)
    law = kind(E, 0.3)
    settle(whole, V, mpm.momentum(law, whole, V.increment, V.test, fbar=fbar), load=2.0)
    for upper in (500.0, lambda x: np.full(x.shape[1], 500.0), np.full((E == 500).sum(), 500.0)):
        points, V = block()
        u, v = V.increment, V.test
        terms = mpm.momentum(kind(upper, 0.3), points, u, v, tag=1, fbar=fbar)
        terms += mpm.momentum(kind(2000.0, 0.3), points, u, v, tag=0, fbar=fbar)
        settle(points, V, terms, load=2.0)
        agree(points, whole)


def test_a_law_and_an_energy_side_by_side():
    """Where they are the same body: at small strain, to its order."""
    ends = []
    for kinds in ((Hencky, Hencky), (NeoHookean, Hencky), (Hencky, NeoHookean)):
        points, V = block()
        terms = [
            mpm.momentum(kind(1e3, 0.3), points, V.increment, V.test, tag=tag)
            for tag, kind in enumerate(kinds)
        ]
        settle(points, V, sum(terms[1:], terms[0]), load=1e-3)
        ends.append(points)
        for tag, kind in enumerate(kinds):
            mark = 4 if kind is NeoHookean else 1
            assert (points["moved_under"][points["tag"] == tag] == mark).all()
    for other in ends[1:]:
        agree(other, ends[0], ("stress",), rtol=1e-3)
        assert np.abs(other["stress"]).max() > 1e-2


def test_each_law_keeps_its_variables_at_its_own_points():
    points, V = block()
    u, v = V.increment, V.test
    upper = points["tag"] == 1
    clays = (
        CamClay(
            swelling=0.018,
            compression=0.13,
            M=1.05,
            mu0=5.4e6,
            alpha=0.0,
            reference_pressure=2e4,
            preconsolidation=4e4,
        ),
        (
            CamClay(
                swelling=0.018,
                compression=0.13,
                M=1.05,
                mu0=5.4e6,
                alpha=0.0,
                reference_pressure=2e4,
                preconsolidation=lambda x: 6e4 + x[0],
            )
        ),
    )
    for tag, law in enumerate(clays):
        mpm.set_stress(
            law, points, lambda x: np.tile(-2e4 * np.eye(3), (x.shape[1], 1, 1)), tag=tag
        )
    first = np.where(upper, 6e4 + points["x0"][:, 0], 4e4)
    np.testing.assert_array_equal(points["preconsolidation_pressure"], first)
    terms = mpm.momentum(clays[0], points, u, v, tag=0)
    terms += mpm.momentum(clays[1], points, u, v, tag=1)
    # a problem made anew takes the variables as they are
    points["preconsolidation_pressure"] = 1.5 * first
    mpm.QuasiStatic(terms, u, points, mpm.fixed(V, "bottom"))
    np.testing.assert_array_equal(points["preconsolidation_pressure"], 1.5 * first)
    points, V = block()
    law = VonMises(1e3, 0.3, radius=10.0, hardening=500.0)
    terms = mpm.momentum(law, points, V.increment, V.test, tag=0)
    terms += mpm.momentum(Hencky(1e3, 0.3), points, V.increment, V.test, tag=1)
    settle(points, V, terms, load=0.4)
    assert (points["plastic_strain"][~upper] > 0).any()
    assert (points["plastic_strain"][upper] == 0).all()


def test_two_laws_of_one_name_that_vary_do_not_share_parameters():
    points, V = block()
    u, v = V.increment, V.test
    soft, stiff = (Hencky(lambda x, E=E: np.full(x.shape[1], E), 0.3) for E in (500.0, 5000.0))
    first = settle(points, V, mpm.momentum(soft, points, u, v))
    settle(points, V, mpm.momentum(stiff, points, u, v))
    assert (points["hencky_parameters"][:, 0] == 500.0).all()
    assert (points["hencky_parameters_2"][:, 0] == 5000.0).all()
    first.step()  # back in balance under the soft one
    with pytest.raises(ParameterError, match="expected one value for each of"):
        mpm.QuasiStatic(
            mpm.momentum(Hencky(np.ones(len(points)), 0.3), points, u, v, tag=1), u, points
        )


def test_two_laws_on_the_same_points_are_refused():
    points, V = block()
    u, v = V.increment, V.test
    one, other = Hencky(1e3, 0.3), VonMises(2e3, 0.3, radius=1.0)

    def refused(form, *match):
        fields = held(points)
        for text in match:
            with pytest.raises(FormError, match=text):
                mpm.QuasiStatic(form, u, points)
        assert points.fields.keys() == fields.keys()

    def term(law, **options):
        return mpm.momentum(law, points, u, v, **options)

    refused(term(one) + term(other), "Hencky.E=1000.*tag=None.*VonMises.E=2000", "tag=...")
    refused(term(one, tag=1) + term(other), r"points of tag \[1\] are in both")
    # (stress of the first again: what is counted twice is momentum)
    sigma = mpm.stress(one, points, u, tag=(0, 1))
    mpm.QuasiStatic(
        term(one, tag=(0, 1)) + ufl.inner(sigma, ufl.grad(v)) * points.dX((0, 1)), u, points
    )
    refused(term(one, tag=(0, 1)) + term(other, tag=(1, 2)), r"tag=\(0, 1\).*tag=\(1, 2\)")
    refused(term(one) + term(one), "Hencky.*Hencky")
    refused(term(one, tag=1) + term(one, tag=1), r"Hencky.*tag=1.*Hencky.*tag=1")
    refused(term(one) + term(one, strain="small"), "Hencky.*Hencky")
    refused(
        term(NeoHookean(1.0, 0.3)) + term(one, tag=1), r"(?=.*NeoHookean\(E=1, ).*Hencky\(E=1000, "
    )
    other_stress = mpm.stress(one, points, u, strain="small")
    refused(
        term(one) + ufl.inner(other_stress, ufl.grad(v)) * points.dX,
        "mpm.stress takes the same law",
    )
    # tags that nobody has do not meet
    mpm.QuasiStatic(term(one, tag=(0, 1)) + term(other, tag=7), u, points)
    for bad in (-1, 1.5, True, (), "clay"):
        with pytest.raises(ParameterError, match="must be a whole number from 0"):
            mpm.momentum(one, points, u, v, tag=bad)


def test_measures_of_points_take_tags():
    """A load on some of the points is one that a field of 0 and 1 picks."""
    ends = []
    for pick in (
        lambda p: p.dX(1), lambda p: (p.chosen * p.dX), lambda p: p.dX((1, 5)),
        lambda p: p.dX(1, metadata=p.dX.metadata()),
    ):  # fmt: skip
        points, V = block()
        points.add_field("chosen")
        points["chosen"] = points["tag"] == 1
        u, v = V.increment, V.test
        F = mpm.momentum(Hencky(1e3, 0.3), points, u, v)
        measure = pick(points)
        term = ufl.inner(ufl.as_vector((1.0, -20.0)), v) + ufl.inner(u, v)
        F -= (
            term * measure
            if isinstance(measure, ufl.Measure)
            else (points.chosen * term * points.dX)
        )
        mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")).step()
        ends.append(points)
    for other in ends[1:]:
        agree(other, ends[0])
    with pytest.raises(FormError, match="restricts a measure of points: tag = -3 must be"):
        mpm.QuasiStatic(F + v[0] * points.dX(-3), u, points)


# --- a law is a value ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law", [Hencky(1e3, 0.3), NeoHookean(1e3, 0.3), VonMises(1e3, 0.3, radius=5.0)]
)
def test_parameters_are_read_and_not_assigned(law):
    assert (law.E, law.nu) == (1e3, 0.3)
    with pytest.raises(ParameterError, match=r"E = 5000000.0: .*E=1000.* make a new law"):
        law.E = 5e6
    with pytest.raises(ParameterError, match=r"E = 5000000\.0: .* make a new law"):
        law.values["E"] = 5e6
    assert law.E == law.values["E"] == 1e3
    with pytest.raises(AttributeError, match="no attribute 'young'; its parameters are E, nu"):
        law.young  # noqa: B018


def test_a_law_keeps_a_copy_of_arrays():
    E = np.full(3, 1e3)
    law = Hencky(E, 0.3)
    E[:] = 1.0
    assert (law.E == 1e3).all()
    with pytest.raises(ValueError, match="read-only"):
        law.E[0] = 1.0


# --- what a body has moved under ---------------------------------------------------------------


def moved_under(measure, tag=None):
    points, V = block()
    law = NeoHookean(1e3, 0.3) if measure == "energy" else Hencky(1e3, 0.3)
    strain = "large" if measure == "energy" else measure
    terms = mpm.momentum(law, points, V.increment, V.test, strain=strain)
    problem = settle(points, V, terms, load=0.4)
    return points, V, problem


# --- numbers are constants ---------------------------------------------------------------------


def test_nothing_is_compiled_twice_for_a_number_a_mesh_or_a_count(tmp_path, monkeypatch):
    options = {"cache_dir": tmp_path / "forms"}
    from dolfinmpm._platform import compat

    real = jit.ffcx_jit
    monkeypatch.setattr(
        compat.jit, "ffcx_jit", lambda *a, **k: real(*a, **{**k, "jit_options": options})
    )

    def solve(E, n, per_cell):
        points, V = block(n, per_cell)
        u, v = V.increment, V.test
        law = NeoHookean(E, 0.3 + 1e-6 * E)
        F = mpm.momentum(law, points, u, v)
        F += ufl.inner(mpm.stress(law, points, u), ufl.grad(v)) * points.dX
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
        problem.stiffness()
        return len(list((tmp_path / "forms").glob("*.c"))), problem

    first, one = solve(1e3, 3, 2)
    assert first > 0
    assert solve(2e3, 3, 2)[0] == first
    assert solve(3e3, 5, 3)[0] == first
    again, other = solve(2e3, 3, 2)
    assert again == first
    # and the number is what counts
    ratio = other.stiffness().norm() / one.stiffness().norm()
    assert 1.9 < ratio < 2.2


def test_numbers_of_laws_are_no_loads():
    points, V = block()
    problem = settle(points, V, mpm.momentum(NeoHookean(1e3, 0.3), points, V.increment, V.test))
    assert "1000" not in problem.loads.describe()
    assert "-1." in problem.loads.describe()


def test_the_stabilisations_take_the_stiffest_law():
    points, V = block()
    u, v = V.increment, V.test
    form = mpm.momentum(NeoHookean(1e3, 0.1), points, u, v, tag=0)
    stiff = Hencky(lambda x: 2e3 + x[0], 0.2)
    form += mpm.momentum(stiff, points, u, v, tag=1)
    problem = mpm.QuasiStatic(form, u, points, stabilisation="weak-aggregation")
    largest = 2e3 + points["x0"][points["tag"] == 1, 0].max()
    np.testing.assert_allclose(problem.stabilisation.E, largest, rtol=1e-12)
    assert problem.stabilisation.nu == 0.2


def test_check_separate_by_itself():
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    law = Hencky(1.0, 0.3)
    for tag in (1, 2, None):
        mpm.momentum(law, points, V.increment, V.test, tag=tag)
    one, two, everywhere = points.declarations.values()
    declarations.check_separate([one, two], {1, 2})
    declarations.check_separate([one, everywhere], {0})
    for several in ([one, everywhere], [one, two, one], [everywhere, everywhere]):
        with pytest.raises(FormError):
            declarations.check_separate(several, {0, 1})

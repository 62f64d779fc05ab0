"""Large strain, small strain and Jaumann's rate: tangents, closed forms, objectivity."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from laws import SOILS

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.kinematics import (
    Jaumann,
    LargeStrain,
    SmallStrain,
    StrainFormulation,
    momentum,
    strain_formulation,
    update_domains,
)
from dolfinmpm.kinematics.strainformulation import symmetric
from dolfinmpm.kinematics.strainfunctions import StrainFunctions
from dolfinmpm.materials.base import lame

KINDS = {1: "interval", 2: "quadrilateral", 3: "hexahedron"}
LAWS = {
    **SOILS,
    "NorSand": mpm.materials.NorSand(
        swelling=0.018, mu0=5.4e6, alpha=0.0, reference_pressure=2e4, M=1.25, N=0.2, chi=3.5,
        hardening=150.0, critical_void_ratio=0.82, critical_slope=0.03, void_ratio=0.65,
        image_pressure=1e4,
    ),
}  # fmt: skip
MEASURES = ("large", "small", "jaumann")
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
each_measure = pytest.mark.parametrize("strain", MEASURES)
each_dimension = pytest.mark.parametrize("d", [1, 2, 3])


def some_points(d, n=2, per_cell=3):
    grid = unit_grid(KINDS[d], n)
    return mpm.fill(grid, mpm.Box((0.0,) * d, (1.0,) * d), per_cell, 1.0)


def bound(law, points, strain):
    """The law with that strain formulation, with its fields added to the points."""
    operator = strain_formulation(law, points, strain)
    operator.bind()
    return operator


def ended(operator, H):
    """All points' fields after a step of these gradients."""
    return operator.commit(H, operator.rows)


def flux(operator, H, tangent=False):
    """Flux, and its tangent if asked, at all points."""
    n, d = len(H), H.shape[-1]
    S, A = np.empty((n, d * d)), np.empty((n, d * d, d * d))
    rows = np.arange(n, dtype=np.int32)
    assert operator.evaluate(H.reshape(n, d * d), S, A if tangent else None, rows) == -1
    return (S, A) if tangent else S


def with_history(operator, seed=1, size=0.004):
    """Elastic strain in all components that there are, and F that is none's identity."""
    points = operator.points
    n, d = len(points), points.gdim
    rng = np.random.default_rng(seed)
    strain = np.zeros((n, 3, 3))
    strain[:, :d, :d] = rng.uniform(-size, size, (n, d, d))
    strain = 0.5 * (strain + np.swapaxes(strain, 1, 2))
    for i in range(d, 3):
        strain[:, i, i] = rng.uniform(-size, size, n)
    if operator.multiplicative:
        strain = np.eye(3) + 2 * strain
    points[operator.state] = strain[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    points["F"] = np.eye(d) + rng.uniform(-0.1, 0.1, (n, d, d))
    return rng


@each_dimension
@each_measure
@each_law
def test_tangent_is_the_derivative_of_the_flux(law, strain, d):
    """Central differences at every point, where differences to both sides agree."""
    operator = bound(law, some_points(d), strain)
    rng = with_history(operator)
    n = len(operator.points)
    H = rng.uniform(-1, 1, (n, d, d)) * 10 ** rng.uniform(-5, -1.3, (n, 1, 1))
    S, A = flux(operator, H, tangent=True)
    t = 1e-7
    size = np.abs(A).max()
    smooth, errors = np.full(n, True), np.zeros(n)
    for k in range(d * d):
        move = np.zeros(d * d)
        move[k] = t
        ahead, behind = (flux(operator, H + s * move.reshape(d, d)) for s in (1, -1))
        two_sides = np.abs((ahead - S) - (S - behind)).max(axis=1) / t
        smooth &= two_sides < 1e-3 * size
        errors = np.maximum(errors, np.abs((ahead - behind) / (2 * t) - A[:, :, k]).max(axis=1))
    assert smooth.mean() > 0.8
    assert errors[smooth].max() < 2e-6 * size


@each_dimension
@each_measure
def test_tangent_where_strains_are_equal(strain, d):
    """At rest, where all principal strains meet, and near it."""
    operator = bound(LAWS["VonMises"], some_points(d, 1, 2), strain)
    lmbda, mu = lame(1e6, 0.3)
    one = np.eye(d)
    exact = lmbda * np.einsum("ij,kl->ijkl", one, one)
    exact += mu * (np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one))
    for size in (0.0, 1e-14, 1e-10, 1e-7):
        H = size * np.random.default_rng(2).uniform(-1, 1, (len(operator.points), d, d))
        A = flux(operator, H, tangent=True)[1]
        np.testing.assert_allclose(
            A, np.broadcast_to(exact.reshape(d * d, d * d), A.shape), atol=1e6 * (1e-8 + 20 * size)
        )


@each_law
@each_dimension
def test_measures_agree_at_tiny_increments(law, d):
    """Large strain and Jaumann's rate tend to small strain linearly with the increment."""
    points = some_points(d)
    rng = np.random.default_rng(4)
    H = rng.uniform(-1, 1, (len(points), d, d))
    gaps = []
    for size in (1e-4, 1e-5):
        S = {m: flux(bound(law, points, m), size * H) for m in MEASURES}
        change = max(np.abs(S["small"]).max() * size, 1e-12)
        gaps.append([np.abs(S[m] - S["small"]).max() / change for m in ("large", "jaumann")])
    assert np.max(gaps) < 60  # relative differences are of the order of the increment


@each_measure
@each_law
def test_commit_goes_with_evaluate(law, strain):
    """Stress, flux and elastic strain at the end belong together; nothing changes before commit."""
    points = some_points(3)
    operator = bound(law, points, strain)
    rng = with_history(operator)
    n = len(points)
    H = rng.uniform(-0.03, 0.03, (n, 3, 3))
    before = {name: values.copy() for name, values in points.fields.items()}
    S = flux(operator, H).reshape(n, 3, 3)
    new = ended(operator, H.reshape(n, 9))
    for name, values in points.fields.items():
        assert np.array_equal(values, before[name]), name
    dF = np.eye(3) + H
    J = np.linalg.det(dF @ points["F"])[:, None, None]
    full = S if strain == "small" else (S @ np.swapaxes(dF, 1, 2)) / J
    np.testing.assert_allclose(new["stress"], full, atol=1e-9 * np.abs(full).max())
    # the elastic strain at the end gives the stress again
    for name, values in new.items():
        points[name] = values
    points["F"] = dF @ points["F"]
    again = ended(operator, np.zeros((n, 9)))
    scale = np.abs(full).max()
    np.testing.assert_allclose(again["stress"], new["stress"], atol=1e-8 * scale)
    assert set(new) == {operator.state, "stress", *law.internal}


def test_plane_strain_keeps_elastic_strain_across():
    """Plastic flow across a plane leaves elastic strain there, opposite to the plastic one."""
    law = mpm.materials.VonMises(1e6, 0.3, radius=1e4)
    points = some_points(2, 1, 2)
    operator = bound(law, points, "small")
    H = np.broadcast_to([0.05, 0.0, 0.0, 0.0], (len(points), 4))
    new = ended(operator, np.ascontiguousarray(H))
    answer = law.respond([[0.05, 0.0, 0.0]])
    np.testing.assert_allclose(new["elastic_strain"][0, :3], answer.strain[0], rtol=1e-12)
    assert abs(new["elastic_strain"][0, 2]) > 1e-3
    np.testing.assert_allclose(np.diagonal(new["stress"][0]), answer.stress[0], rtol=1e-12)


def test_names_and_flags():
    points = some_points(2, 1, 2)
    law = LAWS["Hencky"]
    assert LargeStrain.multiplicative is True
    assert SmallStrain.multiplicative is False
    assert Jaumann.multiplicative is False
    fields = set(points.fields)
    assert isinstance(strain_formulation(law, points, "small"), SmallStrain)
    assert set(points.fields) == fields
    assert callable(update_domains)
    V = mpm.Space(points.grid, "linear")
    with pytest.raises(ParameterError, match="strain = 'green'"):
        momentum(law, points, V.increment, V.test, strain="green")
    neo = mpm.materials.NeoHookean(1.0, 0.3)
    for strain in ("small", "jaumann"):
        with pytest.raises(ParameterError, match="NeoHookean is an energy of large strain"):
            momentum(neo, points, V.increment, V.test, strain=strain)
    momentum(neo, points, V.increment, V.test)


@pytest.mark.parametrize("strain", ["large", "jaumann"])
def test_an_increment_that_turns_a_point_inside_out_has_no_stress(strain):
    points = some_points(2, 1, 2)
    operator = bound(LAWS["Hencky"], points, strain)
    H = np.zeros((len(points), 4))
    H[2] = [-1.5, 0, 0, 0]
    rows = np.arange(len(points), dtype=np.int32)
    assert operator.evaluate(H, np.empty_like(H), None, rows) == 2
    assert "inside out" in operator.describe(H[2], 2)
    assert np.isnan(ended(operator, H)["stress"][2:]).all()


@each_measure
def test_trial_strain_is_what_the_law_sees(strain):
    law = LAWS["Hencky"]
    for d in (1, 2, 3):
        points = some_points(d)
        operator = bound(law, points, strain)
        rng = with_history(operator)
        n = len(points)
        H = rng.uniform(-0.1, 0.1, (n, d, d))
        trial = operator.trial_strain(H, np.arange(n, dtype=np.int32))
        new = symmetric(ended(operator, H.reshape(n, d * d))[operator.state])
        if strain == "large":
            values, Q = np.linalg.eigh(new)
            new = (Q * (0.5 * np.log(values))[:, None]) @ np.swapaxes(Q, 1, 2)
        np.testing.assert_allclose(trial, new, atol=1e-14)


@each_measure
@pytest.mark.parametrize("all_prescribed", [True, False])
def test_a_law_without_stress_names_the_point_and_its_state(strain, all_prescribed):
    """A step that cannot be halved further tells trial strains, internal variables, parameters."""
    # strength is used up: it falls linearly with plastic strain
    law = mpm.materials.VonMises(1e5, 0.3, radius=1e3, hardening=-2e4)
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid, "linear")
    pull = fem.Constant(grid, 0.0)
    # without unknowns the law is asked by the commit first, else by Newton's method
    height = 0.1 if all_prescribed else 0.3
    bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, lambda x: x[1] > height, 0, increment=pull)
    bcs += mpm.prescribed(V, lambda x: x[1] > height, 1, increment=0.0)
    F = mpm.momentum(law, points, V.increment, V.test, strain=strain)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, max_halvings=3)

    def drive():
        for _ in range(40):
            pull.value = 0.01
            problem.step()

    with pytest.raises(ConvergenceError) as caught:
        drive()
    message = str(caught.value)
    assert "VonMises finds no stress at point" in message
    assert "principal trial strains [" in message
    assert "plastic_strain = " in message
    assert "hardening = -20000" in message
    assert points["plastic_strain"].max() > 0.03


@pytest.mark.parametrize("kind", ["weak-aggregation", "soft"])
def test_stabilisation_takes_the_largest_of_moduli_that_vary(kind):
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    by_position = mpm.materials.Hencky(E=lambda x: 10 + 5 * x[0], nu=lambda x: 0.2 + 0.1 * x[1])
    by_array = mpm.materials.Hencky(E=10 + 5 * points["x0"][:, 0], nu=0.25)
    F = mpm.momentum(by_position, points, V.increment, V.test)
    stabilisation = mpm.QuasiStatic(F, V.increment, points, stabilisation=kind).stabilisation
    np.testing.assert_allclose(stabilisation.E, 10 + 5 * points["x0"][:, 0].max())
    assert stabilisation.nu == pytest.approx(0.2 + 0.1 * points["x0"][:, 1].max())
    F = mpm.momentum(by_array, points, V.increment, V.test, strain="small")
    stabilisation = mpm.QuasiStatic(F, V.increment, points, stabilisation=kind).stabilisation
    np.testing.assert_allclose(stabilisation.E, 10 + 5 * points["x0"][:, 0].max())
    assert stabilisation.nu == 0.25


@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_stage_of_its_own_changes_nothing(d):
    """Large strain with ΔF as a first stage, whose derivatives are multiplied as numbers."""

    class Staged(LargeStrain.functions):
        def rate(self, H):
            return H + ufl.Identity(self.d)

        def trial(self, G, old):
            return G * old * G.T

    class StagedFramework(LargeStrain):
        functions = Staged

    law, found = LAWS["VonMises"], []
    for kind in (LargeStrain, StagedFramework):
        operator = kind(law, some_points(d))
        operator.bind()
        rng = with_history(operator)
        H = rng.uniform(-0.05, 0.05, (len(operator.points), d, d))
        end = ended(operator, H.reshape(-1, d * d))
        found.append((*flux(operator, H, tangent=True), *end.values()))
    for one, other in zip(*found):
        np.testing.assert_allclose(other, one, rtol=1e-10, atol=1e-12 * np.abs(one).max())


def test_a_strain_formulation_is_a_few_lines_of_ufl():
    """Green's strain with its own flux: a St Venant–Kirchhoff body, tangent and commit included."""

    class Green(StrainFunctions):
        logarithmic = False

        def trial(self, G, old):
            return old + ufl.sym(G) + 0.5 * G.T * G

        def flux(self, stress, H, F):
            return (ufl.Identity(self.d) + H) * stress

        def volume(self, H, F):
            # second Piola's stress has other axes; its first invariant is all that is compared
            return ufl.det(ufl.Identity(self.d) + H)

    class GreenStrain(StrainFormulation):
        strain, state, rest = "large", "green_strain", (0.0,) * 6
        multiplicative, functions = False, Green

    points = some_points(2)
    operator = GreenStrain(LAWS["Hencky"], points)
    operator.bind()
    H = np.random.default_rng(3).uniform(-0.2, 0.2, (len(points), 2, 2))
    S, A = flux(operator, H, tangent=True)
    lmbda, mu = lame(1e6, 0.3)
    E = 0.5 * (H + np.swapaxes(H, 1, 2) + np.swapaxes(H, 1, 2) @ H)
    second = lmbda * np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 2 * mu * E
    exact = (np.eye(2) + H) @ second
    np.testing.assert_allclose(S.reshape(-1, 2, 2), exact, atol=1e-9 * np.abs(exact).max())
    t, k = 1e-6, 1
    ahead, behind = (flux(operator, H + s * t * np.eye(4)[k].reshape(2, 2)) for s in (1, -1))
    np.testing.assert_allclose((ahead - behind) / (2 * t), A[:, :, k], atol=1e-7 * np.abs(A).max())
    new = ended(operator, H.reshape(-1, 4))
    np.testing.assert_allclose(symmetric(new["green_strain"])[:, :2, :2], E, atol=1e-12)
    J = np.linalg.det(np.eye(2) + H)[:, None, None]
    np.testing.assert_allclose(new["stress"][:, :2, :2], second / J, rtol=1e-9, atol=1e-3)


def test_without_a_tangent_none_is_compiled():
    class Fresh(LargeStrain.functions):
        pass

    class FreshFramework(LargeStrain):
        functions = Fresh

    operator = FreshFramework(LAWS["Hencky"], some_points(2))
    operator.bind()
    H = np.zeros((len(operator.points), 2, 2))
    flux(operator, H)
    made = operator._compiled.__dict__
    assert "_flux" in made
    assert "_slopes" not in made
    assert "_volume" not in made
    flux(operator, H, tangent=True)
    assert "_slopes" in made

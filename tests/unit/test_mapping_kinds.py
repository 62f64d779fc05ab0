"""What each mapping of velocities does."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import disc
from test_mappings import OF_LUMPED, block, mapped

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.dynamics import transfer
from dolfinmpm.dynamics.nodalmass import Mass


def one_step(mapping, **options):
    """A problem after a step from rough velocities, and velocities before."""

    def rough(x):
        return np.stack([np.sin(9 * x[0]), np.cos(7 * x[1])], axis=1)

    problem = disc(mpm.Newmark, velocity=rough, mapping=mapping, **{"mass": "lumped", **options})
    points = problem.points
    points.add_field("acceleration", (2,), "m/s^2")
    points["acceleration"] = 0.1 * np.cos(3 * points["x"])
    problem.motion._starting = False
    before = points["velocity"].copy(), points["acceleration"].copy()
    problem.step(0.01)
    return problem, *before


def test_accel_integrates_the_accelerations():
    problem, v, a = one_step("accel")
    points = problem.points
    expected = v + 0.5 * 0.01 * (a + points["acceleration"])
    np.testing.assert_allclose(points["velocity"], expected, rtol=0, atol=1e-15)


def test_flip_may_have_a_share_of_pic():
    pic, flip = (one_step(mapping)[0].points["velocity"] for mapping in ("pic", "flip"))
    shared = one_step(mpm.Mapping("flip", share=0.7))[0].points["velocity"]
    np.testing.assert_allclose(shared, 0.7 * flip + 0.3 * pic, rtol=0, atol=1e-14)
    assert np.abs(flip - pic).max() > 0.1
    nothing = one_step(mpm.Mapping("flip", share=0.0))[0].points["velocity"]
    np.testing.assert_allclose(nothing, pic, rtol=0, atol=1e-14)


def test_filters_of_one_stage_are_pic_and_of_many_a_consistent_mass():
    pic = one_step("pic")[0].points["velocity"]
    for kind in ("xpic", "fmpm"):
        first = one_step(mpm.Mapping(kind, order=1))[0].points["velocity"]
        np.testing.assert_allclose(first, pic, rtol=0, atol=1e-14)
    # the sum of stages converges to the projection: all of what the grid can carry is kept
    problem = disc(mpm.Newmark, mass="lumped", mapping=mpm.Mapping("fmpm", order=400))
    (field,) = problem.activate().fields
    mass = Mass(problem.motion.terms, problem.here)
    mapping, s = problem.motion.mapping, field.stencils
    momenta = mass.nodal()
    x_node = field.basis.node_coordinates()
    mapping.to_grid(problem.points, field, x_node, momenta)
    lumped = mass.solve(momenta, np.zeros_like(momenta.arrays[0])).arrays[0]
    filtered = transfer.collect(s, mapping._filtered(problem.points, field, lumped, mass))
    once = transfer.collect(s, lumped)
    v = problem.points["velocity"]
    assert np.abs(once - v).max() > 0.1
    assert np.abs(filtered - v).max() < 0.02 * np.abs(once - v).max()


def test_more_stages_lose_less():
    kept = []
    for order in (1, 2, 5):
        problem = disc(mpm.Newmark, mass="lumped", mapping=mpm.Mapping("xpic", order=order))
        start = problem.energies().kinetic
        for _ in range(5):
            problem.step(problem.time + 0.02)
        kept.append(problem.energies().kinetic / start)
    assert kept[0] < kept[1] < kept[2] < 1


def test_apic_is_tpic_on_linear_functions():
    found = {}
    for mapping in ("apic", "tpic"):
        problem = disc(mpm.Newmark, "linear", mass="lumped", mapping=mapping)
        assert problem.motion.mapping.kind == "tpic"
        for _ in range(3):
            problem.step(problem.time + 0.02)
        found[mapping] = problem.points["velocity"]
    np.testing.assert_array_equal(found["apic"], found["tpic"])


@pytest.mark.parametrize("mapping", OF_LUMPED)
def test_what_puts_back_the_smearing_goes_with_a_lumped_mass_alone(mapping):
    with pytest.raises(ParameterError, match=f'"{mapping}" puts back .* mass="lumped"'):
        disc(mapping=mapping)
    assert disc(mass="lumped", mapping=mapping).motion.mapping.kind == mapping


def test_defaults():
    assert disc().motion.mapping.kind == "pic"
    assert disc(mass="lumped").motion.mapping.kind == "accel"
    assert disc(mapping="FLIP").motion.mapping == mpm.Mapping("flip")
    assert mpm.Mapping() == mpm.Mapping("flip", share=1.0, order=2)


@pytest.mark.parametrize("cut", [1e-3, 1e-6, 1e-9])
def test_forces_at_nodes_with_next_to_no_points_are_no_trouble(cut):
    """They may be as large as any, and by the lumped mass there accelerations without bound."""
    mass, V, nodes, _ = mapped(block("quadrilateral", "gimp", cut))
    forces = mass.nodal()
    forces.arrays[0][nodes] = np.random.default_rng(3).random((len(nodes), 2)) - 0.5
    right = forces.arrays[0].copy()
    a = mass.solve(forces, np.zeros_like(V)).arrays[0]
    np.testing.assert_allclose(mass.times(a).arrays[0], right, rtol=0, atol=1e-12)
    assert mass.iterations < 200

"""Mappings of velocities where nodes follow others: leaves of several sizes, and aggregation."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm

SPIN = 1.5  # 1/s


def turning(kind, mapping, levels=2, **options):
    """A free body that turns as a rigid body, on leaves of a quarter and of one metre."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 6, 7 if levels else 25)] * 2)
    refined = {}
    if levels:
        refined = {"refine": lambda x: np.where(x[0] < 2.9, 0.25, 1.0), "levels": levels}
    V = mpm.Space(grid, "gimp", **refined)
    box = mpm.Box((1.4, 2.1), (4.1, 3.9))
    points = mpm.fill(grid, box, 2, 1e3, refine=V if levels else None)
    F = mpm.momentum(mpm.materials.Hencky(1e4, 0.3), points, V.increment, V.test)
    more = {"mass": "lumped"} if kind is mpm.Newmark else {}
    problem = kind(F, V.increment, points, mapping=mapping, **more, **options)
    x = points["x"]
    points["velocity"] = SPIN * np.column_stack([3 - x[:, 1], x[:, 0] - 3])
    if "velocity_gradient" in points.fields:
        points["velocity_gradient"] = np.tile([[0, -SPIN], [SPIN, 0]], (len(points), 1, 1))
    return problem


def sums(problem):
    """Kinetic energy (J) and angular momentum (kg m²/s)."""
    points = problem.points
    found = mpm.split(points, np.zeros(len(points), bool)).before
    return found.kinetic_energy, found.angular_momentum[-1]


@pytest.mark.parametrize(
    "options", [{}, {"levels": 0, "stabilisation": "aggregation"}], ids=["leaves", "aggregation"]
)
@pytest.mark.parametrize("mapping", ["apic", "tpic"])
def test_affine_mappings_keep_angular_momentum(mapping, options):
    problem = turning(mpm.Explicit, mapping, **options)
    energy, spin = sums(problem)
    for k in range(8):
        problem.step(0.004 * (k + 1))
    after, turned = sums(problem)
    # forces turn points that have deformed a little
    assert turned == pytest.approx(spin, rel=1e-6)
    assert 0.85 * energy < after < (1 + 1e-9) * energy


@pytest.mark.parametrize("mapping", ["tpic", mpm.Mapping("xpic", order=3), mpm.Mapping("fmpm")])
def test_no_mapping_makes_energy_on_leaves(mapping):
    problem = turning(mpm.Newmark, mapping)
    energy, _ = sums(problem)
    for k in range(6):
        problem.step(0.01 * (k + 1))
        after, _ = sums(problem)
        assert 0.9 * energy < after <= energy
        energy = after


@pytest.mark.parametrize("kind", ["xpic", "fmpm"])
@pytest.mark.parametrize("fused", [False, True])
def test_filters_and_mass_scaling(kind, fused):
    """The filter knows the scaled mass: scaling inertia does not make energy."""
    problem = turning(
        mpm.Explicit, mpm.Mapping(kind, order=2), levels=0, mass_scaling=4.0, fused=fused
    )
    energy, _ = sums(problem)
    for k in range(6):
        problem.step(0.004 * (k + 1))
    assert 0.9 * energy < sums(problem)[0] <= energy

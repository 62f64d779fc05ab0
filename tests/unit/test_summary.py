"""`print(problem)`."""

from __future__ import annotations

import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm


@pytest.fixture
def parts():
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (4, 4)], (8, 8), mesh.CellType.quadrilateral
    )
    points, V = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 1000.0), mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, V.increment, V.test)
    return F, V, points, mpm.rollers(V, "left") + mpm.fixed(V, "bottom")


def test_a_problem_prints_what_it_is_made_of(parts):
    F, V, points, bcs = parts
    body = mpm.RigidBody(mpm.Disc((1.0, 2.5), 0.5), increment=(0.0, -0.1), name="disc")
    F += mpm.contact(body, points, V.increment, V.test, friction=0.3)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    assert str(problem).splitlines() == [
        "QuasiStatic: 64 points in 2 dimensions",
        "field 1: displacement, GIMP, updated configuration; stabilisation: ghost",
        "law: Hencky(E=1e+06, nu=0.3), large strain",
        "terms: sums over points, contact with 'disc', friction 0.3, integrals over the grid",
        "conditions: left: component 0 held; bottom: component 0 held; bottom: component 1 held",
        "rigid body: 'disc'",
        "solver: Newton's method to 1e-09 of the loads in 20 iterations at most, up to 10 "
        "halvings; linear solver: chosen in the first step",
    ]


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (mpm.Newmark, "scheme: β = 0.25, γ = 0.5; velocity mapping: pic"),
        (mpm.GeneralisedAlpha, "α_f = "),
        (
            mpm.Explicit,
            'scheme: explicit, order "musl", lumped mass, velocity mapping: flip; fused',
        ),
    ],
)
def test_schemes_in_time(parts, make, line):
    F, V, points, bcs = parts
    text = str(make(F, V.increment, points, bcs))
    assert line in text
    assert " mass" in text
    assert "object at" not in text

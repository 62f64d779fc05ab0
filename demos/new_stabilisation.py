"""A stabilisation of one's own, in two lines of UFL.

A body may fill a very small part of a cell. The functions of such a cell have almost no stiffness
and mass. So condition numbers and the critical time step 2/√λ_max depend on the place of the body
in the grid. A stabilisation is a term of the weak form over `points.dS`, the facets beside cut
cells. These facets follow the body. Here a new stabilisation is written in UFL:

    j(u, v) = f E/(90 h²) · h³ ∫ [[∇u]]·[[∇v]] dS   for the stiffness,
    j(u, v) = ρ/12 · h³ ∫ [[∇u]]·[[∇v]] dS          for the mass.

The jump is that of the increment, so that no force accumulates, and a linear motion has no jump. In
one dimension this is the ghost penalty of Coombs (2023, doi 10.1002/nme.7332). With it a bar at any
place has the critical step of linear elements without cuts, Δt = h/(√3 c) with the wave speed c.
Without it the step falls to 2·10⁻⁷ h/c. Try another term: demos/studies/new_stabilisation.py tests
several terms in two dimensions.
"""

import math

import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

E, rho, h = 1.0, 1.0, 1.0
# where the bar's left end is in its cell
PLACES = (1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 0.999, 1 - 1e-6)


def penalty(points, u, v, factor):
    """The new term: jumps of gradients across the facets beside cut cells."""
    jumps = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(v)))
    return factor * h**3 * jumps * points.dS


def bar(offset, factor):
    """Condition numbers and critical steps of a free bar of four cells."""
    grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8 * h])
    body = mpm.Box((2 + offset) * h, (6 + offset) * h)
    points = mpm.fill(grid, body, per_cell=2, density=rho, aligned="body")
    V = mpm.Space(grid, basis="gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E, nu=0.0), points, u, v)
    mass = None
    if factor:
        F += penalty(points, u, v, factor * E / (90 * h**2))
        mass = penalty(points, u, v, factor * rho / 12)
    # rigid motions, which nothing holds here, are left out of κ(K)
    return mpm.study.conditioning(mpm.QuasiStatic(F, u, points), rho, extra=mass)


none = mpm.study.sweep(lambda offset: bar(offset, 0.0), PLACES, label="without")
ours = mpm.study.sweep(lambda offset: bar(offset, 1.0), PLACES, label="with")
worst, uncut = mpm.study.worst(ours), 1 / math.sqrt(3)

if MPI.COMM_WORLD.rank == 0:
    print({name: float(f"{value:.4g}") for name, value in worst.items()})
    with mpm.figure("output/new_stabilisation.png") as (_, axes):
        for rows, label in ((none, "without"), (ours, "with")):
            mpm.study.draw_sweep(axes, rows, x="place", keys={"dt_consistent": f"{label} penalty"})
        axes.axhline(uncut, color="0.5", linestyle="--", label="not cut")
        axes.set(xlabel="offset of the bar (cells)", ylabel="critical step Δt c/h")
        axes.legend()
assert abs(worst["dt_consistent"] / uncut - 1) < 0.01

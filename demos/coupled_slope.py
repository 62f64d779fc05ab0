"""A slope of soft clay fails when it is loaded fast, and stands when its water has time to leave.

A slope of 60°, 6 m high, stands under water, and its weight grows as in a centrifuge. Pressures are
excess pressures, and the weight is the buoyant weight. At first the clay is weightless, and the
suction p₀ of its water holds it together. It is normally consolidated Cam-Clay. Its undrained
strength is known,

    c = M/√3 · p₀ (1/2)^(1 − κ̂/λ̂),

and the same at each point. So Taylor's (1937) number must hold if no water leaves: the slope stands
as long as N = γ'H/c is below 1/0.191 = 5.24. The undrained strength is not in the form. It follows
from the law and from the water, which keeps the volume.

In slow loading the surface keeps its suction, and the grains take over the weight. The clay
settles, becomes stronger, and does not fail.

Both rates have the same form. Only the times of the steps differ, by seven orders of magnitude.
"""

import math

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, p0, M, swelling, compression = 6.0, 50e3, 1.05, 0.018, 0.13
c = M / math.sqrt(3) * p0 * 0.5 ** (1 - swelling / compression)
clay = mpm.materials.CamClay(
    swelling=swelling,
    compression=compression,
    M=M,
    mu0=100 * c,
    alpha=0.0,
    reference_pressure=p0,
    preconsolidation=p0,
)
modulus, k = p0 / swelling + 4 / 3 * 100 * c, 1e-9
grid = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (26, 9)], (52, 18), mesh.CellType.quadrilateral
)


def inside(x):
    """Whether positions, shape (2, n), are in the slope or the ground below it."""
    return (x[1] < 2) | ((x[1] < 2 + H) & (x[0] < 14 - (x[1] - 2) / math.tan(math.pi / 3) - 1e-9))


def load(duration):
    """Raise the weight to N = 6.4 within c_v t/H² = duration; displacements, and the points."""
    points = mpm.fill(grid, mpm.Where(inside), per_cell=2, density=1.0)
    V, Q = mpm.Space(grid, basis="gimp"), mpm.Space(grid, basis="gimp", shape=())
    # the surface is where a point has no neighbour above it, or beside it
    faces = []
    for n in np.array([(0.0, 1.0), (1.0, 0.0)]):
        offset, beyond = points["l0"] * n, points["x0"] + 2 * points["l0"] * n
        free = ~inside(beyond.T) & (beyond[:, 0] < 26)
        area = (2 * points["l0"] * free[:, None])[:, ::-1] * n
        faces.append(mpm.Surface.from_arrays(points, offset, area))
    weight = fem.Constant(grid, (0.0, 0.0))
    F = mpm.poromechanics(
        clay, points, (V.increment, Q.increment), (V.test, Q.test), permeability=k, porosity=0.5,
        modulus=modulus, drained=[(face, -p0) for face in faces],
    )  # fmt: skip
    F -= ufl.inner(points.density * weight, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost"] * 2, tolerance=1e-7
    )
    points["pressure"] = -p0
    second, curve = H**2 * mpm.Fluid().unit_weight / (k * modulus), mpm.History()
    for share in mpm.steps(24, label=f"within {duration:g} H²/c_v"):
        weight.value[1] = -6.4 * share * c / H
        problem.step(share * duration * second)
        far = np.abs(points["x"] - points["x0"]).max(initial=0.0)
        curve.record(N=6.4 * share, moved=grid.comm.allreduce(far, MPI.MAX) / H)
    return curve, points


runs = {"fast": load(1e-4), "slow": load(1e3)}

state = runs["fast"][1].gather("x", "pressure")
with mpm.figure("output/coupled_slope.png", 6.4, 2.4, ncols=2) as (figure, (left, right)):
    for rate, (curve, _) in runs.items():
        left.plot(curve["moved"], curve["N"], label=rate)
    left.axhline(1 / 0.191, color="k", lw=0.8, ls="--", label="Taylor")
    left.set(xlabel="largest displacement / $H$", ylabel="$N = \\gamma' H/c$", ylim=(0, None))
    left.legend()
    if state is not None:
        x, excess = state[0], (state[1] + p0) / c
        drawn = right.scatter(*x.T, s=2, c=excess, cmap="viridis", linewidths=0)
        figure.colorbar(drawn, ax=right, shrink=0.7)
    right.set(aspect="equal", xlabel="$x$ (m)", ylabel="$y$ (m)", title="fast: excess pressure / c")

# it has failed where displacements grow by 0.05 H per unit of N, which slowly they never do
rates = {
    rate: np.diff(curve["moved"], prepend=0.0) / np.diff(curve["N"], prepend=0.0)
    for rate, (curve, _) in runs.items()
}
limit = np.interp(0.05, rates["fast"], runs["fast"][0]["N"] - 0.5 * 6.4 / 24)
if MPI.COMM_WORLD.rank == 0:
    print(f"fast: fails at N = {limit:.2f}, Taylor 5.24; slow: rates of {rates['slow'].max():.3f}")
assert abs(limit - 1 / 0.191) < 0.2

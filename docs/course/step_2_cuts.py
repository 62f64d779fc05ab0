"""Step 2. Cells that the body cuts, and what saves them

The grid does not fit the body. Some cells are cut, and the body may fill a very small part of a
cell, a sliver. The functions of a sliver have almost no stiffness and no mass. Then the matrices
are badly conditioned, and an explicit step must be very small. Here a bar is put at several places
of the grid, and you see what a ghost penalty changes.
"""

# %%
# The bar is four cells long. ``offset`` is the place of its left end in a cell.

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

E, rho, h = 1.0, 1.0, 1.0
elastic = mpm.materials.Hencky(E, nu=0.0)
offsets = [*np.geomspace(1e-6, 0.1, 6), *np.linspace(0.2, 0.9, 8), 0.99]


def bar(offset, stabilisation):
    """Condition numbers and critical steps of a free bar."""
    grid = mesh.create_interval(MPI.COMM_WORLD, 8, [0.0, 8 * h])
    body = mpm.Box((2 + offset) * h, (6 + offset) * h)
    points = mpm.fill(grid, body, per_cell=2, density=rho, aligned="body")
    V = mpm.Space(grid, basis="gimp")
    F = mpm.momentum(elastic, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=stabilisation)
    return mpm.study.conditioning(problem, rho)


# %%
# ``mpm.study.conditioning`` assembles stiffness K and consistent mass M. It returns their
# condition numbers, and the critical step 2/√λ of explicit steps. ``mpm.study.sweep`` does this at
# all places.

kinds = ("none", "ghost", "aggregation")
sweeps = {
    kind: mpm.study.sweep(lambda offset, kind=kind: bar(offset, kind), offsets, label=kind)
    for kind in kinds
}
worst = {kind: mpm.study.worst(rows) for kind, rows in sweeps.items()}
if MPI.COMM_WORLD.rank == 0:
    for kind in kinds:
        kappa, step = worst[kind]["kappa_K"], worst[kind]["dt_consistent"]
        print(f"{kind}: worst condition number {kappa:.3g}, least critical step {step:.3g} h/c")
    with mpm.figure("output/cuts.png", 4.5, 3.0) as (_, axes):
        for kind, rows in sweeps.items():
            mpm.study.draw_sweep(axes, rows, x="place", keys={"kappa_K": kind})
        axes.set(xlabel="offset of the bar (cells)", ylabel="condition number of K")
        axes.legend()

assert worst["ghost"]["kappa_K"] < 1000 < worst["none"]["kappa_K"]

# %%
# What it shows
# -------------
# Without a stabilisation the condition number grows without bound as the sliver shrinks. The ghost
# penalty adds a small force for each jump of the gradient across facets next to cut cells. Now the
# nodes of a sliver follow their neighbours, and the condition number does not depend on the cut.
# Aggregation takes another way: it makes the values of badly supported nodes follow from good
# ones.
#
# Try next
# --------
# - ``stabilisation=mpm.Stabilisation("ghost", factor=0.1)``: a smaller penalty.
# - ``basis="bspline2"``.
# - :doc:`A stabilisation of one's own </demos/new_stabilisation>` writes the penalty in UFL.

# %% [markdown]
# # Consolidation of a column at any strain
#
# A layer of saturated soil on a sealed base between smooth walls is loaded at its drained top
# (`--scene oedometer`), or settles under its own submerged weight (`--scene self-weight`). The
# water carries the load at first, and the soil takes it over as the water drains. In Terzaghi's
# linear theory the degree of consolidation is
#
# $$U = 1 - \sum_m \frac{2}{M_m^2}\, e^{-M_m^2 T}, \qquad M_m = (2m + 1)\frac{\pi}{2},
# \qquad T = \frac{k M t}{\gamma_w H^2}.$$
#
# At finite strain there are exact solutions where stiffness and permeability match.
# With Hencky's law and $k = k_0 \lambda^3/(1 - \ln\lambda)$, and with
# $\sigma' = M \ln\lambda$ and $k = k_0 \lambda^2$ (Xie & Leo 2004), the stretch $\lambda$
# obeys the linear heat equation: U is Terzaghi's at any load, the final settlement is not. Other
# permeabilities are compared with finite differences of the layer (`--permeability`).
#
# The first step is the hardest: shorter than $h^2/(4 c_v)$ it drains less than a cell, and
# pressures oscillate unless they are stabilised or the displacement has finer cells. `overshoot`
# is how far the pressure exceeds the load after one step of `--first` times $h^2/c_v$.

# %%
from __future__ import annotations

import contextlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import finish, say, solver_figures
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.sparse import diags_array

import dolfinmpm as mpm

# bases of displacement and pressure
PAIRS = (
    "linear-linear", "gimp-linear", "gimp-gimp", "bspline2-linear", "bspline2-gimp",
    "bspline2-bspline2", "bspline3-gimp",
)  # fmt: skip
# those of nested grids: the displacement has cells of half the size
NESTED = {"nested": "gimp", "nested-linear": "linear", "nested-bspline2": "bspline2"}
CUTS = (1e-6, 1e-4, 1e-2, 0.1, 0.3, 0.49, 0.51, 0.7, 0.9, 1.0)
SHARES = (1e-8, 1e-6, 1e-4, 1e-2, 0.1, 0.25, 1.0)
WATER = mpm.Fluid()
K0 = 1e-3  # m/s


# %%
@dataclass
class Input(Options):
    """Consolidation of a layer."""

    scene: str = option("oedometer", choices=("oedometer", "self-weight"))
    law: str = option("hencky", choices=("hencky", "xie-leo"))
    permeability: str = option("matched", choices=("constant", "kozeny-carman", "matched"))
    porosity: float = 0.5
    load: float = option(0.1, "q/M, or ρ'gH/M of the submerged weight")
    height: float = option(1.0, "of the layer (m)")
    h: float = positive(1 / 40, "size of the pressure's cells (m); need not divide the height")
    points_per_cell: int = natural(4, "of the displacement, a direction")
    pair: str = option(
        "gimp-gimp",
        "bases of displacement, pressure; nested: the displacement on cells of half the size",
        choices=(*PAIRS, *NESTED),
    )
    projection: str = option("auto", "factor of the pressure projection; none; auto")
    stabilisation: str = option("ghost", choices=("none", "ghost", "aggregation"))
    steps: int = natural(200, "up to the last time, in geometric progression")
    theta: float = option(0.5, "1: backward Euler; 0.5: Crank–Nicolson")
    times: list[float] = option([0.05, 0.1, 0.2, 0.3, 0.5, 1.0], "T")
    first: float = option(1e-6, "step of the overshoot, by h²/c_v")
    sweep: bool = option(False, "first steps alone, of all lengths and cuts")
    cuts: list[float] = option(list(CUTS), "of the sweep: filled share of the top cell")
    shares: list[float] = option(list(SHARES), "of the sweep: steps by h²/c_v")

    def _check(self):
        if self.projection not in ("auto", "none"):
            self.projection = float(self.projection)
        self.times.sort()


args = Input.parse()
comm = MPI.COMM_WORLD
H, h, E = args.height, args.h, 1e6
M = E  # ν = 0
c_v = K0 * M / WATER.unit_weight
weight = args.scene == "self-weight"
q = 0.0 if weight else args.load * M
# submerged weight per volume at first (N/m³)
submerged = args.load * M / H if weight else 0.0


# %% [markdown]
# ## The layer by finite differences
# $\lambda(Z, t)$ over first heights obeys
# $\partial_t \lambda = \partial_Z \left[ \frac{k}{\gamma_w \lambda}
# \left(\partial_Z \sigma'(\lambda) - \gamma' \right)\right]$, the excess pressure following from
# the effective stress: $p = q + \gamma'(H - Z) + \sigma'$. The submerged weight of a slice stays
# what it is, whatever drains.


# %%
def cauchy(stretch):
    """Vertical effective stress (Pa)."""
    return M * np.log(stretch) / (stretch if args.law == "hencky" else 1.0)


def conductivity(stretch, log=np.log):
    """k (m/s) of a stretch, a number or one of UFL."""
    if args.permeability == "matched":
        if args.law == "hencky":
            return K0 * stretch**3 / (1 - log(stretch))
        return K0 * stretch**2
    if args.permeability == "constant":
        return K0 + 0 * stretch
    n = 1 - (1 - args.porosity) / stretch
    return mpm.kozeny_carman(K0, args.porosity)(stretch, n)


def final_stretch(Z):
    """Stretch at rest, at first heights."""
    load = q + submerged * (H - np.atleast_1d(Z))
    return np.array([brentq(lambda s, one=one: cauchy(s) + one, 0.2, 1.0) for one in load])


def layer(times, count=400):
    """Settlement (m) and base pressure (Pa) at times T of finite differences."""
    dZ = H / count
    top = final_stretch(H)[0]

    def rate(_, stretch):
        stress = cauchy(stretch)
        between = 0.5 * (stretch[1:] + stretch[:-1])
        # the drained top carries the load at once
        last = (cauchy(top) - stress[-1]) / (0.5 * dZ)
        slope = np.concatenate([[submerged], np.diff(stress) / dZ, [last]])
        middle = np.concatenate([[stretch[0]], between, [0.5 * (stretch[-1] + top)]])
        flow = conductivity(middle) / (WATER.unit_weight * middle) * (slope - submerged)
        return np.diff(flow) / dZ

    t = np.array(times) * H**2 / c_v
    tridiagonal = diags_array([1.0, 1.0, 1.0], offsets=[-1, 0, 1], shape=(count, count))
    # the search for its steps divides by errors that may be none
    with np.errstate(all="ignore"):
        done = solve_ivp(
            rate, (0, t[-1]), np.ones(count), "BDF", t_eval=t, rtol=1e-7, atol=1e-10,
            jac_sparsity=tridiagonal,
        )  # fmt: skip
    assert done.success, done.message
    found = done.y.T
    base = 1.5 * found[:, 0] - 0.5 * found[:, 1]
    return np.sum(1 - found, axis=1) * dZ, q + submerged * H + cauchy(base)


# %% [markdown]
# ## The layer of points
# The pressure is the excess over the hydrostatic one: of the load, or of the submerged weight,
# which is then the body force of soil and water together.


# %%
def column(height=H):
    """The problem, and its loaded top."""
    cells = int(np.ceil(height / h - 1e-9)) + 1
    nested = args.pair in NESTED
    parts = 2 if nested else 1
    grid = box_grid([(0, 0), (h, cells * h)], (parts, parts * cells))
    body = mpm.Box((0, 0), (h, height))
    points = mpm.fill(grid, body, args.points_per_cell, 1.0, exact=True)
    bases = [NESTED[args.pair]] * 2 if nested else args.pair.split("-")
    V, Q = mpm.Space(grid, bases[0]), mpm.Space(grid, bases[1], shape=(), coarsen=parts)
    if args.law == "hencky":
        soil, modulus = mpm.materials.Hencky(E=E, nu=0.0), None
    else:
        # as stiff in every direction, so that it has shear stiffness too
        soil = mpm.materials.EnergyWithYield(
            lambda e, M: sum(M * ((a - 1) * ufl.exp(a) + 1) for a in (e[0], e[1], e[2])), M=M
        )
        modulus = M
    top = mpm.Surface(points, lambda x: x[1] > height * (1 - 1e-12), (0, 1))
    F = mpm.poromechanics(
        soil, points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=lambda J, n: conductivity(J, ufl.ln) + 0 * J, porosity=args.porosity,
        drained=top, projection=args.projection, theta=args.theta, modulus=modulus,
    )  # fmt: skip
    load = fem.Constant(grid, (0.0, -q))
    F += top.traction(load, V.test)
    if weight:
        F -= fem.Constant(grid, -submerged) * V.test[1] * points.dX
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, mpm.rollers(V, "left", "right", "bottom"),
        stabilisation=[args.stabilisation] * 2,
    )  # fmt: skip
    return problem, top


def largest_pressure(points):
    """At the points (Pa)."""
    return comm.allreduce(points["pressure"].max(initial=0.0), op=MPI.MAX)


def base_pressure(points):
    """At the point that is lowest (Pa)."""
    low = comm.allreduce(points["x0"][:, 1].min(initial=np.inf), op=MPI.MIN)
    here = np.isclose(points["x0"][:, 1], low)
    return comm.allreduce(points["pressure"][here].max(initial=0.0), op=MPI.MAX)


# %% [markdown]
# ## First steps of all lengths, with the top anywhere in its cell


# %%
def sweep():
    """Overshoot of the first step, a row a length and a column a cut."""
    table = np.zeros((len(args.shares), len(args.cuts)))
    # each of the lengths begins with the same state: a problem is made but once a cut
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory()) if comm.rank == 0 else None
        state = Path(comm.bcast(folder)) / "first.npz"
        for j, cut in enumerate(args.cuts):
            first, _ = column((5 + cut) * h)
            first.save(state)
            for i, share in enumerate(args.shares):
                first.load(state)
                first.step(share * h**2 / c_v)
                table[i, j] = largest_pressure(first.points) / q - 1
    say("step c_v/h²  overshoot (%) with the top cell filled to")
    say(" " * 11, *(f"{cut:8.3g}" for cut in args.cuts))
    for share, row in zip(args.shares, table):
        say(f"{share:11.3g}", *(f"{100 * one:8.3f}" for one in row))
    say(f"{args.pair}, {args.stabilisation}: worst {100 * table.max():.3f} %")
    return table


if args.sweep:
    table = sweep()
    finish(args, {"overshoots": table.tolist(), "overshoot": float(table.max())})
    raise SystemExit

started = time.perf_counter()
total = q + submerged * H
first, _ = column()
first.step(args.first * h**2 / c_v)
overshoot = largest_pressure(first.points) / total - 1

problem, top = column()
# steps that grow from one that drains next to nothing, and end at the times
grid_times = np.geomspace(min(1e-4, 0.1 * args.times[0]), args.times[-1], args.steps)
steps = np.unique(np.concatenate([grid_times, args.times]))
settlement, base = [], []
for T in steps:
    problem.step(T * H**2 / c_v)
    if T in args.times:
        settlement.append(-top.mean_displacement()[1])
        base.append(base_pressure(problem.points))
seconds = time.perf_counter() - started

exact_settlement, exact_base = layer(args.times)
Z = H / 4000 * (np.arange(4000) + 0.5)
final = float(np.mean(1 - final_stretch(Z)) * H)
U, exact_U = np.array(settlement) / final, exact_settlement / final
figures = {
    "U": U.tolist(),
    "U_exact": exact_U.tolist(),
    "U_error": float(np.abs(U / exact_U - 1).max()),
    "base_pressure": (np.array(base) / total).tolist(),
    "base_pressure_exact": (exact_base / total).tolist(),
    "base_pressure_error": float(np.abs(np.array(base) - exact_base).max() / total),
    "final_settlement": final / H,
    "overshoot": float(overshoot),
    "seconds": seconds,
    **solver_figures(problem),
}
say(f"final settlement {final / H:.5f} of the height; overshoot of the first step {overshoot:+.4f}")
say("     T         U     exact   base p     exact")
for row in zip(args.times, U, exact_U, np.array(base) / total, exact_base / total):
    say("{:6g} {:9.4f} {:9.4f} {:8.4f} {:9.4f}".format(*row))

# %% [markdown]
# ## What to expect
# With GIMP for both fields (the default) U is within a percent of the exact one at any time from
# T = 0.05 on, at loads of 0.001 and 0.3 M, and the pressure is smooth. With linear functions for
# the pressure (`--pair gimp-linear`) it wavers by some percent where points cross cells.
# `--projection none` lets the first step overshoot by half the load.
#
# On nested grids (`--pair nested`) the displacement has cells of half the size, and the pair is
# stable by itself: `inf_sup.py`. The first step overshoots by less than a percent, whatever its
# length and wherever the top is (`--sweep`), of every pair, with ghost penalties or without; where
# nodes are tied it does not at all. Quadratic splines take more of the projection for that than
# linear functions: with a factor of 3, which is enough where no cell is cut, they overshoot by 4 %
# (`--projection 3`). With quadratic splines for the pressure too it takes 3 points per cell and
# direction; with 2 it is 2 %.

# %%
if not args.no_plot:
    fine = np.geomspace(1e-3, args.times[-1], 60)
    curve = layer(fine)[0] / final
    x, p = problem.points["x"][:, 1], problem.points["pressure"] / total
    if comm.rank == 0:
        with mpm.figure(args.output / "consolidation.png", 7.0, 2.6, ncols=2) as (_, (left, right)):
            left.semilogx(fine, curve, color="0.6", lw=2.4, label="finite differences")
            left.semilogx(args.times, U, "o", ms=3.5, label="material points")
            left.set(xlabel="$T$", ylabel="$U$", ylim=(1, 0))
            left.legend()
            right.plot(p, x / H, ".", ms=3, label=f"$T = {args.times[-1]:g}$")
            right.set(xlabel="excess pressure / load", ylabel="height / initial height")
            right.legend()

finish(args, figures)

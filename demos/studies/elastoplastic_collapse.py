# %% [markdown]
# # A soft block collapses under its own weight
#
# A block of clay, 16 m wide and 8 m high, stands on a smooth floor. Its weight comes in forty
# steps (Coombs & Augarde 2020, doi 10.1016/j.advengsoft.2019.102748). In plane strain its foot
# can carry $\tfrac{2}{\sqrt 3}\sqrt{\tfrac32}\,\rho_y = \sqrt 2\,\rho_y$. At full gravity it must
# carry $\rho g H$, nearly three times as much. So the block yields at a third of its weight, and
# spreads until the foot can carry its height.
#
# Half of the block is computed. The law is von Mises' $f = \sqrt{2 J_2} - \rho_y$ on Hencky's
# elasticity, without hardening.

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm

E, NU, YIELD = 1e6, 0.3, 20e3
DENSITY, GRAVITY = 1000.0, 10.0
SIDE, WIDTH = 8.0, 16.0


@dataclass
class Input(Options):
    """A block of von Mises material collapses under its own weight."""

    h: float = positive(0.5, "size of the cells (m)")
    points_per_cell: int = natural(6, "in each direction")
    steps: int = natural(40)
    basis: str = option("gimp", choices=BASES)
    stabilisation: str = option("ghost", "name of a stabilisation")

    def _check(self):
        if abs(SIDE / self.h - round(SIDE / self.h)) > 1e-9:
            raise ValueError(f"h = {self.h} m must divide {SIDE:g} m")


args = Input.parse()
grid = box_grid([(0, 0), (WIDTH, SIDE)], (round(WIDTH / args.h), round(SIDE / args.h)))
comm = grid.comm
points = mpm.fill(grid, mpm.Box((0, 0), (SIDE, SIDE)), args.points_per_cell, DENSITY)
V = mpm.Space(grid, args.basis)
u, v = V.increment, V.test
clay = mpm.materials.VonMises(E=E, nu=NU, radius=YIELD)
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(clay, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
# the order of Newton's method shows with a new tangent in each iteration
problem = mpm.QuasiStatic(
    F, u, points, mpm.rollers(V, "left", "bottom"), stabilisation=args.stabilisation,
    petsc_options={"snes_lag_jacobian": 1},
)  # fmt: skip

# %% [markdown]
# ## Work and energy
# The weight does work; part of it is stored, the rest is dissipated by plastic flow. Per initial
# volume, with the elastic principal logarithmic strains $\varepsilon_i$ and the accumulated
# plastic strain $\alpha$,
#
# $$\psi = \tfrac\lambda2 (\textstyle\sum\varepsilon_i)^2 + \mu\sum\varepsilon_i^2, \qquad
#   d = \sqrt{\tfrac32}\,\rho_y\,\alpha .$$
#
# The law's own update is exact only for paths that do not turn, so that both sides differ by an
# amount that shrinks with the steps.


# %%
def total(values):
    """Sum over the body, by initial volume (J/m)."""
    return comm.allreduce(float(points["V0"] @ values))


def energies():
    """Stored and dissipated energy (J/m)."""
    be = np.zeros((len(points), 3, 3))
    for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]):
        be[:, i, j] = be[:, j, i] = points["be"][:, k]
    strain = 0.5 * np.log(np.linalg.eigvalsh(be))
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    stored = total(0.5 * lmbda * strain.sum(axis=1) ** 2 + mu * (strain**2).sum(axis=1))
    return stored, total(np.sqrt(1.5) * YIELD * points["plastic_strain"])


def mean_height():
    """Integral of the density by the height of the points (kg)."""
    return total(points["density"] * points["x"][:, 1])


def extent(axis):
    """Where the points' deformed first domains end (m)."""
    reach = np.einsum("pj,pj->p", np.abs(points["F"][:, axis]), points["l0"])
    return comm.allreduce((points["x"][:, axis] + reach).max(initial=-np.inf), op=MPI.MAX)


# %% [markdown]
# ## Forty steps
# Newton's method converges quadratically: the order that three residuals $r_1, r_2, r_3$ in a row
# show is $\ln(r_3/r_2)/\ln(r_2/r_1)$, and the last three of a step show two, or nearly so.

# %%
ready = time.perf_counter()
work, before, history = 0.0, mean_height(), []
orders, ratios = [], []
for load in mpm.steps(args.steps, label="gravity"):
    mean_load = GRAVITY * (load - 0.5 / args.steps)
    gravity.value[1] = -GRAVITY * load
    record = problem.step()
    now = mean_height()
    work, before = work + mean_load * (before - now), now
    stored, dissipated = energies()
    history.append((load, extent(0) - SIDE, extent(1), work, stored, dissipated))
    r = np.array(record.residuals)
    ratios.append([float(r[k] / r[k - 1]) for k in range(max(len(r) - 2, 1), len(r))])
    # below this the rounding of the forces shows, not Newton's method
    r = r[r > 1e-13]
    if len(r) > 3:
        orders.append(float(np.log(r[-1] / r[-2]) / np.log(r[-2] / r[-3])))

load, runout, height, work, stored, dissipated = history[-1]
figures = {
    "runout": runout,
    "height": height,
    "energy": {"work": work, "stored": stored, "dissipated": dissipated},
    "energy_gap": (work - stored - dissipated) / work,
    "max_plastic_strain": float(
        comm.allreduce(points["plastic_strain"].max(initial=0.0), op=MPI.MAX)
    ),
    **solver_figures(problem),
    "iterations": [record.iterations for record in problem.history],
    "last_ratios": ratios,
    "newton_orders": orders,
    "newton_order": float(np.median(orders)) if orders else None,
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say(
    f"{args.basis}, h = {args.h:g} m, {figures['points']} points, {comm.size} rank(s): runout "
    f"{runout:.3f} m, height {height:.3f} m, {figures['newton_iterations']} Newton iterations in "
    f"{args.steps} steps (at most {figures['max_newton_iterations']}, median order "
    f"{figures['newton_order'] or 0:.2f}), work {work / 1e6:.4f} MJ/m, stored {stored / 1e6:.4f}, "
    f"dissipated {dissipated / 1e6:.4f}, gap {figures['energy_gap']:.1%}, "
    f"{figures['seconds_solve']:.2f} s after {figures['seconds_setup']:.2f} s of set-up"
)

# %% [markdown]
# ## Picture
# Plastic strain and $\rho = \sqrt{2 J_2}$ of the Kirchhoff stress by its radius, on the
# deformed body; work and energies over the load.


# %%
def picture(path, x, F, l0, alpha, stress, history):
    """Draw the final state and the energies."""
    tau = stress * np.linalg.det(F)[:, None, None]
    s = tau - np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    rho = np.sqrt((s**2).sum(axis=(1, 2))) / YIELD
    load, runout, height, work, stored, dissipated = np.array(history).T
    layout = [["strain", "energy"], ["stress", "shape"]]
    with mpm.figure(path, 7.2, 4.3) as (figure, old):
        old.remove()
        axes = figure.subplot_mosaic(layout, width_ratios=(1.7, 1))
        shown = (
            ("strain", alpha, "viridis", (0, alpha.max()), r"plastic strain $\alpha$"),
            ("stress", rho, "magma", (0, 1), r"$\sqrt{2J_2}/\rho_y$"),
        )
        for name, values, cmap, limits, label in shown:
            drawn = draw_points(axes[name], x, F, l0, values, cmap=cmap, clim=limits)
            axes[name].plot([0, SIDE, SIDE], [SIDE, SIDE, 0], color="0.5", lw=0.6, ls="--")
            axes[name].set(xlim=(0, WIDTH), ylim=(0, 1.02 * SIDE))
            figure.colorbar(drawn, ax=axes[name], label=label, shrink=0.9)
        axes["energy"].plot(load, work / 1e6, label="work of the weight")
        axes["energy"].plot(load, (stored + dissipated) / 1e6, "--", label="stored + dissipated")
        axes["energy"].plot(load, stored / 1e6, label="stored")
        axes["energy"].set(ylabel="energy (MJ/m)", xlim=(0, 1))
        axes["shape"].plot(load, runout, label="runout")
        axes["shape"].plot(load, height, label="height")
        axes["shape"].set(xlabel="share of the weight", ylabel="m", xlim=(0, 1), ylim=(0, None))
        for name in ("energy", "shape"):
            axes[name].legend()


if not args.no_plot:
    with mpm.ParaView(args.output / "elastoplastic_collapse.pvd", points) as file:
        file.write(1.0)
    rows = points.gather("x", "F", "l0", "plastic_strain", "stress")
    if rows is not None:
        picture(args.output / "elastoplastic_collapse.png", *rows, history)

finish(args, figures)

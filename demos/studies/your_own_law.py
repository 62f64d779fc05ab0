# %% [markdown]
# # Your own law
#
# There are two ways to a law that the library does not have.
#
# **A kernel.** A law is a function of three principal logarithmic strains, compiled by Numba, and
# a class that names its parameters and its internal variables. The library has the kinematics of
# large strain, the tangent of the weak form and the state of the points. The law between the
# marks below is von Mises' with Swift's hardening of metals,
# $\rho_y = A\,(1 + \alpha/\alpha_0)^n$. It is complete, with its return mapping and its
# consistent tangent.

# %%
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, positive
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm
from dolfinmpm.materials import Law, Parameter, law_kernel

# --- the law -------------------------------------------------------------------------------


@law_kernel
def swift(parameters, strain, old, new, stress, tangent):
    E, nu, A = parameters[0], parameters[1], parameters[2]
    first, n = parameters[3], parameters[4]
    K, G = E / (3 * (1 - 2 * nu)), E / (2 * (1 + nu))
    mean = (strain[0] + strain[1] + strain[2]) / 3
    e = (strain[0] - mean, strain[1] - mean, strain[2] - mean)
    norm = math.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2)
    flow, alpha, root = 0.0, old[0], math.sqrt(2 / 3)
    radius = A * (1 + alpha / first) ** n
    slope = n * radius / (first + alpha)
    if not math.isfinite(norm):
        return 1
    yields = 2 * G * norm > radius
    # f is convex and falls with the flow: Newton's method comes from the left and cannot miss
    for _ in range(50 if yields else 0):
        f = 2 * G * (norm - flow) - radius
        if abs(f) <= 1e-14 * 2 * G * norm:
            break
        flow += f / (2 * G + root * slope)
        alpha = old[0] + root * flow
        radius = A * (1 + alpha / first) ** n
        slope = n * radius / (first + alpha)
    new[0] = alpha
    shrink = 1 - flow / norm if yields else 1.0
    along = 1 / (1 + root * slope / (2 * G)) - flow / norm if yields else 0.0
    for i in range(3):
        for j in range(3):
            tangent[3 * i + j] = K - 2 * G * shrink / 3
            if yields:
                tangent[3 * i + j] -= 2 * G * along * (e[i] / norm) * (e[j] / norm)
        tangent[4 * i] += 2 * G * shrink
        strain[i] = mean + shrink * e[i]
        stress[i] = 3 * K * mean + 2 * G * shrink * e[i]
    return 0


class Swift(Law):
    """Von Mises' law with Swift's hardening, f = √(2J₂) − A (1 + α/α₀)ⁿ."""

    parameters = {
        "E": Parameter("Pa", low=0),
        "nu": Parameter("", low=-1, high=0.5),
        "A": Parameter("Pa", low=0),
        "first_strain": Parameter("", low=0),
        "exponent": Parameter("", low=0, high=1),
    }
    internal = {"plastic_strain": ("", 0.0)}
    kernel = swift


# --- its end -------------------------------------------------------------------------------

# %% [markdown]
# **Functions in UFL.** The second way needs no return mapping of one's own: an elastic energy
# $\psi(\varepsilon_1, \varepsilon_2, \varepsilon_3)$ and, if it is to yield, a yield function of
# the principal stresses. Derivatives and Hessians are UFL's, compiled by FFCx, and a
# closest-point return calls them. Here is sand whose bulk and shear moduli grow with compression,
#
# $$\psi = K\kappa^2\,\Bigl(e^{\,\omega} - 1 + \frac{\varepsilon_v}{\kappa}\Bigr), \qquad
#   \omega = -\frac{\varepsilon_v}{\kappa} + \frac{G}{K}\,
#   \frac{\|\mathrm{dev}\,\varepsilon\|^2}{\kappa^2},$$
#
# which is convex, for $\omega$ is, and has the bulk modulus $K$ and the shear modulus $G$ at rest;
# a cone whose apex is rounded by $a$, and a flow that dilates less than the cone opens:
#
# $$f = \sqrt{J_2 + a^2} + \eta\,p - k, \qquad g = \sqrt{J_2 + a^2} + \bar\eta\,p .$$


# %%
def sand_energy(e, K, G, kappa):
    """Energy (J/m³) of elastic principal logarithmic strains."""
    v = e[0] + e[1] + e[2]
    shear = ufl.inner(e, e) - v**2 / 3
    omega = -v / kappa + G / K * shear / kappa**2
    return K * kappa**2 * (ufl.exp(omega) - 1 + v / kappa)


def cone(t, eta, k, a):
    """Yield function (Pa) of principal Kirchhoff stresses."""
    p = (t[0] + t[1] + t[2]) / 3
    J2 = (ufl.inner(t, t) - 3 * p**2) / 2
    return ufl.sqrt(J2 + a**2) + eta * p - k


def flow(t, eta_flow, a):
    """Its plastic potential."""
    return cone(t, eta_flow, 0.0, a)


# %% [markdown]
# ## Is the tangent right?
# A law can be asked without any grid. Its tangent must agree with differences of its stress; a
# wrong one still converges, but slowly, and is hard to find in a whole computation.


# %%
def tangent_error(law, n=200, seed=0, size=0.03):
    """Largest error of a law's tangent against central differences, by its largest entry."""
    strain = np.random.default_rng(seed).uniform(-size, size, (n, 3))
    here, step = law.respond(strain), 1e-6 * size
    numeric = np.empty_like(here.tangent)
    for j in range(3):
        move = step * np.eye(3)[j]
        ahead, behind = law.respond(strain + move), law.respond(strain - move)
        numeric[:, :, j] = (ahead.stress - behind.stress) / (2 * step)
    size_of = np.abs(here.tangent).max(axis=(1, 2))
    error = np.abs(numeric - here.tangent).max(axis=(1, 2)) / size_of
    # between elastic and plastic the stress has a kink, and no difference means anything
    plastic = [law.respond(strain + s).internal[:, 0] > 0 for s in (-2 * step, 2 * step)]
    return float(error[plastic[0] == plastic[1]].max()), float(plastic[0].mean())


# %% [markdown]
# ## A small problem
# A block on a smooth floor, 2 m wide and 2 m high, spreads under its weight. One law after the
# other.


# %%
@dataclass
class Input(Options):
    """Two laws that the library does not have."""

    h: float = positive(0.25, "size of the cells (m)")
    points_per_cell: int = natural(3, "in each direction")
    steps: int = natural(20)

    def _check(self):
        if abs(1 / self.h - round(1 / self.h)) > 1e-9:
            raise ValueError(f"h = {self.h} m must divide 1 m")


def settle(law, weight, E):
    """Let half of a block settle under ρg = weight (Pa/m); returns figures and points."""
    n = round(1 / args.h)
    grid = box_grid([(0, 0), (3, 2)], (3 * n, 2 * n))
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2)), args.points_per_cell, density=1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v) - ufl.inner(load, v) * points.dX
    stabilisation = mpm.Stabilisation("ghost", E=E)
    bcs = mpm.rollers(V, "left", "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    for share in mpm.steps(args.steps, label=type(law).__name__):
        load.value[1] = -weight * share
        problem.step()
    x, comm = points["x"], grid.comm
    return {
        "runout": comm.allreduce(float(x[:, 0].max(initial=0)), op=MPI.MAX),
        "height": comm.allreduce(float(x[:, 1].max(initial=0)), op=MPI.MAX),
        "plastic": comm.allreduce(float(points["plastic_strain"].max(initial=0)), op=MPI.MAX),
        **solver_figures(problem),
    }, points


args = Input.parse()
laws = {
    "Swift": (Swift(E=1e6, nu=0.3, A=10e3, first_strain=0.05, exponent=0.3), 25e3, 1e6),
    "perfect": (mpm.materials.VonMises(E=1e6, nu=0.3, radius=10e3), 25e3, 1e6),
    "sand": (
        mpm.materials.EnergyWithYield(
            sand_energy, cone, potential=flow,
            K=2e6, G=1e6, kappa=0.02, eta=0.4, eta_flow=0.1, k=6e3, a=1e3,
        ),
        25e3,
        2e6,
    ),
}  # fmt: skip
law_lines = (
    Path(__file__).read_text().split("# --- the law")[1].split("# --- its end")[0].count("\n") - 1
)
figures, states = {"law_lines": law_lines, "laws": {}}, {}
for name, (law, weight, modulus) in laws.items():
    error, plastic = tangent_error(law)
    result, points = settle(law, weight, modulus)
    figures["laws"][name] = {"tangent_error": error, "plastic_share": plastic, **result}
    states[name] = points.gather("x", "F", "l0", "plastic_strain")
    say(
        f"{name:8s} tangent against differences {error:.1e} ({plastic:.0%} plastic); runout "
        f"{result['runout'] - 1:.3f} m, {result['newton_iterations']} Newton iterations in "
        f"{args.steps} steps (at most {result['max_newton_iterations']})"
    )
say(f"Swift's law: {law_lines} lines")

# %% [markdown]
# ## Picture


# %%
def picture(path, states):
    """Draw the three blocks."""
    labels = {"Swift": "Swift's hardening", "perfect": "von Mises, perfect", "sand": "sand in UFL"}
    with mpm.figure(path, 7.2, 2.1, ncols=3, sharey=True) as (figure, panels):
        for axes, (name, (x, F, l0, alpha)) in zip(panels, states.items()):
            drawn = draw_points(axes, x, F, l0, alpha, cmap="viridis", clim=(0, 0.6))
            axes.plot([0, 1, 1], [2, 2, 0], "--", color="0.5", lw=0.6)
            axes.set(xlim=(0, 3), ylim=(0, 2.1), title=labels[name])
        for axes in panels[1:]:
            axes.set_ylabel("")
        figure.colorbar(drawn, ax=panels, label=r"plastic strain $\alpha$", extend="max")


if not args.no_plot and MPI.COMM_WORLD.rank == 0:
    picture(args.output / "your_own_law.png", states)

finish(args, figures)

# %% [markdown]
# # New physics and a new stabilisation, both in UFL
#
# A disc of living tissue grows between two plates. It grows most at its core, and not at all at
# its rim, which the core stretches. Tissue, growth and stabilisation are not part of the library:
# this script states the energy, the growth, the stress and the penalty on cut cells in UFL, at
# the material points. The library splits the form, derives flux and tangent, compiles them, and
# moves the points. To try another energy or another penalty, change its line.
#
# The disc is a good test. Its edge cuts the cells of the grid in every possible way. But its
# exact deformation is a function of the radius alone.

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from grown_disc import ExactDisc
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import draw_points, finish, say
from scipy import sparse

import dolfinmpm as mpm


# %%
@dataclass
class Input(Options):
    """Growing tissue: energy, growth and stabilisation in UFL."""

    law: str = option("neo-hookean", choices=("neo-hookean", "gent"))
    stabilisation: str = option("own", choices=("none", "own", "ghost"))
    factor: float = option(1.0, "penalty in units of E/90")
    cells: int = option(16, "over the radius")
    points_per_cell: int = natural(4, "in each direction")
    basis: str = option("gimp", choices=("linear", "gimp"))
    steps: int = natural(10)
    radius: float = positive(1e-3, "m, at first")
    modulus: float = positive(1e3, "Young's modulus (Pa)")
    poisson: float = 0.4
    stretch_limit: float = option(1.0, "Gent's J_m")
    growth: float = option(0.8, "of lengths, at the core")


args = Input.parse()
radius, h = args.radius, args.radius / args.cells
mu = args.modulus / (2 * (1 + args.poisson))
lmbda = args.modulus * args.poisson / ((1 + args.poisson) * (1 - 2 * args.poisson))

# %% [markdown]
# ## The energy
# Per volume, as a function of the first invariant $I_1 = \mathrm{tr}\,F^TF$ and of
# $J = \det F$: the compressible neo-Hookean law, and the one of Gent (1996, doi
# 10.5254/1.3538357), whose fibres cannot be stretched beyond $I_1 - 3 = J_m$,
#
# $$\psi_\mathrm{nH} = \tfrac\mu2 (I_1 - 3) - \mu\ln J + \tfrac\lambda2 (\ln J)^2, \qquad
#   \psi_\mathrm{G} = -\tfrac\mu2 J_m \ln\Bigl(1 - \frac{I_1 - 3}{J_m}\Bigr)
#   - \mu\ln J + \tfrac\lambda2 (\ln J)^2 .$$
#
# The logarithm is an argument, so that the exact solution at the end can use the same
# lines with NumPy's.


# %%
def neo_hookean(I1, J, ln):
    """Compressible neo-Hookean energy (J/m³)."""
    return mu / 2 * (I1 - 3) - mu * ln(J) + lmbda / 2 * ln(J) ** 2


def gent(I1, J, ln):
    """Gent's energy (J/m³), with a limit to the stretch."""
    limit = args.stretch_limit
    return -mu / 2 * limit * ln(1 - (I1 - 3) / limit) - mu * ln(J) + lmbda / 2 * ln(J) ** 2


energy = gent if args.law == "gent" else neo_hookean

# %% [markdown]
# ## The points
# A quarter of the disc, in a grid that has room for it to grow. Two fields of our own
# travel with the points: how much each grows, and the energy that it stores. The plates
# above and below keep the third direction as it is: growth and strain are plane.

# %%
across = int(np.ceil((1 + max(args.growth, 0.0)) * args.cells)) + 2
grid = box_grid([(0, 0), (across * h, across * h)], (across, across))
comm = grid.comm
quarter = mpm.Disc((0, 0), radius) & mpm.Box((0, 0), (radius, radius))
V = mpm.Space(grid, basis=args.basis)
u, v = V.increment, V.test
bcs = mpm.rollers(V, "left", "bottom")


def growth_of(R):
    """Growth of lengths in the end, by initial radius (m)."""
    return args.growth * (1 - (R / radius) ** 2)


def tissue():
    """Material points of the disc, with the fields `growth` and `energy`."""
    points = mpm.fill(grid, quarter, per_cell=args.points_per_cell, density=1e3)
    points.add_field("growth")
    points["growth"] = growth_of(np.linalg.norm(points["x0"], axis=1))
    points.add_field("energy", unit="J/m^3")
    return points


# %% [markdown]
# ## Physics is a line of UFL
# `points.F` is the deformation gradient at the start of the step and `grad(u)` the
# gradient of the step's increment: $F = (I + \nabla u)\,F_n$ is the one at its end. Growth
# by $g$ is a first, stress-free part of it, and only the rest stores energy (Rodriguez,
# Hoger & McCulloch 1994, doi 10.1016/0021-9290(94)90021-3),
#
# $$F = F_e F_g, \qquad F_g = g\,(I - e_z \otimes e_z) + e_z \otimes e_z, \qquad
#   \Pi = \int \det F_g\; \psi(F_e)\, \mathrm dX .$$
#
# A constant takes growth from nothing to its end, so that a step that fails can be halved.

# %%
progress = fem.Constant(grid, 0.0)


def grown_energy(points):
    """Energy per initial volume, and the deformation gradient that it is a function of."""
    g = 1 + progress * points.growth
    F = (ufl.Identity(2) + ufl.grad(u)) * points.F
    F = ufl.variable(ufl.as_tensor([[F[0, 0], F[0, 1], 0], [F[1, 0], F[1, 1], 0], [0, 0, 1]]))
    Fe = F * ufl.as_tensor([[1 / g, 0, 0], [0, 1 / g, 0], [0, 0, 1]])
    return g**2 * energy(ufl.inner(Fe, Fe), ufl.det(Fe), ufl.ln), F


# %% [markdown]
# ## What a step leaves behind is a line of UFL
# `updates` will name fields of the points, and the expressions to which a converged step
# sets them. The stress is not typed in by hand: it is that of whatever energy stands above,
# $\sigma = J^{-1}\, \partial\psi/\partial F \, F^T$.


# %%
def state(psi, F):
    """Fields of the points that follow from the energy."""
    stress = ufl.diff(psi, F) * ufl.transpose(F) / ufl.det(F)
    return {"stress": stress, "energy": psi}


# %% [markdown]
# ## Stabilisation is a line of UFL
# Cells that the body only touches hold their nodes by next to nothing. `points.dS` are
# the *ghost facets*, those between an active cell at the body's boundary and any other
# active cell. A penalty on the jump of the increment's normal derivative across them ties
# such nodes to their neighbours (Burman 2010, doi 10.1016/j.crma.2010.10.006). A linear
# motion has no jump and stays free.

# %%
gamma = args.factor * args.modulus / 90
n, size = ufl.FacetNormal(grid), mpm.cell_size(grid)


def penalty(points):
    """Our own ghost penalty."""
    jump_u, jump_v = ufl.jump(ufl.grad(u), n), ufl.jump(ufl.grad(v), n)
    return gamma * size * ufl.inner(jump_u, jump_v) * points.dS


# %% [markdown]
# ## Growing
# `ufl.derivative` makes the weak form of the energy, and the library the tangent of the
# form. After every step we look at the tangent's condition number, as long as the system
# is small.


# %%
def condition_number(K):
    """κ₂ of a PETSc matrix, or None where it has too many rows to be made dense."""
    if K.size[0] > 1500:
        return None
    indptr, columns, values = K.getValuesCSR()
    rows = comm.gather(sparse.csr_matrix((values, columns, indptr), (len(indptr) - 1, K.size[1])))
    return comm.bcast(float(np.linalg.cond(sparse.vstack(rows).toarray())) if rows else None)


def grow(points, form, updates=None):
    """Let the disc grow step by step; returns the problem and its condition numbers."""
    progress.value = 0.0
    problem = mpm.QuasiStatic(form, u, points, bcs=bcs, updates=updates)
    conditions = []
    for share in mpm.steps(args.steps, label="growth"):
        progress.value = share
        problem.step()
        conditions.append(condition_number(problem.stiffness()))
    return problem, conditions


points = tissue()
psi, F = grown_energy(points)
form = ufl.derivative(psi * points.dX, u, v)
if args.stabilisation == "own":
    form += penalty(points)
elif args.stabilisation == "ghost":
    form += mpm.ghost(points, u, v, gamma=3 * gamma)
ready = time.perf_counter()
problem, conditions = grow(points, form, state(psi, F))

# %% [markdown]
# A second disc has no stabilisation, for comparison.

# %%
bare_points = tissue()
psi, F = grown_energy(bare_points)
bare, bare_conditions = grow(bare_points, ufl.derivative(psi * bare_points.dX, u, v), state(psi, F))

# %% [markdown]
# A third is made of what the library offers: `mpm.materials.NeoHookean` is the energy
# above, and `mpm.ghost` with $\gamma = E/30$ the penalty above. It must move to the same
# place, to rounding.

# %%
from_library = None
if args.law == "neo-hookean":
    others = tissue()
    law = mpm.materials.NeoHookean(E=args.modulus, nu=args.poisson)
    g = 1 + progress * others.growth
    Fe = (ufl.Identity(2) + ufl.grad(u)) * others.F / g
    form = ufl.derivative(g**2 * law.energy(Fe) * others.dX, u, v)
    if args.stabilisation != "none":
        form += mpm.ghost(others, u, v, gamma=3 * gamma)
    grow(others, form)
    # points that moved alike are on the same ranks; sorted by number, in the same order
    first, second = np.argsort(points["id"]), np.argsort(others["id"])
    apart = np.inf
    if np.array_equal(points["id"][first], others["id"][second]):
        apart = np.abs(points["x"][first] - others["x"][second]).max(initial=0.0)
    from_library = float(comm.allreduce(apart, op=MPI.MAX) / radius)

# %% [markdown]
# ## The exact solution
# A ring of radius $R$ moves to $r(R)$ with the principal stretches $\lambda_r = r'$ and
# $\lambda_\theta = r/R$, which make
#
# $$\Pi(r) = \int_0^{R_0} g^2\, \psi\Bigl(\frac{\lambda_r}{g}, \frac{\lambda_\theta}{g}\Bigr)
#   R\, \mathrm dR$$
#
# stationary. A Ritz ansatz $r = R \sum_k c_k T_{2k}(R/R_0)$ with Chebyshev's polynomials
# solves it to all digits that matter here. Complex steps give the derivatives of the
# energy by the stretches.


# %%
exact = ExactDisc(energy, growth_of, radius, mu)
grown = float(exact.position(radius))

# %% [markdown]
# Displacement, stress and stored energy of the points are compared with it, the first two
# in the mean square over the body.


# %%
def total(points, values):
    """Sum over all points of values, shape (n,), weighted with their initial volumes."""
    return comm.allreduce(float(values @ points["V0"]))


displacement_error, stress_error = exact.errors(points)
bare_displacement_error, bare_stress_error = exact.errors(bare_points)


# %%
def worst(conditions):
    """The largest, or None where the system was too large."""
    return None if None in conditions else max(conditions)


iterations = [record.iterations for record in problem.history]
figures = {
    "displacement_error": displacement_error,
    "stress_error": stress_error,
    "area_ratio": total(points, points["V"] / points["V0"]) / total(points, np.ones(len(points))),
    "area_ratio_exact": (grown / radius) ** 2,
    "stored_energy": total(points, points["energy"]),
    "stored_energy_exact": exact.stored_energy,
    "condition_number": worst(conditions),
    "bare_condition_number": worst(bare_conditions),
    "bare_displacement_error": bare_displacement_error,
    "bare_stress_error": bare_stress_error,
    "bare_newton_iterations": sum(record.iterations for record in bare.history),
    "difference_from_library": from_library,
    "newton_iterations": sum(iterations),
    "max_newton_iterations": max(iterations),
    "halvings": sum(record.halvings for record in problem.history),
    "last_residuals": problem.history[-1].residuals,
    "points": points.total,
    "unknowns": problem.history[-1].unknowns,
    "migrated": sum(record.migrated for record in problem.history),
    "ranks": comm.size,
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say(
    f"{args.law}, {figures['points']} points, {comm.size} rank(s): area x "
    f"{figures['area_ratio']:.4f} (exact {figures['area_ratio_exact']:.4f}), "
    f"{sum(iterations)} Newton iterations in {args.steps} steps, {figures['seconds_solve']:.2f} s"
)
say(f"stabilisation      {args.stabilisation:>9s}      none")
for label, name in (
    ("displacement error", "displacement_error"),
    ("stress error      ", "stress_error"),
    ("worst κ(K)        ", "condition_number"),
    ("Newton iterations ", "newton_iterations"),
):
    say(label, *(f"{figures[key] or np.nan:9.3g}" for key in (name, f"bare_{name}")))
if from_library is not None:
    say(f"farthest from the library's own law and penalty: {from_library:.1e} of the radius")

# %% [markdown]
# ## Picture
# Left, every point as the parallelogram that its part of the body has become, with the
# stress around the centre: the core is pressed, the rim is stretched. The dashed lines are
# the edge at first and in the end. In the middle, the points' stresses beside the exact
# ones. Right, what the penalty is for.


# %%
def picture(path, x0, x, F, l0, stress):
    """Draw the grown disc, its stresses by radius and the condition numbers by step."""
    mm, kPa = 1e3, 1e-3
    R = np.linalg.norm(x0, axis=1)
    e = x0 / R[:, None]
    t = e @ np.array([[0, 1], [-1, 0]])
    along, around = (np.einsum("pi,pij,pj->p", a, stress[:, :2, :2], a) * kPa for a in (e, t))
    small = None not in conditions + bare_conditions
    panels = {"ncols": 3 if small else 2, "width_ratios": (1.15, 1, 0.9)[: 3 if small else 2]}
    with mpm.figure(path, 7.2 if small else 5.0, 2.4, **panels) as (figure, axes):
        left, middle = axes[:2]
        top = np.percentile(np.abs(around), 99.5)
        look = {"cmap": "RdBu_r", "clim": (-top, top)}
        drawn = draw_points(left, mm * x, F, mm * l0, around, **look)
        lines = np.arange(across + 1) * h * mm
        left.vlines(lines, 0, lines[-1], color="k", alpha=0.2, lw=0.3)
        left.hlines(lines, 0, lines[-1], color="k", alpha=0.2, lw=0.3)
        angle = np.linspace(0, np.pi / 2, 91)
        for r in (radius, grown):
            left.plot(mm * r * np.cos(angle), mm * r * np.sin(angle), "k--", lw=0.6)
        side = (0, mm * (grown + 1.5 * h))
        left.set(xlabel="$x$ (mm)", ylabel="$y$ (mm)", xlim=side, ylim=side)
        figure.colorbar(drawn, ax=left, label="stress around the centre (kPa)")

        s = np.linspace(1e-3, 1, 101) * radius
        for values, curve, name in zip(
            (along, around), exact.stress(s) * kPa, ("along the radius", "around the centre")
        ):
            (dots,) = middle.plot(R * mm, values, ".", ms=1, alpha=0.5, rasterized=True)
            middle.plot([], [], ".", color=dots.get_color(), label=name)
            middle.plot(s * mm, curve, "k", lw=0.8)
        middle.plot([], [], "k", lw=0.8, label="exact")
        low, high = np.percentile(np.concatenate([along, around]), (0.05, 99.95))
        room = 0.1 * (high - low)
        middle.set(xlabel="initial radius (mm)", ylabel="stress (kPa)")
        middle.set(xlim=(0, 1.02 * radius * mm), ylim=(low - room, high + room))
        middle.legend()
        if not small:
            return
        right = axes[2]
        share = np.arange(1, args.steps + 1) / args.steps
        right.semilogy(share, bare_conditions, "s-", color="0.5", label="no stabilisation")
        if args.stabilisation != "none":
            right.semilogy(share, conditions, "o-", color="C2", label="ghost penalty")
        # room for the legend
        right.set_ylim(0.3 * min(conditions), 3e3 * max(bare_conditions))
        right.set(xlabel="share of growth", ylabel="condition number of the tangent")
        right.legend(loc="upper left")


if not args.no_plot:
    with mpm.ParaView(args.output / "hyperelastic_in_ufl.pvd", points) as file:
        file.write(1.0)
    rows = points.gather("x0", "x", "F", "l0", "stress")
    if rows is not None:
        picture(args.output / "hyperelastic_in_ufl.png", *rows)

finish(args, figures)

# %% [markdown]
# # A cavity expands, long and round like a borehole or round like a ball
#
# A pressure widens a cavity of radius $a = 1$ in an elastic shell (Hencky), or in clay (Hencky
# and Tresca). The outer face at $b$ is free. With `--outer inf` it is infinitely far away. Cavity
# expansion is a test for cones, piles and pressuremeters. Both cavities are axisymmetric: the
# cylinder is a slice between smooth plates, the sphere is a quarter of its section. The sphere is
# not aligned with the grid. The axis is no boundary of the body.
#
# With $k = 1$ (cylinder) or $2$ (sphere) the exact solutions are those of
#
# $$\frac{d\sigma_r}{dr} + \frac kr (\sigma_r - \sigma_\theta) = 0, \qquad
#   \lambda_r = \frac{dr}{dR}, \quad \lambda_\theta = \frac rR .$$
#
# An incompressible body keeps its volume, $r^{k+1} - R^{k+1} = r(a)^{k+1} - a^{k+1}$. So the
# strains are known, and the pressure is an integral. With $I_r = G/c_u$, an infinite body has the
# limits $1 + \ln I_r$ (cylinder) and $\frac43 (1 + \ln I_r)$ (sphere) of $p/c_u$ (Hill 1950,
# chapter V; Gibson & Anderson 1961).

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import finish, say, solver_figures
from shells import HenckyShell, TrescaCavity, shell

import dolfinmpm as mpm

# Clay is next to incompressible: the closed form is that of ν = 0.5
DEFAULTS = {
    "hencky": {"poisson": 0.3, "outer": 2.0, "fbar": "off"},
    "tresca": {"poisson": 0.49, "outer": np.inf, "fbar": "on"},
}


@dataclass
class Input(Options):
    """Expansion of a cylindrical or spherical cavity."""

    shape: str = option("cylinder", choices=("cylinder", "sphere"))
    law: str = option("hencky", choices=tuple(DEFAULTS))
    poisson: float | None = option(None, "Poisson's ratio; by the law", least=0, below=0.5)
    rigidity_index: float = option(100.0, "G/c_u of clay", above=0)
    outer: float | None = option(None, "outer radius by the inner one, or inf", above=1)
    ratio: float = option(1.5, "r(a)/a at the end", above=1)
    h: float | None = positive(
        None,
        "size of the cells at the cavity; by default a 16th of the wall, "
        "and no more than an 8th of the cavity's radius in clay",
    )
    growth: float = option(1.12, "of cells far from the cavity", least=1)
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("bspline2", choices=BASES)
    configuration: str = option("total", choices=("total", "updated"))
    fbar: str | None = option(None, "against locking; by the law", choices=("on", "off", "volumes"))
    stabilisation: str = option("ghost", choices=("ghost", "aggregation"))
    steps: int = natural(20, "of equal growth of the cavity")

    def _check(self):
        self.fill(**DEFAULTS[self.law])
        if self.law == "hencky" and not np.isfinite(self.outer):
            raise ValueError(
                "outer = inf is for clay: what is far away is taken for incompressible"
            )
        wall = self.outer - 1 if np.isfinite(self.outer) else np.inf
        self.fill(h=min(wall / 16, 0.125 if self.law == "tresca" else 1.0))
        if not self.h <= min(1.0, 0.5 * (self.outer - 1)):
            raise ValueError(f"h = {self.h:g} must be at most half the wall, and 1")


# %% [markdown]
# ## The body
# An infinite one is cut off outside of what yields. What is beyond is elastic and
# incompressible and follows $\sigma_r = -2k\,G\,u/r$: springs on the outer face. Cells are of
# one size out to twice the cavity's radius and grow from there if the body is large.

# %%
args = Input.parse()
elastic, infinite = args.law == "hencky", not np.isfinite(args.outer)
exact = (
    HenckyShell(args.shape, args.poisson, args.outer) if elastic else
    TrescaCavity(args.shape, args.rigidity_index, args.outer)
)  # fmt: skip
if elastic:
    law = mpm.materials.Hencky(E=1.0, nu=args.poisson)
else:
    E = 2 * args.rigidity_index * (1 + args.poisson)
    law = mpm.materials.Tresca(E, args.poisson, cohesion=1.0)
b = max(10.0, 1.3 * exact.front(args.ratio)) if infinite else args.outer
# how far the grid is needed: under total increments it stays that of the body at first
moves = args.configuration == "updated"
room = TrescaCavity(args.shape, 1.0, b)(args.ratio)[1] / b if moves else 1.0
room = max(room, exact(args.ratio)[1] / b) if moves and not infinite else room
even = None if b <= 6 else 2.0 * (args.ratio if moves else 1.0)
body = shell(args.shape, 1.0, b, args.h, args.points_per_cell, room, even, args.growth)
points = body.points
V = mpm.Space(points.grid, args.basis, configuration=args.configuration)
u, v = V.increment, V.test
pressure = fem.Constant(points.grid, 1.0)
fbar = args.fbar if args.fbar == "volumes" else args.fbar == "on"
F = mpm.momentum(law, points, u, v, fbar=fbar) + body.inner.pressure(pressure, u, v)
if infinite:
    stiffness = 2 * exact.k * args.rigidity_index / b
    moved = body.outer.position(u) - points.x0 - body.outer.offset
    F += body.outer.traction(-fem.Constant(points.grid, stiffness) * moved, v)
growth = args.ratio ** (1 / args.steps) - 1
problem = mpm.ArcLength(
    F,
    u,
    points,
    bcs=mpm.rollers(V, *body.sides),
    load=pressure,
    control=-body.inner.mean_normal(v),
    length=growth,
    stabilisation=args.stabilisation,
)

# %% [markdown]
# ## Steps of equal growth
# The pressure is found with the increment, past its largest value too.

# %%
ready = time.perf_counter()
curve, shares = [(1.0, 0.0)], mpm.steps(args.steps, label="radius of the cavity")
while curve[-1][0] < args.ratio * (1 - 1e-9):
    next(shares, None)
    now = curve[-1][0]
    problem.path.length = min(growth * now, args.ratio - now)
    record = problem.step()
    curve.append((1.0 + record.displacement, record.factor))
curve = np.array(curve)

# %% [markdown]
# ## Against the closed form
# In a cylinder stretch and stress inside are extrapolated from the points within some cells, in a
# sphere the skin has them. Where clay yields, F-bar leaves waves in the pressure, but not in the
# difference of hoop and radial stress, of which the latter is the pressure inside.

# %%
x0, deformation, sigma = points["x0"], points["F"], points["stress"]
outer_radius = b + body.mean_radial(body.outer)
apart = sigma[:, 2, 2] - body.radial(points["x"], sigma)
turned = deformation[:, 2, 2] * x0[:, 0] / points["x"][:, 0]
ratio = float(curve[-1, 0])
p, far, stretch, hoop = exact(ratio)
hoop_inside = body.inside(sigma[:, 2, 2], 6 * args.h, exact.k + 1)
if not elastic:
    hoop_inside = body.inside(apart, 4 * args.h) - curve[-1, 1]
figures = {
    "pressure": float(curve[-1, 1]),
    "pressure_exact": float(p),
    "error": float(curve[-1, 1] / p - 1),
    "outer_radius": float(outer_radius) if not infinite else None,
    "outer_radius_exact": float(far) if not infinite else None,
    "stretch": body.inside(body.radial(x0, deformation), 4 * args.h),
    "stretch_exact": float(stretch),
    "hoop_stress": float(hoop_inside),
    "hoop_stress_exact": float(hoop),
    "inner_radius": ratio,
    "modelled_radius": float(b),
    "radii": curve[:, 0].tolist(),
    "pressures": curve[:, 1].tolist(),
    "hoop_stretch_error": points.comm.allreduce(
        float(np.abs(turned - 1).max(initial=0)), op=MPI.MAX
    ),
    **solver_figures(problem),
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
if infinite:
    args.outer = None
unit = "E" if elastic else "c_u"
say(
    f"{args.shape}, {args.law}, {args.basis}, h = {args.h:g}, {figures['points']} points, "
    f"{points.comm.size} rank(s): at r(a)/a = {ratio:.4f} the pressure is {curve[-1, 1]:.6f} "
    f"{unit}, {figures['error']:+.2%} from {p:.6f}; stretch {figures['stretch']:.4f} "
    f"({stretch:.4f}), hoop stress {figures['hoop_stress']:.4f} ({hoop:.4f}); "
    f"{figures['newton_iterations']} Newton iterations in {len(curve) - 1} steps, "
    f"{figures['seconds_solve']:.1f} s"
)


# %% [markdown]
# ## Picture
# Pressure over the radius of the cavity, and the radial and hoop stress of all points at the end.


# %%
def picture(path, gathered):
    """The curve, and stresses over the present radius."""
    x, sigma = gathered
    r, radial = body.radius(x)[0], body.radial(x, sigma)
    fine = np.linspace(1.0, curve[-1, 0], 25)[1:]
    closed = [0.0, *(exact(a)[0] for a in fine)]
    name = "E" if elastic else "c_u"
    with mpm.figure(path, 6.5, 2.6, ncols=2) as (_, (left, right)):
        left.plot([1.0, *fine], closed, color="C0", label="closed form")
        left.plot(curve[:, 0], curve[:, 1], "o", ms=3, color="C1", label="material points")
        left.set(xlabel="$r(a)/a$", ylabel=f"pressure $p/{name}$", ylim=(0, None))
        left.legend(loc="lower right")
        right.plot(r, radial, ".", ms=1.5, color="C2", rasterized=True, label=r"$\sigma_r$")
        right.plot(r, sigma[:, 2, 2], ".", ms=1.5, color="C1", rasterized=True,
                   label=r"$\sigma_\theta$")  # fmt: skip
        right.set(xlabel="$r/a$", ylabel=f"stress by ${name}$")
        if b > 6:
            right.set_xscale("log")
        right.legend()
        right.set_title(args.shape, fontsize=8)


gathered = None if args.no_plot else points.gather("x", "stress")
if gathered is not None:
    picture(args.output / f"cavity_expansion_{args.shape}_{args.law}.png", gathered)

finish(args, figures)

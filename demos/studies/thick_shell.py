# %% [markdown]
# # A thick sphere yields from the inside outwards, as the tube beside it does
#
# A hollow sphere with the radii $a$ and $b$ is loaded by an internal pressure. It is elastic and
# perfectly plastic (von Mises, uniaxial yield stress $\sigma_y$), and yields for $r \le c$
# (de Souza Neto, Perić & Owen 2008, section 7.5.2):
#
# $$p = 2\sigma_y \ln\frac ca + \frac{2\sigma_y}{3}\Bigl(1 - \frac{c^3}{b^3}\Bigr), \qquad
#   u_b = \frac{\sigma_y c^3 (1-\nu)}{E\,b^2}, \qquad p_{\lim} = 2\sigma_y \ln\frac ba .$$
#
# It is a body of revolution: a quarter of its section, of which all points are rings. Squares
# know nothing of its circles. `--shape cylinder` is the tube of `thick_cylinder.py` as a slice
# between smooth plates, with $Y = 2\sigma_y/\sqrt 3$ in
#
# $$p = Y\Bigl[\ln\frac ca + \frac12\Bigl(1 - \frac{c^2}{b^2}\Bigr)\Bigr], \qquad
#   u_b = \frac{Y c^2 (1-\nu^2)}{E\,b} .$$

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
from dolfinx import fem
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say, solver_figures
from scipy.optimize import brentq
from shells import ACROSS, shell

import dolfinmpm as mpm


class Yielding:
    """Closed form of a shell of radii a and b (m) of small strains."""

    def __init__(self, shape, a, b, E, nu, strength):
        self.k, self.a, self.b = ACROSS[shape], a, b
        # difference of hoop and radial stress that yields, and u_b by c^(k+1)
        self.Y = strength if shape == "sphere" else 2 * strength / np.sqrt(3)
        self.compliance = self.Y / (E * b**self.k)
        self.compliance *= 1 - nu if shape == "sphere" else 1 - nu**2
        self.limit = self.k * self.Y * np.log(b / a)
        self.last_displacement = self.compliance * b ** (self.k + 1)

    def pressure(self, u):
        """Pressure (Pa) at the outer displacement u (m)."""
        n = self.k + 1
        grown = np.asarray(u, float) / self.compliance
        c = np.clip(grown, self.a**n, self.b**n) ** (1 / n)
        share = self.k * self.Y / n
        plastic = self.k * self.Y * np.log(c / self.a) + share * (1 - (c / self.b) ** n)
        elastic = share * (1 / self.a**n - 1 / self.b**n) * grown
        return np.where(grown < self.a**n, elastic, plastic)

    def displacement(self, p):
        """Outer displacement (m) under a pressure (Pa) below the limit."""
        return brentq(lambda u: self.pressure(u) - p, 0, self.last_displacement, xtol=1e-16)

    def front(self, u):
        """Radius c (m) of the plastic zone."""
        n = self.k + 1
        return float(np.clip(u / self.compliance, self.a**n, self.b**n) ** (1 / n))

    def stress(self, r, u):
        """Radial and hoop stress (Pa) at the radii r (m); once it yields anywhere."""
        n, c, Y = self.k + 1, self.front(u), self.Y
        share = self.k * Y / n * (c / self.b) ** n
        flow = self.k * Y * np.log(r / c) - self.k * Y / n + share
        radial = np.where(r < c, flow, share * (1 - (self.b / r) ** n))
        return radial, np.where(r < c, flow + Y, share * (1 + (self.b / r) ** n / self.k))


@dataclass
class Input(Options):
    """A thick sphere, or tube, under internal pressure, beyond its limit load."""

    shape: str = option("sphere", choices=tuple(ACROSS))
    h: float = positive(0.00625, "size of the cells (m)")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("bspline2", choices=BASES)
    strain: str = option("small", choices=("small", "large"))
    fbar: str = switch("on", "against locking")
    stabilisation: str = option("ghost", choices=("ghost", "aggregation"))
    steps: int = natural(24, least=2)
    reach: float = option(1.2, "last outer displacement, over that at the limit", above=1)
    inner: float = positive(0.1, "inner radius (m)")
    outer: float = positive(0.2, "outer radius (m)")
    modulus: float = positive(210e9, "Young's modulus (Pa)")
    poisson: float = 0.3
    strength: float = option(0.24e9, "uniaxial yield stress, Pa")

    def _check(self):
        if not self.inner < self.outer < np.inf:
            raise ValueError(f"radii {self.inner} and {self.outer} m must increase")
        if not self.h <= 0.5 * (self.outer - self.inner):
            raise ValueError(f"h = {self.h} m must be at most half the wall")


# %% [markdown]
# ## The scene
# Rollers on the axis and at the equator. Under small strain the pressure acts on the face as it
# was; points move all the same, and the half per cent by which radii grow shows in the limit. Under
# large strain it follows the face. Von Mises' law takes $\rho_y = \sqrt{2/3}\,\sigma_y$. The
# solver is given the outer displacement and finds the pressure, also where it no longer rises.

# %%
args = Input.parse()
a, b, h = args.inner, args.outer, args.h
exact = Yielding(args.shape, a, b, args.modulus, args.poisson, args.strength)
body = shell(args.shape, a, b, h, args.points_per_cell)
points = body.points
V = mpm.Space(points.grid, args.basis)
u, v = V.increment, V.test
steel = mpm.materials.VonMises(E=args.modulus, nu=args.poisson, yield_stress=args.strength)
pressure = fem.Constant(points.grid, exact.limit)
F = mpm.momentum(steel, points, u, v, strain=args.strain, fbar=args.fbar == "on")
if args.strain == "large":
    F += body.inner.pressure(pressure, u, v)
else:
    # on the face as it was, along its normal then
    area = fem.Constant(points.grid, body.inner.total_area)
    F += area * pressure * body.inner.mean_normal(v)
length = args.reach * exact.last_displacement / args.steps
problem = mpm.ArcLength(
    F,
    u,
    points,
    bcs=mpm.rollers(V, *body.sides),
    load=pressure,
    control=body.outer.mean_normal(v),
    length=length,
    max_length=length,
    target_iterations=50,
    stabilisation=args.stabilisation,
)

# %% [markdown]
# ## Steps of equal outer displacement
# At the step next to $c = \sqrt{ab}$ the stresses are kept for the picture.

# %%
ready = time.perf_counter()
shown = max(1, round(exact.compliance * (a * b) ** (0.5 * (exact.k + 1)) / length))
curve, field = [(0.0, 0.0)], None
for _ in mpm.steps(args.steps, label="outer displacement"):
    record = problem.step()
    curve.append((record.displacement, record.factor * exact.limit))
    if len(problem.history) == shown:
        field = points.gather("x0", "stress", "tag")
curve = np.array(curve)

# %% [markdown]
# ## Against the closed form
# Near the limit the displacement says little about the pressure's error, and less in return.

# %%
closed = exact.pressure(curve[1:, 0])
error = curve[1:, 1] / closed - 1
lower = curve[(curve[:, 1] > 0) & (curve[:, 1] < 0.95 * exact.limit)]
displacement_error = [w / exact.displacement(p) - 1 for w, p in lower]
figures = {
    "outer_displacement": curve[:, 0].tolist(),
    "pressure": curve[:, 1].tolist(),
    "pressure_exact": [0.0, *closed.tolist()],
    "max_pressure_error": float(np.abs(error).max()),
    "max_displacement_error": float(np.abs(displacement_error).max()),
    "limit_load": float(curve[-1, 1]),
    "limit_load_exact": float(exact.limit),
    "limit_load_error": float(curve[-1, 1] / exact.limit - 1),
    **solver_figures(problem),
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say(
    f"{args.shape}, {args.basis}, {args.stabilisation}, h = {h:g} m, {figures['points']} points, "
    f"{points.comm.size} rank(s): pressure within {figures['max_pressure_error']:.2%} of the "
    f"closed form, limit load {1e-9 * curve[-1, 1]:.5f} GPa ({figures['limit_load_error']:+.2%}), "
    f"{figures['newton_iterations']} Newton iterations in {args.steps} steps, "
    f"{figures['seconds_solve']:.1f} s"
)


# %% [markdown]
# ## Picture
# The curve, and the stresses of all points at the step that was kept.


# %%
def picture(path, field, displacement):
    """Pressure over displacement, and stresses over the radius."""
    x0, stress, tag = field
    x0, stress = x0[tag == 0], stress[tag == 0]
    r, radial = body.radius(x0)[0], body.radial(x0, stress)
    R = np.linspace(a, b, 300)
    with mpm.figure(path, 6.5, 2.6, ncols=2) as (_, (left, right)):
        fine = np.linspace(0, curve[-1, 0], 400)
        left.plot(1e3 * fine, exact.pressure(fine) / 1e6, color="C0", label="closed form")
        left.plot(1e3 * curve[:, 0], curve[:, 1] / 1e6, "o", ms=3, color="C1",
                  label="material points")  # fmt: skip
        left.axhline(exact.limit / 1e6, color="0.5", ls="--", lw=0.8)
        left.set(xlabel="outer displacement $u_b$ (mm)", ylabel="internal pressure $p$ (MPa)")
        left.set(xlim=(0, None), ylim=(0, 1.12 * exact.limit / 1e6))
        left.legend(loc="lower right")
        for values, closed, name, colour in zip(
            (stress[:, 2, 2], radial), exact.stress(R, displacement)[::-1], ("\\theta", "r"),
            ("C1", "C2"),
        ):  # fmt: skip
            right.plot(1e3 * r, values / 1e6, ".", ms=1.5, alpha=0.6, color=colour, rasterized=True)
            right.plot(1e3 * R, closed / 1e6, "k-", lw=0.8)
            right.plot([], [], ".", ms=5, color=colour, label=f"$\\sigma_{{{name}}}$")
        right.plot([], [], "k-", lw=0.8, label="closed form")
        right.set(xlabel="radius (mm)", ylabel="stress (MPa)")
        right.legend(loc="lower right")


if not args.no_plot and field is not None:
    picture(args.output / f"thick_{args.shape}_of_rings.png", field, curve[shown, 0])

finish(args, figures)

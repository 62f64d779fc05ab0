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
# It is axisymmetric: a quarter of its section is computed, whose points are rings. Squares
# know nothing of its circles. `--shape cylinder` is the tube of `thick_cylinder.py` as a slice
# between smooth plates, with $Y = 2\sigma_y/\sqrt 3$ in
#
# $$p = Y\Bigl[\ln\frac ca + \frac12\Bigl(1 - \frac{c^2}{b^2}\Bigr)\Bigr], \qquad
#   u_b = \frac{Y c^2 (1-\nu^2)}{E\,b} .$$

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

from dolfinx import fem
from options import BASES, natural, option, other_default, switch
from scene import finish, say, solver_figures
from shells import ACROSS, shell
from yielding_shell import ShellInput, Yielding, compared, draw_curve, draw_stresses, widen

import dolfinmpm as mpm


@dataclass
class Input(ShellInput):
    """A thick sphere, or tube, under internal pressure, beyond its limit load."""

    shape: str = option("sphere", choices=tuple(ACROSS))
    h: float = other_default(ShellInput, "h", 0.00625)
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("bspline2", choices=BASES)
    strain: str = option("small", choices=("small", "large"))
    fbar: str = switch("on", "against locking")
    stabilisation: str = option("ghost", choices=("ghost", "aggregation"))
    reach: float = other_default(ShellInput, "reach", 1.2)


# %% [markdown]
# ## The problem
# Rollers on the axis and at the equator. Under small strain the pressure acts on the face as it
# was; points move all the same, and the half per cent by which radii grow shows in the limit. Under
# large strain it follows the face. Von Mises' law takes $\rho_y = \sqrt{2/3}\,\sigma_y$. The
# solver is given the outer displacement and finds the pressure, also where it no longer rises.

# %%
args = Input.parse()
a, b, h = args.inner, args.outer, args.h
exact = Yielding(args.shape, args)
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

# %% [markdown]
# ## Steps of equal outer displacement
# At the step next to $c = \sqrt{ab}$ the stresses are kept for the picture.

# %%
ready = time.perf_counter()
problem, curve, field, shown = widen(
    args, exact, F, u, points, "x0", "stress", "tag",
    bcs=mpm.rollers(V, *body.sides), load=pressure, control=body.outer.mean_normal(v),
    stabilisation=args.stabilisation,
)  # fmt: skip

# %% [markdown]
# ## Against the closed form
# Near the limit the displacement says little about the pressure's error, and less in return.

# %%
figures = {
    **compared(exact, curve),
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
    with mpm.figure(path, 6.5, 2.6, ncols=2) as (_, (left, right)):
        draw_curve(left, exact, curve)
        draw_stresses(right, exact, displacement, r, stress[:, 2, 2], radial)


if not args.no_plot and field is not None:
    picture(args.output / f"thick_{args.shape}_of_rings.png", field, shown)

finish(args, figures)

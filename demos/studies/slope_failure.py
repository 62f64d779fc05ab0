# %% [markdown]
# # A slope fails: which runs come to the end?
#
# Coombs (2023, doi 10.1002/nme.7332) brings a slope of soft clay with a weak zone to failure with
# GIMP, on three grids and with three densities of points, and counts the runs that finish. Without
# a stabilisation against small cuts several do not; with ghost stabilisation all do. Material,
# number of steps and the table are published, the shape of the slope only as a picture. The one
# here is
#
# - ground 24 m wide and 2 m thick, on a rough base between smooth walls;
# - on it a slope 6 m high at 45°, with its toe at $x = 12$ m and its crest from $x = 0$ to 6 m, so
#   that the body is 8 m high at the left wall; all that is not above the line
#   $x + y = 14$ m belongs to it;
# - at the foot of the slope a weak zone 8 m long and 1 m thick, $4 \le x \le 12$ m,
#   $2 \le y \le 3$ m;
# - a grid of squares over 24 m by 9 m.
#
# Young's modulus is 1 MPa, Poisson's ratio 0.3, the density 2400 kg/m³. Gravity of 10 m/s² comes
# in $40/h$ equal steps ($h$ in m). The radius $\rho_y$ of von Mises' $f = \sqrt{2J_2} - \rho_y$
# is 15 kPa, and 7.5 kPa in the weak zone. The undrained strength is $c_u = \rho_y/\sqrt2$. A
# slope of 45° without a weak zone stands up to a height of about $5.5\,c_u/(\rho g) = 2.4$ m
# (Taylor's chart). This slope is two and a half times as high.
#
# The slope slides over the weak zone onto the ground in front of it. Its toe moves by several
# metres. Points pass the lines of the grid, and their domains are slivers in the new cells.
#
# With `--refine yield` cells are halved where the clay yields, and points split with them. From
# cells of 1 m, halved once, the toe moves by 3.88 m, with 826 unknowns at the end. On a grid of
# 0.5 m it moves by 3.86 m, with 838 unknowns. At the end much of the slope yields, so the leaves
# save unknowns only before that. Halved twice, the toe moves by 5.2 m, and by 6.0 m on a grid of
# 0.25 m in as many steps, because the stepped surface of the first points stays. Leaves must come
# early: with `--least 0.2` and two levels at once, the slope moves already when its cells are
# halved, and the new cells have no equilibrium.

# %%
import time
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say
from weak_slope import (
    BASE,
    DENSITY,
    GRAVITY,
    GRID_TOP,
    NU,
    TOE,
    WEAK,
    YIELD,
    ZONE,
    E,
    draw_slope,
    in_body,
    in_zone,
)

import dolfinmpm as mpm
from dolfinmpm.io.gridlines import grid_lines

WIDTH = 24.0
STABILISATIONS = "none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"


@dataclass
class Input(Options):
    """A slope with a weak zone fails under its weight."""

    table: bool = option(False, "run all of the lists below, and draw a table")
    h: str | None = option(None, "size of the cells (m), divides 1; with --table 1,0.5,0.25")
    points_per_cell: str | None = option(None, "in each direction; with --table 2,3,4")
    stabilisation: str | None = option(
        None, f"of {', '.join(STABILISATIONS)}; with --table none,ghost,aggregation"
    )
    ghost: str | None = switch(None, "ghost stabilisation or none")
    basis: str = option("gimp", choices=BASES)
    law: str = option("von-mises", choices=("von-mises", "tresca"))
    steps: int | None = natural(None, "of gravity; 40/h by default")
    refine: str = option("none", "halve cells where the clay yields", choices=("none", "yield"))
    levels: int = natural(1, "how often cells are halved with --refine yield", most=4)
    least: float = positive(0.02, "least plastic strain with --refine yield")

    def _check(self):
        if self.ghost is not None and self.stabilisation is not None:
            raise ValueError("--ghost and --stabilisation exclude each other")
        if self.ghost is not None:
            self.stabilisation = "ghost" if self.ghost == "on" else "none"
        defaults = ("1,0.5,0.25", "2,3,4", "none,ghost,aggregation")
        defaults = defaults if self.table else ("1", "2", "ghost")
        kinds = {"h": float, "points_per_cell": int, "stabilisation": str}
        for (name, kind), default in zip(kinds.items(), defaults):
            try:
                values = [kind(word) for word in (getattr(self, name) or default).split(",")]
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
            if len(values) > 1 and not self.table:
                raise ValueError(f"{name}: more than one value needs --table")
            setattr(self, name, values)
        for h in self.h:
            if not 0 < h <= 1 or abs(1 / h - round(1 / h)) > 1e-9:
                raise ValueError(f"h = {h:g} m must divide 1 m")
        for name in self.stabilisation:
            if name not in STABILISATIONS:
                raise ValueError(
                    f"stabilisation = {name} must be one of {', '.join(STABILISATIONS)}"
                )
        if min(self.points_per_cell) < 1 or (self.steps is not None and self.steps < 1):
            raise ValueError("points-per-cell and steps must be at least 1")


# %% [markdown]
# ## One run
# A step in which full Newton steps do not converge is tried again with a line search, and then
# halved, up to ten times. If that does not help, the run ends there, and the table says so, with
# the share of gravity that was reached. The line search matters: for $h = 0.25$ m full steps go to
# and fro between two states when the toe overhangs the ground, however small the load, with ghost
# stabilisation too. With it all runs with ghost stabilisation or aggregation come to the end;
# without stabilisation most do not, and rounding decides which.


# %%
def law_of(name):
    """The law; both have the undrained strength ρ_y/√2."""
    if name == "tresca":
        cohesion = np.array([YIELD, WEAK]) / np.sqrt(2)
        return mpm.materials.Tresca(E, NU, lambda x: np.where(in_zone(x), cohesion[1], cohesion[0]))
    return mpm.materials.VonMises(E, NU, radius=lambda x: np.where(in_zone(x), WEAK, YIELD))


def run(h, per_cell, stabilisation, args):
    """Bring the slope to failure; returns the figures of the run and its points. Collective."""
    started = time.perf_counter()
    grid = box_grid([(0, 0), (WIDTH, GRID_TOP)], (round(WIDTH / h), round(GRID_TOP / h)))
    comm = grid.comm
    points = mpm.fill(grid, mpm.Where(lambda x: in_body(x, WIDTH)), per_cell, DENSITY)
    refined = {}
    if args.refine == "yield":
        # leaves follow the band, and points follow the leaves
        where = mpm.where_it_yields(points, h / 2**args.levels, least=args.least)
        refined = {"refine": where, "levels": args.levels, "per_cell": per_cell}
    V = mpm.Space(grid, args.basis, **refined)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law_of(args.law), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    steps = args.steps or round(40 / h)
    reason = ""
    for load in mpm.steps(steps, label=f"h = {h:g} m, {per_cell}², {stabilisation}"):
        gravity.value[1] = -GRAVITY * load
        try:
            problem.step()
        except mpm.errors.DolfinMPMError as error:
            # the run's outcome is what is asked for, good or bad
            reason = f"{type(error).__name__}: {error}"
            break
    history = problem.history
    slope = points["x0"][:, 1] > BASE
    reach = np.einsum("pj,pj->p", np.abs(points["F"][:, 0]), points["l0"])
    front = comm.allreduce((points["x"][:, 0] + reach)[slope].max(initial=-np.inf), op=MPI.MAX)
    top = comm.allreduce(points["x"][slope, 1].max(initial=-np.inf), op=MPI.MAX)
    strain = comm.allreduce(points["plastic_strain"].max(initial=0.0), op=MPI.MAX)
    return {
        "h": h,
        "points_per_cell": per_cell,
        "stabilisation": stabilisation,
        "ghost": "on" if stabilisation == "ghost" else "off",
        "completed": not reason,
        "steps": steps,
        "steps_done": len(history),
        "gravity_reached": float(-gravity.value[1] / GRAVITY),
        "newton_iterations": sum(record.iterations for record in history),
        "max_newton_iterations": max((record.iterations for record in history), default=0),
        "halvings": sum(record.halvings for record in history),
        "imbalance": max((record.imbalance for record in history), default=1.0),
        "runout": float(front - TOE),
        "top": float(top),
        "max_plastic_strain": float(strain),
        "points": points.total,
        "unknowns": history[-1].unknowns if history else 0,
        "split": sum(record.split for record in history),
        "merged": sum(record.merged for record in history),
        "ranks": comm.size,
        "seconds": time.perf_counter() - started,
        "reason": reason,
    }, points


def describe(result):
    """A line on a run."""
    end = "completed" if result["completed"] else f"ended at {result['gravity_reached']:.1%}"
    r = {**result, "end": end}
    return (
        "h = {h:4g} m, {points_per_cell}² points, {stabilisation:16s} {end:14s} {steps_done:3d} of "
        "{steps} steps, {newton_iterations:4d} iterations (at most {max_newton_iterations}), "
        "{halvings} halvings, runout {runout:5.2f} m, plastic strain {max_plastic_strain:5.2f}, "
        "{seconds:.1f} s"
    ).format(**r)


# %% [markdown]
# ## Pictures
# The deformed body with its plastic strain over its first outline; for a table, the outcomes, and
# below them the states in which runs with a stabilisation came to their end.


# %%
def draw_state(axes, state, limit):
    """Draw the deformed body over its first outline."""
    drawn = draw_slope(axes, state, limit, WIDTH)
    (left, right), (low, high) = ZONE
    corners = [(left, low), (right, low), (right - (high - low), high), (left, high), (left, low)]
    axes.plot(*np.array(corners).T, color="0.8", lw=0.6, ls=":")
    axes.set(xlim=(0, WIDTH), ylim=(0, GRID_TOP))
    return drawn


STATE = "x", "F", "l0", "plastic_strain"


def picture(path, rows, label, lines):
    """Draw one state, and the lines of leaves if there are any."""
    from matplotlib.collections import LineCollection

    with mpm.figure(path, 6.5, 3.0) as (figure, axes):
        axes.add_collection(LineCollection([*lines], colors="0.7", alpha=0.4, linewidths=0.3))
        drawn = draw_state(axes, rows, np.percentile(rows[3], 99.5))
        axes.set_title(label)
        bar = figure.colorbar(drawn, ax=axes, extend="max", shrink=0.75)
        bar.set_label(r"plastic strain $\alpha$")


def table_picture(path, results, states, args):
    """Draw the outcomes of all runs, and one state for every size of cells."""
    stabilisations, shown = args.stabilisation, sorted(states, reverse=True)
    # as high as the states are at the width that they have
    lower = 0.75 + 6.2 / len(shown) * GRID_TOP / WIDTH if shown else 0.0
    height = 0.95 + 0.3 * len(args.h) + lower
    with mpm.figure(path, 7.2, height) as (figure, old):
        old.remove()
        parts = [figure]
        if shown:
            parts = figure.subfigures(2, 1, height_ratios=(height - lower, lower))
        for axes, stabilisation in zip(
            np.atleast_1d(parts[0].subplots(1, len(stabilisations))), stabilisations
        ):
            of_stabilisation = [r for r in results if r["stabilisation"] == stabilisation]
            outcome = {(r["h"], r["points_per_cell"]): r for r in of_stabilisation}
            for row, h in enumerate(args.h):
                for column, n in enumerate(args.points_per_cell):
                    one = outcome[h, n]
                    box = (column - 0.5, row - 0.5), 1, 1
                    colour = "#B7DFC9" if one["completed"] else "#F3C9AE"
                    axes.add_patch(_rectangle(*box, colour))
                    text = "✓" if one["completed"] else f"✗ {100 * one['gravity_reached']:.0f} %"
                    axes.text(column, row, text, ha="center", va="center")
            columns, lines = len(args.points_per_cell), len(args.h)
            axes.set(xlim=(-0.5, columns - 0.5), ylim=(lines - 0.5, -0.5), title=stabilisation)
            axes.set_xticks(range(columns), labels=[f"{n}²" for n in args.points_per_cell])
            axes.set_yticks(range(lines), labels=[f"{h:g}" for h in args.h])
            axes.tick_params(length=0)
            axes.grid(visible=False)
            axes.set_xlabel("points per cell")
        parts[0].axes[0].set_ylabel("$h$ (m)")
        parts[0].suptitle("✓ came to the end, ✗ ended at this share of gravity", fontsize=7)
        if not shown:
            return
        panels = np.atleast_1d(parts[1].subplots(1, len(shown), sharey=True))
        for axes, h in zip(panels, shown):
            label, rows = states[h]
            drawn = draw_state(axes, rows, 2.0)
            axes.set_title(label)
        for axes in panels[1:]:
            axes.set_ylabel("")
        bar = parts[1].colorbar(drawn, ax=[*panels], extend="max", shrink=0.6)
        bar.set_label(r"plastic strain $\alpha$")


def _rectangle(corner, width, height, colour):
    from matplotlib.patches import Rectangle

    return Rectangle(corner, width, height, facecolor=colour, edgecolor="white", linewidth=1.5)


# %% [markdown]
# ## Runs

# %%
args = Input.parse()
results, states = [], {}
for h in args.h:
    for per_cell in args.points_per_cell:
        for stabilisation in args.stabilisation:
            result, points = run(h, per_cell, stabilisation, args)
            results.append(result)
            say(describe(result))
            if result["reason"]:
                say(f"    {result['reason'][:160]} ...")
            if not args.no_plot and (stabilisation == "ghost" or len(args.stabilisation) == 1):
                state = points.gather(*STATE)
                if state is not None:
                    states[h] = f"h = {h:g} m, {per_cell}², {stabilisation}", state

if not args.table:
    result = results[0]
    if not args.no_plot:
        with mpm.ParaView(args.output / "slope_failure.pvd", points) as file:
            file.write(result["gravity_reached"])
        state = points.gather(*STATE)
        drawn = grid_lines(points.grid, None) if args.refine == "yield" else []
        if state is not None:
            label = "" if result["completed"] else f"at {result['gravity_reached']:.1%} of gravity"
            picture(args.output / "slope_failure.png", state, label, drawn)
    finish(args, result)
else:
    stabilised = [r["completed"] for r in results if r["stabilisation"] in ("ghost", "aggregation")]
    bare = [r["completed"] for r in results if r["stabilisation"] == "none"]
    say(
        f"with ghost penalty or aggregation {sum(stabilised)} of {len(stabilised)} runs came to "
        f"the end, without stabilisation {sum(bare)} of {len(bare)}"
    )
    mpm.study.write_table(results, args.output / "slope_failure_table.csv")
    if not args.no_plot and MPI.COMM_WORLD.rank == 0:
        table_picture(args.output / "slope_failure_table.png", results, states, args)
    finish(args, {"runs": results, "all_stabilised_completed": all(stabilised)})

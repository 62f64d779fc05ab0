# %% [markdown]
# # The generalised vortex: orders in space and in time of steps in time
#
# A ring turns within itself: each circle of points goes to and fro by an angle $\alpha$ that
# depends on its radius,
#
# $$\theta = \Theta + \alpha, \qquad \alpha = g(t)\,h(R), \qquad g = A \sin(\pi t/T), \qquad
#   h = 1 - 32 (R-1)^2 + 256 (R-1)^4, \qquad \tfrac34 \le R \le \tfrac54$$
#
# (Brannon, Kamojjala & Sadeghirad 2011, Particles). With $A = 1$ the middle of the ring moves by
# a radian, no volume changes, and $h$ and $h'$ vanish at both edges,
# which so are free of strain and of traction. The edges lie in the cells anyhow: what an order
# shows here is that of the whole method in motion. By default $A = 0.1$, so that points cross
# a cell or two. With $A = 1$ the shear reaches 6, and the fastest points move at nearly
# three times the speed of waves. Explicit steps with quadratic splines and "tpic" come through to
# T/2, with 15, 4.3 and 1.8 % of error with cells of 1/8, 1/16 and 1/32 (`--amplitude 1
# --integrator explicit`): points in the outer edge, where few lie in the cut cells, err by the
# most, and the order falls. With GIMP and with "flip" the error on the third grid is larger than
# on the second.
#
# The force per mass that the motion takes has, along the present $e_r$ and $e_\theta$, the parts
#
# $$b_r = -R\dot\alpha^2 + \frac{\mu}{\rho} R \alpha'^2, \qquad
#   b_\theta = R\ddot\alpha - \frac{\mu}{\rho}(3\alpha' + R\alpha'')$$
#
# for the neo-Hookean $\tau = \lambda \ln J\,I + \mu(b - I)$, and with $k = R\alpha'$,
# $q = 2\mu\,\mathrm{asinh}(k/2)/\sqrt{1 + k^2/4}$
#
# $$b_r = -R\dot\alpha^2 + \frac1\rho\Bigl[\frac{(qk)'}{2} + \frac{qk}{R}\Bigr], \qquad
#   b_\theta = R\ddot\alpha - \frac1\rho\Bigl(q' + \frac{2q}{R}\Bigr)$$
#
# for Hencky's. It is written once, in UFL, in the first positions of the points and the time.

# %%
from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option
from scene import draw_points, finish, say, stage_seconds

import dolfinmpm as mpm
from dolfinmpm import study

E, NU, RHO = 1e3, 0.3, 1e3
LAMBDA, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
INNER, OUTER = 0.75, 1.25


# %%
@dataclass
class Input(Options):
    """A ring turns within itself: observed orders in space and time."""

    basis: str = option("bspline2", choices=(*BASES, "all"))
    integrator: str = option("both", choices=("implicit", "explicit", "both"))
    implicit: str = option("newmark", "steps", choices=("newmark", "generalised-alpha"))
    stabilisation: str = option("ghost", "of the implicit mass", choices=("ghost", "aggregation"))
    law: str = option("neo-hookean", choices=("neo-hookean", "hencky"))
    amplitude: float = option(0.1, "A (rad)")
    period: float = option(1.0, "T (s), half a cycle")
    duration: float = option(0.5, "(s)")
    cells: list[int] = option([8, 16, 32], "a unit of length, by commas", least=4)
    points_per_cell: int = natural(3, "in each direction")
    mapping: str = option("pic", "implicit, behind the consistent mass")
    explicit_mapping: str = option("tpic", "behind the lumped mass")
    scheme: str = option("usl", "explicit", choices=("musl", "usl", "usf"))
    share: float = option(0.2, "of h/(c + |v|) that a step takes")
    steps: list[int] = option(
        [8, 16, 32],
        "of implicit runs for the order in time, by commas; explicit ones take 8 times that",
        least=1,
    )
    time_cells: int = option(8, "cells for the order in time")


# %% [markdown]
# ## The motion


# %%
class Motion:
    """α and its derivatives at radii R and a time t, by NumPy or UFL."""

    def __init__(self, args, R, t, maths=np):
        A, w = args.amplitude, np.pi / args.period
        s = R - 1
        self.R = R
        g = A * maths.sin(w * t)
        h = 1 - 32 * s**2 + 256 * s**4
        slope = -64 * s + 1024 * s**3
        self.alpha, self.rate, self.acceleration = (
            g * h,
            A * w * maths.cos(w * t) * h,
            -w * w * g * h,
        )
        self.slope, self.curvature = g * slope, g * (-64 + 3072 * s**2)
        self.maths = maths

    def force(self, law):
        """Force per mass along e_r and e_θ (m/s²)."""
        R, a1, a2 = self.R, self.slope, self.curvature
        inertia = -R * self.rate**2, R * self.acceleration
        if law == "neo-hookean":
            return (inertia[0] + MU / RHO * R * a1**2, inertia[1] - MU / RHO * (3 * a1 + R * a2))
        k, k1 = R * a1, a1 + R * a2
        root = ufl.sqrt(1 + k**2 / 4)
        arc = ufl.ln(k / 2 + root)
        q = 2 * MU * arc / root
        q1 = MU * k1 / root**2 * (1 - 0.5 * k * arc / root)
        return (
            inertia[0] + ((q1 * k + q * k1) / 2 + q * k / R) / RHO,
            inertia[1] - (q1 + 2 * q / R) / RHO,
        )


def body_force(args, points, t):
    """The force per mass (m/s²), in UFL."""
    X = points.x0
    R = ufl.sqrt(X[0] ** 2 + X[1] ** 2)
    motion = Motion(args, R, t, ufl)
    c, s = ufl.cos(motion.alpha), ufl.sin(motion.alpha)
    e_r = ufl.as_vector([c * X[0] - s * X[1], s * X[0] + c * X[1]]) / R
    e_t = ufl.as_vector([-e_r[1], e_r[0]])
    b_r, b_t = motion.force(args.law)
    return b_r * e_r + b_t * e_t


def exact(args, x0, t):
    """Positions (m) and velocities (m/s) of points first at x0, shape (n, 2)."""
    R, angle = np.hypot(*x0.T), np.arctan2(x0[:, 1], x0[:, 0])
    motion = Motion(args, R, t)
    angle = angle + motion.alpha
    e_r = np.column_stack([np.cos(angle), np.sin(angle)])
    e_t = np.column_stack([-e_r[:, 1], e_r[:, 0]])
    return R[:, None] * e_r, (R * motion.rate)[:, None] * e_t


# %% [markdown]
# ## One run
# The body is free, and begins with the velocities of the solution. Both edges are cut: implicit
# steps take the consistent mass with its ghost penalty and "pic", explicit ones the lumped mass and
# "tpic", which keeps affine motion. Its stress is updated last ("usl"): "musl" maps velocities
# twice, and orders fall to 1.2, as they do with "flip".
#
# Explicit velocities belong to the middle of steps: those at the start are those half
# a step before. Errors are root mean squares over the body, relative to the largest displacement
# of the middle circle, $A$.


# %%
def ring(args, integrator, basis, cells, steps=None):
    """One run: its errors and what it cost, and the points. Collective."""
    side = 1.5
    n = 2 * round(side * cells)
    grid = box_grid([(-side, -side), (side, side)], (n, n))
    body = mpm.Ball((0, 0), OUTER) - mpm.Ball((0, 0), INNER)
    points = mpm.fill(grid, body, args.points_per_cell, RHO, exact=True)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    t = fem.Constant(grid, 0.0)
    law = mpm.materials.Hencky if args.law == "hencky" else mpm.materials.NeoHookean
    F = mpm.momentum(law(E, NU), points, u, v)
    F -= ufl.inner(points.density * body_force(args, points, t), v) * points.dX
    if integrator == "implicit":
        kind = mpm.Newmark if args.implicit == "newmark" else mpm.GeneralisedAlpha
        # without ties a consistent mass has its ghost penalty
        stabilisation = "none" if args.stabilisation == "ghost" else args.stabilisation
        problem = kind(F, u, points, mapping=args.mapping, time=t, stabilisation=stabilisation)
        fastest = args.amplitude * np.pi / args.period
        step = args.share / cells / (np.sqrt((LAMBDA + 2 * MU) / RHO) + fastest)
    else:
        problem = mpm.Explicit(
            F, u, points, scheme=args.scheme, mapping=args.explicit_mapping, time=t
        )
    end = args.duration
    points["velocity"] = exact(args, points["x0"], 0.0)[1]
    if integrator == "explicit":
        step = args.share * problem.critical_step()
    steps = steps or int(np.ceil(end / step))
    if integrator == "explicit":
        points["velocity"] = exact(args, points["x0"], -0.5 * end / steps)[1]
    figures = {"h": 1 / cells, "cells": cells, "steps": steps, "points": points.total}
    figures |= dict.fromkeys(("displacement", "velocity"))
    started, processor = time.perf_counter(), time.process_time()
    try:
        for now in mpm.times(end, end / steps, label=f"{integrator}, {basis}, {cells} cells"):
            problem.step(now)
    except mpm.errors.DolfinMPMError as stopped:
        say(f"{integrator}, {basis}, {cells} cells stopped: {stopped}")
    else:
        late = end - (0.5 * end / steps if integrator == "explicit" else 0.0)
        errors = (
            points["x"] - exact(args, points["x0"], end)[0],
            points["velocity"] - exact(args, points["x0"], late)[1],
        )
        weight = points["V0"]
        sums = np.array([weight.sum(), *(weight @ (e**2).sum(axis=1) for e in errors)])
        sums = points.comm.allreduce(sums, op=MPI.SUM)
        size = args.amplitude, args.amplitude * np.pi / args.period
        for key, square, scale in zip(("displacement", "velocity"), sums[1:], size):
            figures[key] = float(np.sqrt(square / sums[0]) / scale)
    figures["substeps"] = sum(record.parts for record in problem.history)
    figures["seconds"] = time.perf_counter() - started
    figures["seconds_processor"] = time.process_time() - processor
    figures["stages"] = stage_seconds(problem)
    return figures, points


# %% [markdown]
# ## Order in time
# Implicit steps show theirs. Of explicit ones each maps velocities to a lumped mass and back, which
# loses a share of what varies from node to node however short the step is: shorter steps
# lose more often, and there is no order in time alone. Steps that shrink with the cells
# lose in proportion to $h$ or less.
#
# On one grid the error of space stays when steps become shorter. So each run is compared with one
# of four times as many steps as the finest: the order is that of the difference.


# %%
def in_time(args, integrator, basis):
    """Differences of positions from those with very short steps, by steps. Collective."""
    factor = 1 if integrator == "implicit" else 8
    counts = [factor * n for n in args.steps]
    _, points = ring(args, integrator, basis, args.time_cells, 4 * counts[-1])
    finest = position_by_id(points)
    rows = []
    for n in counts:
        _, points = ring(args, integrator, basis, args.time_cells, n)
        off = position_by_id(points)
        off = None if off is None else float(np.sqrt(np.mean((off - finest) ** 2)))
        off = points.comm.bcast(off)
        rows.append({"h": args.duration / n, "steps": n, "difference": off / args.amplitude})
    orders = study.observed_orders([r["h"] for r in rows], [r["difference"] for r in rows])
    for row, order in zip(rows, [None, *orders]):
        row["order"] = order
    return rows


def position_by_id(points):
    """Positions in the order of the points' numbers, on rank 0."""
    rows = points.gather("id", "x")
    return None if rows is None else rows[1][np.argsort(rows[0])]


# %% [markdown]
# ## Picture


# %%
def picture(path, args, space, times, state):
    """Draw the ring with the lines that were radii, and the errors over cells and steps."""
    with mpm.figure(path, 7.2, 2.7, ncols=3, width_ratios=(1.1, 1, 1)) as (_, axes):
        x, x0, l0 = state
        R = np.hypot(*x0.T)
        angle = np.degrees(np.arctan2(x0[:, 1], x0[:, 0])) // 15 % 2
        shade = np.where(angle == 0, 0.35, 0.75) + 0.15 * (np.floor((R - INNER) * 16) % 2)
        one = np.broadcast_to(np.eye(2), (len(x), 2, 2))
        draw_points(axes[0], x, one, 1.1 * l0, shade, cmap="Blues", clim=(0, 1))
        axes[0].set(xlim=(-1.35, 1.35), ylim=(-1.35, 1.35), title=f"$t$ = {args.duration:g} s")
        for integrator, style in zip(space, ("-", "--")):
            for k, (basis, rows) in enumerate(space[integrator].items()):
                known = [(r["h"], r["displacement"]) for r in rows if r["displacement"]]
                if known:
                    axes[1].loglog(
                        *zip(*known),
                        style,
                        marker="o",
                        color=f"C{k}",
                        label=f"{integrator}, {basis}",
                    )
            rows = times[integrator]
            axes[2].loglog(
                [r["h"] for r in rows], [r["difference"] for r in rows], style, marker="o",
                color="C2", label=integrator,
            )  # fmt: skip
        for ax, label, orders in (
            (axes[1], "cell size $h$ (m)", (2,)),
            (axes[2], "step (s)", (1, 2)),
        ):
            (low, high), (bottom, _) = ax.get_xlim(), ax.get_ylim()
            for order in orders:
                h = np.array([low, high])
                ax.loglog(h, 1.5 * bottom * (h / low) ** order, color="0.6", lw=0.7)
                ax.minorticks_off()
                ax.annotate(f"order {order}", (high, 1.5 * bottom * (high / low) ** order),
                            ha="right", fontsize=6, color="0.4")  # fmt: skip
            ax.set_xlabel(label)
        axes[1].set_ylabel("error of positions / $A$")
        axes[2].set_ylabel("difference of positions / $A$")
        axes[1].legend(fontsize=5.5)
        axes[2].legend()


# %% [markdown]
# ## Runs

# %%
if __name__ == "__main__":
    args = Input.parse()
    bases = BASES if args.basis == "all" else (args.basis,)
    integrators = ("implicit", "explicit") if args.integrator == "both" else (args.integrator,)
    space, times, runs, overall, last = {}, {}, [], {}, None
    for integrator in integrators:
        space[integrator] = {}
        for basis in bases:
            rows = []
            for cells in args.cells:
                figures, last = ring(args, integrator, basis, cells)
                rows.append(figures)
            for key in ("displacement", "velocity"):
                values = [r[key] for r in rows]
                orders = study.observed_orders([r["h"] for r in rows], values)
                for row, order in zip(rows, [np.nan, *orders]):
                    row[f"{key}_order"] = float(order) if np.isfinite(order) else None
                fitted = study.overall_order([r["h"] for r in rows], values)
                overall.setdefault(f"{integrator}, {basis}", {})[key] = (
                    fitted if np.isfinite(fitted) else None
                )
                say(
                    f"{integrator}, {basis:9s} {key:13s}",
                    *(
                        ("stopped" if r[key] is None else format(r[key], ".2e"))
                        + (f" ({r[key + '_order']:.2f})" if r[key + "_order"] is not None else "")
                        for r in rows
                    ),
                    f" overall {fitted:.2f}",
                )
            space[integrator][basis] = rows
            runs += [{"integrator": integrator, "basis": basis, **r} for r in rows]
        chosen = "bspline2" if "bspline2" in bases else bases[0]
        times[integrator] = rows = in_time(args, integrator, chosen)
        say(
            f"{integrator}, {chosen}, order in time:",
            *(
                f"{r['difference']:.2e}" + ("" if r["order"] is None else f" ({r['order']:.2f})")
                for r in rows
            ),
        )

    if not args.no_plot:
        rows = [{k: v for k, v in run.items() if k != "stages"} for run in runs]
        study.write_table(rows, args.output / "vortex.csv")
        state = last.gather("x", "x0", "l0")
        if state is not None:
            picture(args.output / "vortex.png", args, space, times, state)

    finish(args, {"runs": runs, "overall": overall, "in_time": times, "ranks": MPI.COMM_WORLD.size})

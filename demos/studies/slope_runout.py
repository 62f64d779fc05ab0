# %% [markdown]
# # A slope fails and runs out to rest
#
# The slope of `slope_failure.py`, 6 m high at 45° over a weak zone, fails under a share of its
# weight. Quasi-static steps bring it down load by load, each in equilibrium. They say nothing
# about the motion. Here the whole weight acts from $t = 0$. The mass that slides gains speed,
# goes beyond the heap of the quasi-static steps, and comes to rest.
#
# Explicit and implicit steps have the same weak form. The work of gravity becomes kinetic energy,
# and then plastic dissipation. A little stays as elastic vibration, which nothing damps in an
# elastoplastic body. At rest means: from this time on, the kinetic energy is below a twentieth of
# its peak. Elastic vibrations keep 2 % of it.

# %%
from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
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
    E,
    draw_slope,
    in_body,
    in_zone,
)

import dolfinmpm as mpm
from dolfinmpm import study

WIDTH = 36.0


@dataclass
class Input(Options):
    """A slope with a weak zone runs out to rest."""

    integrator: str = option("both", choices=("implicit", "explicit", "both"))
    h: list[float] = option([1.0, 0.5, 0.25], "(m), divide 1, by commas", above=0)
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=BASES)
    duration: float = positive(10.0, "(s)")
    dt: float = positive(0.02, "implicit: step (s)")
    samples: int = natural(100, "times at which to measure")

    def _check(self):
        for h in self.h:
            if not h <= 1 or abs(1 / h - round(1 / h)) > 1e-9:
                raise ValueError(f"h = {h:g} m must divide 1 m")


# %% [markdown]
# ## One run
# Explicit steps have the lumped mass with "flip"; implicit ones the lumped mass with "accel", and
# the ghost penalty on the stiffness. The front is how far material of the slope has come beyond
# the toe.


# %%
def run(args, integrator, h):
    """Let the slope run out; returns the figures, the history and the points' state."""
    # cells below the base and beside the walls, for domains that reach there
    cells = round(WIDTH / h) + 4, round(GRID_TOP / h) + 2
    corners = [(-2 * h, -2 * h), (WIDTH + 2 * h, GRID_TOP)]
    grid = box_grid(corners, cells)
    comm = grid.comm
    points = mpm.fill(grid, mpm.Where(lambda x: in_body(x, WIDTH)), args.points_per_cell, DENSITY)
    V = mpm.Space(grid, args.basis)
    u, v = V.increment, V.test
    law = mpm.materials.VonMises(E, NU, radius=lambda x: np.where(in_zone(x), WEAK, YIELD))
    gravity = fem.Constant(grid, (0.0, -GRAVITY))
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.fixed(V, lambda x: x[1] < 1e-6 * h)
    bcs += mpm.prescribed(V, lambda x: (x[0] < 1e-6 * h) | (x[0] > WIDTH - 1e-6 * h), 0)
    if integrator == "explicit":
        problem = mpm.Explicit(F, u, points, bcs)
    else:
        stabilisation = mpm.Stabilisation("ghost", E=E, nu=NU)
        problem = mpm.Newmark(
            F, u, points, bcs, mass="lumped", mapping="accel", stabilisation=stabilisation
        )
    rows, reason = [], ""
    started = time.perf_counter()
    slope = points["x0"][:, 1] > BASE
    try:
        for t in mpm.times(
            args.duration, args.duration / args.samples, label=f"{integrator}, {h:g} m"
        ):
            inner = [t] if integrator == "explicit" else _between(problem.time, t, args.dt)
            for now in inner:
                problem.step(now)
            slope = points["x0"][:, 1] > BASE
            front = comm.allreduce(points["x"][slope, 0].max(initial=-np.inf), op=MPI.MAX)
            energies = problem.energies()
            rows.append(
                {
                    "t": float(t), "front": float(front - TOE), "kinetic": energies.kinetic,
                    "strain": energies.strain, "dissipated": energies["plastic"],
                    "work": energies.external,
                }
            )  # fmt: skip
    except mpm.errors.DolfinMPMError as error:
        # the run's outcome is what is asked for, good or bad
        reason = f"{type(error).__name__}: {error}"
    kinetic = np.array([row["kinetic"] for row in rows])
    moving = np.flatnonzero(kinetic > 0.05 * kinetic.max(initial=0.0))
    rest = rows[moving[-1] + 1]["t"] if rows and moving[-1] + 1 < len(rows) else None
    last = rows[-1] if rows else {}
    gap = None
    if rows:
        held = last["kinetic"] + last["strain"] + last["dissipated"]
        gap = float((last["work"] - held) / last["work"])
    strain = comm.allreduce(points["plastic_strain"].max(initial=0.0), op=MPI.MAX)
    steps = sum(record.parts for record in problem.history)
    seconds = time.perf_counter() - started
    figures = {
        "integrator": integrator,
        "h": h,
        "completed": not reason,
        "reason": reason,
        "runout": last.get("front"),
        "peak_kinetic": float(kinetic.max(initial=0.0)),
        "time_of_peak": rows[int(kinetic.argmax())]["t"] if rows else None,
        "at_rest": rest,
        "last_kinetic": last.get("kinetic"),
        "energy_gap": gap,
        "max_plastic_strain": float(strain),
        "steps": steps,
        "points": points.total,
        "ranks": comm.size,
        "seconds": seconds,
    }
    say(
        f"{integrator}, h = {h:g} m, {points.total} points: "
        + (
            f"runout {last['front']:.2f} m, kinetic energy at most {kinetic.max() / 1e3:.1f} kJ/m "
            f"at {figures['time_of_peak']:.2f} s, at rest "
            + (f"after {rest:.2f} s" if rest is not None else "not yet")
            + f", energy gap {gap:.2%}, "
            if rows
            else ""
        )
        + f"{steps} steps, {seconds:.1f} s"
        + (f"\n    {reason[:200]}" if reason else "")
    )
    return figures, rows, points.gather("x", "F", "l0", "plastic_strain")


def _between(start, end, dt):
    count = int(np.ceil((end - start) / dt - 1e-9))
    return [start + (end - start) * k / count for k in range(1, count)] + [end]


# %% [markdown]
# ## Runs and picture


# %%
def picture(path, runs, states):
    """Draw fronts and energies over time, and where the body lies on the finest grid."""
    width, styles = 7.2, {"explicit": "-", "implicit": "--"}
    with mpm.figure(path, width, 2.5 + 2.0 * len(states)) as (whole, old):
        old.remove()
        upper, lower = whole.subfigures(2, 1, height_ratios=(2.4, 2.0 * len(states)))
        front, kinetic = upper.subplots(1, 2)
        sizes = sorted({figures["h"] for figures, _ in runs}, reverse=True)
        for figures, rows in runs:
            look = {"color": f"C{sizes.index(figures['h'])}", "ls": styles[figures["integrator"]]}
            t = [row["t"] for row in rows]
            label = f"{figures['integrator']}, $h$ = {figures['h']:g} m"
            front.plot(t, [row["front"] for row in rows], label=label, **look)
            kinetic.plot(t, [row["kinetic"] / 1e3 for row in rows], **look)
        front.set(xlabel="time (s)", ylabel="front beyond the toe (m)", xlim=(0, None))
        kinetic.set(xlabel="time (s)", ylabel="kinetic energy (kJ/m)", xlim=(0, None))
        front.legend()
        panels = np.atleast_1d(lower.subplots(len(states), 1, sharex=True))
        for ax, (label, rows) in zip(panels, states):
            drawn = draw_slope(ax, rows, 2.0, WIDTH)
            ax.set(xlim=(0, 26), ylim=(0, GRID_TOP), title=label)
        for ax in panels[:-1]:
            ax.set_xlabel("")
        bar = lower.colorbar(drawn, ax=[*panels], extend="max", shrink=0.7)
        bar.set_label(r"plastic strain $\alpha$")


args = Input.parse()
integrators = ("explicit", "implicit") if args.integrator == "both" else (args.integrator,)
runs, states = [], []
for integrator in integrators:
    for h in args.h:
        figures, rows, state = run(args, integrator, h)
        runs.append((figures, rows))
        if h == min(args.h) and state is not None:
            states.append((f"{integrator}, $h$ = {h:g} m, $t$ = {args.duration:g} s", state))
if not args.no_plot:
    study.write_table([figures for figures, _ in runs], args.output / "slope_runout.csv")
    if MPI.COMM_WORLD.rank == 0:
        picture(args.output / "slope_runout.png", runs, states)
finish(args, {"runs": [figures for figures, _ in runs]})

# %% [markdown]
# # Explicit steps through the grid: what each stabilisation does to step, energy and stress
#
# A square block flies obliquely through the grid and vibrates. Its vibration does not depend on
# its speed of flight. The same block at rest, on a grid that it fits, vibrates in the same way,
# and keeps its energy. All differences come from the grid: the edges of the moving block cut
# cells in every step, again and again by slivers.
#
# **What goes wrong.** With linear functions a point that enters a cell gives the new nodes a
# weight close to zero, but a finite gradient. Their acceleration is $\sigma V \nabla S/(m S)$. It
# has no bound as $S \to 0$. With GIMP and splines, weight and gradient vanish together. A lumped
# mass then keeps the step. With the consistent mass the inverse has no bound where the body lies
# badly, in any basis.
#
# **Stabilisations.** The order of the stress update ("musl" against "usl" and "usf") decides
# whether energy is lost or gained. The ghost penalty on a consistent mass, and aggregation of the
# nodes, prevent the harm of small cuts. Cut-off and redistribution of forces act at nodes with
# less than a hundredth of the largest mass. Their critical step is no eigenvalue: only the flight
# shows it.
#
# With half the critical step of the uncut block, the plain consistent mass ends within the first
# cell, with linear functions and with GIMP. Aggregation keeps the step (0.98 h/c with GIMP, 0.78
# h/c with linear functions, at the worst of twelve places) and the energy. Its lumped mass is
# $C^T M_L C$, with the lumped mass of all nodes. Row sums of the constrained mass would be
# negative at corners that point into the grid, and the block would explode in a single step.
# "usl" loses a third of the energy in six cells of GIMP, with the consistent mass, too. "musl"
# and "usf" keep it.
#
# Quadratic splines need a stabilisation least. With "musl" and the lumped mass they keep 1.2 h/c
# at the worst place, with a third of the spurious stress of GIMP. Aggregated or extended splines
# keep the same. Cut-off of light nodes adds a third to the energy of the elastic block.
# Redistribution of forces adds no more than "musl" without it.
#
# The critical step is $2/\sqrt{\lambda_{\max}}$ of $Kx = \lambda Mx$, the smallest over the
# places of the block. The spurious stress is the root mean square difference from the stress of
# the same points in the block at rest, over $\rho c^2 \varepsilon$.

# %%
from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

E, NU, RHO, YIELD = 1e4, 0.3, 1e3, 40.0
SPEED = np.sqrt(E * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) / RHO)
ACROSS = 6

PLAIN = {"scheme": "usl", "mass": "consistent", "mapping": "pic", "ghost_mass": 0.0}
GHOST = {"scheme": "usl", "mass": "consistent", "mapping": "pic"}
# by name: the basis, options of `Explicit`, and the stabilisation
METHODS = {
    "linear, usl": ("linear", {"scheme": "usl"}, "none"),
    "linear, musl": ("linear", {"scheme": "musl"}, "none"),
    "linear, mass cut-off": ("linear", {"scheme": "musl", "mass_cutoff": 0.01}, "none"),
    "linear, redistribution": ("linear", {"scheme": "musl", "redistribution": 0.01}, "none"),
    "linear, aggregation": ("linear", {"scheme": "musl"}, "aggregation"),
    "linear, consistent": ("linear", PLAIN, "none"),
    "linear, consistent + ghost": ("linear", GHOST, "none"),
    "GIMP, usl": ("gimp", {"scheme": "usl"}, "none"),
    "GIMP, usf": ("gimp", {"scheme": "usf"}, "none"),
    "GIMP, musl": ("gimp", {"scheme": "musl"}, "none"),
    "GIMP, aggregation": ("gimp", {"scheme": "musl"}, "aggregation"),
    "GIMP, consistent": ("gimp", PLAIN, "none"),
    "GIMP, consistent + ghost": ("gimp", GHOST, "none"),
    "splines, musl": ("bspline2", {"scheme": "musl"}, "none"),
    "splines, aggregation": ("bspline2", {"scheme": "musl"}, "aggregation"),
    "splines, extended": ("bspline2", {"scheme": "musl"}, "extended"),
    "splines, consistent + ghost": ("bspline2", GHOST, "none"),
}


# These act on nodes one by one, not on the matrices of the eigenproblem
FILTERS = {"mass_cutoff", "redistribution"}


@dataclass
class Input(Options):
    """A block flies through the grid in explicit steps."""

    methods: str | None = option(None, "names, by semicolons; all by default")
    laws: str = "elastic,elastoplastic"
    cells: float = option(6.0, "that the block passes")
    velocity: float = option(0.3, "of the block, by c")
    strain: float = option(0.01, "amplitude of the vibration")
    share: float = option(0.5, "of the critical step uncut")
    places: int = option(12, "for the critical step")
    points_per_cell: int = natural(3, "in each direction")
    long: int = option(10_000, "steps of a block cut at 1e-6 of a cell")

    def _check(self):
        self.methods = self.methods.split(";") if self.methods else list(METHODS)
        for name in self.methods:
            if name not in METHODS:
                raise ValueError(f"no method {name}; there are {'; '.join(METHODS)}")
        self.laws = self.laws.split(",")
        if set(self.laws) - {"elastic", "elastoplastic"}:
            raise ValueError("laws are elastic and elastoplastic")


# %% [markdown]
# ## The block
# With $h = 1$ m, six cells wide, at an offset from the grid's lines. It begins to vibrate
# from rest, by the velocity $\varepsilon c \sin(\pi X/L)$ along and across.


# %%
def block(args, method, law, offset, kind, travel=0.0):
    """Points and problem of a block; `kind` chooses the explicit problem or a static one."""
    basis, options, stabilisation = METHODS[method]
    n = ACROSS + 6 + int(np.ceil(travel))
    grid = box_grid([(0, 0), (n, n)], (n, n))
    low = 2.0 + np.broadcast_to(offset, 2)
    points = mpm.fill(grid, mpm.Box(low, low + ACROSS), args.points_per_cell, RHO, aligned="body")
    V = mpm.Space(grid, basis)
    material = mpm.materials.Hencky(E, NU)
    if law == "elastoplastic":
        material = mpm.materials.VonMises(E, NU, radius=YIELD)
    F = mpm.momentum(material, points, V.increment, V.test)
    stabilisation = mpm.Stabilisation(stabilisation, E=E, nu=NU)
    if kind == "static":
        return points, mpm.QuasiStatic(F, V.increment, points, stabilisation=stabilisation)
    return points, mpm.Explicit(F, V.increment, points, stabilisation=stabilisation, **options)


def set_off(args, points, velocity):
    """Give the block its velocity and its vibration."""
    middle = points.comm.allreduce(points["x"].sum(axis=0)) / points.total
    X = (points["x"] - middle) / ACROSS
    points["velocity"] = velocity + args.strain * SPEED * np.sin(np.pi * X)


def step_of(args, method, offset):
    """Critical step of the block at an offset, by the method's own mass, in h/c."""
    _, options, stabilisation = METHODS[method]
    points, problem = block(args, method, "elastic", offset, "static")
    consistent = options.get("mass") == "consistent"
    gamma = 1.0 if consistent and options.get("ghost_mass") is None else 0.0
    if gamma and stabilisation == "none":
        # the same penalty that the explicit problem puts on the mass, none on the stiffness
        extra = mpm.ghost(
            points, problem.fields[0].space.increment, problem.fields[0].space.test,
            0.25 * RHO * {1: 1.0, 2: 1e2, 3: 1e4}[problem.fields[0].space.basis.degree],
            scaling="literal",
        )  # fmt: skip
        found = study.conditioning(problem, RHO, 0.0, extra)
    else:
        found = study.conditioning(problem, RHO, 0.0)
    return (found.dt_consistent if consistent else found.dt_lumped) * SPEED


# %% [markdown]
# ## Flight
# Velocities belong to the middle of steps, positions and stresses to their ends. `energies` counts
# kinetic energy at the time of the positions, so that the sum does not swing. What counts is
# whether it drifts.


# %%
def fly(args, method, law, uncut):
    """Fly with one step for all, half the critical one of the uncut block; the figures."""
    dt = args.share * uncut / SPEED
    angle = np.array([1.0, 0.7]) * args.velocity * SPEED
    duration = args.cells / angle[0]
    reference, rest = block(args, method, law, 0.0, "explicit")
    set_off(args, reference, 0.0)
    points, problem = block(args, method, law, 1e-3, "explicit", args.cells)
    set_off(args, points, angle)
    drift = 0.5 * RHO * ACROSS**2 * float(angle @ angle)
    first = problem.energies().kinetic - drift
    steps = max(20, int(np.ceil(duration / dt)))
    energy, spurious, size, reason = [], [], [], ""
    for k in range(1, steps + 1):
        try:
            # one step each, whatever the problem's own estimate is
            problem.courant, rest.courant = 1e6, 1e6
            problem.step(duration * k / steps)
            rest.step(duration * k / steps)
        except mpm.errors.DolfinMPMError as error:
            reason = f"{type(error).__name__} at step {k} of {steps}: {str(error)[:120]}"
            break
        e = problem.energies()
        total = e.kinetic - drift + e.strain + e["plastic"]
        energy.append(float(total / first))
        a, b = (p.gather("id", "stress") for p in (points, reference))
        if a is not None:
            a, b = (s[np.argsort(i)] for i, s in (a, b))
            spurious.append(float(np.sqrt(np.mean((a - b) ** 2))))
            size.append(float(np.sqrt(np.mean(b**2))))
        if not abs(energy[-1]) < 1e3:
            reason = f"energy {energy[-1]:.3g} times the first at step {k} of {steps}"
            break
    scale = RHO * SPEED**2 * args.strain
    spurious = points.comm.bcast(spurious)
    return {
        "completed": not reason,
        "reason": reason,
        "steps": steps,
        "energy": energy[-1] if energy else None,
        "largest_energy": max(energy, default=None),
        "spurious_stress": float(np.sqrt(np.mean(np.square(spurious))) / scale),
        "history": energy,
    }


# %% [markdown]
# ## A cut of a millionth of a cell, for ten thousand steps
# The block vibrates at rest where its edges stand a millionth of a cell over grid lines. Its energy
# must stay bounded at half the critical step of the uncut block.


# %%
def stay(args, method, uncut):
    """Steps in place with a cut of 1e-6; the largest energy by the first."""
    dt = args.share * uncut / SPEED
    points, problem = block(args, method, "elastic", 1e-6, "explicit")
    set_off(args, points, 0.0)
    first, largest, reason, taken = problem.energies().kinetic, 0.0, "", 0
    problem.courant = 1e6
    started = time.perf_counter()
    try:
        while taken < args.long:
            # single steps of dt
            problem.step((taken + 1) * dt)
            taken += 1
            if taken % 20 == 0 or taken == args.long:
                e = problem.energies()
                largest = max(largest, (e.kinetic + e.strain) / first)
                if not largest < 1e3:
                    reason = f"energy {largest:.3g} times the first after {taken} steps"
                    break
    except mpm.errors.DolfinMPMError as error:
        reason = f"{type(error).__name__} after {taken} steps: {str(error)[:120]}"
    return {
        "long_steps": taken,
        "long_energy": float(largest),
        "long_bounded": not reason and largest < 1.5,
        "long_reason": reason,
        "long_seconds": time.perf_counter() - started,
    }


# %%
args = Input.parse()
golden = (np.sqrt(5) - 1) / 2
offsets = [1e-6, 1e-3, *(float(k * golden % 1) for k in range(1, args.places - 1))]
rows, histories = [], {}
for method in args.methods:
    uncut = step_of(args, method, 0.0)
    row = {"method": method, "step_uncut": uncut, "step_worst": None, "step_sliver": None}
    worst = "not an eigenvalue"
    if not FILTERS & set(METHODS[method][1]):
        steps = [step_of(args, method, offset) for offset in offsets]
        row |= {"step_worst": min(steps), "step_sliver": steps[0]}
        worst = f"worst {min(steps):.2g}, at 1e-6 {steps[0]:.2g} h/c"
    for law in args.laws:
        found = fly(args, method, law, uncut)
        histories[method, law] = found.pop("history")
        row |= {f"{law}_{key}": value for key, value in found.items()}
    if args.long:
        row |= stay(args, method, uncut)
    rows.append(row)
    say(
        f"{method:28s} step {uncut:.3f} uncut, {worst}; "
        + "; ".join(
            f"{law}: "
            + (
                f"energy {row[law + '_energy']:.3f}, "
                f"spurious stress {row[law + '_spurious_stress']:.3f}"
                if row[f"{law}_completed"]
                else row[f"{law}_reason"][:60]
            )
            for law in args.laws
        )
        + (
            f"; {row['long_steps']} steps at 1e-6: energy at most {row['long_energy']:.3g}"
            if args.long
            else ""
        )
    )

# %% [markdown]
# ## Picture and table


# %%
def picture(path):
    """Draw critical steps, and the energy over the flight."""
    columns = len(args.laws)
    with mpm.figure(path, 7.2, 4.4, ncols=1 + columns) as (whole, axes):
        left = axes[0]
        y = np.arange(len(rows))[::-1]
        left.barh(y + 0.2, [max(r["step_uncut"], 1e-4) for r in rows], 0.38, label="uncut")
        known = [(k, max(s, 1e-4)) for k, s in zip(y, (r["step_worst"] for r in rows)) if s]
        left.barh([k - 0.2 for k, _ in known], [s for _, s in known], 0.38, label="worst cut")
        left.set(xscale="log", xlabel="critical step $\\Delta t\\, c/h$", xlim=(1e-4, 3))
        left.set_yticks(y, labels=[r["method"] for r in rows])
        left.legend(loc="lower center", bbox_to_anchor=(0.3, 1.0), ncols=2)
        for ax, law in zip(axes[1:], args.laws):
            for k, method in enumerate(args.methods):
                values = np.array(histories[method, law])
                t = np.linspace(0, args.cells, rows[k][f"{law}_steps"] + 1)[1 : 1 + len(values)]
                shown = np.clip(values, 0, 2)
                # a line by the basis, a colour by what is done with it
                basis = METHODS[method][0]
                alike = [m for m in args.methods if METHODS[m][0] == basis]
                style = {"linear": "-", "gimp": "--", "bspline2": ":"}[basis]
                colour = f"C{alike.index(method)}"
                ax.plot(t, shown, style, color=colour, lw=1.0, label=method)
                if not rows[k][f"{law}_completed"] and len(values):
                    ax.plot(t[-1], shown[-1], "x", color=colour, ms=5, clip_on=False, zorder=5)
            ax.set(xlabel="cells passed", ylabel="energy / first", ylim=(0, 2), title=law)
        handles, labels = axes[1].get_legend_handles_labels()
        whole.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=6)


if not args.no_plot:
    study.write_table(rows, args.output / "explicit_stability.csv")
    if MPI.COMM_WORLD.rank == 0:
        picture(args.output / "explicit_stability.png")
finish(args, {"rows": rows, "ranks": MPI.COMM_WORLD.size})

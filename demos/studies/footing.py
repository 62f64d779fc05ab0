# %% [markdown]
# # Footings: settlement, bearing capacity, and what locks
#
# Half of a layer of ground, 15 m wide and 5 m deep, lies on a fixed base between smooth walls. It
# carries a strip footing of half-width 2 m. Three clays show three effects:
#
# - `--law cam-clay`: modified Cam-Clay with weight, normally consolidated, under a flexible
#   smooth footing. Without strain the clay has $p_0 = p_c = 20$ kPa. A surcharge of the same size
#   on the whole top keeps it in equilibrium. Then the weight of 10 kN/m³ comes in 20 steps, and
#   90 kPa on the footing in 50 steps. The linear theory overestimates the settlement: compressed
#   ground becomes thinner, and its columns share more load.
# - `--law tresca`: weightless clay that hardens from 10 to 15 kPa,
#   $c = c_u + (c_0 - c_u)\,e^{-5\bar\varepsilon^p}$, under 70 kPa on a flexible rough footing in
#   100 steps. It flows at constant volume, and standard elements are too stiff for this.
# - `--law tresca-perfect`: the same without hardening, under a rigid footing that is pressed
#   down. The load has a limit, Prandtl's $(2 + \pi)\,c$.
#
# Results, with cells of 0.5 m unless said otherwise:
#
# - Cam-Clay under 90 kPa, 4² points: with quadratic splines the settlement is 0.689 m in the
#   centre and 0.630 m on average; conforming elements have 0.690 and 0.637 m. In the linear
#   theory both have 0.878 m in the centre, 27 % more. GIMP has 0.688 and 0.620 m. The mean is
#   less exact because the ground bends within a cell or two of the edge of the footing.
# - Hardening Tresca clay, 2² points, locks without F-bar. At 70 kPa linear functions are 10 % too
#   stiff in the centre, GIMP 9 %, quadratic splines 5 %. At smaller loads GIMP is sometimes
#   stiffer than linear functions, by up to 7 %, because linear functions become softer where
#   points cross cells. With 4² points it is 1 % stiffer at the end, too.
# - F-bar makes all softer. GIMP is 6 % too stiff at 70 kPa. At 56 kPa, up to which the conforming
#   curves converge, its error is 0.2 %. Quadratic splines are 3.3 % too stiff at 70 kPa, and 0.7 %
#   at 56 kPa; with cells of 0.25 m 0.7 % at 70 kPa. Linear functions flow too much, by 18 %.
# - Means of F-bar over cells do not see splines that alternate from cell to cell: Cam-Clay
#   settles by 4 to 6 % too much. Quadratic splines take means over linear functions instead: the
#   error is 0.4 %. GIMP with F-bar has 0.689 and 0.630 m.
# - Prandtl's limit is overestimated by 1.4 % with F-bar and cells of 0.05 m at the edge. Without
#   F-bar it is 5.6 %, and the load still rises. With cells of 0.1 m the errors are 2.2 and 8.7 %.
#   (E/c is 10⁴ there, so that the clay flows before its shape changes.)
# - Cells of 0.5 m that are halved to 1/64 m at the edge (`--refine 0.015625 --growth 0.2 --h 0.5
#   --coarsest 0.5 --modulus 1e9 --steps 20`) overestimate it by 0.44 % with 1856 unknowns. Equal
#   cells of 1/16 m have an error of 0.98 % with 38 400 unknowns.
# - In time, within 100 s by explicit steps (`--integrator explicit`), the Cam-Clay footing with
#   2² points settles by 0.684 m in the centre and 0.632 m on average. Equilibrium load by load
#   has 0.688 and 0.631 m. The run takes 24 450 steps after the weight.
#
# All pressures are dead, vertical and per first area. The curves are compared with stored ones of
# conforming elements (eight nodes, reduced integration) for the same laws and loads:
# `tests/reference/footings.py`.

# %%
import itertools
import time
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from footing_curves import compared, describe, draw_compared, draw_run, stored
from grids import grid_of_lines, halved, lines
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say, solver_figures

import dolfinmpm as mpm
from dolfinmpm.body.location import destinations

WIDTH, DEPTH, HALF_WIDTH, ROOM = 15.0, 5.0, 2.0, 1.0  # m
COHESION, GRAVITY = 10e3, 10.0  # Pa, m/s²
STABILISATIONS = "none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"
LIMIT = (2 + np.pi) * COHESION
DEFAULTS = {  # by the law
    "cam-clay": {
        "h": 0.5, "points_per_cell": 4, "steps": 50, "load": 90e3, "footing": "flexible",
        "rough": "off", "fbar": "off", "modulus": 1e6, "basis": "bspline2",
    },
    "tresca": {
        "h": 0.5, "points_per_cell": 2, "steps": 100, "load": 70e3, "footing": "flexible",
        "rough": "on", "fbar": "on", "modulus": 1e6, "basis": "gimp",
    },
    "tresca-perfect": {
        "h": 0.05, "points_per_cell": 2, "steps": 25, "load": 70e3, "footing": "rigid",
        "rough": "off", "fbar": "on", "modulus": 1e8, "basis": "gimp",
        "coarsest": 0.5,
    },
}  # fmt: skip


@dataclass
class Input(Options):
    """A strip footing on a layer of clay."""

    law: str = option("cam-clay", choices=tuple(DEFAULTS))
    strain: str = option("large", choices=("large", "small", "jaumann"))
    basis: str | None = option(None, "by the law", choices=BASES)
    fbar: str | None = switch(None, "against locking; by the law")
    footing: str | None = option(None, "by the law", choices=("flexible", "rigid"))
    rough: str | None = switch(None, "by the law")
    h: float | None = positive(None, "size of the cells (m); by the law", most=1)
    coarsest: float | None = option(
        None,
        "size of the cells (m) far from the footing's edge; by the law; h for equal ones",
        most=2,
    )
    refine: float | None = positive(None, "size (m) of halved cells at the edge; GIMP or linear")
    growth: float = positive(0.1, "of the size of halved cells with the distance from the edge")
    points_per_cell: int | None = natural(None, "in each direction; by the law")
    steps: int | None = natural(None, "of the footing; by the law")
    load: float | None = positive(None, "last pressure of a flexible footing (Pa)")
    settlement: float | None = positive(None, "last one of a rigid footing (m); 75 c B/E")
    rest: int = natural(0, "steps under the last load, in which a ghost penalty lets go", least=0)
    modulus: float | None = positive(None, "Young's modulus (Pa) of Tresca's clay")
    stabilisation: str = option("aggregation", choices=STABILISATIONS)
    integrator: str = option(
        "static",
        "explicit: a flexible footing loaded in time by explicit steps after the weight",
        choices=("static", "explicit"),
    )
    duration: float = positive(100.0, "of explicit loading (s)")
    damping: float = option(0.1, "local, of explicit steps")
    compare: bool = option(
        False,
        "cam-clay: measures of strain; tresca: bases with "
        "and without F-bar; tresca-perfect: F-bar on finer and finer cells",
    )

    def _check(self):
        self.fill(**DEFAULTS[self.law])
        self.fill(coarsest=self.h, settlement=75 * 10e3 / self.modulus)
        self.coarsest = max(self.coarsest, self.h)
        if self.integrator == "explicit" and (self.footing, self.strain) != ("flexible", "large"):
            raise ValueError("explicit steps load a flexible footing, under large strain")


# %% [markdown]
# ## Grid and ground
# Equal cells, or cells that grow away from the footing's edge, where the stress jumps: a
# rectangular grid stays one when its lines are moved. There is room above the ground for what
# heaves beside the footing.


# %%
def law_of(args):
    """The law; and the unit weight of the ground (N/m³) and the pressure on its top (Pa)."""
    if args.law == "cam-clay":
        clay = mpm.materials.CamClay(
            swelling=0.018, compression=0.130, M=1.05, mu0=5.4e6, alpha=0.0,
            reference_pressure=20e3, preconsolidation=20e3,
        )  # fmt: skip
        return clay, 10e3, 20e3
    ultimate = 15e3 if args.law == "tresca" else 10e3
    clay = mpm.materials.Tresca(args.modulus, 0.33, COHESION, ultimate_cohesion=ultimate, rate=5.0)
    return clay, 0.0, 0.0


# %% [markdown]
# ## The weak form
# Pressures act on the faces of the points, not on the points. A rough footing that is flexible
# moves with the ground but lets nothing slide: a penalty holds the horizontal displacement of the
# faces. A rigid one has all of that in `RigidFooting`.
#
# ## The linear theory
# Small strain says that equilibrium is that of the ground as it was at first. The points
# of a material point method move, however, and the next step's gradients are taken where they are
# then: in one dimension this alone turns added strains into logarithmic ones. So after
# every step they go back, and the field `moved` keeps the displacement, `turned` its
# gradient. Under a rigid footing, with a few millimetres until the ground flows, they need not.


# %%
class Scene:
    """Ground and footing, step by step.

    Args:
        args: The command line, or a variation of it.
    """

    def __init__(self, args):
        self.grid = grid = grid_of_lines(
            lines(WIDTH, HALF_WIDTH, args.h, args.coarsest),
            lines(DEPTH + ROOM, DEPTH, args.h, args.coarsest),
        )
        self.args = args
        V = mpm.Space(grid, args.basis, **halved(args, (HALF_WIDTH, DEPTH)))
        law, self.weight, surcharge = law_of(args)
        self.internal = next(iter(law.internal))
        body = mpm.Box((0, 0), (WIDTH, DEPTH))
        # any density where there is no weight
        density = self.weight / GRAVITY or 1000.0
        self.points = points = mpm.fill(grid, body, args.points_per_cell, density, refine=V)
        top = mpm.Surface(points, lambda x: np.isclose(x[1], DEPTH), (0, 1), name="top")
        self.under = under = mpm.Surface(
            points, lambda x: np.isclose(x[1], DEPTH) & (x[0] < HALF_WIDTH), (0, 1), name="under"
        )
        u, v = V.increment, V.test
        self.gravity = fem.Constant(grid, (0.0, 0.0))
        self.pressure = fem.Constant(grid, (0.0, 0.0))
        self.settlement = fem.Constant(grid, 0.0)
        moved = points.add_field("moved", (2,), "m")
        turned = points.add_field("turned", (2, 2))
        rough, self.rigid = args.rough == "on", args.footing == "rigid"

        F = mpm.momentum(law, points, u, v, strain=args.strain, fbar=args.fbar == "on")
        F += top.traction(fem.Constant(grid, (0.0, -surcharge)), v)
        F -= ufl.inner(points.density * self.gravity, v) * points.dX
        if self.rigid:
            self.footing = mpm.RigidFooting(under, self.settlement, rough=rough, E=args.modulus)
            F += self.footing.contact(u, v)
        else:
            F += under.traction(self.pressure, v)
        if rough and not self.rigid:
            # a stiff one would shorten explicit steps
            stiff = 1e3 if args.integrator == "static" else 4.0
            stiffness = fem.Constant(grid, stiff * args.modulus / args.h)
            slip = moved + ufl.dot(turned, under.offset) + under.at(u)
            F += under.traction(ufl.as_vector((-stiffness * slip[0], 0.0)), v)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        updates = {"moved": moved + u, "turned": turned + ufl.dot(ufl.grad(u), points.F)}
        self.problem = mpm.QuasiStatic(
            F, u, points, bcs, updates=updates,
            stabilisation=mpm.Stabilisation(args.stabilisation),
        )  # fmt: skip
        self.explicit, self.settled = None, 0.0
        if args.integrator == "explicit":
            self.explicit = mpm.Explicit(
                F, u, points, bcs, updates=updates, damping=args.damping, mapping="flip"
            )

    def load(self):
        """Mean pressure on the footing (Pa). Collective."""
        if self.rigid:
            return self.footing.load() / HALF_WIDTH
        return -float(self.pressure.value[1])

    def step(self):
        """One step; the last two residuals of each of its parts' last. Collective."""
        record = self.problem.step()
        if self.args.strain == "small" and not self.rigid:
            self.put_back()
        return record.residuals[-2:]

    def press(self, part):
        """Bring the load to a part of the last one; see `step`. Collective.

        Explicit steps come there in time, by a tenth of the step's load at once.
        """
        if self.explicit is None:
            self.pressure.value[1] = -self.args.load * part
            self.settlement.value = self.args.settlement * part
            return self.step()
        start, self.settled = self.settled, part
        for k in range(1, 11):
            now = start + (part - start) * k / 10
            self.pressure.value[1] = -self.args.load * (now - 0.05 * (part - start))
            self.explicit.step(self.args.duration * now)
        self.pressure.value[1] = -self.args.load * part
        return []

    def put_back(self):
        """Return the points to where they were at first. Collective."""
        points = self.points
        points["x"], points["l"], points["V"] = points["x0"], points["l0"], points["V0"]
        points["F"] = np.eye(2)
        points.migrate(destinations(self.grid, points["x"], points["cell"]))

    def sunk(self):
        """Downward displacement (m) at the axis, of the footing on average, at its edge."""
        points, offset, area = self.points, self.under.offset.array, self.under.area.array
        at = area[:, 1] > 0
        s = -points["moved"][:, 1] - np.einsum("pj,pj->p", points["turned"][:, 1], offset)
        rows = np.column_stack([points["x0"][at, 0], area[at, 1], s[at]])
        rows = np.concatenate(self.grid.comm.allgather(rows))
        x, size, s = rows[np.argsort(rows[:, 0])].T
        # even in x about the axis, and straight at the edge
        centre = s[0] - (s[1] - s[0]) / (x[1] ** 2 - x[0] ** 2) * x[0] ** 2
        edge = s[-1] + (s[-1] - s[-2]) / (x[-1] - x[-2]) * (HALF_WIDTH - x[-1])
        return np.array([centre, s @ size / size.sum(), edge])

    def look(self):
        """What is drawn of all points: x, F, l0 and what the law remembers; None beyond rank 0."""
        state = self.points.gather("x", "F", "l0", self.internal)
        if self.args.strain == "small" and not self.rigid:
            # the linear theory moves nothing; the picture does
            moved = self.points.gather("moved", "turned")
            if state is not None:
                state = state[0] + moved[0], state[1] + moved[1], *state[2:]
        return state


# %% [markdown]
# ## A run
# Settlement counts from when the footing is loaded. A run that finds no equilibrium ends there.
# Where there is a stored curve of conforming elements, the run is compared with it, in
# `footing_curves.py`, where the pictures are drawn too.


# %%
def run(args):
    """Load the footing; returns the figures, the history and the scene. Collective."""
    started = time.perf_counter()
    scene = Scene(args)
    ready = time.perf_counter()
    residuals, reason = [], ""
    history = mpm.History(scene.grid.comm)
    first = np.zeros(3)
    try:
        for part in mpm.steps(20, label="weight") if scene.weight else ():
            scene.gravity.value[1] = -GRAVITY * part
            residuals.append(scene.step())
        first = scene.sunk()
        history.record(load=0.0, centre=0.0, mean=0.0, edge=0.0)
        for part in itertools.chain(mpm.steps(args.steps, label="footing"), [1.0] * args.rest):
            residuals.append(scene.press(part))
            names = "centre", "mean", "edge"
            history.record(load=scene.load(), **dict(zip(names, scene.sunk() - first)))
    except mpm.errors.ConvergenceError as error:
        reason = str(error)
        if not len(history):
            # under the weight already
            history.record(load=0.0, centre=0.0, mean=0.0, edge=0.0)
    curve = np.array([history[name] for name in ("load", "centre", "mean", "edge")])
    figures = {
        **{name: getattr(args, name) for name in ("law", "strain", "basis", "fbar", "h", "rough")},
        "completed": not reason,
        "reason": reason,
        "load": float(curve[0, -1]),
        "settlement_centre": float(curve[1, -1]),
        "settlement_mean": float(curve[2, -1]),
        "settlement_edge": float(curve[3, -1]),
        "settlement_before": float(first[0]),
        "curve": curve.tolist(),
        "last_ratios": residuals,
        "integrator": args.integrator,
        "explicit_steps": sum(r.parts for r in scene.explicit.history) if scene.explicit else 0,
        **solver_figures(scene.problem if scene.problem.here else scene.explicit),
        "seconds_setup": ready - started,
        "seconds_solve": time.perf_counter() - ready,
    }
    if args.law == "tresca-perfect":
        before = max(0, curve.shape[1] - 1 - max(1, args.steps // 5))
        figures["bearing_factor"] = float(curve[0, -1] / COHESION)
        figures["bearing_factor_exact"] = 2 + np.pi
        figures["bearing_error"] = float(curve[0, -1] / LIMIT - 1)
        # what the last fifth of the settlement still adds
        rise = curve[0, -1] - curve[0, before]
        figures["last_rise"] = float(rise / curve[0, -1]) if rise else 0.0
    reference = stored(args)
    if reference is not None and figures["load"] > 0:
        figures |= compared(curve, reference)
    say(describe(args, figures))
    return figures, history, scene


# %% [markdown]
# ## Runs

# %%
NAMES = {
    "linear": "linear",
    "gimp": "GIMP",
    "bspline2": "quadratic splines",
    "bspline3": "cubic splines",
}


def variations(args):
    """What `--compare` runs: label and options of each."""
    if args.law == "cam-clay":
        return [(f"{strain} strain", {"strain": strain}) for strain in ("large", "small")]
    if args.law == "tresca":
        return [
            (f"{name}, F-bar" if fbar == "on" else name, {"basis": basis, "fbar": fbar})
            for basis, name in NAMES.items()
            for fbar in ("off", "on")
        ]
    return [
        (f"$h$ = {h:g} m" + (", F-bar" if fbar == "on" else ""), {"h": h, "fbar": fbar})
        for h in (4 * args.h, 2 * args.h, args.h)
        for fbar in ("off", "on")
    ]


if __name__ == "__main__":
    args = Input.parse()
    if not args.compare:
        figures, history, scene = run(args)
        history.write(args.output / "footing.csv")
        if not args.no_plot:
            state = scene.look()
            if state is not None:
                picture = args.output / f"footing_{args.law}.png"
                draw_run(picture, args, figures, state, scene.internal, (WIDTH, DEPTH, ROOM), LIMIT)
        finish(args, figures)
    else:
        results = []
        for label, options in variations(args):
            one = replace(args, **options)
            results.append({"label": label, **run(one)[0]})
        short = ("curve", "last_ratios", "last_residuals")
        rows = [{k: v for k, v in r.items() if k not in short} for r in results]
        mpm.study.write_table(rows, args.output / f"footing_{args.law}_compared.csv")
        if not args.no_plot:
            draw_compared(args.output / f"footing_{args.law}_compared.png", args, results, LIMIT)
        finish(args, {"runs": results})

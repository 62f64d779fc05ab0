# %% [markdown]
# # Footings: settlement, bearing capacity, and what locks
#
# Half of a layer of ground, 15 m wide and 5 m deep, on a fixed base between smooth walls,
# carries a strip footing of half-width 2 m. Three clays show three things:
#
# - `--law cam-clay`: modified Cam-Clay with weight, normally consolidated, under a flexible
#   smooth footing. Without strain the clay has $p_0 = p_c = 20$ kPa, which a surcharge of as much
#   on the whole top keeps in equilibrium. Then come the weight, 10 kN/m³ in 20 steps, and
#   90 kPa on the footing in 50. The linear theory overestimates the settlement, for ground that
#   is compressed gets thinner and its columns share more load.
# - `--law tresca`: weightless clay that hardens from 10 to 15 kPa,
#   $c = c_u + (c_0 - c_u)\,e^{-5\bar\varepsilon^p}$, under 70 kPa on a flexible rough footing in
#   100 steps. It flows at constant volume, and standard elements are too stiff for that.
# - `--law tresca-perfect`: the same without hardening under a rigid footing that is pressed down.
#   The load has a limit, Prandtl's $(2 + \pi)\,c$.
#
# What comes out, with cells of 0.5 m and 4² points unless said otherwise:
#
# - Cam-Clay under 90 kPa settles by 0.689 m in the centre and 0.630 m on average with quadratic
#   splines, conforming elements say 0.690 and 0.637 m; in the linear theory both say 0.878 m in the
#   centre, 27 % more. GIMP has 0.688 and 0.620 m. The mean is less exact because the
#   ground bends within a cell or two of the footing's edge.
# - Hardening Tresca clay locks with linear functions and GIMP alike, 12 to 13 % too stiff in the
#   centre at 70 kPa; quadratic splines miss 6 %, cubic ones 3 %. F-bar makes all softer: GIMP
#   misses 4 %, and 0.6 % at 56 kPa, up to where the conforming curves converge.
# - F-bar belongs to linear functions and GIMP. Cell means constrain splines too little: the plastic
#   strain comes in stripes two cells wide, and Cam-Clay settles by 10 % too much, where GIMP with
#   F-bar has 0.689 and 0.630 m.
# - Prandtl's limit is overestimated by 2.3 % with F-bar and cells of 0.1 m at the edge, by 8.7 %
#   without, where the load still rises. (E/c is 10⁴ there, so that the clay flows
#   before its shape changes.)
#
# All pressures are dead, vertical and per first area. The curves are compared with stored ones of
# conforming elements (eight nodes, reduced integration) for the same laws and loads:
# `tests/reference/footings.py`.

# %%
import csv
import time
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scene import draw_points, finish, parser, say, solver_figures

import dolfinmpm as mpm
from dolfinmpm.errors import ConvergenceError
from dolfinmpm.locate import destinations

WIDTH, DEPTH, HALF_WIDTH, ROOM = 15.0, 5.0, 2.0, 1.0  # m
COHESION, GRAVITY = 10e3, 10.0  # Pa, m/s²
LIMIT = (2 + np.pi) * COHESION
STORED = Path(__file__).resolve().parent.parent / "tests" / "reference"
DEFAULTS = {  # by the law
    "cam-clay": {
        "h": 0.5, "points_per_cell": 4, "steps": 50, "load": 90e3, "footing": "flexible",
        "rough": "off", "fbar": "off", "modulus": 1e6, "basis": "bspline2",
    },
    "tresca": {
        "h": 0.5, "points_per_cell": 4, "steps": 100, "load": 70e3, "footing": "flexible",
        "rough": "on", "fbar": "on", "modulus": 1e6, "basis": "gimp",
    },
    "tresca-perfect": {
        "h": 0.1, "points_per_cell": 2, "steps": 25, "load": 70e3, "footing": "rigid",
        "rough": "off", "fbar": "on", "modulus": 1e8, "basis": "gimp",
        "coarsest": 0.5,
    },
}  # fmt: skip


def arguments():
    """The command line; what is not given takes the law's value in DEFAULTS."""
    options = parser("A strip footing on a layer of clay.")
    bases = "linear", "gimp", "bspline2", "bspline3"
    remedies = "none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"
    options.add_argument("--law", choices=tuple(DEFAULTS), default="cam-clay")
    options.add_argument("--strain", choices=("large", "small", "jaumann"), default="large")
    options.add_argument("--basis", choices=bases, help="by the law")
    options.add_argument("--fbar", choices=("on", "off"), help="against locking; by the law")
    options.add_argument("--footing", choices=("flexible", "rigid"), help="by the law")
    options.add_argument("--rough", choices=("on", "off"), help="by the law")
    options.add_argument("--h", type=float, help="size of the cells (m); by the law")
    options.add_argument(
        "--coarsest", type=float, help="size of the cells (m) far from the footing's edge; by the "
        "law; h for equal ones"
    )  # fmt: skip
    options.add_argument("--points-per-cell", type=int, help="in each direction; by the law")
    options.add_argument("--steps", type=int, help="of the footing; by the law")
    options.add_argument("--load", type=float, help="last pressure of a flexible footing (Pa)")
    options.add_argument(
        "--settlement", type=float, help="last one of a rigid footing (m); 75 c B/E by default"
    )
    options.add_argument("--modulus", type=float, help="Young's modulus (Pa) of Tresca's clay")
    options.add_argument("--stabilisation", choices=remedies, default="aggregation")
    options.add_argument(
        "--compare", action="store_true", help="cam-clay: measures of strain; tresca: bases with "
        "and without F-bar; tresca-perfect: F-bar on finer and finer cells"
    )  # fmt: skip
    given = options.parse_args()
    for name, value in DEFAULTS[given.law].items():
        if getattr(given, name) is None:
            setattr(given, name, value)
    if given.coarsest is None:
        given.coarsest = given.h
    given.coarsest = max(given.coarsest, given.h)
    if given.settlement is None:
        given.settlement = 75 * 10e3 / given.modulus
    if not 0 < given.h <= 1:
        options.error(f"h = {given.h:g} m must be positive and at most 1 m")
    if not given.coarsest <= 2:
        options.error(f"coarsest = {given.coarsest:g} m must be at most 2 m")
    if given.steps < 1 or given.points_per_cell < 1:
        options.error("steps and points-per-cell must be at least 1")
    if not min(given.load, given.settlement, given.modulus) > 0:
        options.error("load, settlement and modulus must be positive")
    return given


# %% [markdown]
# ## Grid and ground
# Equal cells, or cells that grow away from the footing's edge, where the stress jumps: a
# rectangular grid stays one when its lines are moved. There is room above the ground for what
# heaves beside the footing.


# %%
def lines(length, at, h, coarsest):
    """Ends of cells in [0, length], a line at `at`, where their size is h (m)."""

    def half(reach):
        sizes = [h]
        while sum(sizes) < reach - 1e-9:
            sizes.append(min(1.2 * sizes[-1], coarsest))
        return np.cumsum(sizes) * reach / sum(sizes) if reach > 0 else np.empty(0)

    return np.r_[at - half(at)[::-1], at, at + half(length - at)]


def rectangle(x, y):
    """A grid of rectangles with the lines x and y (m)."""
    n = len(x) - 1, len(y) - 1
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), n], n, mesh.CellType.quadrilateral)
    at = grid.geometry.x
    at[:, 0] = x[np.rint(at[:, 0]).astype(int)]
    at[:, 1] = y[np.rint(at[:, 1]).astype(int)]
    return grid


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
        self.grid = grid = rectangle(
            lines(WIDTH, HALF_WIDTH, args.h, args.coarsest),
            lines(DEPTH + ROOM, DEPTH, args.h, args.coarsest),
        )
        self.args = args
        law, self.weight, surcharge = law_of(args)
        self.internal = next(iter(law.internal))
        body = mpm.Box((0, 0), (WIDTH, DEPTH))
        # any density where there is no weight
        density = self.weight / GRAVITY or 1000.0
        self.points = points = mpm.fill(grid, body, args.points_per_cell, density)
        top = mpm.Surface(points, lambda x: np.isclose(x[1], DEPTH), (0, 1), name="top")
        self.under = under = mpm.Surface(
            points, lambda x: np.isclose(x[1], DEPTH) & (x[0] < HALF_WIDTH), (0, 1), name="under"
        )
        V = mpm.Space(grid, args.basis)
        u, v = V.increment, V.test
        self.gravity = fem.Constant(grid, (0.0, 0.0))
        self.pressure = fem.Constant(grid, (0.0, 0.0))
        self.settlement = fem.Constant(grid, 0.0)
        moved = points.add_field("moved", (2,), "m")
        turned = points.add_field("turned", (2, 2))
        rough, self.rigid = args.rough == "on", args.footing == "rigid"

        F = mpm.momentum(law, points, u, v, strain=args.strain, fbar=args.fbar == "on")
        F -= top.traction(fem.Constant(grid, (0.0, -surcharge)), v)
        F -= ufl.inner(points.density * self.gravity, v) * points.dX
        if self.rigid:
            self.footing = mpm.RigidFooting(under, self.settlement, rough=rough, E=args.modulus)
            F -= self.footing.contact(u, v)
        else:
            F -= under.traction(self.pressure, v)
        if rough and not self.rigid:
            stiffness = fem.Constant(grid, 1e3 * args.modulus / args.h)
            slip = moved + ufl.dot(turned, under.offset) + under.at(u)
            F -= under.traction(ufl.as_vector((-stiffness * slip[0], 0.0)), v)
        self.problem = mpm.QuasiStatic(
            F,
            u,
            points,
            mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom"),
            updates={"moved": moved + u, "turned": turned + ufl.dot(ufl.grad(u), points.F)},
            stabilisation=mpm.Stabilisation(args.stabilisation, E=args.modulus),
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


# %% [markdown]
# ## A run
# Settlement counts from when the footing is loaded. A run that finds no equilibrium ends there.


# %%
def run(args):
    """Load the footing; returns the figures, the history and the scene. Collective."""
    started = time.perf_counter()
    scene = Scene(args)
    ready = time.perf_counter()
    residuals, reason = [], ""
    for part in mpm.steps(20, label="weight") if scene.weight else ():
        scene.gravity.value[1] = -GRAVITY * part
        residuals.append(scene.step())
    first = scene.sunk()
    history = mpm.History(scene.grid.comm)
    history.record(load=0.0, centre=0.0, mean=0.0, edge=0.0)
    for part in mpm.steps(args.steps, label="footing"):
        scene.pressure.value[1] = -args.load * part
        scene.settlement.value = args.settlement * part
        try:
            residuals.append(scene.step())
        except ConvergenceError as error:
            reason = str(error)
            break
        names = "centre", "mean", "edge"
        history.record(load=scene.load(), **dict(zip(names, scene.sunk() - first)))
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
        **solver_figures(scene.problem),
        "seconds_setup": ready - started,
        "seconds_solve": time.perf_counter() - ready,
    }
    if args.law == "tresca-perfect":
        before = max(0, curve.shape[1] - 1 - max(1, args.steps // 5))
        figures["bearing_factor"] = float(curve[0, -1] / COHESION)
        figures["bearing_factor_exact"] = 2 + np.pi
        figures["bearing_error"] = float(curve[0, -1] / LIMIT - 1)
        # what the last fifth of the settlement still adds
        figures["last_rise"] = float(1 - curve[0, before] / curve[0, -1])
    reference = stored(args)
    if reference is not None:
        figures |= compared(curve, reference)
    say(describe(args, figures))
    return figures, history, scene


# %% [markdown]
# ## Against the stored curves
# The conforming curves with cells of 0.25 m are known to 0.1 % (centre) and 0.5 % (mean) for
# Cam-Clay. For Tresca's clay they are up to 56 kPa; beyond, the ground beside the edge stretches
# the further the smaller the elements.


# %%
def stored(args):
    """Load and settlement of centre, mean and edge by conforming elements, or None."""
    rough = args.rough == "on"
    if (
        args.footing == "rigid"
        or args.law == "tresca-perfect"
        or (args.law == "cam-clay" and rough)
    ):
        return None
    scene = "cam_clay" if args.law == "cam-clay" else "tresca" if rough else "tresca_smooth"
    strain = "small" if args.strain == "small" else "large"
    with open(STORED / f"{scene}_footing.csv", newline="") as file:
        table = csv.DictReader(line for line in file if not line.startswith("#"))
        names = "load_Pa", "centre_m", "mean_m", "edge_m"
        rows = [
            [float(row[k]) for k in names]
            for row in table
            if row["strain"] == strain and float(row["h_m"]) == 0.25
        ]
    return np.array(rows).T


def compared(curve, reference):
    """Figures of a curve against another, at the last load of both and at most on the way."""
    at = min(curve[0, -1], reference[0, -1])
    found, expected = ([np.interp(at, c[0], c[k]) for k in (1, 2)] for c in (curve, reference))
    figures = {"compared_at": float(at)}
    common = curve[:, curve[0] < at * (1 + 1e-12)]
    for k, name in ((1, "centre"), (2, "mean")):
        gap = common[k] - np.interp(common[0], reference[0], reference[k])
        figures[f"reference_{name}"] = float(expected[k - 1])
        figures[f"deviation_{name}"] = float(found[k - 1] / expected[k - 1] - 1)
        figures[f"max_deviation_{name}"] = float(np.abs(gap).max() / expected[k - 1])
    return figures


def describe(args, f):
    """Some lines on a run."""
    text = (
        f"{args.law}, {args.strain} strain, {args.basis}, F-bar {args.fbar}, {args.footing}, rough "
        f"{args.rough}, h = {args.h:g} m, {args.points_per_cell}² points, {args.stabilisation}: at "
        f"{f['load'] / 1e3:.2f} kPa {f['settlement_centre']:.4f} m in the centre, "
        f"{f['settlement_mean']:.4f} m on average; {f['newton_iterations']} iterations, "
        f"{f['halvings']} halvings, {f['seconds_solve']:.1f} s"
    )
    if "compared_at" in f:
        text += (
            f"\n    conforming elements at {f['compared_at'] / 1e3:g} kPa: "
            f"{f['reference_centre']:.4f} and {f['reference_mean']:.4f} m; deviation "
            f"{f['deviation_centre']:+.2%} and {f['deviation_mean']:+.2%}"
        )
    if "bearing_factor" in f:
        text += (
            f"\n    bearing factor {f['bearing_factor']:.4f}, Prandtl's {2 + np.pi:.4f} "
            f"({f['bearing_error']:+.2%}); the last fifth added {f['last_rise']:.2%}"
        )
    return text + (f"\n    ended early: {f['reason'][:400]}" if f["reason"] else "")


# %% [markdown]
# ## Pictures
# Pressure over settlement, and the ground as it is at the end, coloured by what its law
# remembers: the preconsolidation pressure of Cam-Clay, else the plastic strain.

# %%
LABELS = {
    "preconsolidation_pressure": "preconsolidation pressure $p_c$ (kPa)",
    "plastic_strain": r"plastic strain $\bar\varepsilon^p$ (%)",
}
SCALES = {"preconsolidation_pressure": 1e-3, "plastic_strain": 100.0}


def draw_curve(axes, args, figures, label, **look):
    """Draw pressure (kPa) over the mean settlement: of the axis if the footing is flexible."""
    curve = np.array(figures["curve"])
    unit = 1e3 if args.settlement < 0.1 and args.footing == "rigid" else 1.0
    axes.plot(curve[0] / 1e3, unit * curve[1], label=label, **look)
    what = "settlement" if args.footing == "rigid" else "settlement in the centre"
    axes.set(xlabel="pressure on the footing (kPa)", xlim=(0, None))
    axes.set_ylabel(f"{what} ({'mm' if unit > 1 else 'm'})")


def finish_curves(axes, args, strains):
    """Add what the curves are compared with; settlement points down."""
    for strain, dashes in zip(strains, ("-", (0, (4, 2)))):
        reference = stored(type(args)(**{**vars(args), "strain": strain}))
        if reference is not None:
            name = "conforming elements" + (f", {strain}" if len(strains) > 1 else "")
            axes.plot(
                reference[0] / 1e3, reference[1], "k", ls=dashes, lw=0.8, label=name, zorder=1
            )
    if args.law == "tresca-perfect":
        axes.axvline(LIMIT / 1e3, color="k", lw=0.8, label=r"$(2 + \pi)\,c$")
    axes.set_ylim(0, None)
    axes.invert_yaxis()
    axes.legend(loc="lower left")


def picture(path, args, figures, state, name):
    """The curve beside the ground at the end."""
    rigid = args.footing == "rigid"
    ratio = 1.4 if rigid else 1.7
    with mpm.figure(path, 7.5, 2.5, ncols=2, width_ratios=(1, ratio)) as (figure, (left, right)):
        every = max(1, args.steps // 25)
        draw_curve(left, args, figures, "material points", color="C1", marker="o", ms=3, lw=0,
                   markevery=every)  # fmt: skip
        finish_curves(left, args, ["small" if args.strain == "small" else "large"])
        x, F, l0, values = state
        values = SCALES[name] * values
        limit = np.percentile(values, 98 if rigid else 99.5)
        drawn = draw_points(right, x, F, l0, values, cmap="viridis", clim=(values.min(), limit))
        right.plot([0, WIDTH], [DEPTH, DEPTH], color="0.4", lw=0.6, ls="--")
        right.set(xlim=(0, 8 if rigid else WIDTH), ylim=(0, DEPTH + (0.2 if rigid else ROOM)))
        bar = figure.colorbar(drawn, ax=right, extend="max", shrink=0.8, aspect=15)
        bar.set_label(LABELS[name])


# %% [markdown]
# ## Runs

# %%
BASES = {
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
            for basis, name in BASES.items()
            for fbar in ("off", "on")
        ]
    return [
        (f"$h$ = {h:g} m" + (", F-bar" if fbar == "on" else ""), {"h": h, "fbar": fbar})
        for h in (4 * args.h, 2 * args.h, args.h)
        for fbar in ("off", "on")
    ]


args = arguments()
if not args.compare:
    figures, history, scene = run(args)
    history.write(args.output / "footing.csv")
    if not args.no_plot:
        state = scene.points.gather("x", "F", "l0", scene.internal)
        if scene.args.strain == "small" and not scene.rigid:
            # the linear theory moves nothing; the picture does
            moved = scene.points.gather("moved", "turned")
            if state is not None:
                state = state[0] + moved[0], state[1] + moved[1], *state[2:]
        if state is not None:
            picture(args.output / f"footing_{args.law}.png", args, figures, state, scene.internal)
    finish(args, figures)
else:
    results = []
    for label, options in variations(args):
        one = type(args)(**{**vars(args), **options})
        results.append({"label": label, **run(one)[0]})
    short = ("curve", "last_ratios", "last_residuals")
    rows = [{k: v for k, v in r.items() if k not in short} for r in results]
    mpm.study.write_table(rows, args.output / f"footing_{args.law}_compared.csv")
    if not args.no_plot:
        with mpm.figure(args.output / f"footing_{args.law}_compared.png", 3.5, 3.2) as (_, axes):
            pairs = args.law != "cam-clay"
            for k, r in enumerate(results):
                look = {"color": f"C{k // 2}", "ls": ":" if k % 2 == 0 else "-"}
                if not pairs:
                    look = {"color": f"C{k + 1}", "marker": "o", "ms": 3, "lw": 0}
                    look["markevery"] = max(1, args.steps // 20)
                draw_curve(axes, args, r, r["label"], **look)
            finish_curves(axes, args, ["large"] if pairs else ["large", "small"])
            if args.law == "tresca":
                # they part only when much of the ground flows
                axes.set(xlim=(0.6 * args.load / 1e3, 1.01 * args.load / 1e3), ylim=(1.05, 0.1))
    finish(args, {"runs": results})

# %% [markdown]
# # A cone penetrates the ground: clay against Teh & Houlsby's factor, sand under its weight
#
# A penetrometer of 60° with the radius R is pressed down. In weightless clay (Tresca, undrained
# strength $c_u$, rigidity index $I_r = G/c_u$) its resistance becomes steady when the clay no
# longer flows to the surface. Teh & Houlsby (1991, doi 10.1680/geot.1991.41.1.17) found
#
# $$ N_c = \frac{q_c}{c_u} = \frac43 (1 + \ln I_r)\left(1.25 + \frac{I_r}{2000}\right) $$
#
# for smooth cones and shafts, in clay with an isotropic stress at rest. In sand of the relative
# density RD, the stress at rest is that of a deposit with $K_0 = 1 - \sin\varphi$, and the
# stiffness grows with depth. The parameters are Brinkgreve's (`mpm.materials.sand`). The scene is
# the penetrometer of AMPSSIE's tutorials.
#
# With `--refine`, cells of the size h follow the tip alone. Points split and merge with them, and
# keep the mean volumes of F-bar. The ghost factor and the penalty are smaller. The resistance is
# 4.8, 4.4 and 5.1 % too large after 8 R with R/4, R/8 and R/16, and still grows. With `--basis
# bspline2` it is 2.4 and 3.3 % too large with R/4 and R/8.
#
# The cone is in the ground from the start, with its tip at the depth `--start`. Gaps of half a
# point close in the first steps. Domains of points change with their volume and keep their axes.
# Under the tip the ground is stretched along the face of the cone without end. Stretched domains
# would touch the cone from far away, as if it were wider by R/5.
#
# A ghost penalty resists the increment in cut cells, and so the flow past the cone. With its
# usual factor the resistance is too large by a third in cells of R/2, and by a seventh in cells
# of R/4. A tenth of the factor (`--ghost`) is enough. Tip and shoulder are rounded with the
# radius h. The penalty of contact is soft enough for Newton's method to find the corners that
# touch. The force has waves, because each row of points sticks to the tip before it goes past.
#
# Results in clay over four diameters, from 10 R to 18 R: the resistance is 9.2 % too large with
# h = R/2, 8.5 % with R/3 and 7.8 % with R/4 (I_r = 100). The force still grows by 3.4 to 3.9 %.
# With h = R/2 it is 8.4 % and 7.6 % too large for I_r = 50 and 200. Newton's method takes 6 to 9
# iterations per step, and two steps are halved with R/4.
#
# Results in sand at a depth of 4 m: 2.4 and 2.5 MPa with ghost penalties in cells of R/4 and R/2.
# Aggregation comes as far with R/3. With R/2 it does not, because ground beside the cone turns
# inside out. Without stabilisation the first steps fail.
#
# With `--drained`, `--undrained`, `--partly` or `--velocity` the ground is saturated Cam-Clay,
# normally consolidated (`--ratio`) under an isotropic stress (`cone_in_water.py`). The normalised
# velocity is $v d/c_v$, with the diameter d and the $c_v$ of virgin clay. `--curve` takes several
# velocities. The resistance goes from the drained to the undrained one along an S-shaped curve,
# the known "backbone" (DeJong & Randolph, 2012), with its middle at $v d/c_v \approx 3$. Without
# drainage the reference is Teh & Houlsby's factor, with the closed form of the undrained strength
# $c_u$ of the clay.
#
# A quarter of the cone in three dimensions has a smaller resistance than the axisymmetric cone on
# the same grid lines (h = R/2, zone 1.5, growth 2): by 9.5 % from 7.2 R to 8.4 R. It is 5 % below
# the axisymmetric one in cells of R/4, whose waves are smaller. The gaps around the cone are
# larger at first, because cubes leave more room beside a round body than rings do: gaps are half
# of the volume of the cone, and a quarter in the axisymmetric run.

# %%
import math
import time
from dataclasses import dataclass

import cone_factors
import numpy as np
import ufl
from cam_clay import PRESSURE
from cone_grids import graded, near_tip, roots
from cone_in_water import VELOCITIES, Clay, compared
from cone_pictures import draw, draw_curve
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

COHESION = 10e3  # Pa, of the clay
DEFAULTS = {  # by the law, lengths in m
    "tresca": {
        "radius": 1.0, "start": 6.0, "depth": 18.0, "h": 0.25, "step": 0.1, "poisson": 0.45,
        "fbar": "on", "friction": 0.0, "width": 40.0, "stabilisation": "ghost", "penalty": 5.0,
    },
    "sand": {
        "radius": 0.4, "start": 0.0, "depth": 4.0, "h": 0.1, "step": 0.02, "poisson": 0.25,
        "fbar": "off", "friction": 0.3, "width": 12.8, "stabilisation": "ghost", "penalty": 5.0,
    },
    "cam-clay": {
        "radius": 1.0, "start": 4.0, "depth": 12.0, "h": 0.5, "step": 0.1, "poisson": 0.0,
        "fbar": "off", "friction": 0.0, "width": 40.0, "stabilisation": "ghost", "penalty": 1.0,
    },
}  # fmt: skip


@dataclass
class Input(Options):
    """A cone penetrates clay or sand."""

    dimension: str = option("axisymmetric", choices=("axisymmetric", "3"))
    law: str = option("tresca", choices=tuple(DEFAULTS))
    radius: float | None = positive(None, "R (m); by the law")
    start: float | None = option(None, "depth of the tip at first (m); by the law", least=0)
    depth: float | None = option(None, "of the tip at the end (m); by the law")
    h: float | None = positive(None, "size of the cells around it (m); by the law")
    step: float | None = positive(None, "way of the cone in a step (m); by the law")
    rigidity_index: float = positive(100.0, "G/c_u of clay")
    criterion: str = option(
        "tresca", "of clay; or von Mises, c_u in this test", choices=tuple(cone_factors.CRITERIA)
    )
    ratio: float = option(1.0, "overconsolidation of Cam-Clay", least=1)
    drainage: str | None = option(
        None,
        one_of={
            name: "Cam-Clay with water" + (f" at v d/c_v = {value:g}" if value else " that stays")
            for name, value in VELOCITIES.items()
        },
    )
    velocity: float | None = positive(None, "v d/c_v of Cam-Clay, instead")
    curve: bool = option(False, "a run for each of --velocities")
    velocities: list[float] = option(
        [0.01, 0.1, 0.3, 1, 3, 10, 30, 100, 1000], "by commas", above=0
    )
    relative_density: float = option(0.32, "of sand")
    poisson: float | None = option(None, "Poisson's ratio; by the law")
    friction: float | None = option(None, "coefficient at the cone; by the law", least=0)
    width: float | None = positive(None, "radius of the ground (m); by the law")
    refine: bool = option(False, "cells that follow the tip, of the size h there")
    zone: float = option(2.5, "width of equal cells, by R", least=1.5)
    growth: float = option(1.3, "of cells outside of it; 1: all are alike", least=1)
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=("gimp", "linear", "bspline2"))
    fbar: str | None = option(None, "against locking; by the law", choices=("on", "off", "volumes"))
    domains: str = option("volume", "their growth", choices=("volume", "stretch", "fixed"))
    corners: str = option("domains", choices=("domains", "material"))
    penalty: float | None = positive(None, "κ h/E; by the law")
    fillet: float = option(1.0, "of tip and shoulder, by h")
    stabilisation: str | None = option(None, "by the law", choices=("none", "ghost", "aggregation"))
    ghost: float | None = positive(None, "factor of the ghost penalty; 0.1, refined 0.03")
    tolerance: float = 1e-6

    def _check(self):
        if self.curve or self.velocity or self.drainage:
            if self.law == "sand":
                raise ValueError("water goes with --law cam-clay")
            self.law = "cam-clay"
        if self.law == "cam-clay" and self.dimension == "3":
            raise ValueError("water goes with --dimension axisymmetric")
        if self.drainage:
            self.fill(velocity=VELOCITIES[self.drainage])
        if self.refine:
            self.fill(ghost=0.03, penalty=1.0, fbar={"tresca": "volumes"}.get(self.law))
        self.fill(ghost=0.1, **DEFAULTS[self.law])
        if not self.depth >= self.start + self.step:
            raise ValueError("the depth must be more than the start by a step")
        if not self.h <= self.radius:
            raise ValueError(f"h = {self.h:g} m must be at most R = {self.radius:g} m")
        if self.width < 2 * self.zone * self.radius:
            raise ValueError("the ground must be twice as wide as the zone")


# %% [markdown]
# ## Grid and ground
# Cells are of the size h around the cone and along its way, and grow from there.


# %%
class Scene:
    """The ground and the cone, step by step."""

    def __init__(self, args):
        self.args = args
        R, h = args.radius, args.h
        self.height = R * math.sqrt(3.0)
        self.flat = args.dimension == "axisymmetric"
        self.steps = max(1, round((args.depth - args.start) / args.step))
        self.way = (args.depth - args.start) / self.steps
        self.cone = self.penetrometer()
        averaged = {} if args.basis == "linear" else {"domains": args.domains}
        self.grid, low, high = self.background()
        V = mpm.Space(self.grid, args.basis, **averaged, **self.refined)
        touched = 0.5 * h / args.points_per_cell

        def beside(x):
            gap, normal, _ = self.cone.surface.probe(np.ascontiguousarray(x.T, float))
            # no corner of a domain within the cone
            return (x[-1] < 0) & (gap > touched * np.abs(normal).sum(axis=1) - 1e-9 * h)

        ground = mpm.Where(beside, low=low, high=np.append(high[:-1], 0.0))
        deposit = None
        if args.law == "sand":
            sand = mpm.materials.sand(args.relative_density, nu=args.poisson)
            deposit = mpm.Deposit(0.0, [mpm.Layer.of(sand)])
            E = deposit.modulus(sand.E_ref, sand.exponent, p_ref=sand.p_ref)
            law = mpm.materials.MohrCoulomb(E=E, **sand.parameters)
            density, self.unit = sand.density, 1e3
        elif args.law == "cam-clay":
            clay = Clay(args.ratio, args.rigidity_index, args.velocity, 2 * R, self.way)
            law, E, density, self.unit = clay.law, clay.young, 1000.0, clay.strength
        else:
            E = 2 * args.rigidity_index * COHESION * (1 + args.poisson)
            law = cone_factors.clay(E, args.poisson, COHESION, args.criterion)
            density, self.unit = 1000.0, COHESION
        self.points = points = mpm.fill(
            self.grid, ground, args.points_per_cell, density, axisymmetric=self.flat,
            refine=V if args.refine else None,
        )  # fmt: skip
        u, v = V.increment, V.test
        fields, bcs, self.wet = [u], [], args.law == "cam-clay"
        fbar = args.fbar if args.fbar == "volumes" else args.fbar == "on"
        if self.wet:
            Q = mpm.Space(self.grid, args.basis, shape=(), **averaged)
            F, bcs = clay.form(points, Q, u, v, fbar=fbar)
            fields.append(Q.increment)
        else:
            F = mpm.momentum(law, points, u, v, fbar=fbar)
        if deposit is not None:
            mpm.set_stress(law, points, lambda x: deposit.stress(x))
            F -= ufl.inner(deposit.body_force(points), v) * points.dX
        # in units of E/h with the h of the fine cells, where others are smaller
        relative = {"penalty": args.penalty * self.finest / h}
        stiff = {"stiffness_per_area": args.penalty / h * E} if self.wet else relative
        F += mpm.contact(
            self.cone, points, u, v, friction=args.friction, corners=args.corners, **stiff
        )
        if self.flat:
            bcs += mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0)
        else:
            bcs += mpm.rollers(V, "left", "right", "front", "back")
        stabilisation = args.stabilisation
        if stabilisation == "ghost":
            stabilisation = mpm.Stabilisation("ghost", factor=args.ghost)
        kind = mpm.Transient if self.wet else mpm.QuasiStatic
        self.problem = kind(
            F, fields, points, bcs + mpm.fixed(V, "bottom"),
            stabilisation=[stabilisation] * len(fields), tolerance=args.tolerance,
        )  # fmt: skip
        if self.wet:
            points["pressure"] = -PRESSURE
        self.history, self.reason = mpm.History(), ""

    def penetrometer(self):
        """Cone and shaft in one, with its tip where it starts."""
        args, R = self.args, self.args.radius
        tip, long = -args.start, args.depth + 4 * self.height
        # in water a step takes a second
        rate, ahead = "velocity" if args.law == "cam-clay" else "increment", (0.0, -self.way)
        motion = {"fillet": args.fillet * args.h, "name": "cone"}
        if not self.flat:
            shape = mpm.Cone((0.0, 0.0, tip), R, 30.0, long)
            return mpm.RigidBody(shape, **{rate: (0.0, *ahead)}, **motion)
        side = [(R, tip + self.height), (R, tip + long)]
        meridian = [(0.0, tip), *side, *((-r, z) for r, z in side[::-1])]
        return mpm.RigidBody(mpm.Polygon(meridian), **{rate: ahead}, **motion)

    def background(self):
        """The grid, and its lower and upper corner."""
        args, self.refined, self.finest = self.args, {}, self.args.h
        if args.refine:
            levels, across, up = roots(args)
            self.refined |= {"refine": near_tip(self.cone, args), "levels": levels}
            self.refined["per_cell"] = args.points_per_cell
        else:
            across, up = graded(args)
            self.finest = min(np.diff(line).min() for line in (across, up))
        lines = [across, up] if self.flat else [across, across, up]
        low, high = (np.array([line[k] for line in lines]) for k in (0, -1))
        return mpm.create_lattice(MPI.COMM_WORLD, lines), low, high

    def on_shaft(self):
        """What friction on the shaft, above the shoulder, takes of the force (N). Collective."""
        points, d = self.points, self.points.gdim
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * d, indexing="ij")).reshape(d, -1).T
        height = points["x"][:, None, -1] + signs[:, -1] * points["l"][:, None, -1]
        above = height > self.height - self.depth
        friction = -float(points["contact1_tangential_force"][above][:, -1].sum())
        return points.comm.allreduce(friction) * (1 if self.flat else 4)

    def at_shoulder(self):
        """Mean pressure beyond that at first of what is within h of the shoulder (Pa). Collective.

        That is where a piezocone has its filter, u₂.
        """
        points, R = self.points, self.args.radius
        beside = np.linalg.norm(points["x"][:, :-1], axis=1) - R
        above = points["x"][:, -1] - (self.height - self.depth)
        near = (np.abs(beside) < self.args.h) & (np.abs(above) < self.args.h)
        own = np.array([(points["pressure"][near] + PRESSURE).sum(), near.sum()])
        total, count = points.comm.allreduce(own)
        return float(total / count) if count else math.nan

    @property
    def depth(self):
        """Depth of the tip (m)."""
        return self.args.start + len(self.problem.history) * self.way

    def step(self):
        """One step; keeps depth and forces. Collective."""
        # with water a step takes 1 s
        record = self.problem.step(*([len(self.history) + 1.0] if self.wet else []))
        area = math.pi * self.args.radius**2
        whole = record.bodies["cone"]["force"][-1] * (1 if self.flat else 4)
        shaft = self.on_shaft() if self.args.friction else 0.0
        self.history.record(
            depth=self.depth, force=whole, shaft=shaft,
            factor=(whole - shaft) / area / self.unit,
            iterations=record.iterations, halvings=record.halvings,
            pore=self.at_shoulder() / self.unit if self.wet else 0.0,
        )  # fmt: skip

    def run(self):
        """Press the cone down as far as it goes. Collective."""
        for _ in mpm.steps(self.steps, label="cone"):
            try:
                self.step()
            except mpm.errors.ConvergenceError as error:
                self.reason = str(error)
                return


# %% [markdown]
# ## What comes out
# The mean factor of the last four diameters, or the latter half of the way if that is less, its
# scatter and how much it still grows over them: points that pass by the tip and shoulder one by one
# make waves.


# %%
def results(args, scene):
    """The figures of a run."""
    depth, factor = scene.history["depth"], scene.history["factor"]
    figures = {"reached": float(depth[-1]) if len(depth) else args.start, "reason": scene.reason}
    if not len(depth):
        return figures
    span = min(8 * args.radius, 0.5 * (depth[-1] - args.start))
    late = depth > depth[-1] - span - 1e-9
    mean = float(factor[late].mean())
    slope = float(np.polyfit(depth[late], factor[late], 1)[0]) if late.sum() > 1 else 0.0
    quarters = [float(part.mean()) for part in np.array_split(factor[late], 4) if part.size]
    figures |= {
        "factor": mean, "scatter": float(factor[late].std()), "drift": slope * span / mean,
        "quarters": quarters, "depths": depth.tolist(), "factors": factor.tolist(),
        "forces": scene.history["force"].tolist(), "shaft": scene.history["shaft"].tolist(),
        "tip_resistance": mean * scene.unit,
    }  # fmt: skip
    if args.law == "cam-clay":
        pore = float(np.nanmean(scene.history["pore"][late]))
        figures |= {"pore_ratio": pore / mean, "undrained_strength": scene.unit}
    if args.law == "tresca" or (args.law == "cam-clay" and args.velocity is None):
        figures |= cone_factors.compared(args.rigidity_index, mean, depth, factor, args.radius)
    return figures


def once(args):
    """One run, its figures and its scene. Collective."""
    started = time.perf_counter()
    scene = Scene(args)
    ready = time.perf_counter()
    scene.run()
    figures = results(args, scene) | solver_figures(scene.problem)
    figures |= {
        "seconds_setup": ready - started,
        "seconds_solve": sum(record.seconds for record in scene.problem.history),
    }
    text = f"{args.law}, {args.dimension}, h = {args.h:g} m: "
    if scene.wet:
        text += f"v d/c_v = {args.velocity:g}, " if args.velocity else "undrained, "
    if "factor" in figures:
        unit = " kPa" if args.law == "sand" else ""
        text += f"{figures['factor']:.2f}{unit} ± {figures['scatter']:.2f}, drift "
        text += f"{100 * figures['drift']:+.1f} %"
    if "error" in figures:
        text += f", {100 * figures['error']:+.1f} % from {figures['factor_exact']:.2f}, the last "
        text += f"2 R {figures['factor_late']:.2f}, {100 * figures['error_late']:+.1f} %, and "
        text += f"{100 * figures['late_from_lu']:+.1f} % from Lu et al."
    if "pore_ratio" in figures:
        text += f", Δu/q {figures['pore_ratio']:.2f}"
    say(
        f"{text}; {figures['reached']:.3f} m deep, {figures['newton_iterations']} iterations, "
        f"{figures['halvings']} halvings, {figures['seconds_solve']:.0f} s"
        + (f"; ended: {scene.reason[:300]}" if scene.reason else "")
    )
    return figures, scene


# %%
if __name__ == "__main__":
    args = Input.parse()
    if args.curve:
        runs = []
        for velocity in args.velocities:
            args.velocity = velocity
            runs.append({"velocity": velocity, **once(args)[0]})
        figures = {"runs": runs} | compared(runs)
        text = f"drained {figures['drained_ratio']:.2f} times undrained"
        if "V50" in figures:
            text += f", half of it at v d/c_v = {figures['V50']:.2f}; {figures['apart']:.2f} from "
            fitted = figures["V50_fitted"], figures["m_fitted"]
            text += "the backbone at most, fitted by V50 = {:.2f} and m = {:.2f}".format(*fitted)
        say(text)
        if not args.no_plot and MPI.COMM_WORLD.rank == 0:
            draw_curve(args.output / "cone_penetration_curve.png", runs, figures)
    else:
        figures, scene = once(args)
        if not args.no_plot and "factor" in figures:
            draw(args, scene, figures)
    finish(args, figures)

# %% [markdown]
# # A saturated slope fails: fast without drainage, slowly with it, or late
#
# A slope 6 m high stands on 2 m of the same soil, under water. Its weight grows as in a
# centrifuge, until it fails. Pressures are excess pressures, so the weight is the buoyant weight
# γ'. At first the soil is weightless under the isotropic effective stress $p_0$, because its
# water has the suction $-p_0$. So its undrained strength is the same everywhere, and known in
# closed form:
#
# - Cam-Clay: $c_u = \frac{M}{\sqrt3}\, p_0 (R/2)^{1 - \hat\kappa/\hat\lambda}$, with the
#   overconsolidation ratio $R$ (Wood 1990, ch. 7);
# - Mohr-Coulomb without dilation: $c_u = c' \cos\varphi + p_0 \sin\varphi$, for the mean effective
#   stress of the plane stays.
#
# For this reason the weight grows, and no soil is added or removed. Both limits are problems with
# one field, with known numbers:
#
# - **fast** ($c_v t/H^2 = 10^{-4}$): no water leaves. The slope fails as clay of the strength
#   $c_u$: Tresca's law in total stresses (`undrained`), with Taylor's (1937) number
#   $N = \gamma' H/c_u = 5.24$ for 60°;
# - **slow** ($c_v t/H^2 = 10^3$): water passes the surface, where its suction is
#   `--surface-suction`. The suction inside is the same. The soil behaves as soil without water
#   under the same pressure from outside (`drained`). With Mohr-Coulomb's law, Taylor's numbers
#   hold for the cohesion $c' + s \tan\varphi$ with this suction $s$.
#
# Normally consolidated Cam-Clay contracts, so the fast slope is weaker. With constant suction at
# the surface, the slow slope does not fail: it settles. Where the surface is wet (the default of
# Mohr-Coulomb), the suction and its strength fade, and the slow slope is weaker. A slope that is
# loaded fast to less than the undrained limit, and then left alone (`--hold`), stands for a while
# and fails later.
#
# Results in cells of H/12: normally consolidated Cam-Clay fails at N = 5.23, and so does Tresca's
# clay of the same strength. Drained, it moves within 1 % of the soil without water. Wet
# Mohr-Coulomb soil fails at 5.13 fast and at 2.67 slowly (2.67 without water, Taylor 2.47). With
# constant suction it fails at 5.46 fast. Held at N = 4, it fails after $c_v t/H^2 = 0.1$. In fast
# runs all bases and pairs agree within 2 %. Without a ghost penalty or aggregation they end
# before the failure.
#
# The slow limit is too high because of the size of the cells and of locking. 2.67 in cells of
# H/12 becomes 2.43 in cells of H/18, 2.66 with 3² points per cell, and 2.81 with quadratic
# splines (2.90 without F-bar). Without F-bar, or in cells of H/6, the slope carries all of N =
# 3.2.
#
# The failure is the load at which the farthest point moves by 0.05 H per unit of N; with
# `--hold`, the time at which it has moved by 0.05 H. Quasi-static steps go on beyond it, until
# the heap carries the load.

# %%
from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
import ufl
from cam_clay import COMPRESSION, PRESSURE, SWELLING, M, cam_clay
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option, positive, switch
from scene import faces, finish, say, solver_figures
from slope_pictures import BASE, HEIGHT, LIMITS, ROOM, TOE, WIDTH, picture, sheared

import dolfinmpm as mpm

SUCTION = PRESSURE
PERMEABILITY = 1e-9  # m/s; times are by c_v
TIMES = {"fast": 1e-4, "slow": 1e3}  # c_v t/H² of the rise
COHESION, FRICTION = 5e3, 25.0
# Taylor's c/(γH) by the angle of the slope, without friction (toe circles) and with 25°
TAYLOR = {0.0: {60: 0.191, 75: 0.219}, FRICTION: {45: 0.044, 60: 0.079, 75: 0.117}}
FAILS = 0.05  # displacement by H, per unit of N


@dataclass
class Input(Options):
    """A saturated slope is brought to failure, fast and slowly."""

    law: str = option("mohr-coulomb", choices=("cam-clay", "mohr-coulomb"))
    rate: list[str] = option(["fast", "slow"], "fast, slow, by commas")
    duration: float | None = option(None, "c_v t/H² of the rise, in place of --rate")
    hold: float = option(0.0, "c_v t/H² for which the last load stays", least=0)
    hold_steps: int = option(30, least=2)
    no_limits: bool = option(False, "without the problems of one field")
    load: float = positive(6.4, "N = γ'H/c_u at the end")
    steps: int = natural(32, "of the load", least=2)
    ratio: float = option(1.0, "Cam-Clay: overconsolidation ratio R", least=1)
    dilation: float = option(0.0, "Mohr-Coulomb: angle (degrees)")
    surface_suction: float | None = option(None, "kPa; 50 with Cam-Clay, 0 with Mohr-Coulomb")
    rigidity_index: float = option(100.0, "G/c_u")
    slope: float = option(60.0, "its angle (degrees)", least=20, most=90)
    h: float = positive(0.5, "size of the cells (m), divides 1")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    fbar: str | None = switch(None, "of the soil; on where friction drains")
    pair: str = option("equal", "of the pressure", choices=("equal", "nested", "linear"))
    stabilisation: str = option("ghost", choices=("none", "ghost", "aggregation"))

    def _check(self):
        self.fill(surface_suction=SUCTION / 1e3 if self.law == "cam-clay" else 0.0)
        if self.duration is not None:
            self.rate = ["timed"]
        elif not set(self.rate) <= set(TIMES):
            raise ValueError(f"rate = {','.join(self.rate)} must be of {', '.join(TIMES)}")
        if abs(1 / self.h - round(1 / self.h)) > 1e-9 or (self.pair == "nested" and self.h > 0.5):
            raise ValueError(
                f"h = {self.h:g} m must divide 1 m, and be 0.5 m at the most if nested"
            )
        least = 1.0 if self.law == "cam-clay" else 0.0
        if self.surface_suction < least:
            raise ValueError(f"the surface may have {least:g} kPa at the least")


# %% [markdown]
# ## Soil
# The law, and what follows from it in closed form. G is `--rigidity-index` times $c_u$.


# %%
class Soil:
    """A law, its undrained strength (Pa) and its P-wave modulus at first (Pa)."""

    def __init__(self, args):
        if args.law == "cam-clay":
            least = M * SUCTION / math.sqrt(3)
            self.strength = least * (args.ratio / 2) ** (1 - SWELLING / COMPRESSION)
            self.G = args.rigidity_index * self.strength
            self.law = cam_clay(args.ratio, self.G)
            self.modulus = SUCTION / SWELLING + 4 / 3 * self.G
        else:
            phi, nu = math.radians(FRICTION), 0.3
            self.strength = COHESION * math.cos(phi) + SUCTION * math.sin(phi)
            self.G = args.rigidity_index * self.strength
            self.law = mpm.materials.MohrCoulomb(
                2 * (1 + nu) * self.G, nu, COHESION, FRICTION, dilation_angle=args.dilation
            )
            self.modulus = 2 * self.G * (1 - nu) / (1 - 2 * nu)

    @property
    def total(self):
        """Tresca's law of the same undrained strength."""
        return mpm.materials.Tresca(2 * 1.49 * self.G, 0.49, self.strength)


def taylor(args, soil, kind):
    """N at failure by Taylor's circles, or None where they do not tell."""
    if kind == "undrained":
        number = TAYLOR[0.0].get(args.slope)
        known = args.dilation == 0.0 or args.law == "cam-clay"
        return 1 / number if number and known else None
    number = TAYLOR[FRICTION].get(args.slope)
    if number is None or args.law == "cam-clay":
        return None
    cohesion = COHESION + 1e3 * args.surface_suction * math.tan(math.radians(FRICTION))
    return cohesion / number / soil.strength


# %% [markdown]
# ## Slope
# Points whose neighbour above or beside them is missing have a face there: the surface is one of
# steps, level and upright, as the points' domains are.


# %%
class Slope:
    """The slope under a way of loading: fast, slow, timed; or undrained, drained, of one field."""

    def __init__(self, args, way):
        self.args, self.way, self.soil = args, way, Soil(args)
        self.coupled = way not in LIMITS.values()
        top = BASE + HEIGHT + ROOM
        self.grid = box_grid([(0, 0), (WIDTH, top)], (round(WIDTH / args.h), round(top / args.h)))
        self.points = mpm.fill(self.grid, mpm.Where(self.inside), args.points_per_cell, 1.0)
        self.gravity = fem.Constant(self.grid, (0.0, 0.0))
        V = mpm.Space(self.grid, args.basis)
        self.u, self.v = V.increment, V.test
        F, fields = self.with_water() if self.coupled else self.without_water()
        # the density is 1, gravity the weight per volume
        F -= ufl.inner(self.points.density * self.gravity, self.v) * self.points.dX
        if args.law == "mohr-coulomb" and way != "undrained":
            mpm.set_stress(self.soil.law, self.points, -SUCTION * np.eye(3))
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        kind = mpm.Transient if self.coupled else mpm.QuasiStatic
        stabilisations = [args.stabilisation] * len(fields)
        self.problem = kind(
            F, fields, self.points, bcs, stabilisation=stabilisations, tolerance=1e-7
        )  # fmt: skip
        if self.coupled:
            self.points["pressure"] = -SUCTION
        self.history, self.reason, self.state = mpm.History(), "", None

    def inside(self, x):
        """Whether positions, shape (2, n), are in the slope or the ground."""
        # rounding must not decide about the points on the face
        face = TOE - (x[1] - BASE) / math.tan(math.radians(self.args.slope)) - 1e-9
        return (x[0] < WIDTH) & (x[1] < BASE + HEIGHT) & ((x[1] < BASE) | (x[0] < face))

    def faces(self):
        """The level and the upright part of the surface."""
        return faces(self.points, self.inside, WIDTH)

    @property
    def fbar(self):
        """Whether means of cells take the place of the soil's volumes.

        Without them soil that shears at constant volume locks; where its water stays the pressure
        prevents that, and with both the volumes of single points would be free.
        """
        args = self.args
        if args.fbar is not None:
            return args.fbar == "on"
        flows = self.way != "fast" or args.hold > 0
        return args.law == "mohr-coulomb" and args.dilation == 0 and flows

    def with_water(self):
        """Form and fields of soil and water."""
        args, soil = self.args, self.soil
        coarse = {"coarsen": 2} if args.pair == "nested" else {}
        basis = "linear" if args.pair == "linear" else args.basis
        Q = mpm.Space(self.grid, basis, shape=(), **coarse)
        F = mpm.poromechanics(
            soil.law, self.points, (self.u, Q.increment), (self.v, Q.test),
            permeability=PERMEABILITY, porosity=0.5, modulus=soil.modulus, fbar=self.fbar,
            drained=[(face, -1e3 * args.surface_suction) for face in self.faces()],
        )  # fmt: skip
        return F, [self.u, Q.increment]

    def without_water(self):
        """Form and field of the limit: the soil under a pressure from outside, or Tresca's clay."""
        if self.way == "undrained":
            return mpm.momentum(self.soil.total, self.points, self.u, self.v, fbar=True), [self.u]
        F = mpm.momentum(self.soil.law, self.points, self.u, self.v, fbar=self.fbar)
        for face in self.faces():
            F += face.pressure(1e3 * self.args.surface_suction, self.u, self.v)
        return F, [self.u]

    def times(self):
        """Shares of the load, and c_v t/H² at their ends."""
        args = self.args
        shares = np.arange(1, args.steps + 1) / args.steps
        rise = args.duration if self.way == "timed" else TIMES.get(self.way, 1.0)
        T = rise * shares
        if args.hold and self.coupled:
            # the first in which water enters a tenth of a cell, the last as long as the half
            first = min(1e-2 * (args.h / HEIGHT) ** 2, 1e-2 * args.hold)
            held = np.geomspace(first, args.hold, args.hold_steps)
            shares, T = np.append(shares, np.ones(len(held))), np.append(T, T[-1] + held)
        return shares, T

    def run(self):
        """Take the steps. Collective."""
        shares, T = self.times()
        second = HEIGHT**2 / (PERMEABILITY / mpm.Fluid().unit_weight * self.soil.modulus)
        for k in mpm.steps(len(T), label=self.way):
            i = round(k * len(T)) - 1
            self.gravity.value[1] = -self.args.load * shares[i] * self.soil.strength / HEIGHT
            try:
                self.problem.step(*([second * T[i]] if self.coupled else []))
            except mpm.errors.DolfinMPMError as error:
                # the run's outcome is what is asked for, good or bad
                self.reason = f"{type(error).__name__}: {error}"
                return
            self.history.record(N=self.args.load * shares[i], T=T[i], **self.measured())
            self.keep(int(np.count_nonzero(shares < 1)))

    def keep(self, held):
        """Keep the state for a picture: while the load is held, that of the failure. Collective."""
        moved, args = self.history["moved"], self.args
        late = len(moved) > held + 1 and moved[-2] > moved[held] + FAILS
        if self.coupled and not args.no_plot and not late:
            self.state = self.points.gather("x", "F", "l0", "pressure")

    def measured(self):
        """Displacements by H, and the pressure where the soil shears most. Collective."""
        points, comm = self.points, self.points.comm
        moved = points["x"] - points["x0"]
        crest = BASE + HEIGHT - 2 * self.args.h
        at_crest = points["x0"][:, 1] > crest
        down = comm.allreduce((-moved[at_crest, 1]).max(initial=0.0), op=MPI.MAX)
        far = comm.allreduce(np.abs(moved).max(initial=0.0), op=MPI.MAX)
        toe = (np.abs(points["x0"] - (TOE, BASE)) < self.args.h).all(axis=1)
        out = comm.allreduce(moved[toe, 0].max(initial=-np.inf), op=MPI.MAX)
        figures = {"moved": far / HEIGHT, "crest": down / HEIGHT, "toe": out / HEIGHT}
        if self.coupled:
            found = points.gather("F", "pressure")
            mean = None
            if found is not None:
                shear = sheared(found[0])
                most = shear > np.percentile(shear, 95)
                mean = float((found[1][most].mean() + SUCTION) / self.soil.strength)
            figures["excess"] = comm.bcast(mean, root=0)
        return figures

    def results(self):
        """The figures of the run. Collective."""
        names = "N", "T", "moved", "crest", "toe"
        if not len(self.history):
            # the first step failed
            return {"limit": None, "taylor": None, "failed_at": None, "reason": self.reason,
                    "seconds": 0.0, **{name: [] for name in names},
                    **solver_figures(self.problem)}  # fmt: skip
        N, T, moved = (self.history[name] for name in names[:3])
        rising = np.concatenate([[True], np.diff(N) > 0])[: len(N)]
        last = int(np.count_nonzero(rising)) - 1
        failed = failure(N[rising], moved[rising])
        late = np.flatnonzero(moved[last:] > moved[last] + FAILS)
        figures = {
            "limit": failed,
            "taylor": taylor(self.args, self.soil, LIMITS.get(self.way, self.way)),
            "failed_at": float(T[last + late[0]]) if failed is None and len(late) else None,
            "reason": self.reason,
            "seconds": sum(record.seconds for record in self.problem.history),
            **{name: self.history[name].tolist() for name in names},
        }
        if self.coupled:
            excess = self.history["excess"]
            figures["excess"] = excess.tolist()
            if failed is not None:
                figures["excess_at_failure"] = float(np.interp(failed, N[rising], excess[rising]))
        return figures | solver_figures(self.problem)


def failure(N, moved):
    """N from which on displacements grow by more than FAILS per unit of it, or None."""
    rates = np.diff(moved, prepend=0.0) / np.diff(N, prepend=0.0)
    middle = N - 0.5 * np.diff(N, prepend=0.0)
    # in the first step the ground also swells, as its surface takes the suction that is held there
    above = 1 + np.flatnonzero(rates[1:] > FAILS)
    if not above.size:
        return None
    k = above[0]
    if rates[k - 1] >= FAILS:
        return float(middle[k])
    return float(np.interp(FAILS, rates[k - 1 : k + 1], middle[k - 1 : k + 1]))


def describe(way, result):
    """A line on a run."""
    limit, known = result["limit"], result["taylor"]
    text = f"{way:10s} " + ("no failure" if limit is None else f"fails at N = {limit:.3f}")
    text += "" if known is None else f", Taylor {known:.2f}"
    if result["failed_at"] is not None:
        text += f", but later, at c_v t/H² = {result['failed_at']:.3g}"
    if "excess_at_failure" in result:
        text += f", excess pressure on the slip {result['excess_at_failure']:+.2f} c_u"
    moved = result["moved"][-1] if result["moved"] else 0.0
    return (
        f"{text}; moves by {moved:.3f} H in the end, {result['newton_iterations']} iterations, "
        f"{result['halvings']} halvings, {result['seconds']:.1f} s"
        + (f"; ended: {result['reason'][:300]}" if result["reason"] else "")
    )


# %% [markdown]
# ## Runs


# %%
args = Input.parse()
started = time.perf_counter()
ways = list(args.rate)
if not args.no_limits:
    ways += [LIMITS[way] for way in args.rate if way in LIMITS]
runs, states = {}, {}
for way in ways:
    slope = Slope(args, way)
    slope.run()
    runs[way] = slope.results()
    say(describe(way, runs[way]))
    if slope.state is not None:
        states[way] = slope.state
figures = {"runs": runs, "undrained_strength": Soil(args).strength}
for way, limit in LIMITS.items():
    pair = [runs[name]["limit"] for name in (way, limit) if name in runs]
    known = len(pair) == 2 and None not in pair
    figures[f"{way}_error"] = pair[0] / pair[1] - 1 if known else None
    if len(pair) == 2:
        # displacements at the same loads
        ours, theirs = (np.array(runs[name]["moved"]) for name in (way, limit))
        n = min(len(ours), len(theirs))
        apart = np.abs(ours[:n] - theirs[:n]).max(initial=0.0)
        figures[f"{way}_apart"] = float(apart / theirs[:n].max(initial=1e-300))
figures["seconds"] = time.perf_counter() - started
if states:
    name = "held" if args.hold else args.law.replace("-", "_")
    picture(args.output / f"coupled_slope_{name}.png", args, runs, states, Soil(args).strength)
finish(args, figures)

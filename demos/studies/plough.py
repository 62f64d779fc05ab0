# %% [markdown]
# # A plough is dragged through sand
#
# A steel share is dragged through a bed of sand, in which it stands from the start (after the last
# example of Coombs's lectures on implicit material point methods, ALERT 2024: a plough 1.85 m deep
# in sand of the relative density 44 %, friction 0.3, cells of 0.15 m, dragged 20 m). One half is
# solved, symmetric about y = 0. The defaults are a small plough, 1 m deep and wide, in cells of a
# quarter of that, dragged by 1 m; `--distance 20` goes on to where the heap of spoil no longer
# grows.
#
# - The share is a prism with a wedge in front, a closed surface of triangles. Its edges are
#   rounded by a quarter of a point's domain.
# - The sand is at rest at first, with $K_0 = 1 - \sin\varphi$, and its stiffness follows from its
#   stress. Points fill it row by row, beginning at the faces of the share.
# - Cells are fine in a zone around the plough. The zone moves with it cell by cell. Beyond the
#   zone cells grow.
# - The sides behind and in front of the plough are Signorini plates: sand may leave them.
# - Corners overlap with the share by an eighth of a cell, on average of the force. With a penalty
#   ten times as hard, the pull is 4 % larger after a metre. But then a few corners carry all the
#   force, which jumps from one corner to the next, and Newton's method needs 40 % more
#   iterations.
# - The tolerance of the balance is 2e-4 of the loads. With 1e-6 the pull differs by 1 %, in waves
#   of 10 %, and the run takes twice as long. After some metres more than 1e-5
#   is left out of balance, because single corners touch in turn.
#
# The pull rises to 0.21 MN over a metre, seven times Rankine's passive thrust on the width of the
# share. The heap rises to 0.6 m. From four to twenty metres the pull goes in waves, 1.7 m long,
# between 0.19 and 0.24 MN. Each wave is a slip surface that begins in front of the share. From
# the first half of this way to the second half, the mean pull grows by 2 %, and the heap stays at
# 0.94 m. In cells of half a metre the pull stays at about 0.28 MN from ten to twenty metres, with
# a heap of 1.2 m.
#
# The pull has not converged in such cells. Sand within a cell of the share moves with it, as if
# the share were wider and deeper. The ghost penalty resists the flow. After half a metre the pull
# is 258 and 197 kN in cells of 0.5 and 0.25 m. With a tenth of the penalty (`--ghost 0.3`) it is
# 199 and 181 kN, for 1.5 times as many Newton iterations. With a third (`--ghost 1`, the usual
# penalty) a step of the run over a metre takes 8.3 iterations in place of 7.2, and the pull is
# 204 kN in place of 214.
#
# With `--refine`, cells of the size h follow the share. Points split and merge with them, and the
# balance is to 1e-6. After 0.25 m, in steps of 25 mm, the pull is 150 and 131 kN and the heap
# 0.18 and 0.15 m in cells of 0.25 and 0.125 m, with 5.0 and 7.7 iterations per step. With less
# penalty a step takes more iterations: sand that falls into the trench behind the share is at the
# apex of the yield surface, where the tangent is zero. The number of iterations is sensitive: with
# `--ghost 2` in the finer cells ten steps are halved. In cells of 0.0625 m (`--step 0.2`) a step
# takes a minute.

# %%
from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import ufl
from mpi4py import MPI
from options import Options, natural, option, positive
from plough_grids import beside, near_share, roots
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD
LAWS = {"mohr-coulomb": mpm.materials.MohrCoulomb, "drucker-prager": mpm.materials.DruckerPrager}


@dataclass
class Input(Options):
    """A plough is dragged through sand."""

    distance: float = positive(1.0, "of the drag (m)")
    h: float = positive(0.25, "size of the cells around the plough (m)")
    step: float = positive(0.2, "that the plough goes at once, in cells", most=1)
    depth: float = positive(1.0, "of the share in the sand (m)")
    half_width: float = positive(0.5, "of the share (m)")
    plan_angle: float = option(45.0, "between face and way, seen from above (°)", least=20, most=80)
    rake: float = option(90.0, "between the nose and the ground (°)", least=30, most=90)
    relative_density: float = 0.44
    friction: float = option(0.3, "of steel on sand")
    law: str = option("mohr-coulomb", choices=tuple(LAWS))
    points_per_cell: int = natural(2)
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    stabilisation: str = option("ghost", choices=("none", "ghost", "aggregation"))
    refine: bool = option(False, "cells that follow the share, of the size h there")
    ghost: float | None = option(None, "factor of the penalty; 3 of a ghost penalty")
    penalty: float | None = positive(None, "κ h/E; 1.25, refined 1")
    domains: str = option("volume", choices=("stretch", "volume"))
    corners: str = option("domains", choices=("domains", "material"))
    growth: float = option(1.5, "of cells beyond the fine ones", least=1)
    solver: str = option("auto", choices=("auto", "direct", "iterative"))
    tolerance: float | None = positive(None, "of the balance; 2e-4, refined 1e-6")

    def _check(self):
        if self.refine:
            self.fill(penalty=1.0, tolerance=1e-6)
        if self.stabilisation == "ghost":
            self.fill(ghost=3.0)
        self.fill(penalty=1.25, tolerance=2e-4)


# %%
class Share:
    """The plough's share, with its nose's foot at the origin's x.

    Attributes:
        back, top: Where it ends behind (m), and above the ground.
    """

    def __init__(self, args):
        self.d, self.w, h = args.depth, args.half_width, args.h
        self.slope = 1 / math.tan(math.radians(args.plan_angle))
        self.lean = 1 / math.tan(math.radians(args.rake)) if args.rake < 90 else 0.0
        self.top = 1.0 * args.depth
        # leaves converge to one share
        tail = 0.5 * self.d if args.refine else 2 * h
        self.back = -(self.w * self.slope + (self.d + self.top) * self.lean + tail)

    def front(self, y, z):
        """Where its face is at heights z and distances y from the middle (m)."""
        return -y * self.slope - (z + self.d) * self.lean

    def mesh(self):
        """Its whole surface, as triangles."""
        import meshio
        from scipy.spatial import ConvexHull

        ends = [(z, y) for z in (-self.d, self.top) for y in (-self.w, 0.0, self.w)]
        x = [(self.front(abs(y), z), y, z) for z, y in ends]
        x += [(self.back, y, z) for z, y in ends if y]
        x = np.array(x)
        hull = ConvexHull(x)
        a, b, c = (x[hull.simplices[:, k]] for k in range(3))
        inward = np.sum(np.cross(b - a, c - a) * (a - x.mean(axis=0)), axis=1) < 0
        triangles = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
        return meshio.Mesh(x, [("triangle", triangles)])


def graded(first, size, end, growth):
    """Lines beyond `first` (m), in cells that grow from a size up to an end, exactly."""
    length, sizes = abs(end - first), []
    while sum(sizes) < length * (1 - 1e-9):
        size *= growth
        sizes.append(size)
    return first + math.copysign(1.0, end - first) * np.cumsum(sizes) * (length / sum(sizes))


class Scene:
    """Half of the bed, and the plough."""

    def __init__(self, args):
        self.args, self.h, d, w = args, args.h, args.depth, args.half_width
        self.share = Share(args)
        ahead, behind = 2 * d, d - self.share.back
        self.start = behind + 1.5 * d
        length = self.start + args.distance + ahead + 1.5 * d
        self.bed = np.array([length, 4 * d + w, 3 * d])
        self.laid, self.plough = 0, self.tool()
        if args.refine:
            levels, lines = roots(args, self.bed)
            self.bed = np.array([lines[0][-1], lines[1][-1], -lines[2][0]])
            self.refined = {"refine": near_share(self.plough, args), "levels": levels}
            self.refined["per_cell"] = args.points_per_cell
        else:
            self.across, self.refined = self.zoned(behind, ahead), {}
            lines = self.lines()
        grid = mpm.create_lattice(COMM, lines)
        averaged = {} if args.basis == "linear" else {"domains": args.domains}
        V = mpm.Space(grid, args.basis, **averaged, **self.refined)
        self.points = points = self.leaves(grid, V) if args.refine else self.fill(grid)
        self.problem = self.equations(V, points)
        self.first, self.history = float(self.plough.position[0]), mpm.History()

    def zoned(self, behind, ahead):
        """Lines across and up, fine around the plough; sets the fine zone along the way."""
        args, h, d, w = self.args, self.h, self.args.depth, self.args.half_width
        length = self.bed[0]
        # the fine zone, in cells from the nose
        self.zone = math.ceil(behind / h), math.ceil(ahead / h)
        self.outer = (max(2, self._cells(self.start - behind)), 0)
        rest = length - self.start - self.zone[1] * h
        self.outer = (max(3, self._cells(rest)),) * 2
        fine = math.ceil((w + d) / h)
        y = np.r_[h * np.arange(fine + 1), graded(fine * h, h, self.bed[1], args.growth)]
        low, up = math.ceil(1.5 * d / h), math.ceil(0.75 * d / h)
        z = np.r_[
            graded(-low * h, h, -self.bed[2], args.growth)[::-1], h * np.arange(-low, up + 1),
            graded(up * h, h, up * h + 2 * h, 1.0),
        ]  # fmt: skip
        return y, z

    def _cells(self, length):
        """How many growing cells cover a length (m)."""
        return math.ceil(math.log1p(length / self.h * (1 - 1 / self.args.growth)) / math.log(
            self.args.growth))  # fmt: skip

    def lines(self):
        """Lines of the grid with the zone around where the nose is, to whole cells."""
        nose, (back, ahead), h = self.start + self.laid * self.h, self.zone, self.h
        cells = self.outer[0], back + ahead, self.outer[1]
        x = mpm.zoned_line(0.0, self.bed[0], (nose - back * h, nose + ahead * h), cells)
        return [x, *self.across]

    def fill(self, grid):
        """The sand's points: rows along x, cut where the share is."""
        n, share = self.args.points_per_cell, self.share
        y, z = (np.concatenate([np.linspace(a, b, n + 1)[:-1] for a, b in pairwise(line)])
                for line in self.across)  # fmt: skip
        y, z = np.append(y, self.across[0][-1]), np.append(z, self.across[1][-1])
        z = z[z < 1e-9 * self.h]
        z[-1] = 0.0
        size, x, half = self.h / n, [], []
        for y0, y1 in pairwise(y):
            for z0, z1 in pairwise(z):
                rows = [(0.0, self.bed[0])]
                if y0 < share.w * (1 - 1e-9) and z1 > -share.d * (1 - 1e-9):
                    rows = [(0.0, self.start + share.back),
                            (self.start + share.front(y0, z0), self.bed[0])]  # fmt: skip
                for a, b in rows:
                    count = max(1, round((b - a) / size))
                    at = a + (b - a) * (np.arange(count) + 0.5) / count
                    middle = np.full(count, 0.5 * (y0 + y1)), np.full(count, 0.5 * (z0 + z1))
                    x.append(np.column_stack([at, *middle]))
                    lengths = 0.5 * np.array([(b - a) / count, y1 - y0, z1 - z0])
                    half.append(np.tile(lengths, (count, 1)))
        return self.sand(grid, np.concatenate(x), np.concatenate(half))

    def leaves(self, grid, V):
        """The sand's points in leaves, cut where the share is."""
        box = mpm.Box((0, 0, -self.bed[2]), (*self.bed[:2], 0.0))
        whole = mpm.fill(grid, box, self.args.points_per_cell, 1.0, refine=V)
        return self.sand(grid, *beside(whole["x"], whole["l0"], self.share, self.start))

    def sand(self, grid, x, half):
        """Sand in boxes."""
        sand = mpm.materials.sand(self.args.relative_density)
        return mpm.MaterialPoints.from_arrays(
            grid, x, np.prod(2 * half, axis=1), sand.density, half_length=half
        )

    def tool(self):
        """The plough."""
        share, self.ahead = self.share.mesh(), 0.0
        share.points += (self.start, 0.0, 0.0)
        return mpm.RigidBody(
            share, name="plough", increment=lambda t: (self.ahead, 0.0, 0.0),
            fillet=0.25 * self.h / self.args.points_per_cell,
        )  # fmt: skip

    def equations(self, V, points):
        """The problem."""
        args, h = self.args, self.h
        sand = mpm.materials.sand(args.relative_density)
        ground = mpm.Deposit(0.0, mpm.Layer.of(sand))
        law = LAWS[args.law](E=ground.modulus(sand.E_ref, sand.exponent), **sand.parameters)
        mpm.set_stress(law, points, ground.stress)
        u, v = V.increment, V.test
        F = mpm.momentum(law, points, u, v) - ufl.inner(ground.body_force(points), v) * points.dX
        # in units of E/h with the h of the fine cells, where others are smaller
        finest = h if args.refine else min(np.diff(line).min() for line in self.lines())
        penalty = args.penalty * finest / h
        F += mpm.contact(
            self.plough, points, u, v, friction=args.friction, penalty=penalty, corners=args.corners
        )
        # the plates give way by a hundredth of a cell of sand at half the depth of the bed
        deep = np.array([[0.0], [0.0], [-0.5 * self.bed[2]]])
        stiffness = 100 * float(ground.modulus(sand.E_ref, sand.exponent)(deep)[0]) / h
        for side in ("left", "right"):
            # leaves at the plates may be as small as those at the share
            spacing = h if args.refine else None
            plate = mpm.Boundary.from_side(points, side, spacing=spacing)
            F += mpm.signorini(plate, u, v, stiffness_per_area=stiffness)
        bcs = mpm.rollers(V, "front", "back") + mpm.fixed(V, "bottom")
        options = {
            "auto": None, "direct": {"ksp_type": "preonly", "pc_type": "lu"},
            "iterative": {"ksp_type": "gmres", "pc_type": "gamg"},
        }[args.solver]  # fmt: skip
        stabilisation = mpm.Stabilisation(args.stabilisation, factor=args.ghost)
        return mpm.QuasiStatic(
            F, u, points, bcs, stabilisation=stabilisation, tolerance=args.tolerance,
            petsc_options=options,
        )  # fmt: skip

    def step(self):
        """One step; keeps what it took. Collective."""
        way = float(self.plough.position[0] - self.first) / self.h
        if not self.refined and math.floor(way + 1e-6) > self.laid:
            self.laid = math.floor(way + 1e-6)
            mpm.regrid(self.problem, self.lines())
        started = time.perf_counter()
        record = self.problem.step()
        top = (self.points["x"] + self.points["l"])[:, 2].max(initial=0.0)
        self.history.record(
            distance=float(self.plough.position[0] - self.first),
            pull=-2 * float(self.plough.force[0]), lift=2 * float(self.plough.force[2]),
            heap=COMM.allreduce(float(top), op=MPI.MAX), iterations=record.iterations,
            halvings=record.halvings, seconds=time.perf_counter() - started,
            linear=float(np.mean(record.linear_iterations or [0])),
        )  # fmt: skip

    def run(self):
        """Let the sand come to rest at the share, and drag. Collective."""
        args = self.args
        self.step()
        count = math.ceil(args.distance / (args.step * args.h) - 1e-9)
        self.ahead = args.distance / count
        for _ in mpm.steps(count, label="plough"):
            self.step()


def draw(args, scene):
    """Pull, a section along the way, and heights seen from above; rank 0 writes. Collective."""
    points, h = scene.points, args.h / args.points_per_cell
    # of sand that has gone round the share F tells little of where it is: its domains do
    found = points.gather("x", "l", "plastic_strain")
    if found is None:
        return
    x, half, strain = found
    upright = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    history, share = scene.history, scene.share
    nose = scene.start + history["distance"][-1]
    with mpm.figure(
        args.output / "plough.png", 6.0, 6.2, nrows=3, height_ratios=(1, 1.5, 1.5),
    ) as (figure, (curve, middle, bottom)):  # fmt: skip
        curve.plot(history["distance"], history["pull"] / 1e3, "o-", ms=2)
        curve.set(xlabel="distance (m)", ylabel="pull (kN)", ylim=(0, None))
        cut = np.abs(x[:, 1] - 0.5 * h) <= half[:, 1]
        drawn = draw_points(
            middle, x[cut][:, [0, 2]], upright[cut][:, :2, :2], half[cut][:, [0, 2]],
            np.log10(strain[cut] + 1e-4), cmap="magma", clim=(-3, 0.5),
        )  # fmt: skip
        low, up = -share.d, share.top
        middle.fill(
            nose + np.array([share.back, share.front(0, low), share.front(0, up), share.back]),
            [low, low, up, up], color="0.5", zorder=3,
        )  # fmt: skip
        window = max(0.0, nose - 6 * args.depth), min(scene.bed[0], nose + 4 * args.depth)
        middle.set(xlim=window, ylim=(-2 * args.depth, 1.2 * args.depth), ylabel="$z$ (m)")
        figure.colorbar(drawn, ax=middle, label=r"$\log_{10}$ plastic strain")
        # from below to above, so that what lies above hides what lies below
        top = x[:, 2] + half[:, 2]
        order = np.argsort(top)[np.count_nonzero(top < -1.2 * share.d) :]
        limit = max(0.05 * args.depth, float(np.abs(top[order]).max()))
        drawn = draw_points(
            bottom, x[order][:, :2], upright[order][:, :2, :2], half[order][:, :2], top[order],
            cmap="RdBu_r", clim=(-limit, limit),
        )  # fmt: skip
        w = args.half_width
        bottom.fill(
            nose + np.array([share.back, share.front(0, 0), share.front(w, 0), share.back]),
            [0, 0, w, w], color="0.5", zorder=3,
        )  # fmt: skip
        bottom.set(xlim=window, ylim=(0, min(scene.bed[1], 3.2 * args.depth)))
        figure.colorbar(drawn, ax=bottom, label="height of the surface (m)")


# %%
args = Input.parse()
scene = Scene(args)
started = time.perf_counter()
scene.run()
history = scene.history
pull = history["pull"]
late = history["distance"] > 0.8 * history["distance"][-1]
linear = history["linear"]
figures = {
    "pull": float(pull[late].mean()), "last_pull": float(pull[-1]), "peak": float(pull.max()),
    "heap": float(history["heap"][-1]), "at_rest": float(pull[0]),
    "lift": float(history["lift"][-1]), "distances": history["distance"].tolist(),
    "pulls": pull.tolist(), "heaps": history["heap"].tolist(),
    "linear_iterations": float(linear[linear > 0].mean()) if (linear > 0).any() else None,
    "seconds_a_step": float(np.median(history["seconds"])),
    "seconds": time.perf_counter() - started, **solver_figures(scene.problem),
}  # fmt: skip
say(
    f"pull {figures['pull'] / 1e3:.2f} kN over the last fifth of {args.distance:g} m (at most "
    f"{figures['peak'] / 1e3:.2f}), heap {figures['heap']:.3f} m; {figures['unknowns']} "
    f"unknowns, {figures['points']} points, {figures['newton_iterations']} iterations in "
    f"{len(history)} steps, {figures['halvings']} halvings, {figures['seconds']:.0f} s"
)
if not args.no_plot:
    draw(args, scene)
finish(args, figures)

# %% [markdown]
# # Down a slope: blocks that slide or stay, discs and spheres that roll or slip
#
# Gravity is tilted by the slope's angle θ, so that the slope is level on the grid.
#
# - `--shape block`: an elastic block on a rigid plane. Friction holds it as far as it goes, and
#   then it is let go: $d = \tfrac12 g t^2 (\sin\theta - \mu\cos\theta)$, or nothing if μ > tan θ.
# - `--shape disc`, `--shape sphere`: a rigid body that is free, on a stiff slope of material points
#   (the sphere as AMPSSIE's tutorial has it: 2 m, 10⁴ kg, 4000 kg m², E = 1 GPa). With
#   $k = I/mR^2$ it rolls, $d = \tfrac12 g t^2 \sin\theta/(1+k)$, if
#   $\tan\theta < \mu(1 + 1/k)$, and slips like the block else.
# - `--shape cylinder`: an elastic cylinder of material points on a rigid plane (Kratos's example:
#   7800 kg/m³, 200 MPa), $k = 1/2$.
#
# What comes out after 1 s at 45°, with the default steps: the block under μ = 0.3 within 0.1 % by
# Newmark's rule and 0.3 % by explicit steps, in no more than 6 iterations per step; friction takes
# μN times the slip. Under μ = 1.2 it stays, without creep.

# %%
import math
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

G = 9.81
COMM = MPI.COMM_WORLD
INERTIA = {"block": None, "disc": 0.5, "cylinder": 0.5, "sphere": 0.4}  # I/mR²
INTEGRATORS = {
    "newmark": mpm.Newmark, "generalised-alpha": mpm.GeneralisedAlpha, "explicit": mpm.Explicit,
}  # fmt: skip


@dataclass
class Input(Options):
    """A block, disc, cylinder or sphere on a slope."""

    shape: str = option("block", choices=tuple(INERTIA))
    angle: float = option(45.0, "of the slope (degrees)", above=0, below=90)
    friction: float = option(0.3, "coefficient μ", least=0)
    duration: float = positive(1.0, "(s)")
    integrator: str = option("newmark", choices=tuple(INTEGRATORS))
    dt: float | None = option(None, "step (s); by the shape")
    h: float | None = positive(None, "size of the cells (m); by the shape")
    basis: str = option("gimp", choices=("gimp", "linear", "bspline2"))

    def _check(self):
        cylinder = self.shape == "cylinder"
        self.fill(h=0.05 if cylinder else 0.25, dt=0.002 if cylinder else 0.01)


def exact(args, radius=1.0):
    """Displacement (m), rotation (rad), and whether it slips."""
    angle, k = math.radians(args.angle), INERTIA[args.shape]
    half = 0.5 * G * args.duration**2
    sliding = half * (math.sin(angle) - args.friction * math.cos(angle))
    if k is None:
        return max(sliding, 0.0), 0.0, sliding > 0
    if math.tan(angle) > args.friction * (1 + 1 / k):
        return sliding, half * args.friction * math.cos(angle) / (k * radius), True
    rolling = half * math.sin(angle) / (1 + k)
    return rolling, rolling / radius, False


def rectangle(low, high, h):
    """A grid of squares or cubes that covers a box."""
    n = [math.ceil((b - a) / h - 1e-9) for a, b in zip(low, high)]
    ends = [low, [a + k * h for a, k in zip(low, n)]]
    return box_grid(ends, n)


def turned(x, before):
    """Mean small rotation between two sets of arms about their centre (rad)."""
    cross = before[:, 0] * x[:, 1] - before[:, 1] * x[:, 0]
    sums = np.array([cross.sum(), np.sum(before * x)])
    COMM.Allreduce(MPI.IN_PLACE, sums)
    return math.atan2(sums[0], sums[1])


# %%
class Elastic:
    """A block or a cylinder of material points on a rigid plane."""

    def __init__(self, args):
        angle, h = math.radians(args.angle), args.h
        self.args, self.along, self.down = args, G * math.sin(angle), G * math.cos(angle)
        far = exact(args, 0.25)[0]
        block = args.shape == "block"
        E, nu, rho = (1e6, 0.0, 1000.0) if block else (2e8, 0.3, 7800.0)
        R, L, H = 0.25, 1.0, 0.5
        low, high = (
            (-h if block else -R - 2 * h, -h),
            ((L + far + 3 * h, H + h) if block else (R + far + 3 * h, 2 * R + 2 * h)),
        )
        grid = rectangle(low, high, h)
        self.points = points = (
            mpm.fill(grid, mpm.Box((0, 0), (L, H)), 2, rho)
            if block
            else (rings(grid, R, h / 2, rho))
        )
        V = mpm.Space(grid, args.basis)
        u, v = V.increment, V.test
        self.area = L * H if block else math.pi * R**2
        self.weight = rho * self.area * self.down
        kappa = 100 * E
        # as deep in the body as its weight will have it
        deep = rho * self.down * H / kappa if block else 0.0
        self.slope = mpm.RigidBody(mpm.Plane((0, deep), (0, 1)), name="slope")
        self.gravity = fem.Constant(grid, (0.0, 0.0))
        faces = None
        if not block:
            faces = mpm.Surface.from_arrays(points, points["rim_R"], points["rim_A"], name="rim")
        F = mpm.momentum(mpm.materials.Hencky(E=E, nu=nu), points, u, v)
        F -= ufl.inner(points.density * self.gravity, v) * points.dX
        term = mpm.contact(
            self.slope, points, u, v, stiffness_per_area=kappa, friction=args.friction,
            surface=faces,
        )  # fmt: skip
        F += term
        stabilisation = "ghost" if args.integrator != "explicit" else "none"
        if block and args.friction > 0:
            # friction holds it as far as it goes
            held = min(self.along, 0.95 * args.friction * self.down)
            static = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
            for part in (0.25, 0.5, 0.75, 1.0):
                self.gravity.value[:] = part * held, -part * self.down
                static.step()
        self.gravity.value[:] = self.along, -self.down
        options = {} if args.integrator == "explicit" else {"stabilisation": stabilisation}
        self.problem = INTEGRATORS[args.integrator](F, u, points, (), **options)
        (self.contact,) = self.problem.bodies.contacts
        self.taken = self.contact.dissipated
        self.start = self.middle()
        self.angle, self.arms = 0.0, self.by_id(points["x"] - self.start)

    def middle(self):
        """Centre of mass (m). Collective."""
        points = self.points
        mass = points["density"] * points["V0"]
        sums = COMM.allreduce(np.append(mass @ points["x"], mass.sum()))
        return sums[:2] / sums[2]

    def by_id(self, arms):
        """Arms of all points by their numbers, on every rank."""
        ids = np.concatenate(COMM.allgather(self.points["id"]))
        return np.concatenate(COMM.allgather(arms))[np.argsort(ids)]

    def look(self):
        """Displacement (m) and rotation (rad) so far. Collective."""
        middle = self.middle()
        arms = self.by_id(self.points["x"] - middle)
        self.angle += turned(arms / COMM.size, self.arms)
        self.arms = arms
        return float((middle - self.start)[0]), self.angle

    def work(self):
        """Work that friction has taken (J), and μN times the slip of a body that slides (J)."""
        distance = float((self.middle() - self.start)[0])
        slip = distance + (self.angle * 0.25 if self.args.shape == "cylinder" else 0.0)
        return self.contact.dissipated - self.taken, self.args.friction * self.weight * slip


def rings(grid, R, size, rho):
    """Points of a disc above the origin in rings; those of the outermost have the rim's faces."""
    count = max(2, round(R / size))
    x, volume, offset, area = [], [], [], []
    for k in range(count):
        inner, outer = k * R / count, (k + 1) * R / count
        n = max(4, round(2 * math.pi * (k + 0.5)))
        at = 2 * math.pi * (np.arange(n) + 0.5) / n
        out = np.column_stack([np.cos(at), np.sin(at)])
        # where the sector has its centroid
        r = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2) * math.sin(math.pi / n)
        r *= n / math.pi
        x.append(r * out + [0.0, R])
        volume.append(np.full(n, math.pi * (outer**2 - inner**2) / n))
        last = k == count - 1
        offset.append((R - r) * out if last else np.zeros_like(out))
        area.append(2 * math.pi * R / n * out if last else np.zeros_like(out))
    parts = [np.concatenate(part) for part in (x, volume, offset, area)]
    fields = {"rim_R": parts[2], "rim_A": parts[3]}
    return mpm.MaterialPoints.from_arrays(grid, parts[0], parts[1], rho, fields=fields)


class Rigid:
    """A disc or a sphere that is free, on a stiff slope of material points."""

    def __init__(self, args):
        angle, h, R = math.radians(args.angle), args.h, 1.0
        self.args, d = args, 2 if args.shape == "disc" else 3
        far = exact(args)[0]
        side, deep = (() if d == 2 else (2 * h,)), 2 * h
        low = (-4 * h, *(-s for s in side), -deep)
        high = (1.05 * far + 4 * h, *side, h)
        grid = rectangle(low, high, h)
        top = (high[0] + h, *side, 0.0)
        box = mpm.Box(low, [min(t, x) for t, x in zip(top, grid_end(grid))])
        self.points = points = mpm.fill(grid, box, 2, 1000.0)
        V = mpm.Space(grid, args.basis)
        u, v = V.increment, V.test
        mass, k = 1e4, INERTIA[args.shape]
        along, down = G * math.sin(angle), G * math.cos(angle)
        middle = (0.0,) * (d - 2)
        self.body = mpm.RigidBody(
            mpm.Ball((0.0, *middle, R), R), name=args.shape, mass=mass, inertia=k * mass * R**2,
            gravity=(along, *middle, -down),
        )  # fmt: skip
        up = (0,) * (d - 1) + (1,)
        faces = mpm.Surface(points, lambda x: np.isclose(x[-1], 0.0), up, name="top")
        E = 1e9
        F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
        F += mpm.contact(
            self.body, points, u, v, friction=args.friction, stiffness_per_area=E, surface=faces
        )
        sides = ("left", "right", "bottom") + (("front", "back") if d == 3 else ())
        options = {} if args.integrator == "explicit" else {"mass": "lumped"}
        if args.integrator == "newmark":
            # a contact that opens and closes rings under the trapezoidal rule
            options |= {"beta": 0.3025, "gamma": 0.6}
        if d == 3 and args.integrator != "explicit":
            options["petsc_options"] = {"ksp_type": "preonly", "pc_type": "lu"}
        self.problem = INTEGRATORS[args.integrator](F, u, points, mpm.fixed(V, *sides), **options)
        (self.contact,) = self.problem.bodies.contacts

    def look(self):
        """Displacement (m) and rotation (rad) so far."""
        spin = np.radians(self.body.angle)
        return float(self.body.position[0]), float(spin[0] if spin.size == 1 else -spin[1])

    def work(self):
        """Work that friction has taken (J), and μN times the slip (J)."""
        distance, spin = self.look()
        normal = 1e4 * G * math.cos(math.radians(self.args.angle))
        return self.contact.dissipated, self.args.friction * normal * (distance + spin)


def grid_end(grid):
    """Highest coordinates of the grid (m). Collective."""
    x = grid.geometry.x[:, : grid.geometry.dim]
    return np.max(COMM.allgather(x.max(axis=0, initial=-np.inf)), axis=0)


def draw(args, history, rotates):
    """Displacement and rotation against time, and the closed forms; rank 0 writes."""
    t = history["time"]
    last, turn, _ = exact(args, 0.25 if args.shape == "cylinder" else 1.0)
    path, n = args.output / f"incline_{args.shape}.png", 1 + rotates
    with mpm.figure(path, 3.4 * n, 2.8, ncols=n, squeeze=False) as (_, axes):
        shown = [("displacement", last, "displacement (m)"), ("rotation", turn, "rotation (rad)")]
        for ax, (name, end, label) in zip(axes[0], shown):
            ax.plot(t, end * (t / args.duration) ** 2, color="k", lw=1, label="closed form")
            values = np.abs(history[name]) if name == "rotation" else history[name]
            every = max(1, len(t) // 20)
            ax.plot(t[::every], values[::every], "o", ms=3, label="material points")
            ax.set(xlabel="time (s)", ylabel=label)
        axes[0, 0].legend()


# %%
args = Input.parse()
elastic = args.shape in ("block", "cylinder")
scene = Elastic(args) if elastic else Rigid(args)
history = mpm.History()
for t in mpm.times(args.duration, dt=args.dt):
    scene.problem.step(t)
    displacement, rotation = scene.look()
    history.record(time=float(t), displacement=displacement, rotation=rotation)
last, turn, slips = exact(args, 0.25 if args.shape == "cylinder" else 1.0)
work, expected = scene.work()
figures = {
    "displacement": displacement, "rotation": rotation, "exact_displacement": last,
    "exact_rotation": turn, "slips": slips, "dissipated": work,
    "friction_times_slip": expected,
    "displacement_error": displacement / last - 1 if last else None,
    "rotation_error": abs(rotation) / turn - 1 if turn else None,
    "creep": float(history["displacement"][-1] - history["displacement"][len(history) // 2]),
    **solver_figures(scene.problem),
}  # fmt: skip
error = f" ({100 * figures['displacement_error']:+.2f} %)" if last else ""
say(
    f"{args.shape} {'slips' if slips else 'holds'}: {displacement:.6g} m, closed form "
    f"{last:.6g} m{error}, rotation {rotation:.5g} ({turn:.5g}), friction takes {work:.5g} J, "
    f"mu N slip {expected:.5g} J, at most {figures['max_newton_iterations']} iterations"
)
if not args.no_plot:
    draw(args, history, args.shape != "block")
finish(args, figures)

"""What the studies of linear consolidation share: steps in time, values at nodes, round edges."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from grids import box_grid
from options import Options, natural, option, other_default
from scene import finish, say, solver_figures

import dolfinmpm as mpm

# Of water that is next to nothing, and of soils whose strains are
WATER = mpm.Fluid(density=1000.0, gravity=10.0)
MODULUS = 1e6  # E (Pa)
PERMEABILITY = 1e-6  # m/s
SMALL = 1e-6  # largest stress, by E


def consolidation_coefficient(E: float, nu: float) -> float:
    """c_v = k M/γ_w (m²/s), M being the P-wave modulus of E (Pa) and ν."""
    M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    return PERMEABILITY * M / WATER.unit_weight


@dataclass
class InTime(Options):
    """Options of when to measure, and in how many steps."""

    times: list[float] = option([], "at which to measure")
    steps: int = natural(100, "up to the last time, in geometric progression")
    theta: float = option(0.5, "1: backward Euler; 0.5: Crank–Nicolson")
    stabilisation: str = option("none", choices=("none", "ghost", "aggregation"))

    def _check(self) -> None:
        self.times.sort()


def mixture(args: Any, points: Any, V: mpm.Space, Q: mpm.Space, drained: mpm.Surface) -> Any:
    """Weak form of soil with water, of E = MODULUS and small strain, that drains at a surface."""
    return mpm.poromechanics(
        mpm.materials.Hencky(E=MODULUS, nu=args.poisson), points, (V.increment, Q.increment),
        (V.test, Q.test), permeability=PERMEABILITY, porosity=0.5, fluid=WATER, drained=drained,
        theta=args.theta, strain="small",
    )  # fmt: skip


def instants(times: Sequence[float], steps: int) -> np.ndarray:
    """Times to step to, from one that drains next to nothing; those to measure at among them."""
    first = min(1e-4, 1e-2 * min(times))
    return np.unique(np.concatenate([np.geomspace(first, max(times), steps), times]))


def node_value(space: mpm.Space, place: Sequence[float], component: int = 0) -> float:
    """Value of an increment of linear functions at the node at a place. Collective."""
    function, comm = space.increment, space.grid.comm
    x = function.function_space.tabulate_dof_coordinates()
    size = function.function_space.dofmap.index_map_bs
    own = function.function_space.dofmap.index_map.size_local
    d = space.grid.geometry.dim
    near = np.linalg.norm(x[:own, :d] - np.asarray(place), axis=1)
    least = np.min(comm.allgather(near.min(initial=np.inf)))
    found = near == least
    values = function.x.array.reshape(-1, size)[:own][found, component]
    # ranks that do not own it have nothing to say
    return float(comm.allreduce(values.sum()) / comm.allreduce(int(found.sum())))


def rim(points: mpm.MaterialPoints, radius: float, segments: int = 20000) -> mpm.Surface:
    """The circle about the origin as a surface: each of its segments belongs to the nearest point.

    For a body in the first quadrant. Collective.
    """
    from scipy.spatial import cKDTree

    angle = 0.5 * np.pi * (np.arange(segments) + 0.5) / segments
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    length = np.full(segments, 0.5 * np.pi * radius / segments)
    if points.axisymmetric:
        length *= 2 * np.pi * radius * normal[:, 0]
    # of several points as near as each other every number of ranks takes the same one
    x = np.concatenate(points.comm.allgather(points["x"]))
    order = np.lexsort(x.T)
    _, nearest = cKDTree(x[order]).query(radius * normal)
    first = points.comm.exscan(len(points)) or 0
    owner = order[nearest] - first
    mine = (owner >= 0) & (owner < len(points))
    owner, normal, length = owner[mine], normal[mine], length[mine]
    count = len(points)
    area = np.stack([np.bincount(owner, length * n, count) for n in normal.T], axis=1)
    share = np.bincount(owner, length, count)[:, None]
    place = np.stack([np.bincount(owner, length * radius * n, count) for n in normal.T], axis=1)
    offset = np.where(share > 0, place / np.where(share > 0, share, 1.0) - points["x"], 0.0)
    return mpm.Surface.from_arrays(points, offset, area, name="rim")


def draw(args: Any, columns: dict[str, Any], names: Sequence[str]) -> None:
    """Draw the columns over time, each beside its exact values."""
    path = args.output / f"{Path(sys.argv[0]).stem}.png"
    with mpm.figure(path, 4.5, 3.0) as (_, axes):
        for k, name in enumerate(names):
            if f"{name}_exact" in columns:
                axes.semilogx(args.times, columns[f"{name}_exact"], f"C{k}-", lw=0.9)
            label = name.replace("_", " ")
            axes.semilogx(args.times, columns[name], f"C{k}o", ms=4, mfc="none", label=label)
        axes.set(xlabel="T = c_v t/a²", ylabel="circles: computed, lines: exact")
        axes.legend()


def report(args: Any, problem: Any, columns: dict[str, Any], **more: Any) -> None:
    """Print the columns by time, and write them and what the solver took."""
    names = [name for name in columns if not name.endswith("_exact")]
    say("     time  " + "".join(f"{name[:20]:>22}" for name in names))
    for k, t in enumerate(args.times):
        cells = []
        for name in names:
            exact = columns.get(f"{name}_exact")
            beside = "" if exact is None else f" ({exact[k]:.5f})"
            cells.append(f"{columns[name][k]:.5f}{beside}")
        say(f"{t:9g}  " + "".join(f"{cell:>22}" for cell in cells))
    if not args.no_plot and len(args.times) > 1:
        draw(args, columns, names)
    lists = {name: np.asarray(values).tolist() for name, values in columns.items()}
    finish(args, {**lists, **more, **solver_figures(problem)})


def modes(nu: float, sphere: bool, count: int = 60) -> tuple[np.ndarray, ...]:
    """Roots ξ, and what their modes give of e(0), e(a) and u(a)/a, by p0/M.

    The residues of ê = −p0/s · f(qr)/(M f(qa) − c G g(qa)), by Laplace's transform.
    """
    from scipy.optimize import brentq
    from scipy.special import j0, j1

    G = 0.5 * (1 - 2 * nu) / (1 - nu)  # by M

    def at_rim(x):
        return np.sin(x) / x if sphere else j0(x)

    def mean(x):
        return (np.sin(x) - x * np.cos(x)) / x**3 if sphere else j1(x) / x

    def balance(x):
        return at_rim(x) - (4.0 if sphere else 2.0) * G * mean(x)

    x = np.linspace(0.05, np.pi * count, 200 * count)
    values = balance(x)
    change = np.flatnonzero(values[1:] * values[:-1] < 0)
    roots = np.array([brentq(balance, x[k], x[k + 1], xtol=1e-14) for k in change])
    step = 1e-5
    slope = (balance(roots + step) - balance(roots - step)) / (2 * step)
    factor = -1.0 / (0.5 * roots * slope)
    return roots, factor, factor * at_rim(roots), factor * mean(roots)


def round_series(nu: float, sphere: bool, times: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Centre's pressure by p0, and −M u(a)/(p0 a), of a cylinder or a sphere at times c t/a²."""
    G = 0.5 * (1 - 2 * nu) / (1 - nu)
    last = 1.0 / (3 - 4 * G) if sphere else 0.5 / (1 - G)
    roots, centre, rim_strain, shortening = modes(nu, sphere)
    decay = np.exp(-np.outer(np.asarray(times), roots**2))
    return decay @ (centre - rim_strain), last - decay @ shortening


@dataclass
class Round(InTime):
    """The options of a cylinder or a sphere."""

    poisson: float = 0.2
    cells: int = natural(32, "over the radius")
    points_per_cell: int = natural(3)
    stabilisation: str = other_default(InTime, "stabilisation", "aggregation")


def run_round(args: Round, axisymmetric: bool) -> None:
    """A cylinder or a sphere that is squeezed and drains at its edge: study of both."""
    import ufl
    from dolfinx import fem
    from mpi4py import MPI

    comm, nu, a, E = MPI.COMM_WORLD, args.poisson, 1.0, MODULUS
    c_v, p0 = consolidation_coefficient(E, nu), SMALL * E
    M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    h = a / (args.cells - 0.37)
    grid = box_grid([(0, 0), (args.cells * h + h, args.cells * h + h)], [args.cells + 1] * 2)
    turned = {"axisymmetric": True} if axisymmetric else {}
    arc = np.linspace(0, 0.5 * np.pi, 400)
    shape = mpm.Polygon([(0.0, 0.0), *zip(a * np.cos(arc), a * np.sin(arc))])
    points = mpm.fill(grid, shape, args.points_per_cell, 1.0, exact=True, **turned)
    V, Q = mpm.Space(grid, "linear"), mpm.Space(grid, "linear", shape=())
    u, v = V.increment, V.test
    edge = rim(points, a)
    F = mixture(args, points, V, Q, edge)
    load = fem.Constant(grid, -p0)
    F -= load * ufl.dot(edge.area, v) / points.V0 * edge.dX
    bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "bottom", 1)
    problem = mpm.Transient(
        F, [u, Q.increment], points, bcs, stabilisation=[args.stabilisation] * 2
    )
    measured = []
    for T in instants(args.times, args.steps):
        problem.step(T * a**2 / c_v)
        if T in args.times:
            area = points["rim_area"]
            inward = -comm.allreduce(float(np.einsum("pi,pi->", area, edge.displacements())))
            mean = M * inward / (edge.total_area * p0 * a)
            measured.append((node_value(Q, (0.0, 0.0)) / p0, mean))
    exact = round_series(nu, axisymmetric, args.times)
    columns = {}
    for name, ours, theirs in zip(("centre_pressure", "u_r"), np.array(measured).T, exact):
        columns |= {name: ours, f"{name}_exact": theirs}
    errors = {
        f"{name}_error": float(np.abs(columns[name] / columns[f"{name}_exact"] - 1).max())
        for name in ("centre_pressure", "u_r")
    }
    report(args, problem, columns, **errors)

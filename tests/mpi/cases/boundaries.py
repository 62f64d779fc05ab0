"""Boundaries that do not fit the grid, walls and deposits, across ranks."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm.solve.initialguess import InitialGuess

from .common import COMM, sums
from .restart import REPEATABLE, goes_on

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def ring(
    stabilisation="ghost", kind=mesh.CellType.quadrilateral, basis="linear", space=None, **options
):  # fmt: skip
    """A ring that is pushed and widened from inside, against a wall; points change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 3)], (16, 12), kind)
    points = mpm.fill(
        grid, mpm.Disc((2.7, 1.5), 1.0) - mpm.Disc((2.7, 1.5), 0.45), 2, 1000.0, tag=1
    )
    points["tag"][points["x"][:, 1] > 1.5] = 2
    V = mpm.Space(grid, basis, **(space or {}))
    u, v = V.increment, V.test
    hard, soft = (
        mpm.materials.VonMises(
            E=lambda x, E=E: E * (1 + 0.1 * x[0]), nu=0.3, radius=2e3, hardening=5e3
        )
        for E in (1e5, 5e4)
    )
    hole = mpm.Boundary.from_level_set(points, lambda x: 0.45 - np.hypot(x[0] - 2.7, x[1] - 1.5))
    c = fem.Constant(grid, 0.0)
    out = hole.x0 - ufl.as_vector((2.7, 1.5))
    value = c * (ufl.as_vector((0.6, 0.1)) + 0.05 * out)
    F = mpm.momentum(hard, points, u, v, tag=1) + mpm.momentum(soft, points, u, v, tag=2)
    for law, tag in ((hard, 1), (soft, 2)):
        F += mpm.dirichlet(hole, u, v, value, law=law, tag=tag)
    walls = []
    if kind == mesh.CellType.quadrilateral:
        walls.append(mpm.Boundary.from_side(points, "right"))
        for law, tag in ((hard, 1), (soft, 2)):
            F += mpm.signorini(walls[0], u, v, law=law, friction=0.3, tag=tag)
    stabilisation = mpm.Stabilisation(stabilisation, E=1e5)
    problem = mpm.QuasiStatic(F, u, points, stabilisation=stabilisation, **options)

    def step():
        c.value = 0.12 * (len(problem.history) + 1)
        # the first guess is lost where points change rank, so that iterations would differ
        problem.newton.guess = InitialGuess()
        return problem.step()

    return problem, step, hole, walls


def figures_of(problem, hole, walls):
    markers = hole.markers
    weight = markers["V0"] * (1 + markers["x0"].sum(axis=1))
    names = [n for n in markers.fields if n.endswith(("_gap", "_stiffness"))]
    found = {name: list(np.ravel(COMM.allreduce(weight @ markers[name]))) for name in names}
    return {
        "iterations": [record.iterations for record in problem.history],
        "markers": markers.total,
        "area": hole.total_area,
        "place": list(COMM.allreduce(weight @ markers["x"])),
        "forces": [list(wall.force()) for wall in walls],
        **found,
        **sums(problem.points, "x", "F", "stress"),
    }


def boundaries():
    """Nitsche's method on a hole that moves, with two laws, and a wall with friction."""
    results = {}
    for stabilisation in ("ghost", "aggregation"):
        problem, step, hole, walls = ring(stabilisation, tolerance=1e-12)
        for _ in range(4):
            step()
        results[stabilisation] = figures_of(problem, hole, walls)
    moved = sum(record.migrated for record in problem.history)
    return results | {"moved": (moved > 0) if COMM.size > 1 else None}


def boundaries_triangles():
    """The same on triangles, and on splines."""
    results = {}
    for name, options in (
        ("triangles", {"kind": mesh.CellType.triangle}),
        ("splines", {"basis": "bspline2"}),
    ):
        problem, step, hole, walls = ring(tolerance=1e-12, **options)
        for _ in range(2):
            step()
        # the wall is out of reach
        results[name] = figures_of(problem, hole, walls)
    return results


def boundaries_total():
    """The same in the first configuration, where only what the wall meets changes rank."""
    space = {"configuration": "total"}
    results = {}
    for stabilisation, basis in (("ghost", "linear"), ("aggregation", "gimp")):
        problem, step, hole, walls = ring(stabilisation, basis=basis, space=space, tolerance=1e-11)
        for _ in range(4):
            step()
        found = figures_of(problem, hole, walls)
        # gaps are of the size of rounding here
        results[stabilisation] = {k: v for k, v in found.items() if not k.endswith("_gap")}
    return results | {"pushes": bool(walls[0].force()[0] < -1.0)}


def boundary_3d():
    """A block in space, held on a face that is turned against the grid."""
    grid = mesh.create_box(COMM, [(0, 0, 0), (1, 1, 1)], (5, 5, 5), mesh.CellType.hexahedron)
    points = mpm.fill(grid, mpm.Ball((0.5, 0.5, 0.5), 0.38), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = mpm.materials.NeoHookean(E=1e4, nu=0.3)
    skin = mpm.Boundary.from_level_set(
        points, lambda x: np.linalg.norm(x.T - 0.5, axis=1) - 0.38, subdivisions=1
    )
    F = mpm.momentum(law, points, u, v)
    F += mpm.dirichlet(skin, u, v, lambda x: 0.02 * x.T[:, [1, 2, 0]], law=law)
    problem = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
    problem.step()
    return figures_of(problem, skin, [])


def restart_boundaries():
    """A hole that is moved, and a wall, with what they keep."""

    def build():
        problem, step, *_ = ring(petsc_options=REPEATABLE, tolerance=1e-12)
        return problem, step

    return goes_on(build, 4)


def restart_boundaries_total():
    """The same in the first configuration."""

    def build():
        space = {"configuration": "total"}
        problem, step, *_ = ring(space=space, petsc_options=REPEATABLE, tolerance=1e-12)
        return problem, step

    return goes_on(build, 4)


def deposits(stabilisation="aggregation", basis="gimp"):
    """Ground in layers with a water table on a slope, brought into balance."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 3)], (8, 6), mesh.CellType.quadrilateral)
    loose, dense = (mpm.materials.sand(RD) for RD in (0.3, 0.7))
    top = 2.3
    ground = mpm.Deposit(
        lambda x: top + 0.05 * x[0],
        [mpm.Layer.of(loose, 1.5), mpm.Layer.of(dense)],
        water_table=1.2,
    )
    shape = mpm.Polygon([(0, 0), (4, 0), (4, top + 0.2), (0, top)])
    points = mpm.fill(grid, shape, 2, ground.density)
    points["tag"] = np.where(points["x"][:, 1] > 1.5, 1, 2).astype(np.int32)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    F = -ufl.inner(ground.body_force(points), v) * points.dX
    for tag, sand in ((1, loose), (2, dense)):
        E = ground.modulus(sand.E_ref, sand.exponent)
        law = mpm.materials.MohrCoulomb(E=E, **sand.parameters)
        mpm.set_stress(law, points, ground.stress, tag=tag)
        F += mpm.momentum(law, points, u, v, tag=tag)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    steps = mpm.equilibrate(problem)
    return {"steps": steps, **sums(points, "x", "stress", "mohrcoulomb_parameters")}


def rest_under_a_penalty():
    """The same with a ghost penalty, which has no share in the balance."""
    return deposits("ghost")


def rest_of_splines():
    """The same with splines, some of which the points do not hold without their neighbours."""
    return deposits("ghost", "bspline2")


def regridded():
    """A body on a grid whose fine zone moves along it."""
    return _regraded("gimp", "ghost")


def regraded_splines():
    """The same with quadratic splines and nodes that are tied."""
    return _regraded("bspline2", "aggregation")


def _regraded(basis, stabilisation):

    def lines(middle):
        return [
            mpm.zoned_line(0, 4, (middle - 0.5, middle + 0.5), (4, 6, 5)),
            mpm.zoned_line(0, 3, (1.4, 2.4), (3, 5, 2)),
        ]

    n = np.array([40, 22])
    h = np.array([4.0, 2.2]) / n
    x = np.stack(np.meshgrid(*((np.arange(k) + 0.5) for k in n), indexing="ij"), axis=-1)
    grid = mpm.create_lattice(COMM, lines(1.0))
    points = mpm.MaterialPoints.from_arrays(
        grid, x.reshape(-1, 2) * h, h.prod(), 1000.0, half_length=h / 2
    )
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    law = mpm.materials.Hencky(E=1e5, nu=0.3)
    F = mpm.momentum(law, points, u, v, fbar=True)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    for k, middle in enumerate((1.0, 1.8, 2.9)):
        mpm.regrid(problem, lines(middle))
        g.value[:] = 0.4 * (k + 1), -1.0 * (k + 1)
        problem.step()
    moved = sum(record.migrated for record in problem.history)
    return {
        "unknowns": [record.unknowns for record in problem.history],
        "moved": (moved > 0) if COMM.size > 1 else None,
        **sums(points, "x", "F", "stress"),
    }

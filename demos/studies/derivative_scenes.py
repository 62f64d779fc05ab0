"""Small examples as functions of their parameters, for `derivatives.py` and the tests."""

from __future__ import annotations

from functools import partial

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.study import Run

__all__ = ["CASES", "SAND", "SOFT", "by_whole_runs", "column", "errors_of", "footing"]
__all__ += ["grid_of", "history_of", "in_time", "sizes_of"]

# of Newton's method, so that differences of whole runs are exact
TIGHT = 1e-12


def grid_of(corner, cells, comm=MPI.COMM_WORLD):
    """A rectangular grid from the origin to a corner (m)."""
    lines = [np.linspace(0.0, end, n + 1) for end, n in zip(corner, cells)]
    return mpm.create_lattice(comm, lines)


def mean_of(points, values):
    """Mean of the points' values, by first volume, on all ranks."""
    volume = points["V0"].reshape(-1, *[1] * (np.ndim(values) - 1))
    total = points.comm.allreduce(np.sum(volume * values, axis=0), op=MPI.SUM)
    return total / points.comm.allreduce(float(volume.sum()), op=MPI.SUM)


def motion_of(points):
    """Function that returns the mean displacement of the points (m)."""
    return lambda: mean_of(points, points["x"] - points["x0"])


def stress_of(points):
    """Function that returns the mean stress of the points (Pa)."""
    return lambda: mean_of(points, points["stress"])


def loaded(problem, load, values):
    """Steps of a problem to values of a load."""

    def step(value):
        load.value[...] = value
        problem.step()

    return [partial(step, value) for value in values]


def in_time(problem, times):
    """Steps of a problem to given times (s)."""
    return [partial(problem.step, t) for t in times]


def law_of(kind, m):
    """A law by its name, with the parameters of an example."""
    E, nu = m["E"], m["nu"]
    match kind:
        case "hencky":
            return mpm.materials.Hencky(E, nu)
        case "von-mises":
            return mpm.materials.VonMises(E, nu, yield_stress=m["yield"], hardening=0.2 * E)
        case "tresca":
            return mpm.materials.Tresca(E, nu, m["cohesion"])
        case "mohr-coulomb":
            angle, dilation = m["angle"], 0.3 * m["angle"]
            return mpm.materials.MohrCoulomb(E, nu, m["cohesion"], angle, dilation_angle=dilation)
    angle = m["angle"]
    return mpm.materials.DruckerPrager(E, nu, m["cohesion"], angle, dilation_angle=0.3 * angle)


def column(
    m, law="hencky", basis="gimp", dimension=2, stabilisation="ghost", steps=5, gravity=-10.0,
    axisymmetric=False, fine=1, tolerance=TIGHT, **options,
):  # fmt: skip
    """A block that leans on a wall and settles under its own weight.

    Args:
        m: Parameters: E, nu, density; those of the law; perhaps "height" of the block (m), and
            "upper", Young's modulus of its upper half.
        law, basis, dimension, stabilisation, axisymmetric: What it is made of.
        steps: Number of steps.
        gravity: Last acceleration (m/s²).
        fine: Number of cells in place of one, in each direction.
        tolerance: Of Newton's method.
        options: Options of `momentum`.
    """
    cells, end = ((6, 10), (1.5, 2.5)) if dimension == 2 else ((4, 4, 6), (1.0, 1.0, 1.5))
    size = (0.8, m.get("height", 1.9)) if dimension == 2 else (0.6, 0.7, 1.1)
    grid = grid_of(end, [fine * n for n in cells])
    box = mpm.Box((0.0,) * dimension, size)
    points = mpm.fill(grid, box, 2, m["density"], axisymmetric=axisymmetric)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0,) * dimension)
    if "upper" in m:
        points["tag"] = np.where(points["x"][:, 1] > 1.0, 2, 1)
        F = mpm.momentum(law_of(law, m), points, u, v, tag=1)
        F += mpm.momentum(mpm.materials.Hencky(m["upper"], m["nu"]), points, u, v, tag=2)
    else:
        F = mpm.momentum(law_of(law, m), points, u, v, **options)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation, tolerance=tolerance)
    values = [(0.0,) * (dimension - 1) + (gravity * k / steps,) for k in range(1, steps + 1)]
    measured = {"motion": motion_of(points), "stress": stress_of(points)}
    return Run(problem, loaded(problem, g, values), measured)


def footing(m, law="mohr-coulomb", cells=12, steps=5, fbar=False, tolerance=TIGHT):
    """A smooth flexible footing on soil with an initial stress.

    Args:
        m: Parameters: E, nu, those of the law, "pressure" (Pa), and "K0".
        law: The law.
        cells: Number of cells along the layer.
        steps: Number of steps.
        fbar: Whether points share volume changes.
        tolerance: Of Newton's method.
    """
    width, depth = 6.0, 3.0
    h = width / cells
    grid = grid_of((width, depth + 2 * h), (cells, cells // 2 + 2))
    points = mpm.fill(grid, mpm.Box((0, 0), (width, depth)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g, load = fem.Constant(grid, (0.0, -10.0)), fem.Constant(grid, (0.0, 0.0))
    soil = law_of(law, m)
    F = mpm.momentum(soil, points, u, v, fbar=fbar)
    F -= ufl.inner(points.density * g, v) * points.dX
    top = mpm.Surface(points, lambda x: (x[1] > depth - 0.3 * h) & (x[0] < 1.0), (0, 1))
    F += top.traction(load, v)

    def at_rest(x):
        vertical = -(2e4 * (depth - x[1]) + 1e3)
        stress = np.zeros((x.shape[1], 3, 3))
        stress[:, 1, 1] = vertical
        stress[:, 0, 0] = stress[:, 2, 2] = m["K0"] * vertical
        return stress

    points["stress"] = at_rest(points["x"].T)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=tolerance)
    values = [(0.0, -m["pressure"] * k / steps) for k in range(1, steps + 1)]
    measured = {"settlement": lambda: top.mean_displacement()[1], "stress": stress_of(points)}
    return Run(problem, loaded(problem, load, values), measured)


def pressed(m, shape="plane", law="hencky", steps=6, penetration=None):
    """A rigid body presses a block, and slides over it.

    Args:
        m: Parameters: E, nu, those of the law, "way" of the body per step (m), its "height" at
            the start (m), "penalty", and perhaps "friction".
        shape: "plane" or "disc".
        law: The law.
        steps: Number of steps.
        penetration: See `contact`.
    """
    grid = grid_of((3.0, 2.0), (12, 8))
    points = mpm.fill(grid, mpm.Box((0.5, 0), (2.5, 1.2)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(law_of(law, m), points, u, v)
    height = m["height"]
    form = mpm.Plane((0, height), (0.0, -1.0))
    if shape == "disc":
        form = mpm.Disc((1.4, height + 0.5), 0.5)
    body = mpm.RigidBody(form, increment=(0.4 * m["way"], -m["way"]), name="body")
    F += mpm.contact(
        body,
        points,
        u,
        v,
        friction=m.get("friction", 0.0),
        penalty=m["penalty"],
        penetration=penetration,
    )
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=TIGHT)
    measured = {"force": lambda: body.force, "motion": motion_of(points)}
    return Run(problem, [problem.step] * steps, measured)


def plate(m, steps=4):
    """A free rigid plate sinks into a block under a growing load."""
    grid = grid_of((3.0, 2.0), (12, 8))
    points = mpm.fill(grid, mpm.Box((0.5, 0), (2.5, 1.2)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(m["E"], m["nu"]), points, u, v)
    load = fem.Constant(grid, (0.0, 0.0))
    body = mpm.RigidBody(
        mpm.Box((0.9, 1.19), (2.1, 1.5)), force=load, free=(False, True, False), name="plate"
    )
    F += mpm.contact(body, points, u, v, penalty=20.0)
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-11)
    values = [(0.0, -m["load"] * k / steps) for k in range(1, steps + 1)]
    measured = {"place": lambda: body.position[1], "motion": motion_of(points)}
    return Run(problem, loaded(problem, load, values), measured)


def consolidation(m, law="hencky", theta=1.0, steps=6):
    """A layer under a load drains at its top."""
    grid = grid_of((1.0, 3.0), (2, 6))
    points = mpm.fill(grid, mpm.Box((0, 0), (1.0, 2.2)), 2, 1800.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    top = mpm.Surface(points, lambda x: x[1] > 2.1, (0, 1))
    F = mpm.poromechanics(
        law_of(law, m), points, (u, p), (v, q), permeability=m["permeability"],
        porosity=0.4, drained=top, theta=theta,
    )  # fmt: skip
    load = fem.Constant(grid, (0.0, -m["load"]))
    F += top.traction(load, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.Transient(
        F, [u, p], points, bcs, stabilisation=["ghost", "ghost"], tolerance=TIGHT
    )
    times = [4.0 * 1.7**k for k in range(steps)]
    measured = {
        "motion": motion_of(points),
        "pressure": lambda: mean_of(points, points["pressure"]),
    }
    return Run(problem, in_time(problem, times), measured)


def swing(m, problem=mpm.Newmark, steps=8, dimension=1, **options):
    """A body that has a velocity at first, held at its left end."""
    if dimension == 1:
        grid = mesh.create_interval(MPI.COMM_WORLD, 30, [0.0, 30.0])
        box = mpm.Box((0.0,), (25.0,))
    else:
        grid, box = grid_of((8.0, 6.0), (8, 6)), mpm.Box((0.0, 2.0), (6.3, 3.7))
    points = mpm.fill(grid, box, 2, m["density"])
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.2), points, V.increment, V.test)
    way = m["velocity"]
    across = dimension - 1
    points.add_field("velocity", (dimension,), "m/s")
    points["velocity"][:, across] = way * np.sin(np.pi * points["x"][:, 0] / 50)
    time = problem(F, V.increment, points, mpm.fixed(V, "left"), **options)
    dt = 0.5 if problem is not mpm.Explicit else 0.4
    times = [dt * (k + 1) for k in range(steps)]
    measured = {"motion": motion_of(points), "kinetic": lambda: time.energies().kinetic}
    return Run(time, in_time(time, times), measured)


def sliding(m, steps=6, problem=mpm.Newmark):
    """A block on a rigid plane slides against friction, in time."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(-0.25, 2, 10), np.linspace(-0.25, 1, 6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1.0, 0.5)), 2, m["density"])
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, u, v)
    g = fem.Constant(grid, (7.0, -7.0))
    F -= ufl.inner(points.density * g, v) * points.dX
    # with 35e-6 m, differences of whole explicit runs have a kink of the contact between them
    slope = mpm.RigidBody(mpm.Plane((0, 33e-6), (0, 1)), name="slope")
    F += mpm.contact(slope, points, u, v, friction=m["friction"], stiffness_per_area=1e8)
    implicit = {"stabilisation": "ghost", "tolerance": TIGHT}
    problem = problem(F, u, points, **(implicit if problem is mpm.Newmark else {}))
    measured = {"motion": motion_of(points), "force": lambda: slope.force}
    return Run(problem, in_time(problem, [0.01 * (k + 1) for k in range(steps)]), measured)


def arch(m, control="spherical", steps=8):
    """A shallow arch snaps through under a load that is found with the increment."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 10, 21), np.linspace(-2, 2, 9)])
    shape = mpm.Where(lambda x: np.abs(x[1] - np.sin(0.05 * np.pi * x[0]) ** 2) < 0.4)
    points = mpm.fill(grid, shape, 4, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    weight = fem.Constant(grid, (0.0, -100.0))
    F = mpm.momentum(mpm.materials.Hencky(m["E"], m["nu"]), points, u, v)
    F -= ufl.inner(weight, v) * points.dX
    bcs = mpm.fixed(V, "left") + mpm.rollers(V, "right")
    options = {"first": 1.0, "max_length": 0.08}
    if control == "displacement":
        volume = points.comm.allreduce(float(points["V0"].sum()))
        options = {"control": -v[1] / volume * points.dX, "length": 0.06, "max_length": 0.06}
    problem = mpm.ArcLength(
        F, u, points, bcs, load=weight, stabilisation="ghost", tolerance=TIGHT, **options
    )
    # an exact length makes differences of whole runs exact
    problem.path.tolerance = 1e-12
    measured = {"factor": lambda: problem.factor, "motion": motion_of(points)}
    return Run(problem, [problem.step] * steps, measured)


SOFT = {"E": 10e3, "nu": 0.2, "density": 80.0}
CLAY = {"E": 1e6, "nu": 0.45, "cohesion": 10e3, "pressure": 45e3, "K0": 0.8}
PRESS = {"E": 1e6, "nu": 0.3, "way": 0.01, "height": 1.195, "penalty": 20.0}
RUB = PRESS | {"friction": 0.3}
WET = {"E": 1e6, "nu": 0.2, "permeability": 1e-5, "load": 50e3}
BAR = {"E": 100.0, "density": 1.0, "velocity": 0.1}
SAND = CLAY | {"angle": 20.0, "pressure": 60e3, "K0": 0.5}

# name → scene, parameters
CASES = {
    "elastic": (column, SOFT),
    "elastic, splines": (partial(column, basis="bspline2"), SOFT),
    "elastic, linear functions": (partial(column, basis="linear", gravity=-1.0), SOFT),
    "elastic, aggregation": (partial(column, stabilisation="aggregation"), SOFT),
    "elastic, Jaumann's rate": (partial(column, strain="jaumann"), SOFT),
    "elastic, axisymmetric": (partial(column, axisymmetric=True), SOFT),
    "elastic, 3D": (partial(column, dimension=3, steps=3), SOFT),
    "two laws": (column, SOFT | {"upper": 20e3}),
    "height of the body": (column, SOFT | {"height": 1.9}),
    "von Mises": (partial(column, law="von-mises"), SOFT | {"yield": 600.0}),
    "von Mises, 3D": (
        partial(column, law="von-mises", dimension=3, steps=3),
        SOFT | {"yield": 450.0},
    ),
    "von Mises, axisymmetric": (
        partial(column, law="von-mises", axisymmetric=True),
        SOFT | {"yield": 600.0},
    ),
    "Drucker–Prager": (
        partial(column, law="drucker-prager"),
        SOFT | {"cohesion": 350.0, "angle": 15.0},
    ),
    "Tresca footing, F-bar": (partial(footing, law="tresca", fbar=True), CLAY),
    "Mohr–Coulomb footing": (footing, SAND),
    "one step, halved": (partial(footing, steps=1), SAND),
    "contact": (pressed, PRESS),
    "contact with friction": (pressed, RUB),
    "disc in clay": (
        partial(pressed, shape="disc", law="tresca"),
        RUB | {"cohesion": 20e3, "height": 1.19},
    ),
    "bounded penetration": (partial(pressed, penetration=1e-5), PRESS),
    "free plate": (plate, {"E": 1e6, "nu": 0.3, "load": 20e3}),
    "consolidation": (consolidation, WET),
    "consolidation, yielding": (partial(consolidation, law="von-mises"), WET | {"yield": 20e3}),
    "Newmark": (swing, BAR),
    "generalised-α, 2D": (partial(swing, problem=mpm.GeneralisedAlpha, dimension=2), BAR),
    "sliding block": (sliding, {"E": 1e6, "density": 1000.0, "friction": 0.3}),
    "sliding block, explicit": (
        partial(sliding, problem=mpm.Explicit),
        {"E": 1e6, "density": 1000.0, "friction": 0.3},
    ),
    "arc length": (arch, {"E": 1e6, "nu": 0.2}),
    "displacement control": (partial(arch, control="displacement"), {"E": 1e6, "nu": 0.2}),
    "explicit": (partial(swing, problem=mpm.Explicit), BAR),
}


def sizes_of(name):
    """Sizes of the parameters of an example that are no logarithms: distances to the body (m)."""
    return {"height": 0.01} if CASES[name][1] in (PRESS, RUB) or name == "disc in clay" else {}


def history_of(scene, parameters):
    """Figures of a whole run after each step, by name."""
    run = scene(parameters)
    found = {name: [] for name in run.measured}
    for step in run.steps:
        step()
        for name, get in run.measured.items():
            found[name].append(np.array(get(), float))
    return {name: np.array(values) for name, values in found.items()}


def by_whole_runs(scene, parameters, name, size, h=1e-4):
    """Derivatives of the figures of a run by Richardson's rule for differences of whole runs."""
    found = []
    for step in (h, 2 * h):
        up, down = (
            history_of(scene, {**parameters, name: parameters[name] + sign * step * size})
            for sign in (1, -1)
        )
        found.append({k: (up[k] - down[k]) / (2 * step) for k in up})
    fine, coarse = found
    return {k: (4 * fine[k] - coarse[k]) / 3 for k in fine}


def errors_of(scene, parameters, found, h=1e-4):
    """Errors of the derivatives of a run by each parameter, beside differences of whole runs.

    An error is relative to the largest derivative of the same figure by any parameter, over all
    steps: a mean stress under the body's own weight hangs on its density, and hardly on its
    stiffness.
    """
    derivatives = found.derivatives
    largest = {k: max(np.abs(d).max() for d in by.values()) for k, by in derivatives.items()}
    errors = {}
    for m in parameters:
        whole = by_whole_runs(scene, parameters, m, found.scales[m], h)
        errors[m] = max(
            float(np.abs(whole[k] - by[m]).max() / largest[k]) for k, by in derivatives.items()
        )
    return errors

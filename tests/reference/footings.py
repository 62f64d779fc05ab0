"""Load and settlement of strip footings, by the conforming method.

Half of a symmetric layer, 15 m wide and 5 m deep: a fixed base, rollers at both sides,
the footing on 0 ≤ x ≤ 2 m of the top. All loads are dead: vertical, per first area.

    docker/run python3 tests/reference/footings.py --write   # writes the CSV files beside it
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

HERE = Path(__file__).resolve().parent
if __name__ == "__main__":  # pytest sets this path itself
    sys.path.insert(0, str(HERE.parent))

from reference.conforming import Body
from reference.conforming_mesh import Mesh

from dolfinmpm._platform.errors import ConvergenceError, StateError
from dolfinmpm.materials import CamClay, Law, Tresca

Array = npt.NDArray[np.float64]

WIDTH, DEPTH, HALF_WIDTH = 15.0, 5.0, 2.0  # m
STORED = {  # what --write computes: scene → kind of strain → sides of the elements (m)
    "cam_clay": {"large": (1.0, 0.5, 0.25, 0.125), "small": (1.0, 0.5, 0.25, 0.125)},
    "tresca": {"large": (1.0, 0.5, 0.25, 0.125), "small": (1.0, 0.5, 0.25, 0.125)},
    "tresca_smooth": {"large": (1.0, 0.5, 0.25), "small": (1.0, 0.5, 0.25)},
}


@dataclass
class Curve:
    """What a footing did.

    Attributes:
        load: Mean pressure on the footing (Pa), shape (steps + 1,), from 0.
        centre: Settlement at the symmetry axis (m), positive downwards, since the
            footing is loaded; shape (steps + 1,).
        mean: Settlement (m), averaged over the footing's first width.
        edge: Settlement (m) of the footing's edge.
        before: Settlement (m) of the top, on the axis, before the footing is loaded.
        complete: Whether the last load was reached.
        seconds: Time of the run (s).
        body: The body at the end.
    """

    load: Array
    centre: Array
    mean: Array
    edge: Array
    before: float
    complete: bool
    seconds: float
    body: Body


def graded(length: float, at: float, h: float, finest: float | None) -> Array:
    """Ends of elements in [0, length] with sides up to h (m), a node at `at`.

    Args:
        length: Length (m).
        at: Where the smallest elements are (m).
        h: Largest side (m).
        finest: Side (m) at `at`, growing by 1.4 from element to element; h by default.
    """

    def half(reach):
        sizes = [finest or h]
        while sum(sizes) < reach - 1e-9:
            sizes.append(min(1.4 * sizes[-1], h))
        return np.cumsum(sizes) * reach / sum(sizes) if reach > 0 else np.empty(0)

    return np.r_[at - half(at)[::-1], at, at + half(length - at)]


def layer(h: float, finest: float | None = None) -> tuple[Mesh, npt.NDArray[np.bool_]]:
    """The layer's mesh, and which displacements are fixed.

    Args:
        h: Largest side of the elements (m), a divisor of 1: all are squares of it unless
        finest: Side (m) at the footing's edge.
    """
    assert abs(round(1 / h) * h - 1) < 1e-9, "an element must end at the footing's edge"
    mesh = Mesh(graded(WIDTH, HALF_WIDTH, h, finest), graded(DEPTH, DEPTH, h, finest))
    fixed = np.zeros(mesh.x.shape, bool)
    fixed[mesh.nodes("bottom")] = True
    fixed[mesh.nodes("left"), 0] = fixed[mesh.nodes("right"), 0] = True
    return mesh, fixed


def under_footing(mesh: Mesh) -> npt.NDArray[np.int_]:
    """Nodes below the footing, from the axis to its edge."""
    top = mesh.nodes("top")
    order = top[np.argsort(mesh.x[top, 0])]
    return order[mesh.x[order, 0] < HALF_WIDTH + 1e-9]


def footing(
    law: Law, h: float, strain: str, load: float, steps: int, *, rough: bool = False,
    surcharge: float = 0.0, weight: float = 0.0, weight_steps: int = 0, halvings: int = 3,
) -> Curve:  # fmt: skip
    """A flexible footing: equal steps of weight, then equal steps of pressure.

    Args:
        law: Constitutive law.
        h: Side of the square elements (m), a divisor of 1.
        strain: "large" or "small".
        load: Last pressure on the footing (Pa).
        steps: Steps of this pressure.
        rough: Whether the ground sticks to the footing, u_x = 0 under it.
        surcharge: Pressure on the whole top (Pa), from the start and kept, in equilibrium
            with the law's stress without strain.
        weight: Unit weight (N/m³) of the first volume.
        weight_steps: Steps of the weight.
        halvings: How often a step of pressure may be halved. The curve ends before a step
            that fails.
    """
    started = time.perf_counter()
    mesh, fixed = layer(h)
    under = under_footing(mesh)
    fixed[under, 0] |= rough
    body = Body(mesh, law, strain, fixed)
    constant = mesh.edge_load("top", lambda x, n: -surcharge * n)
    gravity = mesh.body_load((0.0, -weight))
    pressure = mesh.strip_load("top", (0.0, -1.0), 0.0, HALF_WIDTH)
    body.step(constant)
    assert np.abs(body.state.u).max() < 1e-12, "the first stress is not in equilibrium"
    for k in range(weight_steps):
        body.step(constant + (k + 1) / weight_steps * gravity)
    first = body.state.u[:, 1].copy()
    # nodal forces of a unit pressure are the weights of Simpson's rule
    share = -pressure[:, 1] / HALF_WIDTH
    rows = [(0.0, 0.0, 0.0, 0.0)]
    for k in range(steps):
        q = load * (k + 1) / steps
        try:
            body.step(constant + gravity + q * pressure, halvings=halvings)
        except (ConvergenceError, StateError):
            break
        s = first - body.state.u[:, 1]
        rows.append((q, s[under[0]], s @ share, s[under[-1]]))
    seconds = time.perf_counter() - started
    return Curve(*np.array(rows).T, -first[under[0]], len(rows) > steps, seconds, body)


def cam_clay(h: float = 0.5, strain: str = "large", steps: int = 50) -> Curve:
    """A flexible smooth footing on normally consolidated Cam-Clay with weight, to 90 kPa.

    Without strain the clay is at p0 = pc = 20 kPa. A surcharge of p0, kept on the whole
    top, makes this stress one of equilibrium. Without it the top would have to become free
    of stress, where this clay has neither stiffness nor strength.
    """
    law = CamClay(
        swelling=0.018, compression=0.130, M=1.05, mu0=5.4e6, alpha=0.0,
        reference_pressure=20e3, preconsolidation=20e3,
    )  # fmt: skip
    return footing(law, h, strain, 90e3, steps, surcharge=20e3, weight=10e3, weight_steps=20)


def tresca(
    h: float = 0.5, strain: str = "large", load: float = 70e3, steps: int = 100, rough: bool = True
) -> Curve:
    """A flexible footing on weightless hardening Tresca clay, to 70 kPa.

    It is rough: under large strain the pressure on a smooth one, vertical on the slope
    towards the footing's edge, has a part along the slope that exceeds the clay's cohesion
    before 70 kPa (q/2 sin 2θ = c at θ = 13° for c = 15 and q = 70 kPa). The surface then
    slides in a layer as thin as an element, and the smooth curve ends there.
    """
    law = Tresca(E=1e6, nu=0.33, cohesion=10e3, ultimate_cohesion=15e3, rate=5.0)
    return footing(law, h, strain, load, steps, rough=rough)


def tresca_smooth(h: float = 0.5, strain: str = "large") -> Curve:
    """`tresca` without friction, which ends before 70 kPa if strains are large."""
    return tresca(h, strain, rough=False)


def rigid_tresca(
    h: float = 0.5, strain: str = "small", *, rough: bool = True, finest: float | None = None,
    depth: float = 1.0, steps: int = 30, ultimate: float = 10e3,
) -> Curve:  # fmt: skip
    """A rigid footing pressed into weightless Tresca clay of 10 kPa.

    As the displacement is prescribed, `load` is the mean of the reaction. Under small strain
    its limit is Prandtl's (2 + π) c, rough or smooth, if the clay is perfectly plastic.

    Args:
        h: Largest side of the elements (m).
        strain: "large" or "small".
        rough: Whether u_x = 0 under the footing.
        finest: Side (m) of the elements at the footing's edge, where stress jumps; h by
            default.
        depth: Last settlement (m).
        steps: Steps of it.
        ultimate: Ultimate cohesion (Pa); more than 10 kPa if the clay hardens.
    """
    started = time.perf_counter()
    law = Tresca(E=1e6, nu=0.33, cohesion=10e3, ultimate_cohesion=ultimate)
    mesh, fixed = layer(h, finest)
    under = under_footing(mesh)
    fixed[under, 1] = True
    fixed[under, 0] |= rough
    body = Body(mesh, law, strain, fixed)
    prescribed, nothing = np.zeros_like(mesh.x), np.zeros_like(mesh.x)
    load, sink = [0.0], depth * np.arange(steps + 1) / steps
    for s in sink[1:]:
        prescribed[under, 1] = -s
        load.append(-body.step(nothing, prescribed)[under, 1].sum() / HALF_WIDTH)
    seconds = time.perf_counter() - started
    return Curve(np.array(load), sink, sink, sink, 0.0, True, seconds, body)


def stored(scene: str, strain: str, h: float) -> Array:
    """Load (Pa) and settlements (m) at the centre, on average and at the edge, of a CSV file.

    Returns:
        Shape (4, steps + 1).
    """
    with open(HERE / f"{scene}_footing.csv", newline="") as file:
        lines = [line for line in file if not line.startswith("#")]
    rows = [
        [float(row[k]) for k in ("load_Pa", "centre_m", "mean_m", "edge_m")]
        for row in csv.DictReader(lines)
        if row["strain"] == strain and float(row["h_m"]) == h
    ]
    assert rows, (scene, strain, h)
    return np.array(rows).T


def write(scene: str) -> None:
    """Compute a scene on all its grids and write `<scene>_footing.csv`."""
    with open(HERE / f"{scene}_footing.csv", "w", newline="") as file:
        file.write(f"# docker/run python3 tests/reference/footings.py --write {scene}\n")
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["strain", "h_m", "load_Pa", "centre_m", "mean_m", "edge_m"])
        for strain, sides in STORED[scene].items():
            for h in sides:
                curve = globals()[scene](h, strain)
                for row in zip(curve.load, curve.centre, curve.mean, curve.edge):
                    rows.writerow([strain, h, f"{row[0]:.1f}", *(f"{s:.8f}" for s in row[1:])])
                file.flush()
                print(
                    f"{scene} {strain} h = {h} m: at {curve.load[-1] / 1e3:.1f} kPa "
                    f"{curve.centre[-1]:.5f} m in the centre, {curve.mean[-1]:.5f} m on average, "
                    f"{curve.edge[-1]:.5f} m at the edge; before {curve.before:.5f} m; "
                    f"{curve.seconds:.1f} s, {curve.body.halvings} halvings",
                    flush=True,
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", nargs="*", choices=list(STORED), required=True)
    for name in parser.parse_args().write or STORED:
        write(name)

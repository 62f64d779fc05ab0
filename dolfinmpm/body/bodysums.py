"""Sums over a body that a split or a merge of its points keeps, or changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.childvalues import first_halves
from dolfinmpm.body.siblingvalues import logarithms, second_moments

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["BodySums", "sums_of"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class BodySums:
    """Sums over the points of all ranks; see `split`.

    Attributes:
        number: Number of points.
        mass: Mass (kg).
        volume: Present volume (m^d).
        momentum: Linear momentum (kg m/s), shape (d,); 0 without velocities.
        angular_momentum: Angular momentum about the origin (kg m²/s), shape (1,) in 2D, (3,) in 3D,
            with the affine parts of velocities. Empty for axisymmetric bodies.
        kinetic_energy: ½ Σ m v² (J), with a velocity gradient as it varies in the domains.
        elastic_energy: ½ Σ V0 J σ : ε_e (J), the stored energy of laws that are linear in ε_e; 0
            for points whose laws keep no elastic strain.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> mpm.split(points, points["x"][:, 0] < 1.0).after.mass
    16000.0
    """

    number: int
    mass: float
    volume: float
    momentum: Array
    angular_momentum: Array
    kinetic_energy: float
    elastic_energy: float


def sums_of(points: MaterialPoints) -> BodySums:
    """The sums of a body as it is. Collective."""
    d, read = points.gdim, points.fields.read
    m, V = read("density") * read("V0"), read("V")
    v = read("velocity") if "velocity" in points.fields else np.zeros((len(points), d))
    kinetic = 0.5 * m @ np.sum(v**2, axis=1)
    more = 3 - d
    place, speed = (np.pad(a, ((0, 0), (0, more))) for a in (read("x"), v))
    spin = np.cross(place, speed)
    B: Array = np.zeros((len(points), d, d))
    if "velocity_gradient" in points.fields and "velocity" in points.fields:
        L = read("velocity_gradient")
        B = L @ second_moments(in_section(points, read("F")), first_halves(points))
        kinetic += 0.5 * m @ np.einsum("pij,pij->p", B, L)
    elif "velocity_moment" in points.fields:
        B = read("velocity_moment")
    B = np.pad(B, ((0, 0), (0, more), (0, more)))
    spin += np.stack([B[:, k, j] - B[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    rows = np.concatenate(
        [[len(points), m.sum(), V.sum(), kinetic, _elastic(points)], m @ v, m @ spin]
    )
    total = points.comm.allreduce(rows, op=MPI.SUM)
    angular = total[5 + d :][2 if d == 2 else 0 :]
    return BodySums(
        int(total[0]), float(total[1]), float(total[2]), total[5 : 5 + d],
        angular[:0] if points.axisymmetric else angular, float(total[3]), float(total[4]),
    )  # fmt: skip


def _elastic(points: MaterialPoints) -> float:
    """Elastic energy of this rank's points (J), as if their laws were linear."""
    fields, total = points.fields, 0.0
    marks = fields.read("moved_under") % 16
    for name, kinds in (("be", (0, 1)), ("elastic_strain", (2, 3))):
        if name not in fields:
            continue
        own = np.isin(marks, kinds)
        strain = logarithms(fields.read(name)[own], name)
        # small strain has no volume change
        V = np.where(marks == 2, fields.read("V0"), fields.read("V"))[own]
        total += float(0.5 * V @ np.einsum("pij,pij->p", fields.read("stress")[own], strain))
    return total

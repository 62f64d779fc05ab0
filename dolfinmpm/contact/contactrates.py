"""Frequencies that the penalty of a contact with a rigid body makes, for the critical step."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.location import bounds

if TYPE_CHECKING:
    from dolfinmpm.contact.rigidcontact import RigidContact

__all__ = ["largest_rate"]

Array = npt.NDArray[np.float64]


def largest_rate(contact: RigidContact, scaling: float) -> float:
    """Bound of the largest squared frequency due to a contact (1/s²). Collective.

    Masses m and M on both ends of a spring k swing with the squared frequency k/m + k/M. If the
    corners on one side of a point touch, the point has the stiffness κ A of a face. A node at the
    body's edge has half the mass of its points. The rigid body may touch with its whole side.

    Args:
        contact: The contact.
        scaling: Factor of the points' mass in their inertia. Rigid bodies keep their mass.
    """
    points = contact.points
    stiffness = contact.stiffness_per_area()
    # by columns: NumPy's reductions of short rows are ten times slower
    sides = [2 * points["l0"][:, k] for k in range(points.gdim)]
    area = functools.reduce(np.multiply, sides) / functools.reduce(np.minimum, sides)
    if points.axisymmetric:
        area = ring(points["x"][:, 0], area)
    mass = points["density"] * points["V0"]
    rates = (2 * stiffness * area / mass).max(initial=0.0), stiffness.max(initial=0.0)
    # one number each: the maximum of Python objects cannot compare arrays
    of_nodes, largest = (points.comm.allreduce(float(own), op=MPI.MAX) for own in rates)
    return of_nodes / scaling + largest * _area_over_mass(contact)


def _area_over_mass(contact: RigidContact) -> float:
    """Largest side of a free body over its mass (m²/kg; m²/kg of a metre in plane strain).

    A force at the distance r of the centre moves the body there with 1/M + r²/J. Prescribed
    motions have no mass.
    """
    body, free = contact.body, contact.body.freedom
    if free is None or free.mass is None:
        return 0.0
    d, M = body.gdim, np.diag(free.inertia(body.start))
    low, high = bounds(contact.points.grid)
    # an infinite body, such as a plane, touches the grid at most
    sizes = np.sort(np.minimum(body.surface.high - body.surface.low, high - low))[1:]
    if contact.points.axisymmetric:
        area = np.pi * min(float(body.surface.high[0]), float(high[0])) ** 2
    else:
        area = float(sizes.prod())
    turns = free.free[free.free >= d]
    moved = 1.0 / free.mass if np.any(free.free < d) else 0.0
    turned = 0.25 * float(sizes @ sizes) / M[turns].min() if turns.size else 0.0
    return area * (moved + turned)

"""Loaded faces of a body under F-bar whose points reach into nearly empty cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from mpi4py import MPI
from ufl.algorithms import extract_coefficients

from dolfinmpm._platform.errors import SoftVolumeWarning, warn
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Field
from dolfinmpm.grid.lattice import Lattice, lattice_of

__all__ = ["warn_of_slivers"]

# Stabilisations that leave nodes of nearly empty cells to the points alone
_WITHOUT = ("none", "soft")
# Part of a domain beyond a grid line that counts: more than rounding of positions
_PART = 1e-6


def warn_of_slivers(form: ufl.Form, points: MaterialPoints, fields: Sequence[Field]) -> None:
    """Warn of faces that have passed a grid line, under F-bar without stabilisation. Collective.

    A `Surface` gives the node beyond the line half of its load while the part beyond is thin. The
    stress of the point beside the face has to follow. Its own volume does not count under F-bar,
    so that only large shear changes this stress.

    Args:
        form: Weak form of the user; one of its laws has F-bar.
        points: Material points.
        fields: Fields of the problem; the first moves the points.
    """
    first = fields[0]
    if (
        first.stabilisation.kind not in _WITHOUT or first.constrains_nodes
        or first.prolongate is not None or not first.space.basis.averaged
        or first.space.configuration == "total"
    ):  # fmt: skip
        return
    lattice = lattice_of(points.grid)
    fields_in_form = [c for c in extract_coefficients(form) if isinstance(c, PointField)]
    # numbers of the user may have such names, too
    known = {c.name for c in fields_in_form if c.ufl_shape == (points.gdim,)}
    names = sorted(n.removesuffix("_offset") for n in known if n.endswith("_offset"))
    names = [name for name in names if f"{name}_area" in known]
    if lattice is None or not names:
        return
    own = np.array([_passes(points, lattice, name) for name in names], np.int32)
    passed = np.zeros_like(own)
    points.comm.Allreduce(own, passed, op=MPI.MAX)
    if passed.any():
        name = names[int(np.argmax(passed))]
        warn(
            points.comm,
            f'fbar = True with stabilisation="{first.stabilisation.kind}": the face of '
            f"'{name}' has passed a grid line. The thin part of the body beyond the line gets its "
            "load, and has no volumetric stiffness of its own: displacements may be several times "
            'too large. Take stabilisation="ghost", or load a Boundary in place of the Surface',
            SoftVolumeWarning,
        )


def _passes(points: MaterialPoints, lattice: Lattice, name: str) -> bool:
    """Whether a grid line cuts the domain of a point of a surface, across its face."""
    area = points[f"{name}_area"]
    rows = np.flatnonzero(np.any(area != 0.0, axis=1))
    n = area[rows] / np.linalg.norm(area[rows], axis=1)[:, None]
    half = n * (1.0 - _PART) * points["l"][rows]
    x = points["x"][rows]
    return bool(np.any(lattice.cells_at(x + half) != lattice.cells_at(x - half)))

"""A bed of springs under a face of a body (Winkler 1867): t = −k (n·d) n.

d is the displacement of the face since it was marked, and n is its initial normal. The bed stands
for ground outside the grid. This file contains the whole term; see `dolfinmpm.assembly.term`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import ufl
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.term import ActiveTerm, Term, as_form
from dolfinmpm.basis.stencils import stencil_matrix
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.surface import Surface
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks

__all__ = ["springs"]

Array = npt.NDArray[np.float64]


class SpringBed(Term):
    """A bed of springs in a weak form; see `springs`.

    Attributes:
        surface: The face.
        stiffness: k (Pa/m).
    """

    kind = "springs"
    holds_faces = True

    def __init__(self, surface: Surface, u: Any, stiffness: float):
        self.points, self.surface, self.stiffness = surface.points, surface, stiffness
        self._u = u

    def __repr__(self) -> str:
        return f"the springs at '{self.surface.name}', {self.stiffness:g} Pa/m"

    def describe(self) -> str:
        """See `Term`."""
        return repr(self)

    def on(self, here: Activation) -> ActiveSprings:
        """See `Term`."""
        return ActiveSprings(self, here)

    @property
    def normals(self) -> tuple[Array, Array]:
        """Normals n, shape (points, gdim), and springs k A (N/m), shape (points,)."""
        area = self.points[self.surface.area.name]
        size = np.linalg.norm(area, axis=1)
        return area / np.where(size > 0.0, size, 1.0)[:, None], self.stiffness * size

    def stiffness_per_area(self) -> float:
        """k (Pa/m)."""
        return self.stiffness

    def energy(self) -> tuple[float, float]:
        """See `Term`. Collective."""
        n, k = self.normals
        along = np.sum(n * self.surface.displacements(), axis=1)
        own = 0.5 * float(k @ along**2)
        return self.points.comm.allreduce(own, op=MPI.SUM), 0.0

    def rate(self) -> float:
        """See `Term`: a node at the edge of the body has half of the mass of its points."""
        mass = self.points["density"] * self.points["V0"]
        worst = float((2.0 * self.normals[1] / mass).max(initial=0.0))
        return self.points.comm.allreduce(worst, op=MPI.MAX)


class ActiveSprings(ActiveTerm):
    """A bed of springs on an activation; see `ActiveTerm`."""

    # the springs store energy, and are not a load
    is_load = False

    def __init__(self, bed: SpringBed, here: Activation):
        self._bed, points = bed, bed.points
        fields = here.fields
        self._k = next(k for k, f in enumerate(fields) if f.space.increment is bed._u)
        s, nodes = fields[self._k].stencils, fields[self._k].basis.nodes.size
        offset = points[bed.surface.offset.name]
        reach = np.einsum("pij,pj->pi", in_section(points, points["F"]), offset)
        # the displacement of a face is u + ∇u r of its point
        self._seen = stencil_matrix(s, s.N, (len(points), nodes))
        for j in range(points.gdim):
            slope = stencil_matrix(s, np.ascontiguousarray(s.dN[:, j]), (len(points), nodes))
            self._seen = self._seen + scipy.sparse.diags(reach[:, j]) @ slope
        self._rows = np.flatnonzero(bed.normals[1])
        self._seen = scipy.sparse.csr_matrix(self._seen)[self._rows]
        self.stiffness = [self._blocks()]

    def _blocks(self) -> Blocks:
        """Stiffness of the springs; nodes that a point sees are coupled anyway."""
        n, k = (values[self._rows] for values in self._bed.normals)
        W = self._seen
        pairs = scipy.sparse.coo_matrix(abs(W).T @ abs(W))
        d = n.shape[1]
        values = np.empty((pairs.nnz, d, d))
        for i in range(d):
            for j in range(d):
                part = scipy.sparse.csr_matrix(W.T @ scipy.sparse.diags(k * n[:, i] * n[:, j]) @ W)
                values[:, i, j] = np.asarray(part[pairs.row, pairs.col]).ravel()
        rows, columns = (x.astype(np.int32) for x in (pairs.row, pairs.col))
        return Blocks(self._k, self._k, rows, columns, values)

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`: forces at the start of the step, which resist."""
        n, k = (values[self._rows] for values in self._bed.normals)
        along = np.sum(n * self._bed.surface.displacements()[self._rows], axis=1)
        out[self._k][...] += self._seen.T @ ((k * along)[:, None] * n)


def springs(surface: Surface, u: Any, v: Any, *, stiffness: float) -> ufl.Form:
    """A bed of springs at a face of a body, a term to be added: F += mpm.springs(...).

    The springs act along the normal of the face, in compression and in tension. They are free of
    stress when the face is marked.

    Args:
        surface: The face, `mpm.Surface`.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        stiffness: k, force per area and displacement (Pa/m).

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range. Or the space
            of the field has configuration="total".

    A bed of springs below the body, 1 MN/m³, under 10 kPa:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> from dolfinx import fem
    >>> top = mpm.Surface(points, lambda x: x[1] > 1.9, normal=(0, 1))
    >>> bottom = mpm.Surface(points, lambda x: x[1] < 0.1, normal=(0, -1))
    >>> F += mpm.springs(bottom, V.increment, V.test, stiffness=1e6)
    >>> F += top.traction(fem.Constant(grid, (0.0, -1e4)), V.test)
    >>> record = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left")).step()
    >>> bottom.mean_displacement()[1].round(6).item()
    -0.01
    """
    check_kind("surface", surface, Surface, "make it with mpm.Surface(points, where, normal)")
    check_displacement(surface.points, u=u, v=v)
    number("stiffness", stiffness, 0.0, unit="Pa/m")
    if u._dolfinmpm_space.configuration == "total":
        raise ParameterError(
            'springs act at present positions: take Space(..., configuration="updated"), got '
            '"total"'
        )
    return as_form(SpringBed(surface, u, stiffness), u, v)

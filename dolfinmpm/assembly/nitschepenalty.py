"""The penalty of Nitsche's method, from eigenproblems of the cells at the boundary.

The method is stable if k exceeds the constant of ∫ |σ(v) n|² da ≤ k a(v, v). The energy a contains
the elastic energy of the points and the stabilisation: the ghost penalty, or the constraints of
aggregation. A fixed multiple of M/h is not enough, and the size of the cut part does not tell the
constant either. An almost empty cell has only the energy of its stabilisation.

Around every cell at the boundary, the largest eigenvalue of the two forms is computed among
functions that are zero behind some layers of nodes. Tractions depend on differences of near nodes.
The error of this restriction is therefore smaller than the factor of 2 on the constant.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import scipy
from petsc4py import PETSc

from dolfinmpm._platform.errors import StateError, raise_together
from dolfinmpm.assembly.facetpenalties import isotropic
from dolfinmpm.assembly.stencilsums import Entries, Matrix, Slope, add_blocks, add_stiffness
from dolfinmpm.basis import Stencils
from dolfinmpm.basis.stencils import pushed_forward
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation

__all__ = ["trace_constants"]

Array = npt.NDArray[np.float64]

# eigenvalues of an energy below this share of the largest one are rounding errors of 0
_NONE = 1e-13
# and pivots below this share may be rounding errors of 0
_SINGULAR = 1e-11


def _tangents(moduli: Array, d: int) -> Array:
    """Isotropic tangents from moduli M and G (Pa), shape (n, d, d, d, d)."""
    M, G = moduli.T
    first, second = isotropic(1.0, 0.0, d), isotropic(0.0, 1.0, d)
    shape = (-1, 1, 1, 1, 1)
    return M.reshape(shape) * first + G.reshape(shape) * second


def _by_slots(points: MaterialPoints, values: Array) -> Array:
    """Linear forms of ∇u as linear forms of stencil slots: gradients, and values if axisymmetric.

    Args:
        points: The points.
        values: Coefficients of ∇u, shape (n, m, strain_dim, strain_dim).

    Returns:
        Coefficients of the slots, shape (n, m, components times slots).
    """
    n, m, rows, columns = values.shape
    if not points.axisymmetric:
        return values.reshape(n, m, rows * columns)
    made = np.zeros((n, m, 2, 3))
    made[..., 1:] = values[..., :2, :2]
    # the hoop strain u_r/r
    made[:, :, 0, 0] = values[..., 2, 2] / points["x"][:, :1]
    return made.reshape(n, m, 6)


def _energies(points: MaterialPoints, moduli: Array) -> Array:
    """Twice the elastic energies of the points, as quadratic forms of their stencil slots."""
    e = points.strain_dim
    D = _tangents(moduli, e) * points["V"].reshape(-1, 1, 1, 1, 1)
    once = _by_slots(points, D.reshape(len(D), e * e, e, e))
    width = once.shape[2]
    turned = np.swapaxes(once, 1, 2).reshape(len(D), width, e, e)
    return _by_slots(points, turned)


def _tractions(markers: MaterialPoints, moduli: Array) -> Array:
    """Squared tractions at markers times areas, as quadratic forms of their stencil slots."""
    d = markers.gdim
    n = markers["area"] / markers["V"][:, None]
    D = _tangents(moduli, markers.strain_dim)[:, :d, :d]
    t = _by_slots(markers, np.einsum("prqis,pq->pris", D, n))
    return np.einsum("p,pra,prb->pab", markers["V"], t, t)


def _assembled(here: Activation, k: int, parts: list[tuple[Stencils, Array]], grid: bool) -> Matrix:
    """Matrix of quadratic forms at points, with the terms over the grid if `grid` is true."""
    matrix = Matrix(here.pattern, here.unknowns)
    field, d = here.unknowns.fields[k], here.fields[k].space.grid.geometry.dim
    nothing = np.zeros((field.numbering.size, field.components))
    entries = Entries(field, field, here.pattern, matrix.data, nothing, nothing.copy())
    for s, values in parts:
        n, width = len(s.order), values.shape[2]
        flat = np.ascontiguousarray(values[s.order]).reshape(n, width**2)
        valued = width > field.components * d
        add_stiffness(s, s, 0, s.groups.size - 1, Slope(flat, valued, valued), entries)
    for kind in ("stiffness", "pattern", "changes", "penalty") if grid else ():
        for b in here.blocks_of(kind, k):
            add_blocks(b, entries)
    matrix.finish()
    return matrix


def _around(
    here: Activation, matrices: list[Matrix], rows: npt.NDArray[np.int64], layers: int
) -> tuple[list[scipy.sparse.csr_matrix], npt.NDArray[np.int64]]:
    """Parts of matrices around some unknowns, and the parts' global numbers. Collective."""
    if here.unknowns.comm.size == 1:
        shape = (here.unknowns.rows,) * 2
        pattern = here.pattern
        made = [
            scipy.sparse.csr_matrix((m.data, pattern.indices, pattern.indptr), shape)
            for m in matrices
        ]
        return made, np.arange(shape[0], dtype=np.int64)
    where = PETSc.IS().createGeneral(np.unique(rows).astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    matrices[0].petsc.increaseOverlap(where, layers)
    where.sort()
    parts = []
    for matrix in matrices:
        (own,) = matrix.petsc.createSubMatrices([where], [where])
        indptr, indices, data = own.getValuesCSR()
        parts.append(scipy.sparse.csr_matrix((data, indices, indptr), own.getSize()))
    return parts, where.getIndices().astype(np.int64)


def _ringed(A: scipy.sparse.csr_matrix, rows: npt.NDArray[Any], layers: int) -> npt.NDArray[Any]:
    """Rows, and the rows coupled to them, layer by layer."""
    for _ in range(layers):
        rows = np.unique(A[rows].indices)
    return rows


@numba.njit(cache=True, error_model="numpy")
def _fill(indptr, indices, data, patch, place, out):
    for i in range(patch.size):
        place[patch[i]] = i
    for i in range(patch.size):
        for k in range(indptr[patch[i]], indptr[patch[i] + 1]):
            j = place[indices[k]]
            if j >= 0:
                out[i, j] = data[k]
    for i in range(patch.size):
        place[patch[i]] = -1


def _part(
    matrix: scipy.sparse.csr_matrix, patch: npt.NDArray[Any], place: npt.NDArray[np.int64]
) -> Array:
    """Dense part of a matrix; `place` is a scratch array of -1, before and after."""
    out = np.zeros((patch.size, patch.size))
    _fill(matrix.indptr, matrix.indices, matrix.data, patch, place, out)
    return 0.5 * (out + out.T)


def _largest(energy: Array, traction: Array) -> float:
    """Largest eigenvalue of tractions over energy; infinite for tractions without energy."""
    from scipy import linalg

    n = len(energy)
    if n == 0:
        # all nodes around are prescribed: nothing there that a penalty could hold
        return 0.0
    try:
        factor = linalg.cholesky(energy, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return _largest_of_free(energy, traction)
    spread = np.diag(factor)
    if spread.min() ** 2 <= _SINGULAR * spread.max() ** 2:
        return _largest_of_free(energy, traction)
    half = linalg.solve_triangular(factor, traction, lower=True, check_finite=False)
    whole = linalg.solve_triangular(factor, half.T, lower=True, check_finite=False)
    found = linalg.eigvalsh(whole, subset_by_index=[n - 1, n - 1], check_finite=False)
    return max(float(found[0]), 0.0)


def _largest_of_free(energy: Array, traction: Array) -> float:
    """`_largest` if some motions have no energy, such as rigid motions of a free body."""
    values, vectors = np.linalg.eigh(0.5 * (energy + energy.T))
    some = values > _NONE * values[-1]
    free = vectors[:, ~some]
    size = np.abs(traction).max(initial=0.0)
    if size == 0.0:
        return 0.0
    if free.size and np.abs(free.T @ traction @ free).max() > 1e-6 * size:
        return np.inf
    own = vectors[:, some] / np.sqrt(values[some])
    return float(np.linalg.eigvalsh(own.T @ traction @ own)[-1])


def trace_constants(
    here: Activation,
    k: int,
    boundary: Boundary,
    moduli: Array,
    at_markers: Array,
) -> Array:
    """Constants of Nitsche's method at the markers of a boundary (Pa/m), shape (markers,).

    Collective.

    Args:
        here: The activation.
        k: Number of the displacement's field.
        boundary: The boundary.
        moduli: Elastic moduli M and G at the points (Pa), shape (points, 2).
        at_markers: Moduli at its markers, shape (markers, 2).

    Raises:
        StateError: A marker is in a cell without stiffness, because the cell has no material and
            no stabilisation.
    """
    points, markers, field = boundary.points, boundary.markers, here.fields[k]
    d, s, own = points.gdim, field.of_markers[markers.number], field.stencils
    if here.total:
        own = pushed_forward(own, in_section(points, points["F"]))
        s = pushed_forward(s, boundary.deformation())
    inside, square = _energies(points, moduli), _tractions(markers, at_markers)
    energy = _assembled(here, k, [(own, inside)], True)
    tractions = _assembled(here, k, [(s, square)], False)
    unknowns = here.unknowns
    row_of, to_global = unknowns.fields[k].row_of, unknowns.to_global
    groups: list[npt.NDArray[np.int64]] = []
    for g in range(s.groups.size - 1):
        seen = row_of[s.nodes[s.node_start[g] : s.node_start[g + 1]]].ravel()
        groups.append(to_global[seen[seen >= 0]].astype(np.int64))
    layers = 2 if d == 2 and here.fields[k].basis.degree == 1 else 1
    wanted = np.concatenate([np.empty(0, np.int64), *groups])
    (A, N), numbers = _around(here, [energy, tractions], wanted, layers)
    constants = np.zeros(len(markers))
    lost: Array | None = None
    place = np.full(len(numbers), -1, np.int64)
    for g, rows in enumerate(groups):
        patch = _ringed(A, np.searchsorted(numbers, rows), layers)
        constant = _largest(*(_part(matrix, patch, place) for matrix in (A, N)))
        members = s.order[s.groups[g] : s.groups[g + 1]]
        constants[members] = constant
        if not np.isfinite(constant) and lost is None:
            lost = markers["x"][members[0]]
    raise_together(
        points.comm,
        None
        if lost is None
        else StateError(
            f"the cell of '{boundary.name}' at {lost} m has no stiffness, neither of material "
            "points nor of a stabilisation: Nitsche's method has no finite penalty there. If the "
            "body does not reach this place, move the boundary to the body, or give follows=False "
            'for a wall that waits for it. Else add stabilisation="ghost" or "aggregation" '
            '(explicit steps: "aggregation"), or penalty'
        ),
    )
    return constants

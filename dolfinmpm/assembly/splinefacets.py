"""Terms over ghost facets of rectangular grids: one element tensor for all facets of a class.

On a rectangular grid, two facets whose surrounding cells have the same sizes have the same splines
around them, up to a translation. Such facets form a class. The tensor between splines is computed
for one facet of each class, and added for all facets of the class. Linear functions are splines of
degree 1. On a grid of equal cells they have one class per direction.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm.assembly.facetpenalties import INTERVALS, by_ratio, lattice_pair
from dolfinmpm.assembly.facettensors import FacetTensors, facet_moduli, readable
from dolfinmpm.assembly.latticefacets import FacetPlace
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.basis.stencils import running_sum
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.grid.lattice import lattice_of

__all__ = ["FacetBlock", "are_alike"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# relative difference of cell sizes below which it is a rounding error
_SAME = 1e-12


def _kinds(line: Array, degree: int) -> tuple[Ints, Ints]:
    """Kinds of the cells of a line: cells with the same splines have the same number, from 0.

    The splines of a cell depend on its size and on the sizes of degree − 1 cells on each side.

    Returns:
        Kinds of the cells, and kinds of the pairs of neighbouring cells.
    """
    steps = np.diff(line)
    order = np.argsort(steps)
    # coordinates have at least this rounding error
    slack = max(_SAME * steps.max(), 8 * np.finfo(float).eps * np.abs(line).max())
    size = np.empty(steps.size, np.int32)
    size[order] = np.cumsum(np.diff(steps[order], prepend=steps[order[0]]) > slack)
    # at the ends of the grid, repeated knots act like cells without size
    reach = degree - 1
    padded = np.concatenate([np.full(reach, -1), size, np.full(reach, -1)])

    def number(width: int) -> Ints:
        if padded.size < width:
            return np.empty(0, np.int32)
        windows = np.lib.stride_tricks.sliding_window_view(padded, width)
        return np.unique(windows, axis=0, return_inverse=True)[1].ravel().astype(np.int32)

    return number(2 * reach + 1), number(2 * reach + 2)


def are_alike(form: ufl.Form, space: Space) -> bool:
    """Whether `FacetBlock` integrates a form: by classes of facets, or facet by facet.

    It does so if the facets have few classes, or if FFCx would take too long. The form must be
    bilinear and over ghost facets only; see `readable`. The answer is the same on all ranks.
    Collective.

    Args:
        form: The form.
        space: Space of both arguments.
    """
    basis = space.basis
    if not isinstance(basis, LatticeBasis):
        return False
    for integral in form.integrals():
        given = integral.subdomain_id()
        ids = given if isinstance(given, tuple) else (given,)
        if integral.integral_type() != "interior_facet" or set(ids) != {GHOST_FACETS}:
            return False
    if not readable(form, space.cell_size):
        return False
    # a line of equal cells has 2 degree − 1 kinds of cells; a graded line has one kind per cell
    kinds = [_kinds(line, basis.degree)[0] for line in basis.lattice.lines]
    few = all(k.max() < 8 * basis.degree for k in kinds)
    # moduli of facets need the tensors themselves. Otherwise one tensor per facet costs less than
    # compilation by FFCx, which takes minutes for third derivatives.
    return few or bool(facet_moduli(form)) or basis.degree + len(kinds) > 4


@numba.njit(cache=True, error_model="numpy")
def _collect(low, direction, table, table_shape, macro, nodes, count):
    """Write the nodes around every facet and count the facets of each node.

    Returns whether all nodes are known.
    """
    gdim = low.shape[1]
    known = True
    for f in range(low.shape[0]):
        for a in range(nodes.shape[1]):
            at = 0
            for d in range(gdim):
                at = at * table_shape[d] + low[f, d] + macro[direction[f], a, d]
            nodes[f, a] = table[at]
            known = known and table[at] >= 0
            count[table[at]] += 1
    return known


@numba.njit(cache=True, error_model="numpy")
def _turn(nodes, place, start, facet, position):
    """Write the facets of every touched node, and the node's position in each facet's nodes."""
    fill = start[:-1].copy()
    for f in range(nodes.shape[0]):
        for a in range(nodes.shape[1]):
            row = place[nodes[f, a]]
            facet[fill[row]], position[fill[row]] = f, a
            fill[row] += 1


@numba.njit(cache=True, error_model="numpy")
def _couple(nodes, direction, start, facet, position, slot, seen, begin, columns, slots):
    """Write the nodes coupled to each touched node; only count them if the arrays are empty."""
    seen[:] = -1
    total = 0
    for row in range(start.size - 1):
        for e in range(start[row], start[row + 1]):
            f = facet[e]
            for b in range(nodes.shape[1]):
                s = slot[direction[f], position[e], b]
                if seen[s] != row:
                    seen[s] = row
                    if columns.size:
                        columns[total], slots[total] = nodes[f, b], s
                    total += 1
        begin[row + 1] = total


@numba.njit(cache=True, error_model="numpy")
def _add(kind, direction, start, facet, position, slot, tensors, scale, begin, slots, sums, out):
    """Sum the facets' scaled tensors between every touched node and its coupled nodes."""
    m, n = tensors.shape[3], tensors.shape[4]
    sums[:] = 0.0
    for row in range(start.size - 1):
        for e in range(start[row], start[row + 1]):
            f, a = facet[e], position[e]
            for part in range(scale.shape[1]):
                factor = scale[f, part]
                for b in range(m):
                    s = slot[direction[f], a, b]
                    for q in range(n):
                        sums[s, q] += factor * tensors[kind[f], part, a, b, q]
        for at in range(begin[row], begin[row + 1]):
            for q in range(n):
                out[at, q] = sums[slots[at], q]
                sums[slots[at], q] = 0.0


class FacetBlock:
    """A bilinear form over ghost facets, between splines or linear functions.

    Args:
        form: The form; `are_alike` must be true for it.
        space: Space of both arguments.

    Attributes:
        rows, columns: Spline nodes of each block, in the basis's local numbering.
        moving: Subdomain ids of the facets in the form.
        constants, coefficients: Data of the form. The only coefficients are moduli of facets.
        moduli: Moduli of facets in the form.
    """

    def __init__(self, form: ufl.Form, space: Space):
        assert isinstance(space.basis, LatticeBasis)
        self._space = space
        self._basis = basis = space.basis
        self._tensor_of = FacetTensors(form, basis.degree, space.components)
        self.constants: list[fem.Constant] = form.constants()
        self.moduli = facet_moduli(form)
        self.coefficients: list[fem.Function] = list(self.moduli)
        # one tensor without moduli, and one tensor per modulus
        self._parts = [None, *self.moduli]
        self.moving = {GHOST_FACETS}
        self._kinds = [_kinds(line, basis.degree) for line in basis.lattice.lines]
        # nodes around a facet by its direction, relative to the first node of its lower cell
        gdim, p = space.grid.geometry.dim, basis.degree
        self._shapes = [tuple(p + 1 + (d == e) for e in range(gdim)) for d in range(gdim)]
        macro = [list(np.ndindex(*shape)) for shape in self._shapes]
        self._macro = np.array(macro, np.int32)
        # position of node b relative to node a, as one number
        strides = (2 * p + 3) ** np.arange(gdim)[::-1]
        apart = self._macro[:, None, :, :] - self._macro[:, :, None, :] + p + 1
        self._slot = (apart @ strides).astype(np.int32)
        self._slots = (2 * p + 3) ** gdim
        self._tensors: dict[int, Array] = {}
        # penalties of adaptive moduli for M = 1, by class of facets and ratio of moduli
        self._penalties: dict[int, Array] = {}
        self._attached = False
        self._rows: slice | npt.NDArray[np.bool_] = slice(None)
        self._values: Array | None = None

    def renew(self) -> None:
        """Forget the facets of the integration."""
        self._attached = False

    def regrid(self) -> None:
        """Forget values that belong to the old lines of the grid."""
        basis = self._space.basis
        assert isinstance(basis, LatticeBasis)
        self._kinds = [_kinds(line, basis.degree) for line in basis.lattice.lines]
        self._tensors, self._penalties, self._attached = {}, {}, False

    def attach(self, entities: dict[int, Ints], basis: LatticeBasis) -> None:
        """Set the ghost facets of the integration, unless they are set already.

        Args:
            entities: Under the key GHOST_FACETS, rows (cell, local facet, cell, local facet),
                flattened. The first cell is "+".
            basis: Basis of the space with its overlap; its numbering of nodes is used.
        """
        if self._attached and basis is self._basis:
            return
        self._basis, self._attached = basis, True
        facets = entities[GHOST_FACETS].reshape(-1, 4)
        self._rows = self._first_parts(facets)
        facets = np.asarray(facets[self._rows], np.int32).reshape(-1, 4)
        halo, ijk = self._basis.halo, self._basis.lattice.cell_ijk
        first, second = ijk[facets[:, 0]], ijk[facets[:, 2]]
        low = np.minimum(first, second)
        self._direction = np.argmax(first != second, axis=1).astype(np.int32)
        code = 2 * self._direction.astype(np.int64) + np.any(first > second, axis=1)
        for d, (cells, pairs) in enumerate(self._kinds):
            across = self._direction == d
            kind = cells[low[:, d]]
            kind[across] = pairs[low[across, d]]
            code = code * (1 + max(cells.max(), pairs.max(initial=0))) + kind
        self._codes, chosen, kind = np.unique(code, return_index=True, return_inverse=True)
        self._kind = kind.ravel().astype(np.int32)
        lines, swapped = self._basis.lattice.lines, np.any(first > second, axis=1)
        self._chosen = [
            FacetPlace(lines, tuple(low[f].tolist()), int(self._direction[f]), bool(swapped[f]))
            for f in chosen
        ]
        nodes = np.empty((len(facets), self._macro.shape[1]), np.int32)
        count = np.zeros(self._basis.nodes.size, np.int64)
        shape = np.array(halo.node_table.shape, np.int64)
        table = low - halo.origin, self._direction, halo.node_table.ravel(), shape
        known = _collect(*table, self._macro, nodes, count)
        assert known
        touched = np.flatnonzero(count)
        start = running_sum(count[touched], np.int64)
        place = np.empty(count.size, np.int32)
        place[touched] = np.arange(touched.size, dtype=np.int32)
        facet, position = np.empty(start[-1], np.int32), np.empty(start[-1], np.int32)
        _turn(nodes, place, start, facet, position)
        self._near = start, facet, position, self._slot
        self._begin = np.zeros(touched.size + 1, np.int64)
        graph = nodes, self._direction, *self._near, np.empty(self._slots, np.int64), self._begin
        self.columns = self._slot_of = np.empty(0, np.int32)
        _couple(*graph, self.columns, self._slot_of)
        self.columns, self._slot_of = np.empty((2, self._begin[-1]), np.int32)
        _couple(*graph, self.columns, self._slot_of)
        self.rows = np.repeat(touched.astype(np.int32), np.diff(self._begin))

    def _first_parts(self, facets: Ints) -> slice | npt.NDArray[np.bool_]:
        """Facets to integrate: for a coarser lattice, the part at each coarse facet's lower corner.

        Returns whether to take each facet, or a slice of all facets.
        """
        basis = self._basis
        if basis.coarsen == 1:
            return slice(None)
        fine = lattice_of(self._space.grid)
        assert fine is not None
        low = np.minimum(fine.cell_ijk[facets[:, 0]], fine.cell_ijk[facets[:, 2]])
        across = fine.cell_ijk[facets[:, 0]] != fine.cell_ijk[facets[:, 2]]
        return np.all((low % basis.coarsen == 0) | across, axis=1)

    def matrix(self) -> Array:
        """This rank's share of the matrix, one block per entry of `rows` and `columns`."""
        values = np.concatenate([np.empty(0), *(np.ravel(c.value) for c in self.constants)])
        if self._values is None or not np.array_equal(values, self._values):
            self._tensors, self._penalties = {}, {}
            self._values = values
        for code, place in zip(self._codes, self._chosen):
            if code not in self._tensors:
                self._tensors[code] = self._tensor(place)
        c, m = self._space.components, self._macro.shape[1]
        tensors = [self._tensors[code] for code in self._codes]
        single = all(t.shape[3] == 1 for t in tensors)
        if not single:
            tensors = [t * np.eye(c).ravel() if t.shape[3] == 1 else t for t in tensors]
        n = 1 if single else c**2
        stacked = np.array(tensors).reshape(-1, len(self._parts), m, m, n)
        scale = np.ones((self._kind.size, len(self._parts)))
        for k, modulus in enumerate(self.moduli):
            modulus.values = self._scaled(k)
            scale[:, 1 + k] = modulus.values
        if self.moduli and not stacked[:, 0].any():
            stacked, scale = np.ascontiguousarray(stacked[:, 1:]), scale[:, 1:].copy()
        sums, out = np.empty((self._slots, n)), np.empty((self.rows.size, n))
        near = self._kind, self._direction, *self._near
        _add(*near, stacked, scale, self._begin, self._slot_of, sums, out)
        return (out[:, :, None] * np.eye(c) if single else out).reshape(-1, c, c)

    def _tensor(self, place: FacetPlace) -> Array:
        """Tensors of a facet: without moduli, and per modulus, shape (1 + moduli, m, m, n)."""
        base = self._tensor_of(place)
        slopes = [self._tensor_of(place, one) for one in self.moduli]
        most, c = max(t.shape[2] for t in (base, *slopes)), self._space.components
        tensors = [t * np.eye(c).ravel() if t.shape[2] < most else t for t in (base, *slopes)]
        return np.array([tensors[0], *(t - tensors[0] for t in tensors[1:])])

    def _scaled(self, k: int) -> Array:
        """Values of a modulus at the facets."""
        modulus = self.moduli[k]
        M, G = modulus.moduli[self._rows].T
        if modulus.target is None:
            return M.copy()
        degree = self._basis.degree
        for code in self._codes:
            self._penalties.setdefault(code, np.full((len(self.moduli), INTERVALS + 1), np.nan))
        kept = np.array([self._penalties[code][k] for code in self._codes])
        kept = kept.reshape(-1, INTERVALS + 1)

        def pair_of(code: int, place: FacetPlace):
            return lambda: lattice_pair(place, degree, self._tensors[code][1 + k])

        pairs = [pair_of(*both) for both in zip(self._codes, self._chosen)]
        ratios = np.divide(G, M, out=np.zeros_like(M), where=M > 0)
        values = M * by_ratio(kept, ratios, self._kind, pairs, modulus.target)
        for code, row in zip(self._codes, kept):
            self._penalties[code][k] = row
        return values

    def state(self) -> dict[str, npt.NDArray]:
        """The tensors kept: rounding differs between the facets that a class was integrated on."""
        if self._values is None:
            return {}
        tensors, known = list(self._tensors.values()), list(self._penalties.values())
        return {
            "constants": self._values,
            "codes": np.array(list(self._tensors), np.int64),
            "shapes": np.array([t.shape for t in tensors], np.int64).reshape(-1, 4),
            "tensors": np.concatenate([np.empty(0), *(t.ravel() for t in tensors)]),
            "penalized": np.array(list(self._penalties), np.int64),
            "penalties": np.concatenate([np.empty(0), *(p.ravel() for p in known)]),
        }

    def set_state(self, kept: dict[str, npt.NDArray]) -> None:
        """Keep the tensors that `state` returned, and no others."""
        self._values = kept.get("constants")
        self._tensors, self._penalties, start = {}, {}, 0
        for code, shape in zip(kept.get("codes", ()), kept.get("shapes", ())):
            end = start + int(np.prod(shape))
            self._tensors[code] = kept["tensors"][start:end].reshape(shape)
            start = end
        codes = kept.get("penalized", ())
        if len(codes):
            shape = len(codes), len(self.moduli), INTERVALS + 1
            self._penalties = dict(zip(codes, kept["penalties"].reshape(shape).copy()))

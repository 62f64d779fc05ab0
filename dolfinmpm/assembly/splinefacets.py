"""Terms over ghost facets of rectangular grids: one element tensor for all facets of a class.

On a rectangular grid, two facets whose surrounding cells have the same sizes have the same splines
around them, up to a translation. Such facets form a class. The tensor between splines is computed
for one facet of each class, and added for all facets of the class. Linear functions are splines of
degree 1. On a grid of equal cells they have one class per direction.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import ClassVar

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinmpm.assembly.facetpenalties import INTERVALS, by_ratio, lattice_pair
from dolfinmpm.assembly.facettensors import FacetTensors, facet_moduli, readable
from dolfinmpm.assembly.knowntensors import KNOWN, key_of_facet, key_of_form
from dolfinmpm.assembly.latticefacets import Couplings, LatticeFacet, couplings_of, facet_patch
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.grid.lattice import lattice_of

__all__ = ["FacetBlock", "uses_facet_classes"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

# whether forms are readable, because UFL needs longer than a small problem for a step to tell
_READABLE: dict[Hashable, bool] = {}
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


@numba.njit(cache=True, error_model="numpy")
def _sum(kind, direction, start, facet, position, slot, tensors, scale, begin, slots, sums, out):
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


def _sums(couplings: Couplings, kind: Ints, tensors: Array, scale: Array) -> Array:
    """Sums of the facets' tensors, shape (entries, n).

    Args:
        couplings: Entries of the matrix.
        kind: Row of each facet in `tensors`.
        tensors: Tensors, shape (kinds, parts, m, m, n).
        scale: Factors, shape (facets, parts).
    """
    work = np.empty((couplings.patch.slots, tensors.shape[-1]))
    out = np.empty((couplings.rows.size, tensors.shape[-1]))
    near = kind, couplings.direction, *couplings.facets_of_nodes, couplings.patch.slot
    _sum(*near, tensors, scale, couplings.begin, couplings.slots, work, out)
    return out


def uses_facet_classes(form: ufl.Form, space: Space) -> bool:
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
    key = key_of_form(form, space)
    if key not in _READABLE:
        _READABLE[key] = readable(form, space)
    if not _READABLE[key]:
        return False
    # a line of equal cells has 2 degree − 1 kinds of cells; a graded line has one kind per cell
    kinds = [_kinds(line, basis.degree)[0] for line in basis.lattice.lines]
    few = all(k.max() < 8 * basis.degree for k in kinds)
    # moduli of facets need the tensors themselves. Otherwise one tensor per facet costs less than
    # compilation by FFCx, which takes minutes for third derivatives.
    return few or bool(facet_moduli(form)) or basis.degree + len(kinds) > 4


@dataclass
class _KeptTensors:
    """Values that hold as long as the form's constants and the grid's lines.

    Attributes:
        constants: Values of the form's constants; None before the first matrix.
        tensors: Element tensors, by class of facets.
        penalties: Penalties of adaptive moduli for M = 1, by class of facets and ratio of moduli.
    """

    constants: Array | None = None
    tensors: dict[int, Array] = field(default_factory=dict)
    penalties: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class _Facets:
    """Facets of the integration.

    Attributes:
        selected: Which ghost facets they are, see `_first_parts`.
        examples: One facet of each class, by the number of the class.
        kind: Position of each facet's class in `examples`.
        couplings: Entries of the matrix.
    """

    selected: slice | npt.NDArray[np.bool_]
    examples: dict[int, LatticeFacet]
    kind: Ints
    couplings: Couplings


class FacetBlock:
    """A bilinear form over ghost facets, between splines or linear functions.

    Args:
        form: The form; `uses_facet_classes` must be true for it.
        space: Space of both arguments.

    Attributes:
        constants: Constants of the form.
        moduli: Moduli of facets in the form.
    """

    # subdomain ids of the facets in the form
    moving: ClassVar[set[int]] = {GHOST_FACETS}

    def __init__(self, form: ufl.Form, space: Space):
        assert isinstance(space.basis, LatticeBasis)
        self._space = space
        self._basis = basis = space.basis
        self._tensor_of = FacetTensors(form, basis.degree, space.components)
        self._key = key_of_form(form, space)
        self.constants: list[fem.Constant] = form.constants()
        self.moduli = facet_moduli(form)
        self._kinds = [_kinds(line, basis.degree) for line in basis.lattice.lines]
        self._patch = facet_patch(space.grid.geometry.dim, basis.degree)
        self._kept = _KeptTensors()
        self._facets: _Facets | None = None

    @property
    def coefficients(self) -> list[fem.Function]:
        """Coefficients of the form, which are its moduli of facets."""
        return list(self.moduli)

    @property
    def facets(self) -> _Facets:
        """The facets of the integration."""
        assert self._facets is not None
        return self._facets

    @property
    def rows(self) -> Ints:
        """Spline nodes of the rows of the blocks."""
        return self.facets.couplings.rows

    @property
    def columns(self) -> Ints:
        """Spline nodes of the columns of the blocks."""
        return self.facets.couplings.columns

    def renew(self) -> None:
        """Forget the facets of the integration."""
        self._facets = None

    def regrid(self) -> None:
        """Forget values that belong to the old lines of the grid."""
        basis = self._space.basis
        assert isinstance(basis, LatticeBasis)
        self._kinds = [_kinds(line, basis.degree) for line in basis.lattice.lines]
        self._kept = _KeptTensors(self._kept.constants)
        self._facets = None

    def attach(self, entities: dict[int, Ints], basis: LatticeBasis) -> None:
        """Set the ghost facets of the integration, unless they are set already.

        Args:
            entities: Under the key GHOST_FACETS, rows (cell, local facet, cell, local facet),
                flattened. The first cell is "+".
            basis: Basis of the space with its overlap; its numbering of nodes is used.
        """
        if self._facets is not None and basis is self._basis:
            return
        self._basis = basis
        facets = entities[GHOST_FACETS].reshape(-1, 4)
        selected = self._first_parts(facets)
        facets = np.asarray(facets[selected], np.int32).reshape(-1, 4)
        ijk, lines = basis.lattice.cell_ijk, basis.lattice.lines
        first, second = ijk[facets[:, 0]], ijk[facets[:, 2]]
        low, swapped = np.minimum(first, second), np.any(first > second, axis=1)
        direction = np.argmax(first != second, axis=1).astype(np.int32)
        code = 2 * direction.astype(np.int64) + swapped
        for d, (cells, pairs) in enumerate(self._kinds):
            across = direction == d
            kind = cells[low[:, d]]
            kind[across] = pairs[low[across, d]]
            code = code * (1 + max(cells.max(), pairs.max(initial=0))) + kind
        codes, examples, kind = np.unique(code, return_index=True, return_inverse=True)
        places = [
            LatticeFacet(lines, tuple(low[f].tolist()), int(direction[f]), bool(swapped[f]))
            for f in examples
        ]
        couplings = couplings_of(self._patch, basis, low, direction)
        kind = kind.ravel().astype(np.int32)
        self._facets = _Facets(selected, dict(zip(codes.tolist(), places)), kind, couplings)

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
        facets, kept = self.facets, self._kept
        values = np.concatenate([np.empty(0), *(np.ravel(c.value) for c in self.constants)])
        if kept.constants is None or not np.array_equal(values, kept.constants):
            self._kept = kept = _KeptTensors(values)
        for code, place in facets.examples.items():
            if code not in kept.tensors:
                key = self._key, values.tobytes(), key_of_facet(place)
                parts_of = functools.partial(self._tensor_of.parts, place, self.moduli)
                kept.tensors[code] = KNOWN.get(key, parts_of)
        c, m, parts = self._space.components, self._patch.nodes.shape[1], 1 + len(self.moduli)
        tensors = [kept.tensors[code] for code in facets.examples]
        single = all(t.shape[3] == 1 for t in tensors)
        if not single:
            tensors = [t * np.eye(c).ravel() if t.shape[3] == 1 else t for t in tensors]
        stacked = np.array(tensors).reshape(-1, parts, m, m, 1 if single else c**2)
        scale: Array = np.ones((facets.kind.size, parts))
        for k, modulus in enumerate(self.moduli):
            modulus.values = self._scaled(k)
            scale[:, 1 + k] = modulus.values
        if self.moduli and not stacked[:, 0].any():
            stacked, scale = np.ascontiguousarray(stacked[:, 1:]), scale[:, 1:].copy()
        out = _sums(facets.couplings, facets.kind, stacked, scale)
        return (out[:, :, None] * np.eye(c) if single else out).reshape(-1, c, c)

    def _scaled(self, k: int) -> Array:
        """Values of a modulus at the facets."""
        modulus, facets, kept = self.moduli[k], self.facets, self._kept
        M, G = modulus.moduli[facets.selected].T
        if modulus.target is None:
            return modulus.plain(M, G)
        degree = self._basis.degree
        for code in facets.examples:
            kept.penalties.setdefault(code, np.full((len(self.moduli), INTERVALS + 1), np.nan))
        known = np.array([kept.penalties[code][k] for code in facets.examples])
        known = known.reshape(-1, INTERVALS + 1)

        def pair_of(code: int, place: LatticeFacet):
            return lambda: lattice_pair(place, degree, kept.tensors[code][1 + k])

        pairs = [pair_of(*both) for both in facets.examples.items()]
        ratios = np.divide(G, M, out=np.zeros_like(M), where=M > 0)
        values = M * by_ratio(known, ratios, facets.kind, pairs, modulus.target)
        for code, row in zip(facets.examples, known):
            kept.penalties[code][k] = row
        return values

    def state(self) -> dict[str, npt.NDArray]:
        """The tensors kept: rounding differs between the facets that a class was integrated on."""
        kept = self._kept
        if kept.constants is None:
            return {}
        tensors, known = list(kept.tensors.values()), list(kept.penalties.values())
        return {
            "constants": kept.constants,
            "codes": np.array(list(kept.tensors), np.int64),
            "shapes": np.array([t.shape for t in tensors], np.int64).reshape(-1, 4),
            "tensors": np.concatenate([np.empty(0), *(t.ravel() for t in tensors)]),
            "penalized": np.array(list(kept.penalties), np.int64),
            "penalties": np.concatenate([np.empty(0), *(p.ravel() for p in known)]),
        }

    def set_state(self, state: dict[str, npt.NDArray]) -> None:
        """Keep the tensors that `state` returned, and no others.

        Those of a form with other moduli are not kept, and are computed anew.
        """
        if any(shape[0] != 1 + len(self.moduli) for shape in state.get("shapes", ())):
            state = {}
        self._kept = kept = _KeptTensors(state.get("constants"))
        start = 0
        for code, shape in zip(state.get("codes", ()), state.get("shapes", ())):
            end = start + int(np.prod(shape))
            kept.tensors[int(code)] = state["tensors"][start:end].reshape(shape)
            start = end
        codes = state.get("penalized", ())
        if len(codes):
            shape = len(codes), len(self.moduli), INTERVALS + 1
            penalties = state["penalties"].reshape(shape).copy()
            kept.penalties.update(zip((int(code) for code in codes), penalties))

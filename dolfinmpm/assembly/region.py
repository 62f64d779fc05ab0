"""Evaluation of the terms of one part of the body, in chunks of some thousand points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform import stages
from dolfinmpm.assembly.functionvalues import function_values
from dolfinmpm.assembly.stencilsums import Entries, Slope, add_stiffness, add_vector
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveRegion
from dolfinmpm.cut.cellcouplings import add_outer
from dolfinmpm.cut.facetmoduli import add_isotropic_moduli
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.operators import AveragingLaw, KeepingLaw, KeptTangents, PointOperator
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.pointwise import Program

__all__ = ["PointFailure", "Region"]

Array = npt.NDArray[np.float64]

# Points per chunk: the tangents of a chunk fit into the cache.
_CHUNK = 4096
# Chunks of a sample of the points
_SAMPLE = 8


@dataclass(frozen=True)
class PointFailure:
    """A point at which a law finds no stress.

    Attributes:
        point: Number of the point on this rank.
        cause: The law's description of the failure; may be empty.
    """

    point: int
    cause: str


class Region:
    """The terms of a part of the body on its points.

    Args:
        terms: The terms.
        points: Material points.
        unknowns: Numbering of the unknowns.
        part: Stencils of the part.
        shared: Data of all points by key of slots, shared between the parts.

    Attributes:
        terms, part: The arguments.
        failure: The point at which a law found no stress in the last call, or None.
        sampled: Whether tangents are those of a sample of the points.
        keeps: Whether results of laws are kept, though no tangent is asked for.
    """

    def __init__(
        self,
        terms: PointTerms,
        points: MaterialPoints,
        unknowns: Unknowns,
        part: ActiveRegion,
        shared: Mapping[tuple, Array],
    ):
        self.terms, self.part, self.sampled, self.keeps = terms, part, False, False
        self.failure: PointFailure | None = None
        self._points, self._unknowns = points, unknowns
        widths = [c.components * (1 + points.gdim) for c in unknowns.fields]
        self._chunks = _chunks_of(part.stencils[0].groups)
        self._columns: list[int] = [sum(widths[:k]) for k in range(len(widths))]
        # intermediate results of laws, in the order of the stencils, and numbers of the operators
        # whose results belong to the present increments
        self._kept: dict[int, Array] = {}
        # how many each operator keeps: the check of a protocol takes time in every chunk
        laws: list[Any] = [operator.law for operator in terms.operators]
        self._keeps = [law.keeps if isinstance(law, KeepingLaw) else 0 for law in laws]
        self._current: set[int] = set()
        self._data = dict(shared)
        for k, (function, gradient) in enumerate(terms.placeholders.functions):
            self._data["function", k] = function_values(function, gradient, points)
        for key in terms.placeholders.sources.values():
            if key[0] == "tagged":
                self._data[key] = np.isin(points["tag"], key[1]).astype(float)
        self.update_constants()

    def update_constants(self) -> None:
        """Read the form's constants again."""
        self._current.clear()
        for k, constant in enumerate(self.terms.placeholders.constants):
            self._data["constant", k] = np.array(constant.value, float).reshape(1, -1)

    def prepare(self) -> None:
        """Forget results at old increments, and compute means over cells of laws that need them.

        Collective if a law needs means.
        """
        self._current.clear()
        for k in self.terms.by_mean:
            averages = self.part.averages
            assert averages is not None
            everywhere = np.arange(len(self._points))
            law = self.averaging(k)
            law.prepare(self.operand(k, everywhere), averages.mean)

    def averaging(self, k: int) -> AveragingLaw:
        """The law of the k-th operator, which takes means over cells."""
        law = self.terms.operators[k].law
        assert isinstance(law, AveragingLaw)
        return law

    def operand(self, k: int, rows: npt.NDArray[np.integer]) -> Array:
        """Operand of the k-th operator at some points, shape (len(rows), size)."""
        source = self.terms.operands[k]
        if not isinstance(source, Program):
            return self._data[source].take(rows, axis=0)
        values = np.empty((len(rows), source.size))
        source.run(self._taken(source.inputs, rows), values)
        return values

    def _taken(self, keys, rows) -> dict[tuple, Array]:
        """Data of some points by key; constants have one row for all points."""
        return {
            key: self._data[key] if key[0] == "constant" else self._data[key].take(rows, axis=0)
            for key in keys
        }

    def run(
        self, programs: Sequence[Program], tangent: bool
    ) -> Iterator[tuple[int, int, list[Array]]]:
        """Run operators and programs, chunk by chunk, in the order of the stencils.

        Yields the range of groups of a chunk and the programs' values at its points. If a law finds
        no stress, the loop ends and `failure` has the point.
        """
        self.failure = None
        terms, s = self.terms, self.part.stencils[0]
        inputs = {key for program in programs for key in program.inputs}
        # some programs, such as dead loads, need no law
        asked = sorted({key[1] for key in inputs if key[0].startswith("operator")})
        plain = [key for key in inputs if not key[0].startswith("operator")]
        known = self._current & set(asked)
        # a law that fails in a chunk leaves the later chunks without new results
        self._current -= set(asked)
        chunks = self._chunks
        if self.sampled:
            chunks = chunks[:: max(len(chunks) // _SAMPLE, 1)]
        for first, last in chunks:
            stages.evaluate.enter()
            try:
                rows = s.order[s.groups[first] : s.groups[last]]
                data = self._taken(plain, rows)
                for k in asked:
                    operator, operand = terms.operators[k], self.operand(k, rows)
                    value = np.empty((rows.size, int(np.prod(operator.ufl_shape))))
                    slope = np.empty((*value.shape, operand.shape[1])) if tangent else None
                    by_mean = None
                    if slope is not None and k in terms.by_mean:
                        data["operator by mean", k] = by_mean = np.empty_like(value)
                    kept = self._kept_in(k, first, last, k in known)
                    bad = self._ask(k, operand, value, slope, rows, by_mean, kept)
                    if bad >= 0:
                        self._fail(operator, int(rows[bad]), operand[bad])
                        return
                    data["operator", k] = value
                    if slope is not None:
                        data["operator tangent", k] = slope
                out: list[Array] = [np.empty((rows.size, program.size)) for program in programs]
                for program, values in zip(programs, out):
                    program.run(data, values)
            finally:
                stages.evaluate.leave()
            yield first, last, out
        if not self.sampled:
            self._current |= {k for k in asked if k in self._kept}

    def _kept_in(
        self, k: int, first: int, last: int, known: bool, again: bool = False
    ) -> KeptTangents | None:
        """Intermediate results of the k-th operator's law at some groups' points, or None.

        Args:
            k: Number of the operator.
            first, last: Range of the groups.
            known: Whether the results are known already.
            again: Whether they are read again, though no tangent has been asked for so far.
        """
        s = self.part.stencils[0]
        # a cached property: explicit steps never ask for a tangent
        wanted = known or again or self.keeps or "tangent" in vars(self.terms)
        if not (wanted and self._keeps[k]):
            return None
        if k not in self._kept:
            self._kept[k] = np.empty((s.order.size, self._keeps[k]))
        return KeptTangents(self._kept[k][s.groups[first] : s.groups[last]], known)

    def _ask(self, k: int, operand, value, slope, rows, by_mean, kept: KeptTangents | None) -> int:
        """Evaluate the k-th operator at some points; it is zero at points of other laws.

        Returns the first point that fails, or -1.
        """
        operator = self.terms.operators[k]
        law: Any = operator.law
        own = None
        if operator.tags is not None:
            own = np.isin(self._points["tag"][rows], operator.tags)
        if own is None or own.all():
            return law.evaluate(operand, value, slope, rows, **_asked(kept, by_mean))
        mine = np.flatnonzero(own)
        whole = value, slope, by_mean
        part = [None if a is None else np.empty((mine.size, *a.shape[1:])) for a in whole]
        of_mine = _taken_of(kept, mine)
        asked = _asked(of_mine, part[2])
        bad = law.evaluate(operand[mine], part[0], part[1], rows[mine], **asked)
        if kept is not None and of_mine is not None and not kept.known:
            kept.values[mine] = of_mine.values
        for a, values in zip(whole, part):
            if a is not None:
                a[:] = 0.0
                a[mine] = values
        return int(mine[bad]) if bad >= 0 else -1

    def _fail(self, operator: PointOperator, point: int, operand: Array) -> None:
        describe = getattr(operator.law, "describe", None)
        cause = "" if describe is None else describe(operand, point)
        self.failure = PointFailure(point, cause)

    def add_flux(self, program: Program | None, out: Sequence[Array]) -> None:
        """Add the nodal forces of a program's fluxes.

        Args:
            program: Program of the fluxes, or None for no fluxes.
            out: Nodal forces (N) of each field, shape (nodes, components).
        """
        self.failure = None
        if program is None:
            return
        for first, last, (flux,) in self.run([program], False):
            for s, column, nodal in zip(self.part.stencils, self._columns, out):
                add_vector(s, first, last, flux, column, nodal)

    def add_tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """Add the tangent at the last increments.

        Args:
            entries: The matrix under assembly, by (row field, column field).
        """
        terms, couplings = self.terms, self.part.couplings
        pairs = list(terms.tangent)
        means = list(terms.by_mean)
        if not pairs:
            return
        both = list(zip(couplings or (), self._unknowns.fields))
        left = {k: [c.forces(f.components) for c, f in both] for k in means}
        programs = [terms.tangent[pair].program for pair in pairs]
        programs += [terms.by_mean[k] for k in means]
        for first, last, values in self.run(programs, True):
            for (i, j), value in zip(pairs, values):
                block = terms.tangent[i, j]
                slope = Slope(value, block.row_value, block.value)
                s = self.part.stencils
                add_stiffness(s[i], s[j], first, last, slope, entries[i, j])
            for k, flux in zip(means, values[len(pairs) :]):
                assert couplings is not None
                for c, column, out in zip(couplings, self._columns, left[k]):
                    c.add_forces(first, last, flux, column, out)
        for k in means:
            assert couplings is not None
            field = terms.field_of(k)
            assert field is not None
            right = self._mean_slope(k, field)
            for i, force in enumerate(left[k]):
                to = entries[i, field]
                add_outer(
                    couplings[i], couplings[field], force, right, (to.rows, to.columns), to.pattern,
                    to.data, to.prescribed, to.lift,
                )  # fmt: skip

    def _mean_slope(self, k: int, field: int) -> Array:
        """Derivatives of the k-th operator's sums over cells by the nodal increments of a field."""
        assert self.part.couplings is not None
        s, coupling = self.part.stencils[field], self.part.couplings[field]
        d, components = self._points.gdim, self._unknowns.fields[field].components
        slopes = self.averaging(k).measure_slope(self.operand(k, s.order))
        slopes *= coupling.averages.weight[s.order, None]
        flux = np.zeros((len(slopes), components, 1 + d))
        # the explicit size serves ranks without points, where -1 does not work
        flat = flux.reshape(len(flux), components * (1 + d))
        program = self.terms.mean_flux.get(k)
        if program is None:
            flux[:, :, 1:] = slopes.reshape(len(slopes), components, d)
        else:
            own = "mean slope", k
            data = self._taken([key for key in program.inputs if key != own], s.order)
            program.run({**data, own: slopes}, flat)
        out = coupling.forces(components)
        coupling.add_forces(0, s.groups.size - 1, flat, 0, out)
        return out

    def ask(self, k: int, out: Array) -> None:
        """Write the value of the k-th operator at the region's points.

        Args:
            k: Number of the operator.
            out: Written at the region's points, shape (points, size); NaN if the law finds no
                stress.
        """
        rows = np.sort(self.part.stencils[0].order)
        value = np.empty((rows.size, out.shape[1]))
        if self._ask(k, self.operand(k, rows), value, None, rows, None, None) >= 0:
            value[:] = np.nan
        out[rows] = value

    def moduli(self, out: Array) -> None:
        """Write the moduli M and G of the laws' tangents (Pa), shape (points, 2)."""
        s, points, d = self.part.stencils[0], self._points, self._points.strain_dim
        # stresses of laws, and not their derivatives
        laws = [o.declaration and o.declaration.operator for o in self.terms.operators]
        chosen = [k for k, o in enumerate(self.terms.operators) if o is laws[k]]
        # one array for all chunks: memory that the system gives anew would take time
        largest = max((s.groups[b] - s.groups[a] for a, b in self._chunks), default=0)
        slopes = np.empty((largest, d * d, d * d))
        for k in chosen:
            known = k in self._current
            for first, last in self._chunks:
                rows = s.order[s.groups[first] : s.groups[last]]
                operand = self.operand(k, rows)
                value, slope = np.empty((rows.size, d * d)), slopes[: rows.size]
                by_mean = np.empty_like(value) if k in self.terms.by_mean else None
                # the end of the step reads them
                kept = self._kept_in(k, first, last, known, again=True)
                if self._ask(k, operand, value, slope, rows, by_mean, kept) >= 0:
                    # the end of the step reports the failure
                    return
                if by_mean is not None:
                    # tangent for a deformation that is the same in the whole cell
                    slope += by_mean[:, :, None] * self.averaging(k).measure_slope(operand)[:, None]
                add_isotropic_moduli(slope, points["V0"][rows] / points["V"][rows], rows, out)
            self._current |= {k} & self._kept.keys()

    def add_end_state(self, new: dict[str, Array]) -> None:
        """Write the laws' fields at the end of the step into new arrays.

        Args:
            new: New arrays of fields by name; extended.
        """
        self.failure = None
        s, points = self.part.stencils[0], self._points
        chunks = self._chunks or [(0, 0)]  # a rank without points needs the fields too
        for k, operator in enumerate(self.terms.operators):
            law: Any = operator.law
            whole = operator.tags is None and s.order.size == len(points)
            for first, last in chunks:
                rows = s.order[s.groups[first] : s.groups[last]]
                kept = self._kept_in(k, first, last, True) if k in self._current else None
                if operator.tags is not None:
                    mine = np.flatnonzero(np.isin(points["tag"][rows], operator.tags))
                    rows, kept = rows[mine], _taken_of(kept, mine)
                operand = self.operand(k, rows)
                found = law.commit(operand, rows, **_asked(kept, None))
                for name, values in found.items():
                    if name not in new:
                        shape = len(points), *values.shape[1:]
                        new[name] = np.empty(shape) if whole else points[name].copy()
                    new[name][rows] = values
                    if self.failure is None and not np.isfinite(values).all():
                        finite = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
                        bad = int(np.argmin(finite))
                        self._fail(operator, int(rows[bad]), operand[bad])
        # the state of the points may change after this
        self._current.clear()
        self._kept.clear()


def _chunks_of(groups: npt.NDArray[np.integer]) -> list[tuple[int, int]]:
    """Ranges of groups with some thousand points each."""
    chunks, first = [], 0
    while first < groups.size - 1:
        last = int(np.searchsorted(groups, groups[first] + _CHUNK, side="right")) - 1
        last = max(last, first + 1)
        chunks.append((first, last))
        first = last
    return chunks


def _asked(kept: KeptTangents | None, by_mean: Array | None) -> dict[str, Any]:
    """Keywords of a call of a law; laws that keep nothing, or take no means, do not know them."""
    given = {"kept": kept, "by_mean": by_mean}
    return {name: value for name, value in given.items() if value is not None}


def _taken_of(kept: KeptTangents | None, rows: npt.NDArray[np.integer]) -> KeptTangents | None:
    """Copy of the kept results at some of the points."""
    return None if kept is None else KeptTangents(kept.values[rows], kept.known)

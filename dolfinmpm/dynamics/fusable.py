"""Forms supported by the fused loops, and their data for the loops."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from ufl.algorithms import extract_arguments
from ufl.constantvalue import Zero

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.body.points import MOTION, MaterialPoints
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.dynamics.explicitbase import Settings
from dolfinmpm.dynamics.fusedneohookean import stored_energy
from dolfinmpm.dynamics.fusedumat import UmatCalls, variables_of
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import JAUMANN, LAW, NEO, SMALL
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.forms.termqueries import depends_on, summands, term_of
from dolfinmpm.grid.constants import is_own
from dolfinmpm.kinematics.fbar import VOLUMES
from dolfinmpm.kinematics.incremental import Incremental
from dolfinmpm.materials.base import lame
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.materials.umat import UMAT
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["FusedLoads", "Laws", "why_not"]

Array = npt.NDArray[np.float64]
# Fields that a step changes: a load that depends on them is evaluated in every step
_FIXED = ("density", "V0", "x0", "l0")
# Fields that loads depend on
_OF_LOADS = frozenset((*_FIXED, "tag"))


def why_not(
    form: WeakForm,
    field: Any,
    mass: str,
    settings: Settings,
    held: EssentialConditions,
    options: dict[str, Any],
) -> str | None:
    """Reason why the fused loops do not support a problem, or None.

    Args:
        form: The weak form.
        field: Its field.
        mass: Kind of the mass.
        settings: Settings of the steps.
        held: Essential conditions.
        options: Other arguments of the problem.
    """
    if not isinstance(field.space.basis, LatticeBasis):
        return "the grid is not rectangular"
    if field.space.refinement is not None:
        return "the space is refined"
    if mass != "lumped":
        return "the mass is consistent"
    if not settings.plain:
        return "bulk viscosity or filters of light nodes act"
    if held.follows:
        return "a condition follows the body (follows=True)"
    tied = field.stabilisation.constrains_nodes or options.get("prolongation")
    if tied or options.get("updates"):
        return "constraints act between nodes, or a step updates fields"
    if settings.mapping.kind not in ("flip", "pic", "apic", "tpic"):
        return "the mapping filters velocities at the nodes"
    reason = _why_not_the_form(form)
    if reason is not None:
        return reason
    loads = FusedLoads(form)
    if not loads.known or loads.varies:
        return "loads depend on functions of the grid, or on fields that a step changes"
    return None


def _why_not_the_form(form: WeakForm) -> str | None:
    """Reason why the fused loops do not support a form, or None."""
    points, declarations = form.points, form.parts.declarations
    space = form.spaces[0]
    if points.gdim == 1:
        return "the loops are for two and three dimensions"
    if points.axisymmetric:
        return "axisymmetric points"
    if space.configuration == "total":
        return "the configuration is total Lagrangian"
    if space.coarsen > 1:
        return "the field has coarser cells than the grid"
    if any(one is not None for one in form.parts.grid.external):
        return "loads over cells or facets of the grid"
    kinds = {_kind(d) for d in declarations}
    if len(kinds) != 1 or None in kinds:
        return "laws have several strain formulations, or an unsupported one"
    published = [d for d in declarations if isinstance(d.law, UMAT)]
    if published and len(published) < len(declarations):
        return "some laws are UMATs, and others are not"
    if published and declarations[0].fbar:
        return "F-bar acts on UMATs"
    if any(d.fbar for d in declarations) and (len(declarations) > 1 or declarations[0].tags):
        return "F-bar acts in laws by tags"
    if any(d.fbar == VOLUMES for d in declarations):
        return "the points keep the mean volumes of F-bar"
    if any(d.u is not space.increment for d in declarations):
        return "a law has another increment"
    if _kind(declarations[0]) == NEO and any(d.law.varies for d in declarations):
        return "the parameters of a neo-Hookean law vary"
    if form.boundaries:
        return "terms over boundaries that do not fit the grid"
    strange = next((term for term in form.parts.terms if not term.fusable), None)
    if strange is not None:
        return f"the loops do not support the term {strange!r}"
    own = [term for d in declarations for term in d.terms]
    for integral in form.given.integrals():
        if term_of(integral) or any(integral.integrand() is term for term in own):
            continue
        inside = (integral.metadata() or {}).get("points")
        for term in summands(integral.integrand()):
            if inside is None or isinstance(term, Zero):
                # penalties on the increment vanish at zero increments
                continue
            if inside != points.number or depends_on(term, [space.increment]):
                return "terms of the points other than momentum and loads"
            if len(extract_arguments(term)) != 1:
                return "terms without a test function"
    return None


def _kind(declaration: Declaration) -> int | None:
    if isinstance(declaration.law, NeoHookean):
        return NEO
    return {"large": LAW, "small": SMALL, "jaumann": JAUMANN}.get(declaration.strain)


class Laws:
    """The laws of a form in the layout of the fused loops.

    Args:
        points: Material points.
        declarations: Declarations of laws in the form.

    Attributes:
        kind: Kind of the strain formulation, see `dolfinmpm.dynamics.passes`.
        state: Name of the field of elastic strain; empty if the law uses F.
        fbar: Whether points share changes of volume, or "centres"; see `Declaration`.
        internal: Internal variables side by side, shape (n, variables).
        table: Addresses of the laws, their parameters, whether parameters vary over points, and
            the law of each point.
        calls: Data of the calls of UMATs, or None for other laws.
    """

    table: tuple[Any, ...]
    internal: Array
    calls: UmatCalls | None = None

    def __init__(self, points: MaterialPoints, declarations: Sequence[Declaration]):
        self._points, self._declarations = points, list(declarations)
        kind = _kind(self._declarations[0])
        assert kind is not None
        self.kind, self._stored = kind, 0.0
        self._revision, self._marked = -1, False
        # revision of the state that the known stored energy belongs to
        self._stored_of: tuple[int, bytes] | None = None
        self._published = isinstance(self._declarations[0].law, UMAT)
        self.state = {LAW: "be", NEO: ""}.get(kind, "elastic_strain")
        if self._published:
            self.state = Incremental.state
        self.fbar = self._declarations[0].fbar

    def gather(self, touched: Set[str]) -> None:
        """Read the present parameters and internal variables of the points. Collective.

        Args:
            touched: Fields that may have changed since the last call, on any rank.
        """
        points, n = self._points, len(self._points)
        laws = self._declarations
        if self._revision == points.revision and touched <= MOTION:
            self._gather_again()
            return
        self._revision, self._marked = points.revision, False
        for d in laws:
            d.bind()
        addresses = np.zeros(len(laws), np.intp)
        if self.kind == NEO:
            numbers = np.array([lame(d.law.E, d.law.nu) for d in laws])
        elif self._published:
            addresses[:] = [d.law.address for d in laws]
            numbers = _rows([d.law.properties for d in laws])
            self.calls = UmatCalls.of(points, laws)
        else:
            addresses[:] = [d.law.stress_address for d in laws]
            numbers = self._parameters()
        which = np.zeros(1, np.uint8)
        if len(laws) > 1:
            which = np.zeros(n, np.uint8)
            for k, d in enumerate(laws):
                which[d.rows] = k
        by_points = any(d.law.varies for d in laws)
        self.table = addresses, numbers, by_points, which
        names = [] if self.kind == NEO else [list(d.law.internal) for d in laws]
        if self._published:
            names = [variables_of(d) for d in laws]
        width = max((len(own) for own in names), default=0)
        self._names = names
        if len(laws) == 1 and width == 1:
            # a single variable of a single law already has the layout of the loop
            self.internal = points[names[0][0]].reshape(-1, 1)
            return
        self.internal = np.zeros((n, width))
        for d, own in zip(laws, names):
            for k, name in enumerate(own):
                self.internal[d.rows, k] = points[name][d.rows]

    def _gather_again(self) -> None:
        """Read data that may have changed without a change of the laws' fields."""
        laws = self._declarations
        if self.kind == NEO:
            addresses, _, *others = self.table
            numbers = np.array([lame(d.law.E, d.law.nu) for d in laws])
            self.table = addresses, numbers, *others
        elif len(laws) == 1 and len(self._names[0]) == 1:
            self.internal = self._points[self._names[0][0]].reshape(-1, 1)

    def release(self) -> None:
        """Release references to the fields' arrays."""
        if len(self._declarations) == 1 and self.internal.shape[1] == 1:
            self.internal = np.empty((0, 1))

    def scatter(self) -> None:
        """Write the internal variables to the points' fields, and mark changed fields."""
        if not self._marked:
            marks = self._points.fields.read("moved_under")
            for d in self._declarations:
                marks[d.rows] = d.mark
            self._marked = True
        if len(self._declarations) == 1 and self.internal.shape[1] == 1:
            return
        for d, own in zip(self._declarations, self._names):
            for k, name in enumerate(own):
                self._points[name][d.rows] = self.internal[d.rows, k]

    def gained(self) -> float:
        """Energy stored by neo-Hookean points since the last call (J), on this rank."""
        _, numbers, _, which = self.table
        fields = self._points.fields
        now = stored_energy(fields.read("F"), fields.read("V0"), numbers, which)
        before, self._stored = self._stored, now
        self._stored_of = self._points.revision, numbers.tobytes()
        return now - before

    def start(self, touched: Set[str]) -> None:
        """Read the present state of the points and their stored energy. Collective.

        Args:
            touched: See `gather`.
        """
        self.gather(touched)
        if self.kind == NEO:
            now = self._points.revision, self.table[1].tobytes()
            if self._stored_of != now or touched & {"F", "V0"}:
                self.gained()

    def _parameters(self) -> Array:
        laws, n = self._declarations, len(self._points)
        # kernels also need parameters derived from the declared ones
        values = [d.parameters() for d in laws]
        if not any(d.law.varies for d in laws):
            return _rows([own[0] for own in values])
        width = max(own.shape[1] for own in values)
        numbers = np.zeros((n, width))
        for d, own in zip(laws, values):
            numbers[d.rows, : own.shape[1]] = own
        return numbers


def _rows(values: Sequence[Array]) -> Array:
    """Rows of different lengths, with zeros behind the shorter ones."""
    result = np.zeros((len(values), max(own.size for own in values)))
    for row, own in zip(result, values):
        row[: own.size] = own
    return result


class FusedLoads:
    """Loads of a form as forces at the points.

    Args:
        form: The weak form.

    Attributes:
        uniform: Whether the loads are the same acceleration at all points.
        gravity: This acceleration (m/s²), shape (d,); zeros if loads are not uniform.
        body: Forces on the points (N), shape (n, d), or (0, d) if loads are uniform.
        varies: Whether the loads depend on fields that a step changes.
    """

    uniform: bool
    gravity: Array
    body: Array

    def __init__(self, form: WeakForm):
        self._form, self._revision = form, -1
        programs = [region.external for region in form.regions]
        keys = [key for program in programs if program for key in program.inputs]
        self.known = all(key[0] in ("field", "constant", "tagged") for key in keys)
        self.varies = any(key[0] == "field" and key[1] not in _FIXED for key in keys)
        self._constants = [
            c for region in form.regions for c in region.placeholders.constants if not is_own(c)
        ]
        self._taken = self._values()

    def _values(self) -> list[Array]:
        return [np.array(c.value) for c in self._constants]

    def changed(self) -> bool:
        """Whether constants of the form have changed since the last evaluation."""
        return any(not np.array_equal(a, b) for a, b in zip(self._taken, self._values()))

    def follow(self, touched: Set[str]) -> None:
        """Evaluate the present loads, unless they are unchanged. Collective.

        Args:
            touched: Fields that may have changed since the last evaluation, on any rank.
        """
        still = self._revision == self._form.points.revision and not touched & _OF_LOADS
        if not still or self.changed():
            self.evaluate()

    def evaluate(self) -> None:
        """Evaluate the present loads. Collective."""
        self._taken = self._values()
        points = self._form.points
        self._revision = points.revision
        d, n = points.gdim, len(points)
        forces = np.zeros((n, d))
        for region in self._form.regions:
            chosen = region.chosen(points["tag"])
            # indexing would copy; a slice is a view
            rows: Any = slice(None) if chosen is None else np.flatnonzero(chosen)
            program = region.external
            if program is None:
                continue
            data: dict[tuple, Array] = {}
            for key in program.inputs:
                if key[0] == "field":
                    data[key] = points[key[1]][rows]
                elif key[0] == "tagged":
                    data[key] = np.isin(points["tag"][rows], key[1]).astype(float)
                else:
                    value = region.placeholders.constants[key[1]].value
                    data[key] = np.array(value, float).reshape(1, -1)
            count = n if chosen is None else rows.size
            flux = np.empty((count, program.size))
            program.run(data, flux)
            forces[rows] -= flux.reshape(count, d, 1 + d)[:, :, 0]
        m = point_masses(points)
        # by columns: NumPy's reductions of short rows are ten times slower
        a = [forces[:, k] / m for k in range(d)]
        low = np.array([one.min(initial=np.inf) for one in a])
        high = np.array([one.max(initial=-np.inf) for one in a])
        points.comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
        points.comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
        self.uniform = bool(np.all(high - low <= 1e-14 * np.abs(high).max(initial=0.0)))
        if self.uniform:
            self.gravity, self.body = high, np.empty((0, d))
        else:
            self.gravity, self.body = np.zeros(d), forces

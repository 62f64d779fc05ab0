"""The base of all problems: fields, form, conditions, loads, and their state."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, ClassVar

import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from dolfinmpm._platform import stages
from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm._platform.readonce import ReadList, ReadOnce
from dolfinmpm._platform.uncopied import Uncopied
from dolfinmpm.assembly.state import HasState, gathered, given_back
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.location import use_configuration
from dolfinmpm.body.meshpartition import warn_of_imbalance
from dolfinmpm.body.overlapchecks import check_room
from dolfinmpm.body.pointchecks import check_grid
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.contact.rigidcontact import RigidContact
from dolfinmpm.cut.activate import activate
from dolfinmpm.cut.activation import Activation, Field, Prolongate, movers, with_constraints
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.cut.pattern import KeptCouplings
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.forms.formchecks import check_fields, check_form, check_laws, check_levels
from dolfinmpm.forms.hoop import check_hoops
from dolfinmpm.grid.lattice import times_regridded
from dolfinmpm.solve import setup
from dolfinmpm.solve.adaptation import Adaptation, adapt
from dolfinmpm.solve.arguments import (
    ELSEWHERE,
    as_read,
    check_bcs_and_loads,
    check_conditions,
    check_prolongation,
    check_spaces,
    check_updates,
    increments_of,
    scheme_of,
    stabilisations_of,
)
from dolfinmpm.solve.boundarychecks import check_boundary_conditions
from dolfinmpm.solve.description import summary
from dolfinmpm.solve.loads import Loads, loads_of
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.problemchecks import (
    check_field_tags,
    check_kinds_of_conditions,
    check_times,
    refuse_rates,
    warn_at_start,
)
from dolfinmpm.solve.restart import load, save
from dolfinmpm.solve.scheme import Scheme
from dolfinmpm.solve.step import Step, StepRecord
from dolfinmpm.solve.weakform import WeakForm
from dolfinmpm.terms.referencemarkers import require_reference

__all__ = ["Problem"]


class Problem(Uncopied, ReadOnce):
    """A weak form over points and grid, for steps through time or load.

    Args:
        form, increment, points, bcs, updates, stabilisation, prolongation: See `QuasiStatic`.
        scheme: The scheme of a step: loads, times, equations and the state at the end.

    Attributes:
        scheme: The argument.
        history: One record per step.
        points: The material points.
        fields: The fields, with their spaces and stabilisations.
        form: The compiled weak form.
        bodies: The rigid bodies that the points touch.
        here: The `Activation` of the last step, or None before the first step.
        kept: Couplings for the next sparsity pattern, or None.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        FormError: A term of the form cannot be evaluated in its integral.
        ConflictingConditionsError: Two conditions contradict each other.

    Later assignment to an argument raises a ParameterError, unless steps read the attribute.
    """

    scheme: Scheme
    _attributes = frozenset({"points", "form", "scheme"})
    _hints, _takes_scheme = ELSEWHERE, True  # whether the user may give a scheme
    _elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("energies", "momentum", "angular_momentum", "time"),
        "it is for steps in time: mpm.Newmark, mpm.GeneralisedAlpha and mpm.Explicit",
    )

    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        updates: dict[str, Expr] | None = None,
        stabilisation: setup.Stabilisations = "none",
        prolongation: Prolongate | None = None,
        scheme: Scheme,
    ):
        self.scheme = scheme_of(scheme)
        increments = increments_of(increment, points)
        check_spaces(spaces := [u._dolfinmpm_space for u in increments])
        check_form(form)
        check_laws(form, points)
        check_hoops(form, points)
        check_grid(points)
        read, bcs = as_read(bcs), check_conditions(bcs, spaces)
        check_times(type(self).__name__, scheme.inertia, scheme.in_time, form, points, bcs)
        check_room(points)
        updates = check_updates(updates, points)
        stabilisations = stabilisations_of(stabilisation, len(spaces))
        check_prolongation(prolongation, points, stabilisations)
        self.points = points
        self.history: list[StepRecord] = []
        stabilisations = setup.with_moduli(stabilisations, spaces, form, points)
        self.fields = [Field(*both, prolongation) for both in zip(spaces, stabilisations)]
        if scheme.ties_movers:
            for k in movers(spaces):
                self.fields[k] = with_constraints(self.fields[k])
        whole, soft, changes = setup.with_stabilisations(form, self.fields, points)
        self.form = WeakForm(whole, spaces, points, soft, changes)
        check_fields(form, spaces)
        check_field_tags(self.fields, self.form)
        setup.refuse_held_faces(form, self.form)
        parts = self.form.parts
        check_boundary_conditions(form, self.form.boundaries, parts.declarations, parts.carried)
        rigid = [term for term in self.form.terms if isinstance(term, RigidContact)]
        self.bodies = RigidBodies(rigid)
        self.bodies.check_steps(scheme.in_time, type(self).__name__)
        check_kinds_of_conditions(bcs, spaces, parts.carried)
        if not scheme.inertia:
            check_levels(self.form.parts.carried, 1.0, type(self).__name__)
        self._locate_markers()
        self.here: Activation | None = None
        self.kept: KeptCouplings | None = None
        self.essential_conditions = EssentialConditions(bcs, spaces)
        self.essential_conditions.read = read
        self.form.updates = setup.updates_of(self.form, updates)
        loads = loads_of(self.form.loads)
        check_bcs_and_loads(bcs, loads, self.configuration)
        self.loads = Loads(loads, increments)
        use_configuration(points, self.configuration)
        warn_of_imbalance(points)

    def __new__(cls, *_: Any, **given: Any) -> Problem:  # noqa: D102
        cls._refuse_unknown(given, ELSEWHERE)
        if "scheme" in given and not cls._takes_scheme:
            raise ParameterError(
                f"scheme = {shown(given['scheme'])}: {cls.__name__} has a scheme of its own; leave "
                "it out, or give it to QuasiStatic"
            )
        return super().__new__(cls)

    def __str__(self) -> str:
        """Fields, bases, stabilisation, laws, terms, conditions, scheme and solver, in lines."""
        return summary(self)

    def _repr_html_(self) -> str:
        """The same lines, for notebooks."""
        return f"<pre>{escape(summary(self))}</pre>"

    def scheme_lines(self) -> list[str]:
        """Lines of the summary on scheme and solver."""
        return self.scheme.summary()

    def _instead(self, name: str) -> str:
        """See `ReadOnce`."""
        return (
            f"make a new {type(self).__name__} of the same points with {name}=..., which goes on "
            "from their state; what steps are to change are values of dolfinx.fem.Constant"
        )

    def _locate_markers(self) -> None:
        """Assign markers to the cells of their positions in the problem. Collective."""
        if self.configuration == "total":
            require_reference(self.form.boundaries, [t for t in self.form.terms if t.sides])
            return
        for of in self.form.boundaries:
            use_configuration(of.boundary.markers, self.configuration)

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the points."""
        return self.points.comm

    @property
    def bcs(self) -> Sequence[Condition]:
        """The essential conditions; read-only."""
        return ReadList(self.essential_conditions.conditions)

    @property
    def stabilisation(self) -> Stabilisation | list[Stabilisation]:
        """The stabilisation with all its parameters; for several fields a list."""
        stabilisations = [field.stabilisation for field in self.fields]
        return stabilisations if len(stabilisations) > 1 else stabilisations[0]

    @property
    def configuration(self) -> str:
        """Configuration of stencils and gradients: "updated" or "total"."""
        return self.fields[0].space.configuration

    @property
    def blocks_from(self) -> float:
        """Number of unknowns from which they are stored in blocks, see `Unknowns`."""
        return math.inf

    @property
    def moves(self) -> bool:
        """Whether the points move, with the first field or with the fields of their tags."""
        spaces = [field.space for field in self.fields]
        first = next(iter(movers(spaces)), 0)
        return spaces[first].increment.ufl_shape == (self.points.gdim,)

    @collective
    @stages.output
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint for a restart, one archive of NumPy (.npz). Collective.

        A complete new file replaces an old file of this name. So a run killed at any time leaves a
        file that `load` reads. Call it between steps. Values set by the user since the last step
        are not in the file.

        Args:
            path: File to write, in an existing folder.

        Raises:
            ParameterError: The path is invalid.
            CheckpointError: The file cannot be written.
        """
        save(self, file_path("path", path))

    @collective
    def load(self, path: str | os.PathLike[str]) -> None:
        """Restart from a checkpoint of `save`, on any number of ranks. Collective.

        Build the same problem first: grid, points with their fields and laws, form and
        conditions. After the call points, loads and `history` are those of the file. So a script
        continues with `for k in range(len(problem.history), steps)`. The constants and functions
        of the form, and the constants of the conditions, have their saved values. Set different
        values after this call. Increments are zero until the next step.

        A next stage may have other parameters of laws, other bases, levels of leaves,
        stabilisations and conditions.
        A `DifferentProblemWarning` lists the differences.

        A restarted run gives the same figures as an uninterrupted run. On one rank they are equal
        bit for bit. They are so on several ranks, too, under two conditions: ranks and
        distribution of the grid are the same, and the linear solver is deterministic. (MUMPS on
        several ranks is not, nor are iterations whose preconditioner is kept by measured times.)
        Otherwise the figures are equal to the tolerance of Newton's method: on another number of
        ranks, and for fields on leaves, its first guess is not restored.

        A file of a total Lagrangian problem may be loaded into an updated Lagrangian problem.

        Args:
            path: The file.

        Raises:
            ParameterError: The path is invalid.
            CheckpointError: The file is missing, cut short, damaged, of a newer version, of
                another grid or of another problem. The state is then unchanged.
        """
        load(self, file_path("path", path))

    def keeping(self) -> list[tuple[str, HasState]]:
        """Objects with a state from step to step, besides the points, with their names."""
        refinements = [s.refinement for s in self.form.spaces if s.refinement is not None]
        once = {id(refinement): refinement for refinement in refinements}
        return [
            ("loads", self.loads),
            ("prescribed", self.essential_conditions),
            *self.form.named_terms(),
            # the account of energies tells the bodies what has changed between steps
            ("scheme", self.scheme),
            ("bodies", self.bodies),
            *((f"leaves {k}", refinement) for k, refinement in enumerate(once.values())),
        ]

    @collective
    def state(self) -> dict[str, Any]:
        """The state from step to step besides the points' fields, by name. Collective.

        It serves checkpoints, and studies that go back to a state; see `dolfinmpm.assembly.state`.
        A failed substep needs no state: nothing is written before a substep has converged.
        """
        return gathered(self.keeping())

    @collective
    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`, on any number of ranks. Collective."""
        given_back(self.keeping(), values)
        self.here = None

    @collective
    @stages.activate
    def activate(self, step: Step | None = None) -> Activation:
        """The activation for a step from the present positions of the points. Collective.

        Args:
            step: The step or substep; by default a whole step.
        """
        share = 1.0 if step is None else step.share
        if step is not None:
            self.points.interval = step.t - step.dt, step.dt
        if step is not None and self.here is None and not self.scheme.in_time:
            refuse_rates(self.form.given, self.points, type(self).__name__)
        self.form.bind()
        if any(field.space.tags is not None for field in self.fields):
            check_field_tags(self.fields, self.form)
        for boundary in self.form.boundaries:
            boundary.place()
        if self.essential_conditions.follows:
            self.essential_conditions.follow()
        first = self.here is None
        # couplings of a checkpoint serve one activation
        kept, self.kept = self.kept, None
        self.here = activate(
            self.points, self.fields, self.essential_conditions, self.form, share, self.here, kept,
            self.blocks_from if step is not None else math.inf,
        )  # fmt: skip
        if self.form.boundaries:
            self._set_penalties(self.here)
        if first and kept is None:
            warn_at_start(self, step is not None)
        return self.here

    def _set_penalties(self, here: Activation) -> None:
        """Set the penalties of weak conditions at boundaries. Collective."""
        self.form.set_penalties(here)

    @collective
    def adapt(self) -> Adaptation:
        """Let leaves of refined spaces, and points, follow the sizes wanted now. Collective.

        Points split where their domains are larger than their part of the leaf at their centre.
        Siblings merge where leaves are larger again and the siblings are alike. Sums stay, see
        `dolfinmpm.split`. Every call of `step` begins with it.
        """
        return adapt(self)

    def _check_still_valid(self) -> None:
        """Check that no other problem has moved bodies or grid lines, and reserve the bodies.

        Raises:
            ParameterError: Another problem has moved a rigid body, or the grid's lines.
        """
        if self.bodies.all:
            self.bodies.take()
        if times_regridded(self.points.grid) != self.form.placed:
            raise ParameterError(
                "mpm.regrid has placed the grid's lines anew for another problem, and this one has "
                f"kept where they were: make a new Space and a new {type(self).__name__} of its "
                "points, or give it a grid of its own"
            )
        check_grid(self.points)

    def regrid(self) -> None:
        """Discard data that depend on the old grid lines; see `regrid`."""
        self.form.regrid()
        self.scheme.regrid()
        self.here = self.kept = None

    @collective
    def operator(self) -> Operator:
        """The weak form in the present state: residual, tangent, external forces. Collective."""
        return Operator(self.form, self.activate())

    @collective
    def stiffness(self) -> PETSc.Mat:
        """Tangent stiffness of the active unknowns in the present state. Collective."""
        operator = self.operator()
        operator.move_to_zero()
        matrix = Matrix(operator.here.pattern, operator.here.unknowns)
        operator.tangent(matrix)
        return matrix.petsc

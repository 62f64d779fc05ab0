"""What all problems have in common: fields, form, conditions, loads and what is kept of them."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr

from dolfinmpm._platform import stages
from dolfinmpm._platform.checks import file_path
from dolfinmpm._platform.errors import (
    CheckpointError,
    FormError,
    ParameterError,
    raise_together,
)
from dolfinmpm._platform.given import ReadList, ReadOnce
from dolfinmpm._platform.together import together
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.heldmotions import warn_idle
from dolfinmpm.body.meshparts import warn_of_imbalance
from dolfinmpm.body.migration import settle
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.room import check_room
from dolfinmpm.contact.bodies import Bodies
from dolfinmpm.cut.activation import activate, active_on_grid
from dolfinmpm.cut.couplings import KeptCouplings
from dolfinmpm.cut.held import Held
from dolfinmpm.cut.participants import Activation, Field, Prolongate, movers, with_ties
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.forms.formchecks import check_fields, check_form, check_levels
from dolfinmpm.forms.hoop import check_hoops
from dolfinmpm.grid.graded import times_regridded
from dolfinmpm.io import checkpoint
from dolfinmpm.solve.arguments import (
    ELSEWHERE,
    check_callable,
    check_conditions,
    check_grid,
    check_spaces,
    check_updates,
    increments_of,
    stabilisations_of,
)
from dolfinmpm.solve.axis import warn_of_free_axis
from dolfinmpm.solve.bodyfields import check_bodies
from dolfinmpm.solve.boundaries import memory_of_markers, order_of_markers, set_markers
from dolfinmpm.solve.conflicts import check_boundaries_of
from dolfinmpm.solve.description import describe, warn_of_differences
from dolfinmpm.solve.loads import Loads, loads_of
from dolfinmpm.solve.memory import saved_loads, set_loads
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.pressures import refuse_increments
from dolfinmpm.solve.referencemarkers import needed_of, require_reference
from dolfinmpm.solve.setup import Stabilisations, updates_of, with_moduli, with_stabilisations
from dolfinmpm.solve.step import Step, StepRecord
from dolfinmpm.solve.summary import summary
from dolfinmpm.solve.timeless import check_timeless
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Problem"]


class Problem(ReadOnce):
    """A weak form over points and grid, with what it takes to step through time or load.

    Args:
        form, increment, points, bcs, updates, stabilisation, prolongation: See `QuasiStatic`.

    Attributes:
        history: One record per step.
        points: The material points.
        fields: The fields, with their spaces and stabilisations.
        form: The weak form, made ready.
        here: What took part in the last step, or None before the first.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: A term of the form cannot be evaluated where it stands.
        ConflictingConditionsError: Two conditions contradict each other.

    An argument that is assigned to later ends in a ParameterError, unless steps look at it.
    """

    _of_step: type[StepRecord] = StepRecord
    # whether steps have a length in seconds, and whether forces balance with inertia at their level
    _in_time = False
    _has_inertia = False
    # whether nodes that move points are tied where the points hardly support them
    _ties_movers = False
    _attributes = frozenset({"points", "form"})
    _elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("energies", "momentum", "angular_momentum", "time"),
        "it is of steps in time, mpm.Newmark, mpm.GeneralisedAlpha and mpm.Explicit",
    )

    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        updates: dict[str, Expr] | None = None,
        stabilisation: Stabilisations = "none",
        prolongation: Prolongate | None = None,
    ):
        increments = increments_of(increment, points)
        spaces = [u._dolfinmpm_space for u in increments]
        check_spaces(spaces)
        check_form(form)
        check_hoops(form, points)
        if not self._has_inertia and points.inertia in extract_constants(form):
            raise FormError(
                f"the form has the acceleration of the body, and {type(self).__name__} has no "
                "inertial forces at the end of a step that would tell it: take Newmark or "
                "GeneralisedAlpha, or leave it out, mpm.poromechanics(..., inertia=False)"
            )
        check_grid(points)
        bcs = check_conditions(bcs, spaces)
        for condition in bcs:
            if condition.velocity is not None and not self._in_time:
                raise ParameterError(
                    f"the condition at '{condition.where}' prescribes a velocity, and "
                    f"{type(self).__name__} knows no time; prescribe increments with "
                    "mpm.prescribed, or take Newmark, GeneralisedAlpha or Explicit"
                )
        check_room(points)
        updates = check_updates(updates, points)
        stabilisations = stabilisations_of(stabilisation, len(spaces))
        check_callable("prolongation", prolongation)
        self.points = points
        self.history: list[StepRecord] = []
        stabilisations = with_moduli(stabilisations, spaces, form, points)
        self.fields = [Field(*both, prolongation) for both in zip(spaces, stabilisations)]
        if self._ties_movers:
            for k in movers(spaces):
                self.fields[k] = with_ties(self.fields[k])
        whole, soft, changes = with_stabilisations(form, self.fields, points)
        self.form = WeakForm(whole, spaces, points, soft, changes)
        check_fields(form, spaces)
        check_bodies(self.fields, self.form)
        check_boundaries_of(self.form.boundaries, self.form.parts.declarations)
        refuse_increments(bcs, self.form.parts.carried)
        if not self._has_inertia:
            check_levels(self.form.parts.carried, 1.0, type(self).__name__)
        self._settle_markers()
        self.here: Activation | None = None
        self._kept: KeptCouplings | None = None
        self._held = Held(bcs, spaces)
        if self._held.follows and self.configuration == "total":
            raise ParameterError(
                'conditions with follows=True need Space(..., configuration="updated"), got '
                '"total": what is active at first positions stays'
            )
        self._updates = updates_of(self.form, updates)
        loads = loads_of(self.form.loads)
        for condition in self.bcs:
            if any(condition.value is load for load in loads):
                raise ParameterError(
                    f"a constant is both a load of the form and the increment prescribed at "
                    f"'{condition.where}'; a part of a step would scale it twice: use two constants"
                )
        self._loads = Loads(loads, increments)
        settle(points, self.configuration)
        warn_of_imbalance(points)

    def __new__(cls, *_: Any, **given: Any) -> Problem:  # noqa: D102
        cls._refuse_unknown(given, ELSEWHERE)
        return super().__new__(cls)

    def __str__(self) -> str:
        """Fields, bases, stabilisation, laws, terms, conditions, scheme and solver, in lines."""
        return summary(self)

    def _scheme(self) -> list[str]:
        """Lines of the summary on scheme and solver."""
        return []

    def _instead(self, name: str) -> str:
        """See `ReadOnce`."""
        return (
            f"make a new {type(self).__name__} of the same points with {name}=..., which goes on "
            "from their state; what steps are to change are values of dolfinx.fem.Constant"
        )

    def _settle_markers(self) -> None:
        """Bring boundaries to the cells of the positions that the problem sees. Collective."""
        if self.configuration == "total":
            require_reference(self.form.boundaries, self.form.parts.between)
            return
        for of in self.form.boundaries:
            settle(of.boundary.markers, self.configuration)

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the points."""
        return self.points.comm

    @property
    def bodies(self) -> Bodies:
        """The rigid bodies that the points touch."""
        return self.form.bodies

    @property
    def bcs(self) -> Sequence[Condition]:
        """The essential conditions, which stay as they are."""
        return ReadList(self._held.conditions)

    @property
    def stabilisation(self) -> Stabilisation | list[Stabilisation]:
        """The stabilisation with all its parameters, a list of several fields' ones."""
        stabilisations = [field.stabilisation for field in self.fields]
        return stabilisations if len(stabilisations) > 1 else stabilisations[0]

    @property
    def configuration(self) -> str:
        """Configuration that stencils and gradients are taken in."""
        return self.fields[0].space.configuration

    @property
    def _moves(self) -> bool:
        """Whether the points move with the first field, or with those of their tags."""
        spaces = [field.space for field in self.fields]
        first = next(iter(movers(spaces)), 0)
        return spaces[first].increment.ufl_shape == (self.points.gdim,)

    @together
    @stages.output
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all that it takes to go on from here into one archive of NumPy (.npz). Collective.

        The file is written beside the one of that name, and takes its place when it is
        whole: a run that is killed at any time leaves one that `load` reads. Save between
        steps; what the user has set since the last one is not in the file.

        Args:
            path: File to write, in a folder that is there.

        Raises:
            ParameterError: It is no path.
            CheckpointError: The file cannot be written.
        """
        path = file_path("path", path)
        state, local, cells = self._memory()
        history = [dataclasses.asdict(record) for record in self.history]
        state["description"] = [list(pair) for pair in self._description().items()]
        checkpoint.write(path, self.points, state, local, history, cells, self._laws)

    @together
    def load(self, path: str | os.PathLike[str]) -> None:
        """Go on from where `save` was called, on any number of ranks. Collective.

        Build the same problem first: grid, points with their fields and laws, form and
        conditions. Points, loads and `history` are then those of the file, so that a script
        goes on with `for k in range(len(problem.history), steps)`. The constants and
        functions of the form, and the constants of the conditions, hold what they held in
        the saved state: set what is to differ after this call.
        Increments are zero until the next step.

        A next stage may have other parameters of laws, other bases, stabilisations and conditions;
        a `DifferentProblemWarning` lists what differs.

        A run that goes on gives the same figures as one that was not interrupted: bit for
        bit on one rank, and on as many ranks as before if the grid is distributed as it
        was and the linear solver repeats itself (MUMPS on several ranks does not, nor do
        iterations whose preconditioner is kept by measured times); else to
        rounding. A file of a total Lagrangian problem may be loaded into an updated one.

        Args:
            path: The file.

        Raises:
            ParameterError: It is no path.
            CheckpointError: The file is missing, cut short, damaged, of a newer version, of
                another grid or of another problem. The state is then
                what it was.
        """
        path = file_path("path", path)
        found = checkpoint.read(path, self.points, self._laws)
        raise_together(self.comm, self._mismatch(os.fspath(path), found.state))
        before = dict(found.state.get("description", ()))
        warn_of_differences(self.comm, os.fspath(path), before, self._description())
        found.put(self.points)
        self._remember(found.state, found.local, found.cells)
        names = {f.name for f in dataclasses.fields(self._of_step)}
        self.history = [
            self._of_step(**{k: v for k, v in row.items() if k in names}) for row in found.history
        ]

    def _description(self) -> dict[str, str]:
        """What the problem is, in words, of which a next stage may change some. Collective."""
        return describe(self.fields, self.form, self.bcs)

    @property
    def _laws(self) -> list[str]:
        """Laws with their measures of strain; a next stage may have other parameters."""
        declared = self.form.parts.declarations
        return sorted({f"{type(d.law).__name__} under {d.strain} strain" for d in declared})

    def _problem(self) -> dict[str, Any]:
        """What a checkpoint must have in common with this problem."""
        constants = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        return {
            "solver": type(self).__name__,
            "unknown fields": str([space.increment.ufl_shape for space in self.form.spaces]),
            "loads": str([load.ufl_shape for load, _ in self._loads.converged()]),
            "prescribed": len(constants),
            "boundaries": str([of.boundary.markers.total for of in self.form.boundaries]),
            "rigid bodies": len(self.bodies.all),
        }

    def _mismatch(self, path: str, state: dict[str, Any]) -> CheckpointError | None:
        for what, here in self._problem().items():
            found = state.get(what, "[]" if what == "boundaries" else None)
            if found != here:
                return CheckpointError(
                    f"{path} is of another problem: its {what} is {found}, that of this "
                    f"one {here}; build the same problem before you load"
                )
        absent = [name for name in needed_of(self.form.boundaries) if name not in state]
        if absent and self.configuration == "total":
            return CheckpointError(
                f"{path} is of a problem in the updated configuration: it lacks '{absent[0]}', "
                'where boundaries were at first; load it into one with configuration="updated"'
            )
        return None

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """State that all ranks share, that of this rank, and that of its cells."""
        loads, cells = saved_loads(self._loads)
        values = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        given = {f"prescribed {k}": np.array(value.value) for k, value in enumerate(values)}
        markers = memory_of_markers(self.form.boundaries)
        order = order_of_markers(self.form.boundaries)
        kept = {**loads, **given, **markers, **self.bodies.memory()}
        return {**self._problem(), **kept}, order, cells

    def _remember(
        self, state: dict[str, Any], local: dict[str, Any] | None, cells: dict[str, Any]
    ) -> None:
        """Take what `_memory` returned. Collective."""
        values = [bc.value for bc in self.bcs if isinstance(bc.value, fem.Constant)]
        for k, value in enumerate(values):
            value.value = state[f"prescribed {k}"]
        set_loads(self._loads, state, cells)
        set_markers(self.form.boundaries, state, local)
        self.bodies.remember(state)
        self.here = None

    @together
    @stages.activate
    def activate(self, step: Step | None = None) -> Activation:
        """What takes part in a step from where the points are now. Collective.

        Args:
            step: The step; all of it by default.
        """
        share = 1.0 if step is None else step.share
        if step is not None and self.here is None and not self._in_time:
            check_timeless(self.form.given, self.points, type(self).__name__)
        self.form.bind()
        check_bodies(self.fields, self.form)
        self.form.place_markers()
        self._held.follow()
        first, kept, self._kept = self.here is None, self._kept, None
        self.here = activate(
            self.points, self.fields, self._held, self.form, share, self.here, kept,
            self._in_blocks if step is not None else None,
        )  # fmt: skip
        if first and kept is None:
            warn_of_free_axis(self.points, self.here)
        self._set_penalties(self.here)
        # what moves may come to a side later
        if first and kept is None and not self._in_time:
            active = [active_on_grid(field) for field in self.here.fields]
            warn_idle(self.bcs, self.form.spaces, active)
        return self.here

    def _set_penalties(self, here: Activation) -> None:
        """Set the penalties of weak conditions. Collective."""
        self.form.set_penalties(here)

    def _begin(self) -> None:
        """Look whether bodies and grid are where this problem has left them, as a step begins.

        Raises:
            ParameterError: Another problem has moved a rigid body, or the grid's lines.
        """
        self.bodies.take()
        if times_regridded(self.points.grid) != self.form.laid:
            raise ParameterError(
                "mpm.regrid has placed the grid's lines anew for another problem, and this one has "
                f"kept where they were: make a new Space and a new {type(self).__name__} of its "
                "points, or give it a grid of its own"
            )

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were; see `regrid`."""
        self.form.regrid()
        self.here = self._kept = None

    def _in_blocks(self, count: int) -> bool:
        """Whether so many unknowns of a step are to stand in blocks, see `Unknowns`."""
        return False

    @together
    def operator(self) -> Operator:
        """The weak form on what takes part now: residual, tangent and external. Collective."""
        return Operator(self.form, self.activate())

    @together
    def stiffness(self) -> PETSc.Mat:
        """Tangent stiffness of the active unknowns in the present state. Collective."""
        operator = self.operator()
        operator.rest()
        matrix = Matrix(operator.here.pattern, operator.here.unknowns)
        operator.tangent(matrix)
        return matrix.petsc

"""What must hold of a pressure, or another scalar field, before a first step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinmpm._platform.errors import ParameterError, UndeterminedFieldError, raise_together
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis.conditions import Condition, idle
from dolfinmpm.body.points import PointField
from dolfinmpm.cut.activation import active_on_grid
from dolfinmpm.cut.participants import Activation
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.solve.operator import Operator

__all__ = ["refuse_idle", "refuse_increments", "refuse_undetermined"]

# Share of what an arbitrary field of its size does, up to which a constant one does nothing
_NOTHING = 1e-12


def refuse_idle(conditions: Sequence[Condition], here: Activation) -> None:
    """Raise where conditions on scalar fields hold no node that the body moves. Collective.

    A displacement may be held where the body comes later; a boundary that drains and is away from
    the body leaves it sealed in silence.

    Raises:
        ParameterError: There are such conditions.
    """
    scalar = [c for c in conditions if c.space.increment.ufl_shape == ()]
    spaces = [field.space for field in here.fields]
    names = idle(scalar, spaces, [active_on_grid(field) for field in here.fields])
    if names:
        places = ", ".join(f"'{name}'" for name in names)
        raise ParameterError(
            f"the conditions on the pressure at {places} hold no node of the body, which is away "
            "from there: hold the pressure where the body is, by a function of positions, or on "
            "its own surface, mpm.poromechanics(..., drained=surface)"
        )


def refuse_undetermined(operator: Operator) -> None:
    """Raise where a constant may be added to a scalar field and changes nothing. Collective.

    Raises:
        UndeterminedFieldError: There is such a field.
    """
    here = operator.here
    unknowns = here.unknowns
    scalar = [k for k, f in enumerate(here.fields) if f.space.increment.ufl_shape == ()]
    if not scalar or unknowns.total == 0:
        return
    matrix = Matrix(here.pattern, unknowns)
    operator.rest()
    operator.tangent(matrix)
    x, y = matrix.petsc.createVecs()
    random = np.random.default_rng(unknowns.comm.rank)
    for k in scalar:
        norms = []
        for values in (np.ones(unknowns.owned), random.choice([-1.0, 1.0], unknowns.owned)):
            x.getArray()[:] = unknowns.only(k, values)
            matrix.petsc.mult(x, y)
            norms.append(y.norm())
        if norms[0] <= _NOTHING * norms[1]:
            matrix.petsc.destroy()
            raise UndeterminedFieldError(
                f"field {k + 1} of {len(here.fields)}, a pressure, is determined up to a "
                "constant: the body is held all around, sealed, and what fills its pores cannot "
                "be compressed. Hold the pressure somewhere, drain a surface, leave a part of the "
                "body free to move, or give the fluid a bulk modulus"
            )
    matrix.petsc.destroy()


def refuse_increments(bcs: Sequence[Condition], kept: Sequence[PointField]) -> None:
    """Refuse increments of fields that are none. Collective.

    A field that a form carries as it is, from step to step, is no increment.

    Raises:
        ParameterError: A condition would give parts of a step a share of its value.
    """
    wholes = [f.of for f in kept if isinstance(f, CarriedField)]
    for condition in bcs:
        if condition.whole or all(w is not condition.space.increment for w in wholes):
            continue
        error = None
        if condition.changes:
            error = ParameterError(
                f"the condition at '{condition.where}' prescribes an increment, a share of which "
                "is that of a step's part, and the field is none: its values are carried from step "
                "to step; give mpm.prescribed(..., increment=False)"
            )
        raise_together(condition.space.grid.comm, error)

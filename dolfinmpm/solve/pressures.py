"""What must hold of a pressure, or another scalar field, before a first step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinmpm._platform.errors import ParameterError, UndeterminedFieldError
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis.conditionchecks import idle
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import PointField
from dolfinmpm.cut.activation import active_on_grid
from dolfinmpm.cut.participants import Activation, movers
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.solve.operator import Operator

__all__ = ["refuse_idle", "refuse_undetermined", "refuse_wrong_kinds"]

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


def refuse_wrong_kinds(
    bcs: Sequence[Condition], spaces: Sequence[Space], kept: Sequence[PointField]
) -> None:
    """Refuse increments of fields that are carried, and values of those that move points.

    Args:
        bcs: The conditions.
        spaces: Spaces of the problem's fields.
        kept: Fields of points that the form carries from step to step.

    Raises:
        ParameterError: A part of a step would have a share of a value, or a whole increment.
    """
    carried = [f.of for f in kept if isinstance(f, CarriedField)]
    moving = [spaces[k].increment for k in movers(spaces)]
    for condition in bcs:
        u, where = condition.space.increment, condition.where
        kept_as_is = any(one is u for one in carried)
        if condition.kind == "increment" and kept_as_is:
            raise ParameterError(
                f"the condition at '{where}' prescribes an increment, and the form carries the "
                "field's values from step to step: give mpm.prescribed(..., value=...)"
            )
        if condition.kind == "value" and not kept_as_is and any(one is u for one in moving):
            raise ParameterError(
                f"the condition at '{where}' prescribes a value, and the field is the increment "
                "of a step, which moves points: give mpm.prescribed(..., increment=...)"
            )

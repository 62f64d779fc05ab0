"""Fields that are results of steps: a change by hand would be overwritten in silence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.grid.tensors import determinants

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["OF_STRAIN", "overwritten", "seal_results", "seal_stress", "unseal_results"]

# Values of `moved_under` of points whose stress follows from a strain, see
# `dolfinmpm.kinematics.strainhistory.MARKS`; with those after `dolfinmpm.set_stress`
OF_STRAIN = (1, 2, 3, 4)
_GIVEN = tuple(16 + mark for mark in OF_STRAIN)
_RESULTS = ("V", "stress")
# Relative difference of volumes by rounding
_ROUNDING = 1e-9


def seal_results(points: MaterialPoints) -> None:
    """Note the volumes and stresses that a step has written."""
    points.fields.seal("V")
    seal_stress(points)


def seal_stress(points: MaterialPoints) -> None:
    """Note the stresses that a step or `dolfinmpm.set_stress` has written."""
    points.fields.seal("stress", _strained(points))


def unseal_results(points: MaterialPoints) -> None:
    """Allow changes of volumes and stresses, until they are noted again."""
    points.fields.unseal(*_RESULTS)


def overwritten(points: MaterialPoints) -> ParameterError | None:
    """Error for volumes or stresses of this rank that were changed since a step, or None.

    The next step computes volumes from F and V0, and stresses from strains. Stresses of UMATs and
    of forms that contain the field `stress` are a state. They may be changed.
    """
    fields = points.fields
    if fields.broken("V"):
        V, wanted = fields.read("V"), determinants(fields.read("F")) * fields.read("V0")
        bad = np.flatnonzero(~(np.abs(V - wanted) <= _ROUNDING * np.abs(wanted)))
        if bad.size:
            p = bad[0]
            return ParameterError(
                f"points['V'] of point {fields.read('id')[p]} at {fields.read('x')[p]} m was set "
                f"to {V[p]:.6g} m^{points.strain_dim}. It must be det(F) V0 = {wanted[p]:.6g}, as "
                f"the next step computes it ({bad.size} such points on this rank). For another "
                "first volume set points['V0'] too, before the first step"
            )
    if fields.broken("stress", _strained(points)):
        largest = np.abs(fields.read("stress")).max()
        return ParameterError(
            f"points['stress'] was changed by hand (largest component now {largest:.6g} Pa), "
            "and the next step computes it from the strain of the points. Call "
            "mpm.set_stress(law, points, stress)"
        )
    return None


def _strained(points: MaterialPoints) -> slice | npt.NDArray[np.bool_]:
    """Points of this rank whose stress follows from a strain."""
    marks = points.fields.read("moved_under")
    if marks.size and marks.min() >= 1 and marks.max() <= OF_STRAIN[-1]:
        return slice(None)
    return np.isin(marks, OF_STRAIN + _GIVEN)

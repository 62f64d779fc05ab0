"""Laws given by an energy in UFL: their declarations, energies, stiffnesses and moduli."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.body.axisymmetry import gradient
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import (
    Declaration,
    ElasticResponse,
    LawConstant,
    LawField,
    rows_within,
)
from dolfinmpm.forms.pointwise import compile_here, input_numbers
from dolfinmpm.kinematics.strainformulation import PointParameters
from dolfinmpm.kinematics.strainhistory import ENERGY, MARKS, check_history, refuse_stress
from dolfinmpm.materials.base import lame
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["declare_energy", "end_of_step"]


def end_of_step(points: MaterialPoints, u) -> Expr:
    """Deformation gradient at the end of the step, for UFL.

    Args:
        points: Material points.
        u: Increment of the displacement (m).
    """
    return (ufl.Identity(points.strain_dim) + gradient(points, u)) * points.F


def declare_energy(law: Any, points: MaterialPoints, u, tags: Tags) -> Declaration:
    """Declaration of a law that is an energy in UFL.

    Args:
        law: The law.
        points: Material points.
        u: Increment of the displacement (m).
        tags: Tags of the points with this law; None means all points.
    """
    parameters = PointParameters(law, points, tags)
    holders: list[LawConstant | LawField]
    if parameters.field:
        name, size = parameters.field, len(law.parameters)
        holders = [LawField(points, name, (size,), "")]
        given = {key: holders[0][k] for k, key in enumerate(law.parameters)}
    else:
        holders = [LawConstant(points.grid, law.values[key]) for key in law.parameters]
        given = dict(zip(law.parameters, holders))

    def bind() -> None:
        rows = rows_within(points, tags)
        check_history(points, rows, ENERGY, str(declaration))
        refuse_stress(points, rows, str(declaration))
        parameters.adopt()

    declaration = Declaration(
        points=points, law=law, u=u, strain="large", fbar=False, tags=tags, given=given,
        operator=None, updates={"stress": law.cauchy_stress(end_of_step(points, u), **given)},
        mark=MARKS[ENERGY], bind=bind,
        parameters=lambda: parameters.at(rows_within(points, tags)),
        elastic=ElasticResponse(
            lambda: _energy_at(law, points, parameters, tags),
            lambda: _stiffness_at(points, parameters, tags),
            lambda: _moduli_at(points, parameters, tags),
        ),
    )  # fmt: skip
    for holder in holders:
        holder.declaration = declaration
    return declaration


def _energy_at(law: NeoHookean, points: MaterialPoints, parameters: PointParameters, tags: Tags):
    """The law's energy per initial volume at its points (J/m³)."""
    rows, d = rows_within(points, tags), points.strain_dim
    number = len(law.parameters)
    z = input_numbers(d * d + number)
    F = ufl.as_tensor([[z[d * i + j] for j in range(d)] for i in range(d)])
    program = compile_here([law.energy(F, *(z[d * d + k] for k in range(number)))], z)
    values = np.empty((len(rows), d * d + number))
    values[:, : d * d] = points["F"][rows].reshape(len(rows), d * d)
    values[:, d * d :] = parameters.at(rows)
    return program.values(values)[:, 0]


def _stiffness_at(points: MaterialPoints, parameters: PointParameters, tags: Tags):
    """Stiffness bound λ + μ (1 + λ_max²) at the points of the neo-Hookean law (Pa)."""
    rows = rows_within(points, tags)
    if len(rows) == 0:
        return np.empty(0)
    lmbda, mu = lame(*parameters.at(rows).T)
    F = points["F"][rows]
    largest = np.einsum("pij,pij->p", F, F)
    return lmbda + mu * (1.0 + np.maximum(largest, 1.0))


def _moduli_at(points: MaterialPoints, parameters: PointParameters, tags: Tags):
    """Moduli λ + 2μ and μ of the neo-Hookean law at its points (Pa), shape (n, 2) or (1, 2)."""
    lmbda, mu = lame(*parameters.at(rows_within(points, tags)).T)
    return np.stack([lmbda + 2 * mu, mu], axis=1)

"""One material point with a law: what an element test asks of a law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.algorithms.ad import expand_derivatives

from dolfinmpm._platform.argumentchecks import choice, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.filling import fill
from dolfinmpm.body.shapes import Box
from dolfinmpm.forms.pointwise import compile_here, input_numbers
from dolfinmpm.grid.graded import create_lattice
from dolfinmpm.kinematics.lawterms import set_stress, strain_formulation
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.materials.umat import UMAT

__all__ = ["ElementPoint", "matrix"]

Array = npt.NDArray[np.float64]

_ROWS = np.zeros(1, np.int32)
# xx, yy, zz, xy, yz, xz
_AT = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])


def matrix(components: Array) -> Array:
    """Upper triangle of a tensor from xx, yy, zz, xy, yz, xz, shape (3, 3)."""
    result = np.zeros((3, 3))
    result[_AT] = components
    return result


def _of_energy(law: NeoHookean) -> Callable[[Array], tuple[Array, Array]]:
    """Function of F that returns the Cauchy stress, shape (3, 3), and its derivative by F."""
    z = input_numbers(9)
    F = ufl.variable(ufl.as_tensor([[z[3 * i + j] for j in range(3)] for i in range(3)]))
    sigma = law.cauchy_stress(F)
    slope = expand_derivatives(ufl.diff(sigma, F))
    index = [*np.ndindex(3, 3)], [*np.ndindex(3, 3, 3, 3)]
    program = compile_here([*(sigma[i] for i in index[0]), *(slope[i] for i in index[1])], z)

    def respond(at: Array) -> tuple[Array, Array]:
        out = program.values(np.ascontiguousarray(at).reshape(1, 9))
        return out[0, :9].reshape(3, 3), out[0, 9:].reshape(3, 3, 3, 3)

    return respond


class ElementPoint:
    """A material point in a cell of its own, which nothing else knows.

    Attributes:
        law: The law.
        kind: Strain formulation.
        strain: Sums of the strain increments xx, yy, zz, xy, yz, xz, with engineering shear
            strains (-).
        stress: Cauchy stress xx, yy, zz, xy, yz, xz (Pa).
        motion: Gradient of the increment that the next `commit` takes, shape (3, 3).

    Args:
        law: A law of `dolfinmpm.materials`.
        kind: Strain formulation, or None for the usual one.
        stress: First normal stresses (Pa), shape (3,).

    Raises:
        ParameterError: The law is not known, or has no first stress.
        StateError: The first stress is outside the yield surface.
    """

    def __init__(self, law: Any, kind: str | None, stress: Array):
        if not isinstance(law, (Law, NeoHookean, UMAT)):
            raise ParameterError(f"law = {shown(law)} must be one of mpm.materials, such as Hencky")
        usual = "jaumann" if isinstance(law, UMAT) else "large"
        self.kind = choice("strain", usual if kind is None else kind, ("large", "small", "jaumann"))
        self.law = law
        self.strain: Array = np.zeros(6)
        self.motion: Array = np.zeros((3, 3))
        grid = create_lattice(MPI.COMM_SELF, [[0.0, 1.0]] * 3)
        self._points = fill(grid, Box((0, 0, 0), (1, 1, 1)), per_cell=1, density=1.0)
        self._formulation: Any = None
        if isinstance(law, NeoHookean):
            if stress.any() or self.kind != "large":
                raise ParameterError(
                    f"{law!r} is an energy: it has no first stress, and large strain only"
                )
            self._hyperelastic = _of_energy(law)
        else:
            if stress.any():
                set_stress(law, self._points, np.diag(stress), strain=self.kind)
            self._formulation = strain_formulation(law, self._points, self.kind)
            self._formulation.bind()
        begun = self.respond(np.zeros((3, 3)))
        self.stress: Array = np.zeros(6)
        if stress.any():
            self.stress[:3] = stress
        elif not isinstance(begun, str) and not isinstance(law, UMAT):
            self.stress = begun[0]

    def respond(self, H: Array) -> tuple[Array, Array] | str:
        """Cauchy stress (Pa), shape (6,), and its derivative by H, shape (6, 9); or a failure.

        Args:
            H: Gradient of the increment, shape (3, 3).
        """
        dF = np.eye(3) + H
        F = self._points["F"][0]
        if self._formulation is None:
            sigma, slope = self._hyperelastic(dF @ F)
            by_F = np.einsum("ijkl,nl->ijkn", slope, F)
            return sigma[_AT], by_F[_AT].reshape(6, 9)
        S, A = np.empty((1, 9)), np.empty((1, 9, 9))
        if self._formulation.evaluate(H.reshape(1, 9), S, A, _ROWS) >= 0:
            return str(self._formulation.describe(H, 0))
        flux, by_H = S.reshape(3, 3), A.reshape(3, 3, 3, 3)
        if self.kind == "small":
            return flux[_AT], by_H[_AT].reshape(6, 9)
        J = np.linalg.det(dF @ F)
        sigma = flux @ dF.T / J
        slope = np.einsum("ikmn,jk->ijmn", by_H, dF) / J
        slope += np.einsum("in,jm->ijmn", flux, np.eye(3)) / J
        slope -= np.einsum("ij,nm->ijmn", sigma, np.linalg.inv(dF))
        return sigma[_AT], slope[_AT].reshape(6, 9)

    def commit(self, G: Array) -> None:
        """Take the motion as the new state.

        Args:
            G: Strain increments of the motion, shape (6,).
        """
        points, H = self._points, self.motion
        begun = self.respond(H)
        assert not isinstance(begun, str)
        self.strain, self.stress = self.strain + G, begun[0]
        if self._formulation is not None:
            for name, values in self._formulation.commit(H.reshape(1, 9), _ROWS).items():
                points.fields[name][_ROWS] = values
        points["F"][0] = (np.eye(3) + H) @ points["F"][0]
        points["V"][0] = np.linalg.det(points["F"][0]) * points["V0"][0]

    def variables(self) -> dict[str, float]:
        """Name of an internal variable → its value."""
        names = () if self._formulation is None else self.law.internal
        return {name: float(self._points[name][0]) for name in names}

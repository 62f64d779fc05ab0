"""Velocities at absorbing sides at the end of an explicit step.

The dashpots resist the mean of the velocities before and after the step's impulses, ½ (v₀ + v):
second order in the step. Here v = v₁ + B q, v₁ is the velocity without dashpots, B the velocity by
an impulse, and q = Δt (f − ½ C (v₀ + v)) the impulse of dashpots C and of incoming waves f. With a
consistent mass B is M⁻¹. With a lumped mass M_L and "flip", the points take the change of the
nodes' velocities. They give it back to the nodes in the next step, so that B is M_L⁻¹ M M_L⁻¹. B is
symmetric, and so is (C⁻¹ + ½ Δt B) q = Δt (C⁻¹ f − ½ (v₀ + v₁)). The impulse works on the same
mean, so that the dashpots only take energy, whatever their size. Node by node, B would be M_L⁻¹.
Then stiff sides make energy, because B C is not what the points feel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ConvergenceError
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.transfer import collect, scatter

__all__ = ["SideDashpots"]

Array = npt.NDArray[np.float64]
# the residual ends at this share of the right-hand side
_TOLERANCE, _MOST = 1e-12, 500


@dataclass
class SideDashpots:
    """Dashpots and incoming waves at the nodes of a step.

    Attributes:
        mass: The mass at the nodes.
        dashpots: Coefficients of the dashpots (N s/m), shape (nodes, d).
        wave: Forces of incoming waves (N), shape (nodes, d).
        free: Components that dashpots may move, on the rank of each node, shape (nodes, d).
        dt: Time during which forces act (s).
    """

    mass: Mass
    dashpots: Array
    wave: Array
    free: npt.NDArray[np.bool_]
    dt: float

    def by_nodes(self, V: Array, V_start: Array) -> tuple[Array, Array]:
        """With a lumped mass: velocities of the nodes, each for itself, and those resisted.

        Args:
            V: Velocities without dashpots (m/s), shape (nodes, d).
            V_start: Velocities at the start of the step (m/s), shape (nodes, d).
        """
        rate = self.dt / np.where(self.mass.lumped > 0, self.mass.lumped, np.inf)[:, None]
        half = 0.5 * rate * self.dashpots
        V_end = (V + rate * self.wave - half * V_start) / (1.0 + half)
        return V_end, 0.5 * (V_start + V_end)

    def consistent(self, V: Array, V_start: Array) -> tuple[Array, Array]:
        """With a consistent mass: velocities of the nodes, and those resisted. Collective.

        Args:
            V: Velocities without dashpots (m/s), shape (nodes, d).
            V_start: Velocities at the start of the step (m/s), shape (nodes, d).
        """
        c, dt, free = self.dashpots, self.dt, self.free

        def product(w: Array) -> Array:
            return free * (self.mass.times(self._known(w)).arrays[0] + 0.5 * dt * c * w)

        m = np.maximum(self.mass.lumped, 1e-3 * self.mass.lumped.max(initial=0.0))[:, None]
        mean = 0.5 * (V_start + V)
        w = self._known(self._solved(product, m + 0.5 * dt * c, free * dt * (self.wave - c * mean)))
        return V + w, mean + 0.5 * w

    def lumped(self, V: Array, V_start: Array, s: Stencils, weight: Array) -> tuple[Array, Array]:
        """With a lumped mass and "flip": velocities as in `consistent`. Collective.

        Args:
            V: Velocities without dashpots (m/s), shape (nodes, d).
            V_start: Velocities at the start of the step (m/s), shape (nodes, d).
            s: The points' stencils.
            weight: Masses of the points (kg), shape (points,).
        """
        dt = self.dt
        m = np.where(self.mass.lumped > 0, self.mass.lumped, np.inf)[:, None]
        on = self.free & (self.dashpots > 0)
        c = np.where(on, self.dashpots, np.inf)

        def kept(change: Array) -> Array:
            """Changes of velocity that the points give back to the nodes."""
            back = self.mass.nodal()
            scatter(s, weight, collect(s, self._known(change)), back.arrays[0])
            back.add_up()
            return back.arrays[0] / m

        def product(q: Array) -> Array:
            return on * (q / c + 0.5 * dt * kept(q / m))

        mean = V_start + 0.5 * kept(V - V_start)
        right = on * dt * (self.wave / c - mean)
        q = self._solved(product, np.where(on, 1 / c + 0.25 * dt / m, 1.0), right)
        return V + self._known(q / m), mean + 0.5 * kept(q / m)

    def works(self, V: Array, mean: Array) -> tuple[float, float]:
        """Work of the waves, and loss by the dashpots (J). Collective.

        Args:
            V: Velocities that the dashpots resist (m/s), shape (nodes, d).
            mean: Means of the velocities before and after their impulse (m/s), likewise.
        """
        move = np.where(self.free, self.dt * mean, 0.0)
        both = np.array([np.sum(self.wave * move), np.sum(self.dashpots * V * move)])
        self.mass.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.SUM)
        return float(both[0]), float(both[1])

    def _known(self, values: Array) -> Array:
        """Values of the nodes' owners, on all ranks that know the nodes. Collective."""
        out = self.mass.nodal()
        out.arrays[0][:] = values
        out.spread()
        return out.arrays[0]

    def _dot(self, a: Array, b: Array) -> float:
        return self.mass.comm.allreduce(float(np.sum((a * b)[self.free])), op=MPI.SUM)

    def _solved(self, product: Callable[[Array], Array], diagonal: Array, right: Array) -> Array:
        """Conjugate gradients with a diagonal preconditioner. Collective.

        Raises:
            ConvergenceError: The mass is singular.
        """
        x, rest = np.zeros_like(right), right.copy()
        z = rest / diagonal
        along, rho = z, self._dot(rest, z)
        end = _TOLERANCE**2 * rho
        for _ in range(_MOST):
            if rho <= end:
                return x
            image = product(along)
            step = rho / self._dot(along, image)
            x, rest = x + step * along, rest - step * image
            z = rest / diagonal
            rho, before = self._dot(rest, z), rho
            along = z + rho / before * along
        raise ConvergenceError(
            f"dashpots at absorbing sides: no solution after {_MOST} iterations, since the mass is "
            'next to singular; give ghost_mass=0.25, or mass="lumped", or more points per cell'
        )

"""The exact solution of the growing disc of `hyperelastic_in_ufl.py`."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.optimize import least_squares


def slope(function, *at):
    """Derivative of an analytic function of several numbers by each of them."""
    step = 1e-30
    return [
        np.imag(function(*(x + 1j * step * (i == j) for j, x in enumerate(at)))) / step
        for i in range(len(at))
    ]


def polar(points):
    """Initial radii (m), shape (n,), and the axes along the radius, around and across, as rows."""
    R = np.linalg.norm(points["x0"], axis=1)
    axes = np.zeros((len(points), 3, 3))
    axes[:, 0, :2] = points["x0"] / R[:, None]
    axes[:, 1, :2] = axes[:, 0, :2] @ np.array([[0, 1], [-1, 0]])
    axes[:, 2, 2] = 1
    return R, axes


class ExactDisc:
    """Positions and Cauchy stresses of the disc, by initial radius; energy (J/m) of a quarter.

    A Ritz ansatz r = R Σ c_k T_2k(R/R0) with Chebyshev's polynomials makes the energy stationary.

    Args:
        energy: Energy (J/m³) of I₁, J and a logarithm.
        growth_of: Growth of lengths by initial radius (m).
        radius: R0 (m).
        mu: Shear modulus (Pa), the unit of the balance.
        terms: Number of polynomials.

    Raises:
        RuntimeError: No solution is found.
    """

    def __init__(self, energy, growth_of, radius, mu, terms=10):
        self.energy, self.growth_of, self.radius = energy, growth_of, radius
        s, weight = np.polynomial.legendre.leggauss(40)
        s, weight = 0.5 * (s + 1), 0.5 * weight
        basis = [Chebyshev.basis(2 * k) for k in range(terms)]
        c = np.eye(terms)[0]
        ratio = np.array([T(s) for T in basis])
        along = ratio + np.array([s * T.deriv()(s) for T in basis])
        for share in np.linspace(0, 1, 11)[1:]:
            g = 1 + share * growth_of(s * radius)

            def balance(c, g=g):
                P_r, P_t, _ = slope(lambda *at: self._energy(g, *at), c @ along, c @ ratio, 1.0)
                return (along * P_r + ratio * P_t) @ (weight * s) / mu

            solution = least_squares(
                balance, c, jac="3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
            )
            c = solution.x
        if np.abs(solution.fun).max() > 1e-9:
            raise RuntimeError(f"no exact solution with this growth: {solution.message}")
        density = self._energy(g, c @ along, c @ ratio, 1.0)
        self.stored_energy = float(np.pi / 2 * radius**2 * (density @ (weight * s)))
        self._ratio = sum(a * T for a, T in zip(c, basis))

    def _energy(self, g, a, b, c):
        """Energy (J/m³) of the principal stretches a, b and c, the last along the axis."""
        return g**2 * self.energy((a**2 + b**2) / g**2 + c**2, a * b * c / g**2, np.log)

    def position(self, R):
        """Radius r (m) to which the ring of radius R (m) moves."""
        return R * self._ratio(R / self.radius)

    def stress(self, R):
        """Cauchy stresses (Pa) along the radius, around it and along the axis, shape (3, n)."""
        s, g = R / self.radius, 1 + self.growth_of(R)
        a, b = self._ratio(s) + s * self._ratio.deriv()(s), self._ratio(s)
        P_r, P_t, P_z = slope(lambda *at: self._energy(g, *at), a, b, np.ones_like(a))
        return np.array([P_r / b, P_t / a, P_z / (a * b)])

    def errors(self, points):
        """Relative errors of displacement and stress."""
        R, axes = polar(points)
        moved = (self.position(R) - R)[:, None] * axes[:, 0, :2]
        stress = np.einsum("ap,pai,paj->pij", self.stress(R), axes, axes)
        result = []
        for found, sought in ((points["x"] - points["x0"], moved), (points["stress"], stress)):
            square = [(e**2).reshape(len(R), -1).sum(axis=1) for e in (found - sought, sought)]
            sums = [points.comm.allreduce(float(e @ points["V0"])) for e in square]
            result.append(float(np.sqrt(sums[0] / sums[1])))
        return result

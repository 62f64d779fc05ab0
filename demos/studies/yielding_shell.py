"""What studies of thick shells that yield share: options, closed form, steps and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from options import Options, natural, option, positive
from scipy.optimize import brentq
from shells import ACROSS

import dolfinmpm as mpm


@dataclass
class ShellInput(Options):
    """The options of a shell under internal pressure."""

    h: float = positive(0.0125, "size of the cells (m)")
    steps: int = natural(24, least=2)
    reach: float = option(1.3, "last outer displacement, over that at the limit", above=1)
    inner: float = positive(0.1, "inner radius (m)")
    outer: float = positive(0.2, "outer radius (m)")
    modulus: float = positive(210e9, "Young's modulus (Pa)")
    poisson: float = 0.3
    strength: float = option(0.24e9, "uniaxial yield stress, Pa")

    def _check(self):
        if not self.inner < self.outer < np.inf:
            raise ValueError(f"radii {self.inner} and {self.outer} m must increase")
        if not self.h <= 0.5 * (self.outer - self.inner):
            raise ValueError(f"h = {self.h} m must be at most half the wall")


class Yielding:
    """Closed form of a shell of radii a and b (m) of small strains.

    Source: Hill's solution, in de Souza Neto, Perić & Owen (2008), section 7.5.
    """

    def __init__(self, shape: str, args: ShellInput):
        a, b, nu = args.inner, args.outer, args.poisson
        self.k, self.a, self.b = ACROSS[shape], a, b
        # difference of hoop and radial stress that yields, and u_b by c^(k+1)
        self.Y = args.strength if shape == "sphere" else 2 * args.strength / np.sqrt(3)
        self.compliance = self.Y / (args.modulus * b**self.k)
        self.compliance *= 1 - nu if shape == "sphere" else 1 - nu**2
        self.limit = self.k * self.Y * np.log(b / a)
        self.last_displacement = self.compliance * b ** (self.k + 1)

    def pressure(self, u):
        """Pressure (Pa) at the outer displacement u (m)."""
        n = self.k + 1
        grown = np.asarray(u, float) / self.compliance
        c = np.clip(grown, self.a**n, self.b**n) ** (1 / n)
        share = self.k * self.Y / n
        plastic = self.k * self.Y * np.log(c / self.a) + share * (1 - (c / self.b) ** n)
        elastic = share * (1 / self.a**n - 1 / self.b**n) * grown
        return np.where(grown < self.a**n, elastic, plastic)

    def displacement(self, p):
        """Outer displacement (m) under a pressure (Pa) below the limit."""
        return brentq(lambda u: self.pressure(u) - p, 0, self.last_displacement, xtol=1e-16)

    def front(self, u):
        """Radius c (m) of the plastic zone."""
        n = self.k + 1
        return float(np.clip(u / self.compliance, self.a**n, self.b**n) ** (1 / n))

    def stress(self, r, u):
        """Radial and hoop stress (Pa) at the radii r (m); once it yields anywhere."""
        n, c, Y = self.k + 1, self.front(u), self.Y
        share = self.k * Y / n * (c / self.b) ** n
        flow = self.k * Y * np.log(r / c) - self.k * Y / n + share
        radial = np.where(r < c, flow, share * (1 - (self.b / r) ** n))
        return radial, np.where(r < c, flow + Y, share * (1 + (self.b / r) ** n / self.k))


def widen(
    args: ShellInput, exact: Yielding, form: Any, u: Any, points: Any, *fields: str, **options: Any
) -> tuple[mpm.ArcLength, np.ndarray, Any, float]:
    """Widen a shell by equal steps of its outer displacement, and find the pressures. Collective.

    Args:
        args: The command line.
        exact: The closed form, whose limit is the unit of `load`.
        form, u, points: The weak form, the increment and the points.
        fields: Fields of the points to keep at the step next to c = √(ab).
        options: Further arguments of `ArcLength`.

    Returns:
        The problem; outer displacement (m) and pressure (Pa) of each step, shape (steps + 1, 2);
        the fields, and the outer displacement (m) then.
    """
    length = args.reach * exact.last_displacement / args.steps
    problem = mpm.ArcLength(
        form, u, points, length=length, max_length=length, target_iterations=50, **options
    )
    middle = (exact.a * exact.b) ** (0.5 * (exact.k + 1))
    shown = max(1, round(exact.compliance * middle / length))
    rows, kept = [(0.0, 0.0)], None
    for _ in mpm.steps(args.steps, label="outer displacement"):
        record = problem.step()
        rows.append((record.displacement, record.factor * exact.limit))
        if len(problem.history) == shown:
            kept = points.gather(*fields)
    curve = np.array(rows)
    return problem, curve, kept, float(curve[min(shown, args.steps), 0])


def compared(exact: Yielding, curve: np.ndarray) -> dict[str, Any]:
    """Figures of the curve of `widen` against the closed form."""
    closed = exact.pressure(curve[1:, 0])
    error = curve[1:, 1] / closed - 1
    # near the limit the displacement says little about the pressure's error, and less in return
    lower = curve[(curve[:, 1] > 0) & (curve[:, 1] < 0.95 * exact.limit)]
    displacement_error = [w / exact.displacement(p) - 1 for w, p in lower]
    return {
        "outer_displacement": curve[:, 0].tolist(),
        "pressure": curve[:, 1].tolist(),
        "pressure_exact": [0.0, *closed.tolist()],
        "max_pressure_error": float(np.abs(error).max()),
        "max_displacement_error": float(np.abs(displacement_error).max()),
        "limit_load": float(curve[-1, 1]),
        "limit_load_exact": float(exact.limit),
        "limit_load_error": float(curve[-1, 1] / exact.limit - 1),
    }


def draw_curve(axes: Any, exact: Yielding, curve: np.ndarray) -> None:
    """Draw pressure over outer displacement, and the closed form."""
    fine = np.linspace(0, curve[-1, 0], 400)
    axes.plot(1e3 * fine, exact.pressure(fine) / 1e6, color="C0", label="closed form")
    axes.plot(1e3 * curve[:, 0], curve[:, 1] / 1e6, "o", ms=3, color="C1", label="material points")
    axes.axhline(exact.limit / 1e6, color="0.5", ls="--", lw=0.8)
    axes.text(30 * fine[-1], exact.limit / 1e6, "limit load", va="bottom", size=7)
    axes.set(xlabel="outer displacement $u_b$ (mm)", ylabel="internal pressure $p$ (MPa)")
    axes.set(xlim=(0, None), ylim=(0, 1.12 * exact.limit / 1e6))
    axes.legend(loc="lower right")


def draw_stresses(
    axes: Any, exact: Yielding, u: float, r: np.ndarray, hoop: np.ndarray, radial: np.ndarray
) -> None:
    """Draw stresses (Pa) of points at radii r (m), and the closed form at displacement u (m)."""
    R = np.linspace(exact.a, exact.b, 300)
    for values, closed, name, colour in zip(
        (hoop, radial), exact.stress(R, u)[::-1], ("\\theta", "r"), ("C1", "C2")
    ):
        axes.plot(1e3 * r, values / 1e6, ".", ms=1.3, alpha=0.5, color=colour, rasterized=True)
        axes.plot(1e3 * R, closed / 1e6, "k-", lw=0.8)
        axes.plot([], [], ".", ms=5, color=colour, label=f"$\\sigma_{{{name}}}$")
    axes.plot([], [], "k-", lw=0.8, label="closed form")
    axes.set(xlabel="radius $r$ (mm)", ylabel="stress (MPa)")
    axes.legend(loc="lower right")

"""Checks of the stability atlas that find wrong results of steps that converge.

The checks use only the fields of the points and the outlines of the rigid bodies, not the solver.
Bounds are wide enough for the errors of a penalty and of means over cells.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from atlas_example import Example, Rigid
from mpi4py import MPI

__all__ = ["Checks", "inside_by"]

VOLUME = 0.02  # volume lost beyond what elastic strain takes, by the first volume
ADMISSIBLE = 1e-6  # elastic strain that a second return mapping would take
FIELDS = "x", "F", "V", "stress"


class Checks:
    """Looks for what is wrong after each step. Collective.

    Args:
        example: The problem before its first step.

    Attributes:
        found: The first that was wrong, or "".
        made: Most energy that came from nowhere since there was least of it, by all that came.
    """

    def __init__(self, example: Example):
        self.example, self.points = example, example.problem.points
        self.comm = self.points.comm
        self.mass, self.count = self._mass(), self.points.total
        self.found, self.made, self._least = "", 0.0, 0.0

    def _sum(self, values: Any) -> float:
        return float(self.comm.allreduce(float(np.sum(values)), op=MPI.SUM))

    def _most(self, values: Any) -> float:
        mine = np.max(np.asarray(values, float), initial=-np.inf)
        return float(self.comm.allreduce(float(mine), op=MPI.MAX))

    def _mass(self) -> float:
        return self._sum(self.points["density"] * self.points["V0"])

    def step(self) -> bool:
        """Whether all is well after a step. Collective."""
        for check in (self._finite, self._volumes, self._energy, self._overlap):
            self.found = self.found or check()
        return not self.found

    def end(self) -> bool:
        """Whether all is well at the end too. Collective."""
        for check in (self._kept, self._elastic_volume, self._admissible):
            self.found = self.found or check()
        return not self.found

    def _finite(self) -> str:
        names = [name for name in (*FIELDS, "velocity", "pressure") if name in self.points.fields]
        bad = [name for name in names if self._most(~np.isfinite(self.points[name])) > 0]
        return f"not finite: {', '.join(bad)}" if bad else ""

    def _volumes(self) -> str:
        least = -self._most(-np.linalg.det(self.points["F"]))
        return f"det F = {least:.3g}" if least <= 0 else ""

    def _energy(self) -> str:
        """More energy than came, or than was left: dissipation must not hide what is made."""
        if not self.example.dynamic:
            return ""
        e = self.example.problem.energies()
        there, came = e.kinetic + e.strain + e.bodies + e.contact, e.initial + e.external
        more = (there - came) / abs(came)
        self._least = min(self._least, more)
        self.made = max(self.made, more - self._least)
        return f"energy made: {self.made:.2%}" if self.made > self.example.made else ""

    def _overlap(self) -> str:
        for rigid in self.example.rigid:
            depth = self._most(inside_by(rigid, self.points["x"]))
            if depth > rigid.bound:
                return f"points inside a rigid body by {depth:.3g} m"
        return ""

    def _kept(self) -> str:
        lost = 1.0 - self._mass() / self.mass
        if self.points.total != self.count or abs(lost) > 1e-9:
            return f"mass lost: {lost:.2%}"
        V, V0 = self.points["V"], self.points["V0"]
        apart = self._most(np.abs(V / V0 - np.linalg.det(self.points["F"])))
        return f"V/V0 and det F differ by {apart:.2g}" if apart > 1e-6 else ""

    def _elastic_volume(self) -> str:
        """Volume beyond exp(tr ε), ε elastic and logarithmic, where plastic strain has none."""
        if not self.example.keeps_volume:
            return ""
        points = self.points
        elastic = np.sqrt(np.linalg.det(_elastic(points))) * points["V0"]
        changed = self._sum(points["V"] - elastic) / self._sum(points["V0"])
        return f"volume lost: {-changed:.2%}" if abs(changed) > VOLUME else ""

    def _admissible(self) -> str:
        """The elastic strain must stay as it is if the law answers it once more."""
        points, most = self.points, -np.inf
        for tag, law in self.example.laws.items():
            if law is None:
                continue
            mine = points["tag"] == tag
            strain = 0.5 * np.log(np.linalg.eigvalsh(_elastic(points)[mine]))
            internal = [points[name][mine] for name in law.internal]
            kept = np.column_stack(internal) if internal else np.empty((len(strain), 0))
            if len(strain):
                again = law.respond(strain, internal=kept, x=points["x0"][mine])
                most = max(most, np.abs(np.sort(again.strain, axis=1) - strain).max())
        most = self._most([most])
        return f"beyond the yield surface by a strain of {most:.2g}" if most > ADMISSIBLE else ""


def _elastic(points: Any) -> Any:
    """Elastic left Cauchy-Green tensors, shape (n, 3, 3)."""
    xx, yy, zz, xy, xz, yz = points["be"].T
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)


def inside_by(rigid: Rigid, x: Any) -> Any:
    """How deep positions are inside a rigid body's outline (m), shape (n,); 0 outside.

    Args:
        rigid: The body.
        x: Positions (m), shape (n, 2).
    """
    angle = np.radians(float(rigid.body.angle[0]))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = rigid.corners @ turn.T + rigid.body.position
    ends = np.roll(corners, -1, axis=0)
    along = ends - corners
    at = x[:, None] - corners
    share = np.clip(np.sum(at * along, axis=2) / np.sum(along**2, axis=1), 0.0, 1.0)
    away = np.linalg.norm(at - share[:, :, None] * along, axis=2).min(axis=1)
    # a ray to the right crosses the outline an odd number of times from inside
    above = (corners[:, 1] > x[:, None, 1]) != (ends[:, 1] > x[:, None, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = corners[:, 0] + (x[:, None, 1] - corners[:, 1]) / along[:, 1] * along[:, 0]
    inside = np.count_nonzero(above & (x[:, None, 0] < crossing), axis=1) % 2 == 1
    return np.where(inside, away, 0.0)

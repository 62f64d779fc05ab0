"""The pose of a rigid body: its centre, and its rotation since it was made."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

__all__ = ["Pose", "rotation_of"]

Array = npt.NDArray[np.float64]


def rotation_of(turn: Array, gdim: int) -> Array:
    """Matrix of a rotation, shape (gdim, gdim).

    Args:
        turn: Angle (rad), shape (1,), in 2D, or the rotation vector (rad), shape (3,).
        gdim: Dimension of space.
    """
    if gdim < 3:
        c, s = math.cos(turn[0]), math.sin(turn[0])
        return np.array([[c, -s], [s, c]])
    angle = float(np.linalg.norm(turn))
    W = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
    if angle < 1e-8:
        return np.eye(3) + W + 0.5 * W @ W
    # Rodrigues
    half = math.sin(0.5 * angle) / (0.5 * angle)
    return np.eye(3) + math.sin(angle) / angle * W + 0.5 * half**2 * W @ W


@dataclass(frozen=True)
class Pose:
    """Position and rotation of a body.

    Attributes:
        origin: Initial position of the centre of rotation (m), shape (gdim,).
        shift: Translation of the centre since then (m), shape (gdim,).
        rotation: Rotation matrix since then, shape (gdim, gdim).
        turn: Angle since then (rad), shape (1,), in 2D, with whole turns; in 3D the sum of all
            small rotations, shape (3,).
    """

    origin: Array
    shift: Array
    rotation: Array
    turn: Array

    @staticmethod
    def first(origin: Array) -> Pose:
        """The pose of a body that has not moved."""
        d = len(origin)
        return Pose(origin, np.zeros(d), np.eye(d), np.zeros(1 if d < 3 else 3))

    @property
    def centre(self) -> Array:
        """Present position of the centre (m), shape (gdim,)."""
        return self.origin + self.shift

    def moved(self, shift: Array, turn: Array) -> Pose:
        """The pose after a further motion.

        Args:
            shift: Translation of the centre (m), shape (gdim,).
            turn: Rotation about the centre (rad), shape (1,), in 3D (3,).
        """
        rotation = self.rotation
        if turn.any():
            rotation = rotation_of(turn, len(shift)) @ rotation
        return replace(self, shift=self.shift + shift, rotation=rotation, turn=self.turn + turn)

    def back(self, x: Array) -> Array:
        """Initial positions of points of the body (m) from present ones, shape (n, gdim)."""
        return self.origin + (x - self.centre) @ self.rotation

    def forth(self, x: Array) -> Array:
        """Present positions of points of the body (m) from initial ones, shape (..., gdim)."""
        return self.centre + (x - self.origin) @ self.rotation.T

    def directions(self, v: Array) -> Array:
        """Present directions of vectors fixed to the body, shape (..., gdim)."""
        return v @ self.rotation.T

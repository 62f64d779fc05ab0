"""Waves that come in through absorbing sides.

Beyond an absorbing side the ground goes on as an elastic half-space. An upward wave in it with the
velocity v_up pushes the side, so that the traction of the dashpots becomes ρ c (2 v_up − v)
(Lysmer & Kuhlemeyer 1969; Joyner & Chen 1975, Bull. Seism. Soc. Am. 65, 1315).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import at_time, check_function, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.dynamics.groundcolumn import ColumnAtSide

__all__ = ["IncomingWaves", "checked_incoming"]

Array = npt.NDArray[np.float64]
Wave = Callable[[float], float]


def checked_incoming(
    incoming: Any, impedance: Sequence[float], axes: Sequence[int], d: int
) -> tuple[Wave | None, ...] | None:
    """Velocities of incoming waves, one per direction, or None without any.

    Args:
        incoming: The argument: None, or one function of time or None per direction.
        impedance: Impedances of pressure and shear waves (Pa s/m).
        axes: Directions of the normals of the sides.
        d: Dimension of space.

    Raises:
        ParameterError: An entry is no function of time, or a side has no dashpots for it.
    """
    if incoming is None:
        return None
    if not isinstance(incoming, (list, tuple)) or len(incoming) != d:
        raise ParameterError(
            f"incoming = {shown(incoming)} must be one velocity per direction, None for none: "
            f"incoming=({', '.join(['record'] + ['None'] * (d - 1))})"
        )
    for k, wave in enumerate(incoming):
        if wave is None:
            continue
        check_function("incoming", wave, "of time that returns the velocity of the wave (m/s)")
        _velocity(wave, 0.0)
        for axis in axes:
            if not impedance[0 if k == axis else 1] > 0.0:
                speed = "p_speed" if k == axis else "s_speed"
                raise ParameterError(
                    f"a wave comes in with motion in the direction {k}, and {speed} = 0 m/s gives "
                    f"the side no dashpots there: give {speed} of the ground beyond the side"
                )
    return tuple(incoming) if any(incoming) else None


def _velocity(wave: Wave, t: float) -> float:
    """Velocity of a wave at time t (m/s)."""
    return number("incoming", at_time("incoming", wave, t), unit="m/s")


class IncomingWaves:
    """Forces of incoming waves on the nodes of a basis.

    Args:
        size: Number of nodes.
        d: Dimension of space.

    Attributes:
        beside: Sides beside columns of ground.
    """

    beside: list[ColumnAtSide]

    def __init__(self, size: int, d: int):
        self._shape, self.beside = (size, d), []
        self._parts: list[tuple[npt.NDArray[np.intp], int, Array, Wave]] = []

    def __bool__(self) -> bool:
        return bool(self._parts or self.beside)

    def clear(self) -> None:
        """Forget the waves that were added."""
        self._parts.clear()

    def add(self, nodes: npt.NDArray[np.intp], direction: int, dashpots: Array, wave: Wave) -> None:
        """Add a wave through some nodes.

        Args:
            nodes: The nodes, shape (n,).
            direction: Direction of the motion.
            dashpots: Coefficients of the dashpots (N s/m), shape (n,).
            wave: Velocity of the wave by time (m/s).
        """
        self._parts.append((nodes, direction, dashpots, wave))

    def forces(self, t: float) -> Array:
        """Forces 2 c v_up of the waves, and of columns, at time t (N), shape (nodes, d)."""
        out = np.zeros(self._shape)
        for nodes, k, c, wave in self._parts:
            out[nodes, k] += 2.0 * c * _velocity(wave, t)
        for side in self.beside:
            nodes, pushes = side.forces(t)
            out[nodes] += pushes
        return out

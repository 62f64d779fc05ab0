"""Named errors, and the one way to raise them on all ranks together.

An exception that is raised on one rank only leaves the others waiting in the
next collective call. Every check that can fail on some ranks therefore ends in
:func:`raise_together`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

__all__ = [
    "CheckpointError",
    "ConflictingConditionsError",
    "ConvergenceError",
    "DolfinMPMError",
    "EmptyShapeError",
    "FieldShapeError",
    "FormError",
    "MigrationError",
    "ParameterError",
    "PointsOutsideGridError",
    "ShapeOutsideGridError",
    "StateError",
    "UnsupportedGridError",
    "call_together",
    "raise_together",
]

Result = TypeVar("Result")


class DolfinMPMError(Exception):
    """Base class of every error that dolfinmpm raises."""


class ParameterError(DolfinMPMError, ValueError):
    """A number or a name is outside what it may be."""


class FieldShapeError(DolfinMPMError, ValueError):
    """A field of the material points was given an array of the wrong shape."""


class ShapeOutsideGridError(DolfinMPMError, ValueError):
    """A shape to be filled with material points reaches outside the background grid."""


class EmptyShapeError(DolfinMPMError, ValueError):
    """No material point falls into a shape."""


class UnsupportedGridError(DolfinMPMError, ValueError):
    """The background grid is not of the kind that was asked of it."""


class ConflictingConditionsError(DolfinMPMError, ValueError):
    """Two essential conditions prescribe different values for one unknown."""


class FormError(DolfinMPMError, ValueError):
    """A term of the weak form cannot be evaluated where it stands."""


class PointsOutsideGridError(DolfinMPMError, RuntimeError):
    """Material points left the background grid during a step."""


class MigrationError(DolfinMPMError, RuntimeError):
    """Material points were lost or doubled between ranks."""


class StateError(DolfinMPMError, RuntimeError):
    """A constitutive law finds no stress for a strain."""


class CheckpointError(DolfinMPMError, RuntimeError):
    """A checkpoint cannot be written or read, or is not one of this problem."""


class ConvergenceError(DolfinMPMError, RuntimeError):
    """A step did not converge, however small it was made."""


def call_together(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call a function that may raise on some ranks only; then all ranks raise. Collective.

    Args:
        comm: Communicator whose ranks all make this call.
        function: What to call; it makes no collective calls itself.
    """
    error, result = None, None
    try:
        result = function()
    except Exception as caught:
        error = caught
    raise_together(comm, error)
    return result  # type: ignore[return-value]


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank if any rank has an error. Collective.

    Args:
        comm: Communicator whose ranks all make this call.
        error: This rank's error, or None.

    Raises:
        Exception: This rank's own error, or, on the ranks that have none, an
            error of the same class as that of the lowest failing rank and with
            its message.
    """
    if comm.size == 1:
        if error is not None:
            raise error
        return
    failing = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failing == comm.size:
        return
    first = (type(error), str(error)) if comm.rank == failing else None
    kind, message = comm.bcast(first, root=failing)
    if error is not None:
        raise error
    try:
        other = kind(message)
    except TypeError:  # some exceptions of other packages take more arguments
        other = DolfinMPMError(f"{kind.__name__}: {message}")
    raise other

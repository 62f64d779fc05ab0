"""Named errors and warnings, and the one way to raise or give them on all ranks together.

An exception that is raised on one rank only leaves the others waiting in the
next collective call. Every check that can fail on some ranks therefore ends in
:func:`raise_together`.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from mpi4py import MPI

__all__ = [
    "CheckpointError",
    "ConflictingConditionsError",
    "ConvergenceError",
    "DegreesWarning",
    "DifferentCallsError",
    "DifferentProblemWarning",
    "DolfinMPMError",
    "DolfinMPMWarning",
    "EmptyShapeError",
    "FieldShapeError",
    "FormError",
    "FreeAxisWarning",
    "IdleConditionWarning",
    "ImbalanceWarning",
    "InstabilityError",
    "MigrationError",
    "MissingPackageError",
    "ParameterError",
    "PointsOutsideGridError",
    "ShapeOutsideGridError",
    "SingularMassWarning",
    "SoftVolumeWarning",
    "StateError",
    "UndeterminedFieldError",
    "UnknownNameError",
    "UnreadOptionWarning",
    "UnstablePairWarning",
    "UnsupportedGridError",
    "call_together",
    "common_text",
    "raise_together",
    "warn",
]

Result = TypeVar("Result")
_PACKAGE = str(Path(__file__).resolve().parents[1])

_COMMON = "_text_on_all_ranks"


class DolfinMPMError(Exception):
    """Base class of every error that dolfinmpm raises."""


class ParameterError(DolfinMPMError, ValueError):
    """A number or a name is outside what it may be."""


class UnknownNameError(ParameterError, KeyError, AttributeError):
    """Nothing goes by the name that was asked for."""

    # a KeyError shows its message in quotes
    __str__ = Exception.__str__


class DifferentCallsError(DolfinMPMError, RuntimeError):
    """Ranks make different calls where all of them must make the same."""


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


class MissingPackageError(DolfinMPMError, ImportError):
    """An optional package or program is necessary for a call, and is not installed."""


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


class UndeterminedFieldError(DolfinMPMError, RuntimeError):
    """A field is determined up to a constant alone."""


class InstabilityError(DolfinMPMError, RuntimeError):
    """An explicit computation became unstable."""


class DolfinMPMWarning(UserWarning):
    """Base class of every warning that dolfinmpm gives; one rank gives it."""


class IdleConditionWarning(DolfinMPMWarning):
    """An essential condition holds no node that the body moves."""


class FreeAxisWarning(DolfinMPMWarning):
    """A body of revolution reaches its axis, and nothing holds it there radially."""


class DegreesWarning(DolfinMPMWarning):
    """An angle may have been given in radians in place of degrees, or the reverse."""


class DifferentProblemWarning(DolfinMPMWarning):
    """A checkpoint goes on in a problem with other laws, bases, stabilisations or conditions."""


class SingularMassWarning(DolfinMPMWarning):
    """A consistent mass is next to singular: its nodal velocities are out of all proportion."""


class SoftVolumeWarning(DolfinMPMWarning):
    """F-bar leaves changes of volume with too little stiffness for the law."""


class UnstablePairWarning(DolfinMPMWarning):
    """Displacement and pore pressure are of equal order, without stabilisation."""


class UnreadOptionWarning(DolfinMPMWarning):
    """An option of PETSc was given, and nothing that solves a problem has read it."""


class ImbalanceWarning(DolfinMPMWarning):
    """Some rank has far more material points than others."""


def warn(comm: MPI.Comm, message: str, category: type[DolfinMPMWarning]) -> None:
    """Warn on rank 0, at the line of the user's script that led here.

    Args:
        comm: Communicator of the ranks that may all make this call.
        message: What to say.
        category: Kind of warning.
    """
    if comm.rank != 0:
        return
    level = 1
    frame = sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


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
    lowest = np.array([comm.rank if error is not None else comm.size])
    # of a number in an array; one of Python's would take four times as long
    comm.Allreduce(MPI.IN_PLACE, lowest, op=MPI.MIN)
    failing = int(lowest[0])
    if failing == comm.size:
        return
    first = (type(error), str(error)) if comm.rank == failing else None
    kind, message = comm.bcast(first, root=failing)
    if error is None:
        try:
            error = kind(message)
        except TypeError:  # some exceptions of other packages take more arguments
            error = DolfinMPMError(f"{kind.__name__}: {message}")
    error.__dict__[_COMMON] = f"{kind.__name__}: {message}"
    raise error


def common_text(error: BaseException) -> str | None:
    """What all ranks say of an error that they raised together: class and message of one."""
    return error.__dict__.get(_COMMON)

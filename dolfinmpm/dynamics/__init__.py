"""Motion in time: mass, velocity mappings, implicit and explicit steps."""

from dolfinmpm.dynamics.clock import times
from dolfinmpm.dynamics.collision import Collision
from dolfinmpm.dynamics.explicit import Explicit
from dolfinmpm.dynamics.faces import absorbing, free_field, frictional
from dolfinmpm.dynamics.groundcolumn import GroundColumn
from dolfinmpm.dynamics.inputmotion import InputMotion
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.newmark import GeneralisedAlpha, Newmark
from dolfinmpm.dynamics.transient import Transient

__all__ = [
    "Collision",
    "Explicit",
    "GeneralisedAlpha",
    "GroundColumn",
    "InputMotion",
    "Mapping",
    "Newmark",
    "Transient",
    "absorbing",
    "free_field",
    "frictional",
    "times",
]

"""Motion in time: mass, velocity mappings, implicit and explicit steps."""

from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.newmark import GeneralisedAlpha, Newmark
from dolfinmpm.dynamics.times import times

__all__ = ["GeneralisedAlpha", "Mapping", "Newmark", "times"]

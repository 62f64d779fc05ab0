"""Rigid bodies, and material points that touch them."""

from dolfinmpm.contact.rigid import RigidBody
from dolfinmpm.contact.terms import contact
from dolfinmpm.contact.tools import Cone, Plane, Wedge

__all__ = ["Cone", "Plane", "RigidBody", "Wedge", "contact"]

"""Rigid bodies, and material points that touch them."""

from dolfinmpm.contact.rigid import RigidBody
from dolfinmpm.contact.terms import contact
from dolfinmpm.contact.tools import Plane

__all__ = ["Plane", "RigidBody", "contact"]

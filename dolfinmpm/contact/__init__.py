"""Rigid bodies, material points that touch them, and bodies that touch each other."""

from dolfinmpm.contact.between import contact_between
from dolfinmpm.contact.contactterm import contact
from dolfinmpm.contact.rigid import RigidBody
from dolfinmpm.contact.springbed import springs
from dolfinmpm.contact.tools import Cone, Plane, Wedge

__all__ = ["Cone", "Plane", "RigidBody", "Wedge", "contact", "contact_between", "springs"]

"""Rigid bodies, material points that touch them, and bodies that touch each other."""

from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.contact.rigidcontact import contact
from dolfinmpm.contact.rigidshapes import Cone, Plane, Wedge
from dolfinmpm.contact.springbed import springs
from dolfinmpm.contact.twobodycontact import contact_between

__all__ = ["Cone", "Plane", "RigidBody", "Wedge", "contact", "contact_between", "springs"]

"""UFL at the material points: splitting a weak form, and compiling its pointwise part."""

from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.split import SplitForm, split

__all__ = ["PointOperator", "SplitForm", "split"]

"""UFL at the material points: splitting a weak form, and compiling its pointwise part."""

from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.splitting import SplitForm, split

__all__ = ["PointOperator", "SplitForm", "split"]

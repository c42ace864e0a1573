"""Many runs of one model, flown by threads of machine code or by processes."""

from .runs import ensemble

__all__ = ["ensemble"]

"""Many runs of one model, in parallel: in threads of compiled code, or in processes."""

from .runs import ensemble

__all__ = ["ensemble"]

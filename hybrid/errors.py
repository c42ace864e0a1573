"""What can go wrong, one class for each kind of fault.

Every message names the model, the mode or edge, the value, and what would mend it. A package that
only some features need is asked for here, too (:func:`need`).
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec

#: Modules that a feature needs beyond the package itself.
PLOT = ("matplotlib",)
HTML = ("plotly",)
PROOFS = ("flint",)
TABLES = ("xarray",)
FRAMES = ("pandas",)
FILES = ("xarray", "h5netcdf", "h5py")
MAPS = ("xarray", "zarr")

#: Packages whose modules have other names.
PACKAGES = {"flint": "python-flint"}


class HybridError(Exception):
    """Base class of every error that this package raises on purpose.

    Attributes
    ----------
    status : str
        How a lane of an ensemble has ended that fails by it (:func:`hybrid.ensemble`).
    """

    status = "failed"

    def by(self, status: str) -> HybridError:
        """The same, with another name for how a lane has ended."""
        self.status = status
        return self


class DeclarationError(HybridError):
    """A model's class body has faults; all of them are listed together.

    Attributes
    ----------
    faults : tuple of str
        One sentence for each fault.
    """

    def __init__(self, model: str, faults: Sequence[str]) -> None:
        self.model = model
        self.faults = tuple(faults)
        lines = "\n".join(f"  - {fault}" for fault in self.faults)
        count = "a fault" if len(self.faults) == 1 else f"{len(self.faults)} faults"
        super().__init__(f"{model} has {count} in its declaration:\n{lines}")


class ParameterError(HybridError, ValueError):
    """A parameter is unknown, or its value is outside its bounds."""


class StartError(HybridError, ValueError):
    """The start is incomplete, outside the mode's domain, or undecidable."""

    status = "outside"


class OptionError(HybridError, ValueError):
    """An option of a run (solver, method, tolerance, times) cannot be used."""

    status = "refused"


class TraceError(HybridError):
    """A flow, guard or reset uses something that cannot be lowered."""


class FlowError(HybridError):
    """A flow, guard or reset gave a value that is not finite, or a solver gave up."""

    status = "not_finite"


class DomainError(HybridError):
    """A reset put the state outside the domain of the mode it enters."""

    status = "outside"


class JumpLoopError(HybridError):
    """Jumps follow each other without end at one time."""

    status = "jump_loop"


class ZenoError(HybridError):
    """Jumps accumulate and the caller asked for an error (``zeno="raise"``)."""

    status = "zeno_raised"


class OrbitError(HybridError):
    """No return, periodic orbit or first variation was found where one was asked for."""


class StoreError(HybridError):
    """A saved trajectory cannot be written or read."""


def need(what: str, modules: tuple[str, ...]) -> None:
    """Refuse what needs a package that is missing.

    Raises
    ------
    OptionError
        With the command that installs what is missing.
    """
    missing = [PACKAGES.get(name, name) for name in modules if find_spec(name) is None]
    if missing:
        raise OptionError(f"{what} needs {', '.join(missing)}: pip install {' '.join(missing)}")

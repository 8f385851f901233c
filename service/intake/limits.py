"""How a file that was sent is read, and how much it may ask for, while it is read and once it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from joulemap.model.runs.odometry import Odometry

_MB_PER_S = 5.0  # the slowest format, text, is read at twice this speed
_WALL_PER_CPU = 6.0  # other work may take most of the processors, and no reader waits for anything else


@dataclass(frozen=True)
class ReadLimits:
    """What reading one file may take.

    Attributes
    ----------
    seconds : float
        Processor time [s]; a large file has a second more for each 5 MB.
    memory_mb : float
        Memory beyond that of an idle process [1e6 bytes].
    """

    seconds: float
    memory_mb: float

    def of_file(self, size: int) -> ReadLimits:
        """Return the limits of a file. `size`: its length [bytes]."""
        return ReadLimits(self.seconds + size / 1e6 / _MB_PER_S, self.memory_mb)

    @property
    def wall_s(self) -> float:
        """Real time that it may take [s]."""
        return _WALL_PER_CPU * self.seconds


@dataclass(frozen=True)
class RunLimits:
    """How large a measured run may be.

    Attributes
    ----------
    mb : float
        Size of its file [1e6 bytes].
    km : float
        Length that was driven [km].
    table : mapping of str to int or float
        Of its table: the fields of `TableLimits`.
    """

    mb: float
    km: float
    table: Mapping[str, Any]


@dataclass(frozen=True)
class RunReading:
    """How a measured run is to be read.

    Attributes
    ----------
    odometry : Odometry or None
        How its track is integrated from wheel speeds; None for a run with positions or a distance.
    mapping : mapping of str to str
        Where columns are taken from.
    accept_implausible : bool
        Whether it is kept if its numbers are hardly in the units that they are read in.
    """

    odometry: Odometry | None = None
    mapping: Mapping[str, str] = field(default_factory=dict)
    accept_implausible: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunReading:
        """Return what `as_dict` wrote."""
        track = values["odometry"]
        return cls(None if track is None else Odometry(**track), values["mapping"], values["accept_implausible"])

"""The whole error tree: everything that joulemap raises on purpose.

    JoulemapError(code, message, context)
    ├── InputError                   the caller sent something unusable            422
    │   ├── HeightmapError           not a heightmap, bad resolution, no known cell
    │   ├── RobotError               a robot file with a missing, unknown or impossible value
    │   ├── ModelError               an unknown model name or a broken model folder
    │   ├── RunsError                a measured run that cannot be read
    │   └── PointError               NaN, infinite or out-of-map coordinates
    ├── InfeasibleError              a well-formed question without an answer      422
    │   ├── BlockedError             start or goal is on blocked ground
    │   ├── NoRouteError             no route joins start and goal
    │   └── NegativeCycleError       regeneration pays for driving in circles
    ├── NotFoundError                no such heightmap, cost map or model          404
    ├── ConflictError                this lattice is for another robot, or not ready 409
    ├── TooLargeError                more bytes or cells than the limit            413
    ├── UnauthorizedError            no key, or one that is not valid              401
    ├── ForbiddenError               a foreign web page, or not what this key may do 403
    ├── RateError                    more requests or jobs at once than a key may  429
    ├── StorageFullError             no room: the disk's, or what a key may keep   507
    ├── DamagedError                 what was kept is lost or not what was written 503
    └── BusyError                    come back later                               503

`service/problems.py` alone maps the tree to HTTP statuses and exit codes. Anything else that escapes is our bug.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, Self


class JoulemapError(Exception):
    """Base of the tree.

    Parameters
    ----------
    message : str
        What is wrong, in words that a robot operator understands.
    **context : Any
        The offending value, the limit and what else a program may want to read; JSON-able.
    """

    code = "joulemap_error"

    def __init__(self, message: str, **context: Any) -> None:
        super().__init__(message)
        self.message = message
        self.context = context

    @classmethod
    def of_run(cls, run: str, words: str, **context: Any) -> Self:
        """Return the error of a measured run.

        Parameters
        ----------
        run : str
            Its name, which comes before the words and is in the context.
        words : str
            What is wrong.
        **context : Any
            As of `JoulemapError`.

        Returns
        -------
        Self
            To be raised.
        """
        return cls(f"run {run}{words if words[0] in ' ,' else f': {words}'}", run=run, **context)


class InputError(JoulemapError):
    """The caller sent something that cannot be used."""

    code = "invalid_input"


class HeightmapError(InputError):
    """Not a heightmap, a wrong or missing resolution, or no known cell."""

    code = "invalid_heightmap"


class RobotError(InputError):
    """A robot description with a missing, unknown or impossible value."""

    code = "invalid_robot"


class ModelError(InputError):
    """A model that is not there, or whose files do not fit together."""

    code = "invalid_model"


class RunsError(InputError):
    """A measured run that cannot be read."""

    code = "invalid_runs"


class PointError(InputError):
    """Coordinates that are not finite or lie outside the map."""

    code = "invalid_point"


class InfeasibleError(JoulemapError):
    """The question is well-formed, but it has no answer."""

    code = "infeasible"


class BlockedError(InfeasibleError):
    """Start or goal is on blocked ground; `reason` is in the context."""

    code = "blocked"


class NoRouteError(InfeasibleError):
    """No route joins start and goal within the robot's limits."""

    code = "no_route"


class NegativeCycleError(InfeasibleError):
    """Regeneration would pay for driving in circles: the prices cannot be true."""

    code = "negative_cycle"


class NotFoundError(JoulemapError):
    """No such heightmap, cost map, path or model."""

    code = "not_found"


class ConflictError(JoulemapError):
    """The request contradicts what is stored: another robot, or a cost map that is not ready."""

    code = "conflict"


class TooLargeError(JoulemapError):
    """More bytes or cells than the limit allows."""

    code = "too_large"


class UnauthorizedError(JoulemapError):
    """A request without a key, or with one that is not valid."""

    code = "unauthorized"


class ForbiddenError(JoulemapError):
    """A request that this caller may not make: from a foreign web page, or for the operator alone."""

    code = "forbidden"


class RateError(JoulemapError):
    """More requests, or more jobs at once, than one key may have; `retry_after_s` is in the context."""

    code = "rate_limited"


class StorageFullError(JoulemapError):
    """No room to keep more: of the disk, or of what one key may keep."""

    code = "storage_full"


class DamagedError(JoulemapError):
    """What was kept is lost in part, or is not what was written; `file` is in the context."""

    code = "damaged"


class BusyError(JoulemapError):
    """The service is full or still starting; `retry_after_s` is in the context."""

    code = "busy"


def error_of(code: str, message: str, context: dict[str, Any]) -> JoulemapError:
    """Return an error that another process reported.

    Parameters
    ----------
    code, message : str
        Of the error.
    context : dict
        Of the error.

    Returns
    -------
    JoulemapError
        Of the class with this code; InputError where there is none.
    """
    kinds = [JoulemapError]
    for kind in kinds:
        kinds += kind.__subclasses__()
    return next((kind for kind in kinds if kind.code == code), InputError)(message, **context)


_COMPARED = 100  # letters of a wrong name: comparing takes longer than in proportion


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that a wrong one most likely means.

    Parameters
    ----------
    name : str
        The name that is not known, for example ``mass``.
    known : iterable of str
        The names that are, for example ``mass_kg``.

    Returns
    -------
    str or None
        A known name that contains `name` or is spelled nearly like it; None where none is near.
    """
    given, names = name[:_COMPARED].lower(), {other.lower(): other for other in known}
    longer = [other for other in names if len(given) >= 3 and given in other]
    near = get_close_matches(given, longer or names, n=1, cutoff=0.0 if longer else 0.6)
    return names[near[0]] if near else None

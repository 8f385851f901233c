"""The model architectures by name: one line each. Importing this module loads neither torch nor numpy."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar, cast

from joulemap.model.errors import ModelError

if TYPE_CHECKING:
    from joulemap.model.energy.architectures.contract import Architecture

A = TypeVar("A", bound="Architecture[Any]")

ARCHITECTURES: dict[str, str | type[Architecture[Any]]] = {
    "compact": "joulemap.model.energy.architectures.compact.architecture:Compact",
    "resnet18": "joulemap.model.energy.architectures.resnet18:ResNet18",
}
"""Every architecture: its name, and its class or where that is (module:class). docs/how-to/add-a-model.md adds one."""

DEFAULT_ARCHITECTURE = "compact"
"""The architecture of the shipped network."""


def register(architecture: type[A]) -> type[A]:
    """Make an architecture of your own known to this process. A decorator of its class.

    Parameters
    ----------
    architecture : type
        A subclass of `Architecture`.

    Returns
    -------
    type
        The class itself.
    """
    ARCHITECTURES[architecture.name] = architecture
    return architecture


def find_architecture(name: str) -> Architecture[Any]:
    """Return the architecture called `name`.

    Parameters
    ----------
    name : str
        One of `ARCHITECTURES`.

    Returns
    -------
    Architecture
        What builds, reads, trains and asks networks of this kind.

    Raises
    ------
    ModelError
        If there is no such architecture.
    """
    if name not in ARCHITECTURES:
        raise ModelError(f"no architecture {name!r}: known are {', '.join(ARCHITECTURES)}", name=name)
    found = ARCHITECTURES[name]
    if isinstance(found, str):
        module, _, cls = found.partition(":")
        found = cast("type[Architecture[Any]]", getattr(import_module(module), cls))
    return found()

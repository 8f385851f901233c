"""Where everything that is finished is kept: the data folder itself, or an object store of which it has copies."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from joulemap.service.storage.object_vault import ObjectVault
from joulemap.service.storage.sizes import bytes_of


class Vault(Protocol):
    """Where what is finished is kept. A key is a path like ``costmaps/cm-0123456789ab.zarr``."""

    def put(self, key: str, place: Path) -> None:
        """Keep a file or a folder, whole or not at all."""

    def fetch(self, key: str, place: Path) -> None:
        """Have a copy in the data folder."""

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept."""

    def remove(self, key: str) -> None:
        """Keep something no longer; its copy in the data folder is left."""

    def check(self) -> None:
        """Raise OSError where nothing can be kept."""


class FolderVault:
    """The data folder: what lies in it is kept."""

    def put(self, key: str, place: Path) -> None:
        """Do nothing: it is there."""

    def fetch(self, key: str, place: Path) -> None:
        """Do nothing: it is there, or its reader will say that it is not."""

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept."""
        return bytes_of(place)

    def remove(self, key: str) -> None:
        """Do nothing: who removes the file removes it."""

    def check(self) -> None:
        """Do nothing: the disk has a check of its own."""


def vault_of(url: str | None) -> FolderVault | ObjectVault:
    """Return where everything is kept.

    `url`: of an object store, None for the data folder. Result: ready; nothing is asked of it yet.
    """
    return FolderVault() if url is None else ObjectVault(url)

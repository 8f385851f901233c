"""Where everything that is finished is kept: the data folder itself, or an object store of which it has copies."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from joulemap.service.storage.object_vault import ObjectVault
from joulemap.service.storage.sizes import bytes_of


class Vault(Protocol):
    """Where what is finished is kept. A key is a path like ``costmaps/cm-0123456789ab.zarr``."""

    def put(self, key: str, place: Path) -> None:
        """Keep a file or a folder, whole or not at all.

        Parameters
        ----------
        key : str
            Its name here.
        place : Path
            Where it is in the data folder.
        """

    def fetch(self, key: str, place: Path) -> None:
        """Have a copy in the data folder.

        Parameters
        ----------
        key : str
            Its name here.
        place : Path
            Where the copy belongs; nothing is done if it is there.

        Raises
        ------
        FileNotFoundError
            If it is not kept.
        """

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept.

        Parameters
        ----------
        key : str
            Its name here.
        place : Path
            Where it is in the data folder.

        Returns
        -------
        int
            Bytes; 0 where it is not kept.
        """

    def remove(self, key: str) -> None:
        """Keep something no longer; its copy in the data folder is left.

        Parameters
        ----------
        key : str
            Its name here.
        """

    def check(self) -> None:
        """Raise OSError where nothing can be kept."""


class FolderVault:
    """The data folder: what lies in it is kept."""

    def put(self, key: str, place: Path) -> None:
        """Do nothing: it is there.

        Parameters
        ----------
        key, place : str, Path
            As of `Vault`.
        """

    def fetch(self, key: str, place: Path) -> None:
        """Do nothing: it is there, or its reader will say that it is not.

        Parameters
        ----------
        key, place : str, Path
            As of `Vault`.
        """

    def size(self, key: str, place: Path) -> int:
        """Return how much is kept.

        Parameters
        ----------
        key, place : str, Path
            As of `Vault`.

        Returns
        -------
        int
            Bytes.
        """
        return bytes_of(place)

    def remove(self, key: str) -> None:
        """Do nothing: who removes the file removes it.

        Parameters
        ----------
        key : str
            Its name.
        """

    def check(self) -> None:
        """Do nothing: the disk has a check of its own."""


def vault_of(url: str | None) -> FolderVault | ObjectVault:
    """Return where everything is kept.

    Parameters
    ----------
    url : str or None
        Of an object store; None for the data folder.

    Returns
    -------
    FolderVault or ObjectVault
        Ready; nothing is asked of it yet.
    """
    return FolderVault() if url is None else ObjectVault(url)

"""The address of a Dask scheduler, as an option or a setting names it: checked before anything is asked of it."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

PORT = 8786
"""Of a Dask scheduler, where nothing else is said when it is started."""
_SCHEMES = ("tcp", "tls", "ws", "wss")
_HOST = re.compile(r"[A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.%]+\]")


def scheduler_address(text: str) -> str:
    """Return the address of a scheduler with its protocol.

    Result: ``tcp://HOST:8786`` of the last one, else the same.
    """
    scheme, mark, rest = text.strip().rpartition("://")
    scheme = scheme.lower() or "tcp"
    if mark and scheme not in _SCHEMES:
        raise ValueError(
            f"{text[:100]!r} begins with {scheme[:20]}://, which no scheduler speaks: write tcp:// or tls://"
        )
    try:
        found = urlsplit(f"//{rest.rstrip('/')}")
        port = found.port
    except ValueError:  # no number, or beyond 65535; or half of the brackets of an IPv6 address
        raise ValueError(f"{text[:100]!r} has no port of 1 to 65535: write {scheme}://HOST:{PORT}") from None
    host = found.netloc.rpartition(":")[0] if port is not None else found.netloc
    if not _HOST.fullmatch(host) or found.path or found.query or found.fragment:
        raise ValueError(f"{text[:100]!r} is no address of a Dask scheduler: write {scheme}://HOST:{PORT}")
    if not port:
        raise ValueError(f"{text[:100]!r} has no port of 1 to 65535: write {scheme}://{host}:{PORT}")
    return f"{scheme}://{host}:{port}"

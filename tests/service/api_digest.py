"""What the repository keeps of the OpenAPI document: its hash, and the list of operations.

`make openapi` writes both, and the document itself, which is not in the repository.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "openapi"


def sha256_of(document: dict[str, Any]) -> str:
    """Of the document as JSON with sorted keys and without spaces."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def operations_of(document: dict[str, Any]) -> str:
    """A line for each operation: method, path, what it is called and the first sentence of its description."""
    lines = []
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            said = " ".join(operation.get("description", "").split()).partition(". ")[0].rstrip(".")
            lines.append(f"{method.upper():6} {path}  {operation['operationId']}: {said}")
    return "\n".join(lines) + "\n"


def kept(document: dict[str, Any]) -> dict[str, str]:
    """Content of the files in the repository, by name."""
    return {"sha256": sha256_of(document) + "\n", "operations.txt": operations_of(document)}


if __name__ == "__main__":
    from joulemap.service.http.app import openapi_document

    written = openapi_document()
    whole = json.dumps(written, indent=2, ensure_ascii=False) + "\n"
    for name, text in {**kept(written), "openapi.json": whole}.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"written: openapi/{name}")

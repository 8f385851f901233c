"""numpydoc's checks of what users call; ruff checks that everything else has a summary.

python -m tests.docs.docstrings
"""

from __future__ import annotations

import sys

from numpydoc.hooks.validate_docstrings import parse_config, process_file

from tests.docs.code_blocks import ROOT
from tests.docs.public_objects import public_objects


def findings() -> list[str]:
    """What is wrong, a line each: file, object, check and description."""
    config = parse_config(str(ROOT))
    found = []
    for path, names in sorted(public_objects(ROOT).items()):
        for where, name, check, description in process_file(str(path), config):
            inside = name.removeprefix(path.stem).lstrip(".") if path.name != "__init__.py" else name.partition(".")[2]
            if inside in names or any(one and inside.startswith(f"{one}.") for one in names):
                found.append(f"{where}: {name}: {check} {description}")
    return found


if __name__ == "__main__":
    wrong = findings()
    print("\n".join(wrong), file=sys.stderr)
    sys.exit(f"{len(wrong)} docstrings to correct" if wrong else 0)

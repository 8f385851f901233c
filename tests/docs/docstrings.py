"""numpydoc's checks of what users call; ruff checks that everything else has a summary.

python -m tests.docs.docstrings
"""

from __future__ import annotations

import re
import sys
from importlib import import_module
from operator import attrgetter
from pathlib import Path

from numpydoc.hooks.validate_docstrings import parse_config, process_file

from joulemap.service.questions.asking import SHARED
from tests.docs.code_blocks import ROOT
from tests.docs.public_objects import public_objects


def findings() -> list[str]:
    """What is wrong, a line each: file, object, check and description."""
    config = parse_config(str(ROOT))
    found = []
    for path, names in sorted(public_objects(ROOT).items()):
        for where, name, check, description in process_file(str(path), config):
            inside = name.removeprefix(path.stem).lstrip(".") if path.name != "__init__.py" else name.partition(".")[2]
            public = inside in names or any(one and inside.startswith(f"{one}.") for one in names)
            if public and not (check == "PR01" and _added(path, inside, description)):
                found.append(f"{where}: {name}: {check} {description}")
    return found


def _added(path: Path, name: str, description: str) -> bool:
    """Whether the parameters that a docstring lacks are those that `asks` describes when it makes the method."""
    made = attrgetter(name)(import_module(".".join(("joulemap", *path.relative_to(ROOT).with_suffix("").parts))))
    return hasattr(made, "__wrapped__") and set(re.findall(r"'(\w+)'", description)) <= {"wanted", *SHARED}


if __name__ == "__main__":
    wrong = findings()
    print("\n".join(wrong), file=sys.stderr)
    sys.exit(f"{len(wrong)} docstrings to correct" if wrong else 0)

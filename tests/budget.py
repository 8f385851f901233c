"""How large the code may be: limits in budget.toml, which may only fall.

python -m tests.budget           prints sizes beside their limits, and fails where one is exceeded
python -m tests.budget --write   lowers the limits to what is there; never raises one
"""

from __future__ import annotations

import argparse
import ast
import io
import sys
import tokenize
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = Path(__file__).with_suffix(".toml")
ROOMS = ("model", "planner", "service", "tests")
MODULE_LINES, ARGUMENTS = 300, 8
_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
_HEADER = f"""\
# Limits of `python -m tests.budget`, which `make lint` runs. They may only fall: `--write` lowers them.
# code_lines: without blank lines, comments and docstrings; all_lines: with them;
# large_modules: files of more than {MODULE_LINES} lines of code; wide_functions: of more than {ARGUMENTS} arguments.
"""


def code_lines(source: str) -> int:
    """Number of lines that hold code, not only a comment or a docstring."""
    texts = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    held: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            held.update(range(token.start[0], token.end[0] + 1))
    return len(held - texts)


def wide_functions(source: str) -> int:
    """Number of functions with more arguments than `ARGUMENTS`, without self and cls."""
    found = 0
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            found += sum(name not in ("self", "cls") for name in names) > ARGUMENTS
    return found


def measured() -> dict[str, dict[str, int]]:
    """Sizes by room."""
    found = {}
    for room in ROOMS:
        sources = [path.read_text(encoding="utf-8") for path in sorted((ROOT / room).rglob("*.py"))]
        lines = [code_lines(source) for source in sources]
        found[room] = {
            "code_lines": sum(lines),
            "all_lines": sum(source.count("\n") for source in sources),
            "large_modules": sum(number > MODULE_LINES for number in lines),
            "wide_functions": sum(map(wide_functions, sources)),
        }
    return found


def report(sizes: dict[str, dict[str, int]], limits: dict[str, dict[str, int]]) -> tuple[str, list[str]]:
    """A table of sizes and limits, and a sentence for each limit that is exceeded."""
    kinds = list(next(iter(sizes.values())))
    lines = ["         " + "".join(f"{kind:>20}" for kind in kinds)]
    exceeded = []
    for room, found in sizes.items():
        cells = [f"{found[kind]} of {limits[room][kind]}" for kind in kinds]
        lines.append(f"{room:9}" + "".join(f"{cell:>20}" for cell in cells))
        exceeded += [
            f"{room}: {found[kind]} {kind.replace('_', ' ')}, and the limit is {limits[room][kind]}: "
            f"remove {found[kind] - limits[room][kind]}"
            for kind in kinds
            if found[kind] > limits[room][kind]
        ]
    return "\n".join(lines), exceeded


def lowered(sizes: dict[str, dict[str, int]], limits: dict[str, dict[str, int]]) -> str:
    """The file of limits, each the smaller one of the size and the limit so far."""
    text = _HEADER
    for room, found in sizes.items():
        old = limits.get(room, {})
        text += f"\n[{room}]\n" + "".join(
            f"{kind} = {min(size, old.get(kind, size))}\n" for kind, size in found.items()
        )
    return text


def main() -> int:
    """Print the sizes; 1 where a limit is exceeded."""
    parser = argparse.ArgumentParser(prog="python -m tests.budget", description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="lower the limits to what is there")
    options = parser.parse_args()
    limits = tomllib.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    sizes = measured()
    if options.write:
        FILE.write_text(lowered(sizes, limits), encoding="utf-8")
        limits = tomllib.loads(FILE.read_text(encoding="utf-8"))
    table, exceeded = report(sizes, limits)
    print(table)
    print("\n".join(exceeded), file=sys.stderr, end="\n" if exceeded else "")
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main())

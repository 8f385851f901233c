"""How many small random changes of the product the tests notice.

python -m tests.mutants --mutants 30 --seed 1     draws 30 changes, and runs the tests that import what is changed

The tests run in a copy of the checkout. Those that name the changed file most often come first, and the first failure
ends a mutant. One that survives is equal in behaviour, or shows what no test asks.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("model", "planner", "service")
OTHER = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
"""The operator that stands in place of another."""


class Mutant(NamedTuple):
    """A piece of a file and what stands there instead."""

    path: Path
    node: ast.expr | ast.stmt
    new: str

    def place(self) -> str:
        """File and line."""
        return f"{self.path.relative_to(ROOT)}:{self.node.lineno}"

    def source(self) -> tuple[str, str]:
        """The piece, and the whole file after the change."""
        raw = self.path.read_bytes()
        lines = raw.splitlines(keepends=True)
        start = sum(map(len, lines[: self.node.lineno - 1])) + self.node.col_offset
        end = sum(map(len, lines[: (self.node.end_lineno or 0) - 1])) + (self.node.end_col_offset or 0)
        return raw[start:end].decode(), (raw[:start] + self.new.encode() + raw[end:]).decode()


def changed(node: ast.AST) -> str | None:
    """What stands in place of a piece of a program, None where nothing is changed."""
    match node:
        case ast.Compare(left, [operator, *rest], others) if type(operator) in OTHER:
            return f"({ast.unparse(ast.Compare(left, [OTHER[type(operator)](), *rest], others))})"
        case ast.BinOp(left, operator, right) if type(operator) in OTHER and not isinstance(
            left, ast.Constant | ast.JoinedStr
        ):
            return f"({ast.unparse(ast.BinOp(left, OTHER[type(operator)](), right))})"
        case ast.BoolOp(operator, values):
            return f"({ast.unparse(ast.BoolOp(OTHER[type(operator)](), values))})"
        case ast.Constant(bool(value)):
            return str(not value)
        case ast.Constant(int(value) | float(value)):
            return str(value + 1)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            return f"({ast.unparse(operand)})"
        case ast.Return(ast.expr() as value) if not isinstance(value, ast.Constant):
            return "return None"
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Continue() | ast.Raise():
            return "pass"
    return None


def mutants(path: Path) -> Iterator[Mutant]:
    """All that may be changed in a file: in functions, outside of annotations, f-strings and decorators."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = [child for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) for child in node.body]
    while inside:
        node = inside.pop()
        if isinstance(node, ast.expr | ast.stmt) and (new := changed(node)) is not None:
            yield Mutant(path, node, new)
        if isinstance(node, ast.If | ast.While | ast.IfExp) and not isinstance(
            node.test, ast.Compare | ast.BoolOp | ast.UnaryOp
        ):
            yield Mutant(path, node.test, f"(not ({ast.unparse(node.test)}))")
        if isinstance(node, ast.AnnAssign):
            inside += [node.value] if node.value else []
        elif not isinstance(node, ast.JoinedStr | ast.FunctionDef | ast.arguments):
            inside += ast.iter_child_nodes(node)


def imports(path: Path) -> set[Path]:
    """Files of the checkout that a file imports; those of a test's conftest.py count as its own."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    stems = [ROOT / re.sub(r"^joulemap\.", "", name).replace(".", "/") for name in names]
    files = [file for stem in stems for file in (stem.with_suffix(".py"), stem / "__init__.py")]
    return {file for file in (*files, path.parent / "conftest.py") if file.is_file() and file != path}


def nearest_tests(path: Path, imported: dict[Path, set[Path]]) -> list[Path]:
    """Test files whose imports lead to a file: those that name it most often first, then those of the fewest steps."""
    importers: dict[Path, set[Path]] = {}
    for file, files in imported.items():
        for one in files:
            importers.setdefault(one, set()).add(file)
    # What is imported by no name is loaded by a registry in its folder.
    steps = dict.fromkeys([path] if path in importers else path.parent.glob("*.py"), 0)
    now = list(steps)
    for file in now:  # grows while it is gone through: nearest first
        for importer in importers.get(file, ()):
            if importer not in steps:
                steps[importer] = steps[file] + 1
                now.append(importer)
    tests = [file for file in imported if file.name.startswith("test_")]
    tests = [file for file in tests if file in steps] or tests
    named = re.compile(rf"\b{re.escape(path.stem)}\b")
    return sorted(tests, key=lambda file: (-len(named.findall(file.read_text("utf-8"))), steps.get(file, 0)))


class Checkout:
    """A copy of the checkout in which tests run."""

    def __init__(self, folder: Path) -> None:
        left_out = shutil.ignore_patterns(".*", "build", "dist", "data", "*.egg-info")
        shutil.copytree(ROOT, folder, symlinks=True, ignore=left_out, dirs_exist_ok=True)
        self._folder = folder

    def killer(self, mutant: Mutant, tests: list[Path], limit_s: float) -> str | None:
        """The first test that fails with a mutant; empty where none does, None where time ran out."""
        place = self._folder / mutant.path.relative_to(ROOT)
        before, after = place.read_text(encoding="utf-8"), mutant.source()[1]
        env = os.environ | {"PYTHONPATH": str(self._folder), "PYTHONDONTWRITEBYTECODE": "1"}
        if "numba" in before:  # compiled callers in other files would go on with the code that they have
            env["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=self._folder)
        place.write_text(after, encoding="utf-8")
        try:
            names = [str(test.relative_to(ROOT)) for test in tests]
            command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", "--no-header", *names]
            how: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
            with subprocess.Popen(command, cwd=self._folder, env=env, start_new_session=True, **how) as process:
                try:
                    words, _ = process.communicate(timeout=limit_s)
                except subprocess.TimeoutExpired:
                    return None
                finally:
                    with suppress(ProcessLookupError):  # with the services that tests began
                        os.killpg(process.pid, signal.SIGKILL)
            said = re.findall(r"^(?:FAILED|ERROR) (\S+)", words, re.MULTILINE)
            return said[0] if said else "" if process.returncode == 0 else f"pytest ended with {process.returncode}"
        finally:
            place.write_text(before, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutants", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--under", default="", help="only files whose path begins so, as planner/any_angle")
    parser.add_argument("--tests", type=int, default=40, help="at most so many test files for a mutant")
    parser.add_argument(
        "--limit-s", type=float, default=900.0, help="seconds of tests after which a mutant is left undecided"
    )
    asked = parser.parse_args()

    files = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    imported = {
        file: imports(file) for file in (*files, ROOT / "joulemap/__init__.py", *(ROOT / "tests").rglob("*.py"))
    }
    drawn = [
        mutant for file in files if str(file.relative_to(ROOT)).startswith(asked.under) for mutant in mutants(file)
    ]
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        checkout = Checkout(Path(folder))
        for mutant in random.Random(asked.seed).sample(drawn, asked.mutants):
            began = time.perf_counter()
            tests = nearest_tests(mutant.path, imported)[: asked.tests]
            killer = checkout.killer(mutant, tests, asked.limit_s)
            word = "undecided" if killer is None else "killed" if killer else "SURVIVED"
            outcomes[word] += 1
            change = f"{mutant.place()}: {mutant.source()[0]!r} -> {mutant.new!r}"
            taken_s = time.perf_counter() - began
            print(f"{word} {killer or ''} {change}, {len(tests)} test files, {taken_s:.0f} s", flush=True)
    print(", ".join(f"{count} {word}" for word, count in sorted(outcomes.items())))


if __name__ == "__main__":
    main()

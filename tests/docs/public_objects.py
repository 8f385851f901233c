"""A list of what users call: `joulemap.__all__`, the classes that it returns, and what docs/reference lists."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import sys
import typing
from functools import cache
from pathlib import Path
from typing import Any

_LISTED = re.compile(r"^::: (joulemap[\w.]*)", re.M)
_NAME = re.compile(r"[A-Za-z_]\w*")


def public_objects(root: Path) -> dict[Path, set[str]]:
    """Qualified names of the public objects by file; a class stands for its public methods and properties too."""
    joulemap = importlib.import_module("joulemap")
    found: dict[Path, set[str]] = {}

    def add(module: str, name: str) -> None:
        file = inspect.getsourcefile(sys.modules[module])
        assert file is not None
        found.setdefault(Path(file).resolve(), set()).add(name)

    offered = [getattr(joulemap, name) for name in joulemap.__all__]
    for one in offered:
        add(one.__module__, one.__qualname__)
    for kind in _returned(offered):
        add(kind.__module__, kind.__qualname__)
    for page in sorted((root / "docs/reference").glob("*.md")):
        for path in _LISTED.findall(page.read_text(encoding="utf-8")):
            _add_listed(path, add)
    return found


def _add_listed(path: str, add: Any) -> None:
    """A module stands for its public definitions and for what its `__all__` takes from other modules."""
    try:
        module = importlib.import_module(path)
    except ModuleNotFoundError:
        home, _, name = path.rpartition(".")
        value = getattr(importlib.import_module(home), name)
        _add_class_or_function(value, add)
        return
    add(path, "")  # the module's own docstring
    source = Path(inspect.getsourcefile(module) or "").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            add(path, node.name)
    for name in getattr(module, "__all__", ()):
        value = getattr(module, name)
        if getattr(value, "__module__", path) != path:
            _add_class_or_function(value, add)


def _add_class_or_function(value: Any, add: Any) -> None:
    value = getattr(value, "py_func", value)  # of a compiled function
    for kind in value.__mro__ if inspect.isclass(value) else (value,):
        if getattr(kind, "__module__", "").startswith("joulemap") and hasattr(kind, "__qualname__"):
            add(kind.__module__, kind.__qualname__)


def _returned(offered: list[Any]) -> list[type]:
    """Classes of joulemap whose objects the public functions, methods and properties return, and their base classes."""
    seen: dict[type, None] = {}
    todo = list(offered)
    while todo:
        one = todo.pop()
        for value in _annotated(one):
            for kind in _classes(value):
                if kind not in seen and kind.__module__.startswith("joulemap"):
                    seen[kind] = None
                    todo.append(kind)
        if inspect.isclass(one):
            for base in one.__mro__[1:]:
                if base.__module__.startswith("joulemap"):
                    seen.setdefault(base)
    return list(seen)


def _annotated(one: Any) -> list[Any]:
    """Annotations of what a function returns, or a class's public methods, properties and fields."""
    if not inspect.isclass(one):
        return [_return_of(one)]
    values: list[Any] = []
    for name, member in inspect.getmembers_static(one):
        if name.startswith("_") and name != "__enter__":
            continue
        if isinstance(member, property):
            values.append(_return_of(member.fget))
        elif hasattr(member, "func"):  # cached_property
            values.append(_return_of(member.func))
        elif isinstance(member, classmethod | staticmethod):
            values.append(_return_of(member.__func__))
        elif inspect.isfunction(member):
            values.append(_return_of(member))
    for base in one.__mro__:
        if base.__module__.startswith("joulemap"):
            home = vars(sys.modules[base.__module__])
            for name, text in vars(base).get("__annotations__", {}).items():
                if not name.startswith("_"):
                    values.append(_names(text, home))
    return values


def _return_of(function: Any) -> Any:
    text = getattr(function, "__annotations__", {}).get("return")
    return _names(text, getattr(function, "__globals__", {}))


def _names(text: Any, home: dict[str, Any]) -> list[Any]:
    """Classes that an annotation names, those under TYPE_CHECKING too."""
    if not isinstance(text, str):
        return [text]
    found = []
    for name in _NAME.findall(text):
        if name in home:
            found.append(home[name])
        elif (value := _type_checked(home, name)) is not None:
            found.append(value)
    return found


def _type_checked(home: dict[str, Any], name: str) -> Any:
    file = home.get("__file__")
    if not file:
        return None
    home_of = _imports(file).get(name)
    return None if home_of is None else getattr(importlib.import_module(home_of[0]), home_of[1], None)


@cache
def _imports(file: str) -> dict[str, tuple[str, str]]:
    """Module and name of what a file takes from joulemap, by its name in the file."""
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.walk(ast.parse(Path(file).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("joulemap")
        for alias in node.names
    }


def _classes(value: Any) -> list[type]:
    if isinstance(value, list):
        return [kind for one in value for kind in _classes(one)]
    if inspect.isclass(value) and not typing.get_args(value):
        return [value]
    return [kind for one in typing.get_args(value) for kind in _classes(one)]

"""Methods whose parameters are the fields of a request (`service/questions/asking.py`), on the page of Python."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

import griffe


class AskedMethods(griffe.Extension):
    """Shows their signature and docstring as `help` does; sources have one parameter `wanted`."""

    def on_function_instance(self, *, func: griffe.Function, **_: Any) -> None:
        """Replace what the source says of one."""
        asking = any(str(decorator.value).startswith("asks(") for decorator in func.decorators)
        if not asking or func.docstring is None or func.parent is None:
            return
        module = import_module(func.module.path)
        method = getattr(module if func.parent.is_module else getattr(module, func.parent.name), func.name)
        func.docstring.value = inspect.getdoc(method) or ""
        empty = inspect.Parameter.empty
        func.parameters = griffe.Parameters(
            *(
                griffe.Parameter(
                    one.name,
                    kind=griffe.ParameterKind(one.kind.description),
                    annotation=None if one.annotation is empty else str(one.annotation),
                    default=None if one.default is empty else repr(one.default),
                )
                for one in inspect.signature(method).parameters.values()
            )
        )

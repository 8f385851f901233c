"""The reference of the HTTP service, from its OpenAPI document: per endpoint its parameters, fields and answers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

_INTRO = """# HTTP

This page is made from the OpenAPI document, which a running service answers at `/openapi.json`. `/docs` of a running
service is the same document as a page where every question can be tried; it works without the internet.

Errors are [RFC 9457](https://www.rfc-editor.org/rfc/rfc9457) problems: `detail` says in words what is wrong, `code`
names the kind of error, and `context` holds the offending value and its limit. Settings are on the page
[settings](settings.md).
"""
_METHODS = ("get", "post", "put", "patch", "delete")
_MODELS = "#/components/schemas/"


def http_page() -> str:
    """The page, in Markdown."""
    from joulemap.service.http.app import openapi_document

    document = openapi_document()
    lines = [
        _INTRO,
        f"Version {document['info']['version']}. {_plain(document['info']['description'])}",
        "",
        "## Endpoints",
    ]
    for path, methods in document["paths"].items():
        for method in _METHODS:
            if method in methods:
                lines += _endpoint(method, path, methods[method])
    lines += ["", "## Bodies and answers"]
    for name, schema in sorted(document["components"]["schemas"].items()):
        lines += _model(name, schema)
    return "\n".join(lines) + "\n"


def _endpoint(method: str, path: str, operation: dict[str, Any]) -> Iterator[str]:
    yield from ("", f"### `{method.upper()} {path}`", "", _plain(operation.get("description", "")), "")
    if parameters := operation.get("parameters"):
        yield from ("| parameter | in | type | default | meaning |", "| --- | --- | --- | --- | --- |")
        for one in parameters:
            schema = one["schema"]
            yield (
                f"| `{one['name']}`{' (required)' if one.get('required') else ''} | {one['in']} | {_type(schema)} | "
                f"{_default(schema)} | {_plain(one.get('description') or schema.get('description', ''))} |"
            )
        yield ""
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        yield from (f"Body, `{kind}`: {_type(content.get('schema', {}))}", "")
    for status, response in operation["responses"].items():
        kinds = ", ".join(
            f"`{kind}` {_body(content)}".rstrip() for kind, content in response.get("content", {}).items()
        )
        yield f"- **{status}** {_plain(response.get('description', ''))}{': ' + kinds if kinds else ''}"


def _body(content: dict[str, Any]) -> str:
    return _type(content["schema"]) if "$ref" in content.get("schema", {}) else ""


def _model(name: str, schema: dict[str, Any]) -> Iterator[str]:
    yield from ("", f"### {name}", "", _plain(schema.get("description", "")), "")
    if not (fields := schema.get("properties")):
        return
    yield from ("| field | type | default | meaning |", "| --- | --- | --- | --- |")
    for key, field in fields.items():
        needed = " (required)" if key in schema.get("required", ()) else ""
        yield f"| `{key}`{needed} | {_type(field)} | {_default(field)} | {_plain(field.get('description', ''))} |"


def _type(schema: dict[str, Any]) -> str:
    """A schema in a few words; a model as a link to its table."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix(_MODELS)
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_type(one) for one in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if schema.get("type") == "array":
        return f"list of {_type(schema['items'])}" if schema.get("items") else "list"
    if schema.get("type") == "object" and "properties" in schema:
        return "form with " + ", ".join(f"`{key}`" for key in schema["properties"])
    return str(schema.get("format") if schema.get("format") == "binary" else schema.get("type", "any"))


def _default(schema: dict[str, Any]) -> str:
    return f"`{json.dumps(schema['default'])}`" if schema.get("default") is not None else ""


def _plain(text: str) -> str:
    """On one line, and safe in a table; brackets are units, not links."""
    return " ".join(text.split()).replace("|", "\\|").replace("[", "\\[")

"""A heightmap out of a request, as a form or as its raw body, by way of a file and never whole in memory."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import anyio
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from starlette.datastructures import UploadFile

from model.errors import InputError
from service.schemas import UploadOptions
from service.state import Service
from service.store import HeightmapRow

Model = TypeVar("Model", bound=BaseModel)


def media_type(request: Request) -> str:
    """The request's content type without parameters, lower case."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


def validated(model: type[Model], values: Mapping[str, Any], *, where: str) -> Model:
    """`values` as a model. Raises RequestValidationError in the words of FastAPI's own checks."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise invalid(error, where) from error


def invalid(error: ValidationError, where: str) -> RequestValidationError:
    """Pydantic's findings as those of a request; `where` is body, query or the name of a form field."""
    found = error.errors(include_url=False)
    return RequestValidationError([{**e, "loc": (where, *e["loc"])} for e in found])


async def take_raw(request: Request, service: Service, options: UploadOptions) -> HeightmapRow:
    """Keep the heightmap that is the request's whole body."""
    with service.store.upload_file() as path:
        async with await anyio.open_file(path, "wb") as out:
            async for chunk in request.stream():
                await out.write(chunk)
        return await _keep(service, path, options, filename="upload")


async def take_form(form: Mapping[str, Any], service: Service, options: UploadOptions) -> HeightmapRow:
    """Keep the heightmap in the form field `file`; form fields win over query parameters."""
    upload = form.get("file")
    if not isinstance(upload, UploadFile):
        raise InputError("the form has no file: send the heightmap as the field `file`", field="file")
    given = {key: value for key, value in form.items() if key not in ("file", "options")}
    fields = validated(UploadOptions, given, where="body")
    options = options.model_copy(update=fields.model_dump(exclude_unset=True))
    filename = PurePosixPath((upload.filename or "upload").replace("\\", "/")).name[:200] or "upload"
    with service.store.upload_file() as path:
        await anyio.to_thread.run_sync(_spill, upload, path)
        return await _keep(service, path, options, filename=filename)


def _spill(upload: UploadFile, path: Path) -> None:
    with path.open("wb") as out:
        shutil.copyfileobj(upload.file, out, 1 << 20)


async def _keep(service: Service, path: Path, options: UploadOptions, *, filename: str) -> HeightmapRow:
    values = options.model_dump(exclude={"name"})
    name = options.name or filename

    def keep() -> HeightmapRow:
        return service.keep_heightmap(path, name=name, **values)

    return await anyio.to_thread.run_sync(keep, limiter=service.ingest_limit)

"""Heightmaps and runs out of a request, as a form or as its raw body, by way of files and never whole in memory."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import anyio
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData, UploadFile

from joulemap.model.errors import InputError
from joulemap.service.http.state import Service
from joulemap.service.schemas.maps import UploadOptions
from joulemap.service.storage.tables import HeightmapRow, RunsRow

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
        await _receive(request, path)
        return await _keep(service, path, options, filename="upload")


async def take_form(form: Mapping[str, Any], service: Service, options: UploadOptions) -> HeightmapRow:
    """Keep the heightmap in the form field `file`; form fields win over query parameters."""
    upload = form.get("file")
    if not isinstance(upload, UploadFile):
        raise InputError("the form has no file: send the heightmap as the field `file`", field="file")
    given = {key: value for key, value in form.items() if key not in ("file", "options")}
    fields = validated(UploadOptions, given, where="body")
    options = options.model_copy(update=fields.model_dump(exclude_unset=True))
    filename = _name_of(upload)
    with service.store.upload_file() as path:
        await anyio.to_thread.run_sync(_spill, upload, path)
        return await _keep(service, path, options, filename=filename)


async def take_raw_run(request: Request, service: Service, *, name: str, **how: Any) -> RunsRow:
    """Keep the run that is the request's whole body. how : as `Service.keep_runs`."""
    with service.store.upload_file() as path:
        await _receive(request, path)
        return await _keep_runs(service, [(name, path)], **how)


async def take_runs(form: FormData, service: Service, **how: Any) -> RunsRow:
    """Keep the runs in the form fields `file`, all or none. how : as `Service.keep_runs`."""
    uploads = form.getlist("file")
    other = sorted({key for key in form if key != "file"})
    if other:
        raise InputError(
            f"the form has a field {other[0][:80]!r}: every run is sent as the field `file`", field=other[0]
        )
    if not uploads or not all(isinstance(upload, UploadFile) for upload in uploads):
        raise InputError("the form has no file: send every run as the field `file`", field="file")
    with ExitStack() as stack:
        files = []
        for upload in uploads:
            assert isinstance(upload, UploadFile)
            path = stack.enter_context(service.store.upload_file())
            await anyio.to_thread.run_sync(_spill, upload, path)
            files.append((_name_of(upload), path))
        return await _keep_runs(service, files, **how)


async def _keep_runs(service: Service, files: list[tuple[str, Path]], **how: Any) -> RunsRow:
    def keep() -> RunsRow:
        return service.keep_runs(files, **how)

    return await anyio.to_thread.run_sync(keep, limiter=service.ingest_limit)


async def _receive(request: Request, path: Path) -> None:
    async with await anyio.open_file(path, "wb") as out:
        async for chunk in request.stream():
            await out.write(chunk)


def _name_of(upload: UploadFile) -> str:
    return PurePosixPath((upload.filename or "upload").replace("\\", "/")).name[:200] or "upload"


def _spill(upload: UploadFile, path: Path) -> None:
    with path.open("wb") as out:
        shutil.copyfileobj(upload.file, out, 1 << 20)


async def _keep(service: Service, path: Path, options: UploadOptions, *, filename: str) -> HeightmapRow:
    values = options.model_dump(exclude={"name"})
    name = options.name or filename

    def keep() -> HeightmapRow:
        return service.keep_heightmap(path, name=name, **values)

    return await anyio.to_thread.run_sync(keep, limiter=service.ingest_limit)

"""Takes heightmaps and runs out of a request, a form or a raw body, through files and never as a whole in memory."""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator, Mapping
from contextlib import ExitStack, asynccontextmanager
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import anyio
from fastapi import Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData, UploadFile
from starlette.types import Message

from joulemap.model.errors import InputError
from joulemap.model.ranges import LONGEST_NAME
from joulemap.service.http.long_questions import unless_gone
from joulemap.service.http.service import Service
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.storage.tables import HeightmapRow, RunsRow

Model = TypeVar("Model", bound=BaseModel)


def media_type(request: Request) -> str:
    """Return the content type of a request, in lower case and without parameters."""
    return request.headers.get("content-type", "").split(";")[0].strip().lower()


def validated(model: type[Model], values: Mapping[str, Any], *, where: str) -> Model:
    """Return values as a model, checked as FastAPI checks a body."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise invalid(error, where) from error


def invalid(error: ValidationError, where: str) -> RequestValidationError:
    """Return pydantic's findings as those of a request."""
    found = error.errors(include_url=False)
    return RequestValidationError([{**e, "loc": (where, *e["loc"])} for e in found])


@asynccontextmanager
async def arriving(request: Request, service: Service) -> AsyncIterator[Request]:
    """Yield a request whose body takes room while it arrives. Raises StorageFullError where there is none."""
    check = partial(anyio.to_thread.run_sync, service.store.check_room)
    with service.store.upload() as upload:

        async def _receive() -> Message:
            message = await request.receive()
            if upload.arrives(len(message.get("body", b""))):
                await check()
            return message

        declared = request.headers.get("content-length", "0")
        upload.reserve(int(declared) if declared.isdecimal() else 0)
        await check()
        yield Request(request.scope, _receive)


async def take_raw(request: Request, service: Service, options: UploadOptions) -> HeightmapRow:
    """Keep the heightmap that is the whole body of a request."""
    with service.store.upload_file() as path:
        await _receive(request, path)
        return await _keep(request, service, path, options, "upload")


async def take_form(
    request: Request, form: Mapping[str, Any], service: Service, options: UploadOptions
) -> HeightmapRow:
    """Keep the heightmap in the field `file` of a form."""
    upload = form.get("file")
    if not isinstance(upload, UploadFile):
        raise InputError("the form has no file: send the heightmap as the field `file`", field="file")
    given = {key: value for key, value in form.items() if key not in ("file", "options")}
    fields = validated(UploadOptions, given, where="body")
    options = options.model_copy(update=fields.model_dump(exclude_unset=True))
    filename = _name_of(upload)
    with service.store.upload_file() as path:
        await anyio.to_thread.run_sync(_spill, upload, path)
        return await _keep(request, service, path, options, filename)


async def take_raw_run(request: Request, service: Service, *, name: str, **how: Any) -> RunsRow:
    """Keep the run that is the whole body of a request."""
    with service.store.upload_file() as path:
        await _receive(request, path)
        return await unless_gone(request, service.keep_runs([(name, path)], **how))


async def take_runs(request: Request, form: FormData, service: Service, **how: Any) -> RunsRow:
    """Keep the runs in the fields `file` of a form: all of them or none."""
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
        return await unless_gone(request, service.keep_runs(files, **how))


async def _receive(request: Request, path: Path) -> None:
    async with await anyio.open_file(path, "wb") as out:
        async for chunk in request.stream():
            await out.write(chunk)


def _name_of(upload: UploadFile) -> str:
    name = PurePosixPath((upload.filename or "upload").replace("\\", "/")).name
    return "".join(letter for letter in name[:LONGEST_NAME] if letter.isprintable()) or "upload"


def _spill(upload: UploadFile, path: Path) -> None:
    with path.open("wb") as out:
        shutil.copyfileobj(upload.file, out, 1 << 20)


async def _keep(request: Request, service: Service, path: Path, options: UploadOptions, filename: str) -> HeightmapRow:
    values = options.model_dump(exclude={"name"})
    return await unless_gone(request, service.keep_heightmap(path, name=options.name or filename, **values))

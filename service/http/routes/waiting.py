"""The answer to who asks for a job: at once, or with `Prefer: wait=SECONDS` when it is over."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated, Any

import anyio
from fastapi import Header
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from joulemap.service import problems
from joulemap.service.http.state import Service
from joulemap.service.storage.tables import DONE, FAILED

MAX_WAIT_S = 300.0
_WAIT = re.compile(r"(?:^|[,;])\s*wait\s*=\s*\"?(\d{1,18})\"?\s*(?:$|[,;])", re.IGNORECASE)

Prefer = Annotated[str | None, Header(description="`wait=SECONDS` (at most 300) answers when done")]


async def job_answer(
    service: Service,
    job_id: str,
    place: str,
    prefer: str | None,
    *,
    load: Callable[[str], Any],
    answer: Callable[[Any], BaseModel],
) -> JSONResponse:
    """202 with the job, or within the time that the caller waits 201 when it is done and its problem when it failed.

    place : where jobs of its kind are found; load, answer : its row by id, and what is told of it.
    """
    headers = {"Location": f"{place}/{job_id}"}
    match = _WAIT.search(prefer or "")
    if match:
        seconds = min(float(match.group(1)), MAX_WAIT_S)
        headers["Preference-Applied"] = f"wait={seconds:.0f}"
        await service.jobs.wait(job_id, seconds)
    row = await anyio.to_thread.run_sync(load, job_id)
    if row.status == FAILED and row.problem is not None:
        body = {**row.problem, "context": {**row.problem["context"], "job_id": job_id}}
        return problems.response(body, headers)
    told = answer(row).model_dump(mode="json")
    return JSONResponse(told, status_code=201 if row.status == DONE else 202, headers=headers)

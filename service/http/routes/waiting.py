"""The answer to a request for a job: at once, or with `Prefer: wait=SECONDS` once the job has ended."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated, Any

import anyio
from fastapi import Header
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from joulemap.service.http import problem_answers
from joulemap.service.http.service import Service
from joulemap.service.storage.tables import DONE, FAILED

MAX_WAIT_S = 300.0
_WAIT = re.compile(r"(?:^|[,;])\s*wait\s*=\s*\"?(\d{1,18})\"?\s*(?:$|[,;])", re.IGNORECASE)

Prefer = Annotated[str | None, Header(description="`wait=SECONDS` (at most 300): answer once it is done")]


async def job_answer(
    service: Service,
    job_id: str,
    place: str,
    prefer: str | None,
    *,
    load: Callable[[str], Any],
    answer: Callable[[Any], BaseModel],
) -> JSONResponse:
    """Answer 202 with the job; if it ends while the caller waits, 201 with the result or the problem of its failure.

    Parameters
    ----------
    service : Service
        Whose job it is.
    job_id : str
        Its id.
    place : str
        Path of the jobs of its kind.
    prefer : str or None
        The header Prefer.
    load : callable
        Returns the row of an id.
    answer : callable
        Returns the answer's model of a row.

    Returns
    -------
    JSONResponse
        With the job's place in ``Location``.
    """
    headers = {"Location": f"{place}/{job_id}"}
    match = _WAIT.search(prefer or "")
    if match:
        seconds = min(float(match.group(1)), MAX_WAIT_S)
        headers["Preference-Applied"] = f"wait={seconds:.0f}"
        await service.job_events.until_over(job_id, seconds)
    row = await anyio.to_thread.run_sync(load, job_id)
    if row.status == FAILED and row.problem is not None:
        body = {**row.problem, "context": {**row.problem["context"], "job_id": job_id}}
        return problem_answers.response(body, headers)
    found = answer(row).model_dump(mode="json")
    return JSONResponse(found, status_code=201 if row.status == DONE else 202, headers=headers)

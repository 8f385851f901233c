"""What the routes are made of: the service that answers, and the part of a list that is wanted."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query

from service.http.state import Service, get_service, with_kernels

ServiceDep = Annotated[Service, Depends(get_service)]
KernelsDep = Annotated[Service, Depends(with_kernels)]
Limit = Annotated[int, Query(ge=1, le=1000, description="most items to answer")]
Offset = Annotated[int, Query(ge=0, le=10**9, description="items to skip")]

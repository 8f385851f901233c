"""Sends a cost map off to a cluster, tile by tile."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from joulemap.model.errors import DamagedError
from joulemap.service.storage.stats import noise_of_stats
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import HeightmapRow, named_rasters
from joulemap.service.storage.vault import ObjectVault
from joulemap.service.work import tiles, vaulted
from joulemap.service.work.tiles import MapOrder
from joulemap.service.work.vaulted import VaultedOrder

if TYPE_CHECKING:  # which takes half a second to load
    from distributed import Client

Report = Callable[[float], Awaitable[None]]


def order_of(store: Store, costmap_id: str, models_dir: Path) -> MapOrder | VaultedOrder:
    """Return the order of a cost map for its workers, after making the folder of its notes.

    Result: with places that do not depend on where a worker runs. Raises NotFoundError if it was deleted.
    """
    row = store.costmap(costmap_id)
    asked = row.request
    survey = store.heightmap(row.heightmap_id)
    order = MapOrder(
        place=store.lattice_path(row.id).resolve(),
        heightmap=store.path(HeightmapRow, row.heightmap_id).resolve(),
        reading={"filename": survey.name, **noise_of_stats(survey.stats), **store.layers_asked(asked)},
        robot=asked["robot"],
        model=asked["model"],
        spacing_m=asked["spacing_m"],
        headings=asked["headings"],
        models_dir=models_dir,
    )
    store.begin(costmap_id)
    if isinstance(store.vault, ObjectVault):  # what other machines have finished is no file here
        return VaultedOrder(store.vault.url, store.folder.resolve(), order)
    for each in (row.heightmap_id, *named_rasters(asked).values()):
        store.intact_heightmap(each)
    return replace(order, finished=tuple(_intact(store, store.alike(row))))


def _intact(store: Store, costmap_ids: Iterable[str]) -> Iterator[Path]:
    """The folders of those cost maps that are not known to be damaged."""
    for costmap_id in costmap_ids:
        with suppress(DamagedError):
            yield store.lattice_folder(costmap_id).resolve()


async def make(
    client: Client, order: MapOrder | VaultedOrder, *, key: str, priority: float = 0.0, report: Report
) -> Any:
    """Make a cost map on a cluster."""
    from distributed import as_completed

    work: Any = vaulted if isinstance(order, VaultedOrder) else tiles
    sent: list[Any] = []

    def _submit(function: Any, *arguments: Any, name: str | tuple[str, int]) -> Any:
        sent.append(client.submit(function, order, *arguments, key=name, priority=priority))
        return sent[-1]

    try:
        count, missing = await _submit(work.lay_out, name=f"{key}-layout")
        await report((count - len(missing)) / (count + 1))
        building = [_submit(work.build, number, name=(f"{key}-tile", number)) for number in missing]
        left = len(missing)
        async for tile in as_completed(building, loop=client.loop):
            await tile
            tile.release()
            left -= 1
            await report((count - left) / (count + 1))
        return await _submit(work.finish, name=f"{key}-finish")
    finally:  # by name: an error keeps its task, and the next try would be given the same error without being made
        for task in sent:
            task.release()

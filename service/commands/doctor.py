"""`joulemap doctor`: what is installed, what is missing, and where things are kept."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections import defaultdict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer

from joulemap.service.commands.console import JsonFile, Output, extra_of
from joulemap.service.commands.data_directory import DataDir, settings_of

if TYPE_CHECKING:
    from joulemap.service.hosting.settings import Settings

GOOD, MISSING, WRONG = "good", "missing", "wrong"
_STYLES = {GOOD: "green", MISSING: "yellow", WRONG: "bold red"}
_FOR = {
    "server": "joulemap serve and demo, workers, the data directory",
    "train": "joulemap train and distill, networks of other kinds than the shipped one",
    "tours": "joulemap tour",
    "geo": "routes as GeoDataFrame",
    "objects": "JOULEMAP_STORE, an object store",
    "logs": "ROS bags, MCAP and other logs",
    "clouds": "LAS and LAZ point clouds as heightmaps",
    "cluster": "PostgreSQL under several workers",
}
"""What an optional part of the installation is for."""


Finding = dict[str, str]


def doctor(data_dir: DataDir = None, json_file: JsonFile = None) -> None:
    """Say **what is installed and what is missing**: versions, optional formats, data directory, GPU, and what to type.

    The exit code is 1 where something is wrong; what is only missing is optional.

    Example: `joulemap doctor`
    """
    output = Output(json_file)
    found: list[Finding] = []
    for name, looks in _CHECKS.items():
        try:
            found += looks(data_dir)
        except Exception as error:  # a doctor names whatever is broken, and goes on
            extra = extra_of(error)
            words = f"{type(error).__name__}: {str(error)[:300]}" if extra is None else f"without the extra {extra}"
            found.append(_finding(name, WRONG if extra is None else MISSING, words))
    for one in found:
        advice = f" -> {one['advice']}" if one["advice"] else ""
        output.say(f"{one['name']:<18} {one['words']}{advice}", head=f"{one['state']:<7}", style=_STYLES[one["state"]])
    wrong = sum(one["state"] == WRONG for one in found)
    output.document({"findings": found, "wrong": wrong})
    if wrong:
        raise typer.Exit(1)


def _finding(name: str, state: str, words: str, advice: str = "") -> Finding:
    return {"name": name, "state": state, "words": words, "advice": advice}


def _versions(_: Any) -> list[Finding]:
    from joulemap import __version__

    machine = f"{platform.system()} {platform.release()}, {platform.machine()}, {os.cpu_count()} cores"
    return [
        _finding("joulemap", GOOD, __version__),
        _finding("python", GOOD, f"{platform.python_version()}, {sys.executable}"),
        _finding("machine", GOOD, machine),
    ]


def _needed() -> dict[str | None, list[tuple[str, str]]]:
    """State and words of every package that the distribution names, by the extra that brings it."""
    from importlib.metadata import PackageNotFoundError, requires, version  # loads slowly

    from packaging.requirements import Requirement

    found: dict[str | None, list[tuple[str, str]]] = defaultdict(list)
    for need in map(Requirement, requires("joulemap") or ()):
        usual = need.marker is None or need.marker.evaluate({"extra": ""})
        extras = [] if usual or need.marker is None else [e for e in _FOR if need.marker.evaluate({"extra": e})]
        if not usual and not extras:  # for another system, or for developers
            continue
        try:
            there = version(need.name)
        except PackageNotFoundError:
            state, words = MISSING, f"{need.name} is not installed"
        else:
            fits = need.specifier.contains(there, prereleases=True)
            wanted = "" if fits else f" is installed, {need.specifier} is needed"
            state, words = GOOD if fits else WRONG, f"{need.name} {there}{wanted}"
        found[None if usual else extras[0]].append((state, words))
    return found


def _packages(_: Any) -> list[Finding]:
    """What is needed in any case, then each extra."""
    needed = _needed()
    bad = [words for state, words in needed[None] if state != GOOD]
    if bad:
        found = [_finding("requirements", WRONG, "; ".join(bad), "pip install --upgrade joulemap")]
    else:
        found = [_finding("requirements", GOOD, f"{len(needed[None])} packages, all of them as wanted")]
    for extra, purpose in _FOR.items():
        states = needed[extra] or [(MISSING, "this installation does not know it")]  # the metadata of an older one
        worst = max((state for state, _ in states), key=[GOOD, MISSING, WRONG].index)
        words = "; ".join(words for state, words in states if worst == GOOD or state != GOOD)
        advice = "" if worst == GOOD else f"pip install 'joulemap[{extra}]'"
        found.append(_finding(f"extra {extra}", worst, f"{purpose}: {words}", advice))
    return found


def _formats(_: Any) -> list[Finding]:
    import rasterio
    from rasterio.drivers import is_blacklisted

    with rasterio.Env() as environment:
        drivers = environment.drivers()
    wanted = {"GTiff": "GeoTIFF", "COG": "cloud-optimised GeoTIFF", "AAIGrid": "ESRI ASCII grid", "PNG": "PNG"}
    lacking = [words for name, words in wanted.items() if name not in drivers or is_blacklisted(name, "r")]
    words = f"GDAL {rasterio.__gdal_version__}, PROJ {_proj()}"
    if lacking:
        return [
            _finding("geodata", WRONG, f"{words}; GDAL lacks {', '.join(lacking)}", "pip install --upgrade rasterio")
        ]
    return [_finding("geodata", GOOD, words)]


def _proj() -> str:
    import pyproj

    from joulemap.model.terrain.crs_text import transformer

    # Malaga in UTM zone 30N: finds a PROJ whose database is not there
    x, _ = transformer("EPSG:4326", "EPSG:32630").transform(-4.49, 36.72)
    if not 360_000.0 < x < 370_000.0:
        raise RuntimeError(f"PROJ {pyproj.proj_version_str} transforms coordinates wrongly: x {x}")
    return pyproj.proj_version_str


def _model(_: Any) -> list[Finding]:
    from joulemap.service.models import DEFAULT_MODEL, find_predictor

    find_predictor(DEFAULT_MODEL)
    return [_finding("model", GOOD, "the shipped network can be loaded")]


def _gpu(_: Any) -> list[Finding]:
    import torch

    words = f"torch {torch.__version__}, {torch.get_num_threads()} threads"
    if not torch.cuda.is_available():
        return [_finding("gpu", GOOD, f"{words}; no GPU, and none is needed: the processor does everything")]
    names = ", ".join(torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count()))
    return [_finding("gpu", GOOD, f"{words}; {names}")]


def _data(data_dir: Any) -> list[Finding]:
    settings: Settings = settings_of(data_dir=data_dir)
    folder = settings.data_dir.resolve()
    above = next(path for path in (folder, *folder.parents) if path.exists())
    free_mb = shutil.disk_usage(above).free / 1e6
    kept = _plain_url(settings.database_url) if settings.database_url else "SQLite"
    words = f"{folder}{'' if folder.exists() else ' (made when a service starts)'}, {free_mb / 1e3:.1f} GB free; {kept}"
    if settings.store is not None:
        words += f"; everything is kept in {_plain_url(settings.store)}"
    if not os.access(above, os.W_OK):
        return [_finding("data directory", WRONG, f"{words}; {above} cannot be written", "set JOULEMAP_DATA_DIR")]
    if free_mb < settings.min_free_mb:
        needed = f"the service wants {settings.min_free_mb:g} MB"
        return [_finding("data directory", WRONG, f"{words}; {needed}", "free some, or set JOULEMAP_DATA_DIR")]
    return [_finding("data directory", GOOD, words)]


def _plain_url(url: str) -> str:
    """A URL without its password."""
    head, at, tail = url.rpartition("@")
    return f"{head.partition('://')[0]}://...@{tail}" if at else url


def _environment(_: Any) -> list[Finding]:
    from joulemap.service.hosting.settings import Settings

    given = sorted(name for name in os.environ if name.startswith("JOULEMAP_"))
    known = {f"JOULEMAP_{name.upper()}" for name in Settings.model_fields} | {"JOULEMAP_KEY", "JOULEMAP_REAL_DATA"}
    unknown = [name for name in given if name.upper() not in known]
    if unknown:
        return [_finding("environment", WRONG, f"{', '.join(unknown)}: there is no such setting", "see its spelling")]
    return [_finding("environment", GOOD, ", ".join(given) or "no JOULEMAP_ variable is set")]


_CHECKS: dict[str, Callable[[Any], list[Finding]]] = {
    "versions": _versions,
    "requirements": _packages,
    "geodata": _formats,
    "model": _model,
    "gpu": _gpu,
    "data directory": _data,
    "environment": _environment,
}

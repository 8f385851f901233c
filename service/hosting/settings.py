"""What an operator can set, from the environment (JOULEMAP_...), read when a service is made, never at import."""

from __future__ import annotations

import re
from importlib.util import find_spec
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import unquote, urlsplit

from pydantic import Field, ValidationInfo, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from joulemap.service.cluster.address import scheduler_address
from joulemap.service.models import DEFAULT_MODEL

_DATABASES = {("sqlite", "pysqlite"), ("postgresql", "psycopg")}
Names = Annotated[tuple[str, ...], NoDecode]


class Settings(BaseSettings):
    """Settings of a service; a field that is not given is read from ``JOULEMAP_<FIELD>``."""

    model_config = SettingsConfigDict(env_prefix="JOULEMAP_", extra="ignore", allow_inf_nan=False)

    data_dir: Path = Field(
        default=Path("data"), description="folder of everything that is kept: a path or a file:// URL"
    )
    database_url: str | None = Field(default=None, description="SQLAlchemy URL; default: SQLite in the data directory")
    store: str | None = Field(
        default=None,
        pattern=r"^[a-z][a-z0-9+.-]*://.+$",
        description="URL of an object store in which everything is kept, `s3://BUCKET/PREFIX`; the data folder has "
        "copies then; default: the data folder",
    )
    models_dir: Path | None = Field(default=None, description="folder of trained models; default: `models` in data_dir")
    host: str = Field(default="127.0.0.1", description="address to listen on")
    port: int = Field(default=8000, ge=0, le=65535, description="port to listen on")
    max_upload_mb: float = Field(default=512.0, gt=0, description="largest heightmap file [MB = 1e6 bytes]")
    max_json_mb: float = Field(default=8.0, gt=0, description="largest other request body [MB]")
    max_cells: int = Field(default=100_000_000, gt=0, description="most cells a heightmap may have")
    max_lattice_values: int = Field(default=100_000_000, gt=0, description="most rows * cols * headings of a cost map")
    max_cells_in_memory: int = Field(
        default=4_000_000, gt=0, description="most rows * cols of a cost map whose routes are planned in memory"
    )
    route_memory_gb: float = Field(default=1.5, gt=0, description="most memory of a route on a larger cost map [GB]")
    read_processes: int = Field(default=2, gt=0, description="processes that read the files that are sent")
    read_queue_size: int = Field(default=32, gt=0, description="most sent files that wait for one of these processes")
    read_seconds: float = Field(
        default=5.0,
        gt=0,
        description="processor time for reading one sent file, and 1 s more for each 5 MB; six times as much in real "
        "time [s]",
    )
    read_memory_mb: float = Field(
        default=750.0, gt=0, description="memory for reading one sent file, beyond the 220 MB of the process [MB]"
    )
    max_connections: int = Field(
        default=1000,
        ge=8,
        description="most connections that are answered at a time, besides probes, and fewer where the system permits "
        "fewer open files; three times as many may be open",
    )
    client_connections: int | None = Field(
        default=None,
        gt=0,
        description="most connections that are answered at a time of one address, and of one key; default: a quarter "
        "of max_connections",
    )
    client_streams: int | None = Field(
        default=None,
        gt=0,
        description="most streams of server-sent events at a time of one address, and of one key; default: a tenth of "
        "max_connections",
    )
    stalled_s: float = Field(
        default=10.0, gt=0, description="an answer ends of which the client takes nothing for so long [s]"
    )
    trusted_proxies: Names = Field(
        default=(),
        description="addresses or networks of proxies, separated by commas, whose header X-Forwarded-For says from "
        "which address a request comes; default: none, and a client is known by the address that connects",
    )
    queue_size: int = Field(default=32, gt=0, description="most jobs of a kind that wait or run at a time")
    max_run_mb: float = Field(default=64.0, gt=0, description="largest file of one measured run [MB]")
    max_run_rows: int = Field(default=1_000_000, gt=0, description="most rows of one measured run")
    max_run_columns: int = Field(default=2_000, gt=0, description="most columns of one measured run")
    max_run_cells: int = Field(default=20_000_000, gt=0, description="most rows * columns of one measured run")
    max_run_text_mb: float = Field(
        default=200.0, gt=0, description="most memory of the columns of text of one measured run [MB]"
    )
    max_run_km: float = Field(default=200.0, gt=0, description="longest measured run [km]")
    max_runs: int = Field(default=100, gt=0, description="most runs in one upload")
    max_calibration_rows: int = Field(default=1_000_000, gt=0, description="most rows of all runs of a calibration")
    max_calibration_segments: int = Field(default=200_000, gt=0, description="most 1 m segments of all its runs")
    scheduler: str | None = Field(
        default=None,
        description="address of a Dask scheduler, `tcp://HOST:PORT` or `tls://HOST:PORT`, whose workers do the jobs; "
        "default: worker processes of the service's own",
    )
    workers: int = Field(
        default=2,
        ge=0,
        le=1000,
        description="worker processes of the service's own; 0: jobs are left to other services",
    )
    calibrations_at_once: int = Field(default=1, gt=0, description="calibrations of this service that run at a time")
    plan_threads: int | None = Field(
        default=None,
        gt=0,
        description="questions that search or go over a whole cost map at a time; default: one for each core",
    )
    plan_queue_size: int = Field(
        default=128, gt=0, description="most questions of one cost map that wait; of all cost maps four times as many"
    )
    min_free_mb: float = Field(
        default=200.0,
        ge=0,
        description="disk space that stays free: /readyz fails and new work is refused below it [MB]",
    )
    check_every_h: float | None = Field(
        default=None, gt=0, description="hours between checks of what is kept, as `joulemap check` does; default: never"
    )
    log_format: Literal["text", "json"] = Field(default="text", description="form of a line of the log")
    open_costmaps: int = Field(default=3, gt=0, description="cost maps kept in memory for questions")
    allowed_hosts: Names = Field(
        default=(),
        description="further names by which the service is called, separated by commas, besides localhost, 127.0.0.1 "
        "and [::1]; `*` for any",
    )
    cors_origins: Names = Field(
        default=(),
        description="web pages that may call the service, like `https://maps.example`, separated by commas",
    )
    basemap_url: str = Field(
        default="",
        pattern=r"^(https?://[A-Za-z0-9.:-]+/\S*)?$",
        description="pictures in Web Mercator that the page can show under a map, like "
        "`https://tiles.example/{z}/{x}/{y}.png`; browsers load them from that host, which sees who looks at which "
        "ground; default: none",
    )
    basemap_attribution: str = Field(
        default="",
        validate_default=True,
        description="whose pictures these are, as their licence wants it said; may be HTML",
    )
    key_requests_per_s: float = Field(
        default=300.0, gt=0, description="most requests per second of one key, over ten seconds"
    )
    key_jobs: int = Field(default=8, gt=0, description="most jobs of one owner that wait or run at a time")
    key_gb: float = Field(default=100.0, gt=0, description="most that one owner keeps [GB = 1e9 bytes]")
    retention_days: float | None = Field(
        default=None, gt=0, description="what was not used for so long is removed [days]; default: never"
    )
    retention_gb: float | None = Field(
        default=None,
        gt=0,
        description="where more is kept, the cost maps are removed that were not used longest [GB]; default: no limit",
    )
    shutdown_s: int = Field(
        default=3, ge=1, description="after SIGTERM, longest time until requests in flight are cut off [s]"
    )
    warm_models: tuple[str, ...] = Field(default=(DEFAULT_MODEL,), description="models loaded at start-up")

    @field_validator("allowed_hosts", "cors_origins", "trusted_proxies", mode="before")
    @classmethod
    def _separated_by_commas(cls, value: str | tuple[str, ...]) -> tuple[str, ...]:
        names = value.split(",") if isinstance(value, str) else value
        return tuple(name.strip().lower().rstrip("/") for name in names if name.strip())

    @field_validator("trusted_proxies")
    @classmethod
    def _networks(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for name in value:
            ip_network(name, strict=False)  # its words say which, and what it is not
        return value

    @field_validator("basemap_url")
    @classmethod
    def _places_of_pictures(cls, value: str) -> str:
        if value and (missing := [name for name in ("{z}", "{x}", "{y}") if name not in value]):
            raise ValueError(f"it lacks {', '.join(missing)}: write `https://HOST/{{z}}/{{x}}/{{y}}.png`")
        if other := set(re.findall(r"\{[^}]*\}?", value)) - {"{z}", "{x}", "{y}"}:
            raise ValueError(f"{', '.join(sorted(other))} is filled with nothing: only {{z}}, {{x}} and {{y}} are")
        if value and not urlsplit(value).hostname:
            raise ValueError("it names no host: write `https://HOST/{z}/{x}/{y}.png`")
        _ = urlsplit(value).port  # raises ValueError where it is none
        return value

    @field_validator("basemap_attribution")
    @classmethod
    def _said_with_its_pictures(cls, value: str, info: ValidationInfo) -> str:
        if info.data.get("basemap_url") and not value.strip():
            raise ValueError("write whose pictures JOULEMAP_BASEMAP_URL names, which the page says beside them")
        return value

    @field_validator("scheduler")
    @classmethod
    def _address(cls, value: str | None) -> str | None:
        """An empty one is none, as compose files pass on what is not set."""
        return scheduler_address(value) if value is not None and value.strip() else None

    @field_validator("database_url")
    @classmethod
    def _known_database(cls, value: str | None) -> str | None:
        """An empty one is none. Its parts are looked at, and nothing is asked of it."""
        if value is None or not value.strip():
            return None
        from sqlalchemy.engine import make_url  # loads slowly
        from sqlalchemy.exc import ArgumentError, NoSuchModuleError

        try:
            url = make_url(value.strip())
            known = (url.get_backend_name(), url.get_driver_name()) in _DATABASES
        except (ArgumentError, NoSuchModuleError, ValueError):
            known = False
        if not known:
            raise ValueError(
                "write `postgresql+psycopg://USER:PASSWORD@HOST:5432/NAME` for a PostgreSQL, or `sqlite:////FOLDER/FILE`"
            )
        if url.get_backend_name() == "postgresql" and find_spec("psycopg") is None:
            raise ValueError("a PostgreSQL needs psycopg: pip install 'joulemap[cluster]'")
        return value.strip()

    @field_validator("data_dir", mode="before")
    @classmethod
    def _folder_of_url(cls, value: str | Path) -> Path:
        """The folder of file:///srv/joulemap is /srv/joulemap; several machines share one that each of them mounts."""
        scheme, colon, rest = str(value).partition(":")
        if not colon or len(scheme) < 2:
            return Path(value)
        if scheme != "file":
            raise ValueError(f"this is a folder: give its path or a file:// URL, and {scheme}: as JOULEMAP_STORE")
        return Path(unquote(rest if not rest.startswith("//") else "/" + rest.lstrip("/")))

    @property
    def resolved_database_url(self) -> str:
        """The database's URL: SQLite in the data directory where none was given."""
        return self.database_url or f"sqlite:///{self.data_dir.resolve() / 'joulemap.db'}"

    @property
    def most_client_connections(self) -> int:
        """Connections of one client: four that take all of theirs are needed to fill the service."""
        return self.client_connections or max(1, self.max_connections // 4)

    @property
    def most_client_streams(self) -> int:
        """Event streams of one client."""
        return self.client_streams or max(1, self.max_connections // 10)

    @property
    def resolved_models_dir(self) -> Path:
        """The folder of trained models: ``models`` in the data directory where none was given."""
        return self.models_dir or self.data_dir / "models"

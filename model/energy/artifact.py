"""A model as a folder of weights.safetensors and config.json: how it is written, read and checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from joulemap.model.energy.architectures import ARCHITECTURES, find_architecture
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.learned import Learned
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError

if TYPE_CHECKING:
    from joulemap.model.energy.architectures.network import Network

WEIGHTS_FILE = "weights.safetensors"
CONFIG_FILE = "config.json"
FORMAT = 2


@dataclass(frozen=True)
class Artifact:
    """A trained network and how it was made.

    Attributes
    ----------
    net : Network
        The network.
    domain : Domain
        Ranges of what it was trained on.
    size : int
        Rows and columns of its input; 0 is replaced by the architecture's usual size.
    spread : Spread
        Its errors on runs that it had not seen.
    costs : DriveCosts
        Of turning, time and speeding up in its runs, beyond straight driving.
    training : mapping
        JSON-able facts: seed, data_hash, runs and run_hashes, held_out (errors on whole runs that were not trained on),
        command, started_from.
    """

    net: Network
    domain: Domain
    size: int = 0
    spread: Spread = field(default_factory=Spread)
    costs: DriveCosts = field(default_factory=DriveCosts)
    training: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.size:
            object.__setattr__(self, "size", find_architecture(self.architecture).input_size(None))

    @property
    def architecture(self) -> str:
        """Name of the network's architecture."""
        return self.net.architecture


def save_artifact(folder: str | Path, artifact: Artifact) -> str:
    """Write a model's folder.

    config.json is written last, so that it marks a complete model.

    Result: the version: the first 16 hex digits of the SHA-256 of the weights file.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    state = {key: value.detach().cpu().contiguous().numpy() for key, value in artifact.net.state_dict().items()}
    data = save(state)
    digest = hashlib.sha256(data).hexdigest()[:16]
    config = {
        "format": FORMAT,
        "architecture": artifact.architecture,
        "version": digest,
        "joulemap": _own_version(),
        "size": artifact.size,
        "network": find_architecture(artifact.architecture).config_of(artifact.net),
        "domain": artifact.domain.as_dict(),
        "spread": artifact.spread.as_dict(),
        "drive_costs": artifact.costs.as_dict(),
        "training": dict(artifact.training),
    }
    (folder / CONFIG_FILE).unlink(missing_ok=True)
    _write(folder / WEIGHTS_FILE, data)
    _write(folder / CONFIG_FILE, (json.dumps(config, indent=2) + "\n").encode())
    return digest


def read_artifact(folder: str | Path) -> Artifact:
    """Read a model's folder."""
    found = _read(Path(folder))
    try:
        net: Network = find_architecture(found.architecture).read(found.network, found.weights, size=found.size)
    except ModelError as error:
        raise ModelError(f"{folder}: {error.message}", **error.context) from error
    return Artifact(net, found.domain, found.size, found.spread, found.costs, found.config.get("training") or {})


def load_artifact(folder: str | Path, *, name: str | None = None) -> Learned:
    """Return the predictor of a model's folder."""
    folder = Path(folder)
    found = _read(folder)
    try:
        return find_architecture(found.architecture).predictor_of_weights(
            found.network,
            found.weights,
            found.domain,
            {"kind": found.architecture, "version": found.config["version"], "config": found.config},
            size=found.size,
            name=name or folder.resolve().name,
            spread=found.spread,
            costs=found.costs,
        )
    except ModelError as error:
        raise ModelError(f"{folder}: {error.message}", **error.context) from error


def predictor_of(artifact: Artifact, provenance: Mapping[str, Any], *, name: str) -> Learned:
    """Make a predictor of an artifact."""
    return find_architecture(artifact.architecture).predictor(
        artifact.net,
        artifact.domain,
        provenance,
        size=artifact.size,
        name=name,
        spread=artifact.spread,
        costs=artifact.costs,
    )


@dataclass(frozen=True)
class _Files:
    """What lies in a model's folder."""

    config: dict[str, Any]
    weights: dict[str, NDArray[Any]]
    architecture: str
    size: int

    @property
    def network(self) -> dict[str, Any]:
        return dict(self.config.get("network") or {})

    @property
    def domain(self) -> Domain:
        return Domain.from_dict(self.config.get("domain") or {})

    @property
    def spread(self) -> Spread:
        return Spread.from_dict(self.config.get("spread") or {})

    @property
    def costs(self) -> DriveCosts:
        return _costs_of(self.config)


def _read(folder: Path) -> _Files:
    """Both files of a folder, which belong together, of an architecture that is known."""
    config = _read_config(folder)
    try:
        data = (folder / WEIGHTS_FILE).read_bytes()
    except OSError as error:
        raise ModelError(f"the model {folder} has no readable {WEIGHTS_FILE}: {error.strerror}") from error
    digest = hashlib.sha256(data).hexdigest()[:16]
    if digest != config.get("version"):
        raise ModelError(
            f"the weights of {folder} (version {digest}) are not those its {CONFIG_FILE} describes "
            f"({config.get('version')}): the folder is damaged or mixed",
            version=digest,
            expected=config.get("version"),
        )
    name, size = str(config.get("architecture")), config.get("size")
    if name not in ARCHITECTURES:
        raise ModelError(
            f"{folder} is of an unknown architecture {name!r}: known are {', '.join(ARCHITECTURES)}", architecture=name
        )
    if not isinstance(size, int):
        raise ModelError(f"{folder / CONFIG_FILE} does not say the size of the network's input", size=str(size))
    try:
        weights = load(data)
    except (SafetensorError, KeyError) as error:  # KeyError: a type of numbers that numpy has not
        raise ModelError(f"{folder / WEIGHTS_FILE} cannot be read: {error}") from error
    return _Files(config, weights, name, size)


def _costs_of(config: Mapping[str, Any]) -> DriveCosts:
    """Costs of driving. Models that version 0.1 trained on runs know that of turning alone, and none of time."""
    if "drive_costs" in config:
        return DriveCosts.from_dict(dict(config["drive_costs"]))
    on_runs = "runs" in (config.get("training") or {})
    return DriveCosts(turn_j_per_rad=float(config.get("turn_j_per_rad", 0.0)), driving_w=None if on_runs else 0.0)


def _read_config(folder: Path) -> dict[str, Any]:
    try:
        config = json.loads((folder / CONFIG_FILE).read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"{folder} is not a trained model: it has no readable {CONFIG_FILE}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{folder / CONFIG_FILE} is not valid JSON: {error}") from error
    if not isinstance(config, dict) or config.get("format") != FORMAT:
        raise ModelError(f"{folder / CONFIG_FILE} is not in the model format {FORMAT} of this version")
    return config


def _write(path: Path, data: bytes) -> None:
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(data)
    partial.replace(path)


def _own_version() -> str:
    try:
        return version("joulemap")
    except PackageNotFoundError:
        return "uninstalled"

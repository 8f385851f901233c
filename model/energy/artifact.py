"""A model as a folder of weights.safetensors and config.json: how it is written, read and checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from joulemap.model.energy.architectures import ARCHITECTURES, find_architecture
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.learned import Facts, Learned
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError

if TYPE_CHECKING:
    from joulemap.model.energy.architectures.contract import Architecture
    from joulemap.model.energy.architectures.network import Network

Made = TypeVar("Made")

WEIGHTS_FILE = "weights.safetensors"
CONFIG_FILE = "config.json"
FORMAT = 2
_CHECKSUM = "checksum"  # of all else in the file; models of version 0.1 have none


@dataclass(frozen=True)
class Artifact:
    """A trained network and how it was made."""

    net: Network  # The network
    domain: Domain  # Ranges of what it was trained on
    size: int = 0  # Rows and columns of its input; 0 is replaced by the architecture's usual size
    spread: Spread = field(default_factory=Spread)  # Its errors on runs that it had not seen
    # Of turning, time and speeding up in its runs, beyond straight driving
    costs: DriveCosts = field(default_factory=DriveCosts)
    # JSON-able facts: seed, data_hash, runs and run_hashes, held_out (errors on whole runs that were not trained on),
    # command, started_from
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
    config[_CHECKSUM] = _sum(config)
    (folder / CONFIG_FILE).unlink(missing_ok=True)
    _write(folder / WEIGHTS_FILE, data)
    _write(folder / CONFIG_FILE, (json.dumps(config, indent=2) + "\n").encode())
    return digest


def read_artifact(folder: str | Path) -> Artifact:
    """Read a model's folder."""
    kind, config, weights, facts = _read(Path(folder))
    net: Network = _of(folder, lambda: kind.read(config.get("network") or {}, weights, size=facts.size))
    return Artifact(net, facts.domain, facts.size, facts.spread, facts.costs, config.get("training") or {})


def load_artifact(folder: str | Path, *, name: str | None = None) -> Learned:
    """Return the predictor of a model's folder."""
    folder = Path(folder)
    kind, config, weights, facts = _read(folder)
    facts = replace(facts, name=name or folder.resolve().name)
    return _of(folder, lambda: kind.predictor_of_weights(config.get("network") or {}, weights, facts))


def predictor_of(artifact: Artifact, *, name: str = "") -> Learned:
    """Make a predictor of an artifact."""
    facts = Facts(artifact.domain, artifact.size, name, spread=artifact.spread, costs=artifact.costs)
    return find_architecture(artifact.architecture).predictor(artifact.net, facts)


def _of(folder: str | Path, make: Callable[[], Made]) -> Made:
    """What is made of a folder, which errors name."""
    try:
        return make()
    except ModelError as error:
        raise ModelError(f"{folder}: {error.message}", **error.context) from error


def _read(folder: Path) -> tuple[Architecture[Any], dict[str, Any], dict[str, NDArray[Any]], Facts]:
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
    facts = _of(
        folder,
        lambda: Facts(
            Domain.from_dict(config.get("domain") or {}),
            size,
            provenance={"kind": name, "version": digest, "config": config},
            spread=Spread.from_dict(config.get("spread") or {}),
            costs=_costs_of(config),
        ),
    )
    return find_architecture(name), config, weights, facts


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
    kept = config.pop(_CHECKSUM, None)
    if kept not in (None, _sum(config)):
        raise ModelError(f"{folder / CONFIG_FILE} is not what was written: the folder is damaged or mixed")
    return config


def _sum(config: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(config).encode()).hexdigest()[:16]


def _write(path: Path, data: bytes) -> None:
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(data)
    partial.replace(path)


def _own_version() -> str:
    try:
        return version("joulemap")
    except PackageNotFoundError:
        return "uninstalled"

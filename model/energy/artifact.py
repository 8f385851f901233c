"""A model as a folder: weights.safetensors and config.json, saved, found again and checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load, save

from joulemap.model.energy.compact import CompactConfig, CompactNet
from joulemap.model.energy.dense import CompactPredictor
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.resnet import ResNetEnergy, ResNetPredictor
from joulemap.model.energy.tensors import Network
from joulemap.model.energy.tracks import PIXEL_M, SQUARE
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import ModelError

WEIGHTS_FILE = "weights.safetensors"
CONFIG_FILE = "config.json"
FORMAT = 2


@dataclass(frozen=True)
class Artifact:
    """A trained network and how it was made.

    domain : what it learned. size : rows and columns of what it reads. spread : how far off it was on runs it had not
    seen. turn_j_per_rad : what its runs took for turning beyond straight driving. training : JSON-able facts: seed,
    data_hash, held_out (errors of whole runs that were not trained on), command, parent (the version it was fine-tuned
    from).
    """

    net: Network
    domain: Domain
    size: int = SQUARE
    spread: Spread = field(default_factory=Spread)
    turn_j_per_rad: float = 0.0
    training: Mapping[str, Any] = field(default_factory=dict)

    @property
    def architecture(self) -> str:
        return "compact" if isinstance(self.net, CompactNet) else "resnet18"


def save_artifact(folder: str | Path, artifact: Artifact) -> str:
    """Write the folder (created where needed; config.json last, so that it marks a whole model). Returns the version.

    The version is the first 16 hex digits of the SHA-256 of the weights file.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    state = {key: value.detach().cpu().contiguous().clone() for key, value in artifact.net.state_dict().items()}
    data = save(state)
    digest = hashlib.sha256(data).hexdigest()[:16]
    network: dict[str, Any] = {"pixel_m": PIXEL_M} if isinstance(artifact.net, CompactNet) else {}
    if isinstance(artifact.net, CompactNet):
        network |= artifact.net.config.as_dict()
    config = {
        "format": FORMAT,
        "architecture": artifact.architecture,
        "version": digest,
        "joulemap": _own_version(),
        "size": artifact.size,
        "network": network,
        "domain": artifact.domain.as_dict(),
        "spread": artifact.spread.as_dict(),
        "turn_j_per_rad": artifact.turn_j_per_rad,
        "training": dict(artifact.training),
    }
    (folder / CONFIG_FILE).unlink(missing_ok=True)
    _write(folder / WEIGHTS_FILE, data)
    _write(folder / CONFIG_FILE, (json.dumps(config, indent=2) + "\n").encode())
    return digest


def read_artifact(folder: str | Path) -> Artifact:
    """The network of a folder. Raises ModelError where a file is missing, broken or not the other's partner."""
    folder = Path(folder)
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
    architecture = config.get("architecture")
    network = dict(config.get("network") or {})
    if architecture == "compact":
        pixel = network.pop("pixel_m", None)
        if pixel != PIXEL_M or config.get("size") != SQUARE:
            raise ModelError(
                f"{folder} reads {config.get('size')} pixels of {pixel} m, this version {SQUARE} of {PIXEL_M}"
            )
        net: Network = CompactNet(CompactConfig.from_dict(network))
    elif architecture == "resnet18":
        net = ResNetEnergy()
    else:
        raise ModelError(f"{folder} is of an unknown architecture {architecture!r}", architecture=architecture)
    try:
        net.load_state_dict(load(data), strict=True)
    except (RuntimeError, SafetensorError) as error:
        raise ModelError(f"the weights of {folder} do not fit its network: {error}") from error
    size = config.get("size")
    if not isinstance(size, int):
        raise ModelError(f"{folder / CONFIG_FILE} does not say the size of a patch", size=str(size))
    domain, spread = Domain.from_dict(config.get("domain") or {}), Spread.from_dict(config.get("spread") or {})
    turn = float(config.get("turn_j_per_rad", 0.0))
    return Artifact(net.eval(), domain, size, spread, turn, config.get("training") or {})


def load_artifact(folder: str | Path, *, name: str | None = None) -> CompactPredictor | ResNetPredictor:
    """The predictor of a folder, called by the folder's name unless told otherwise. Raises ModelError."""
    folder = Path(folder)
    artifact = read_artifact(folder)
    config = _read_config(folder)
    provenance = {"kind": artifact.architecture, "version": config["version"], "config": config}
    name = name or folder.resolve().name
    return predictor_of(artifact, provenance, name=name)


def predictor_of(artifact: Artifact, provenance: Mapping[str, Any], *, name: str) -> CompactPredictor | ResNetPredictor:
    """The predictor that an artifact's network is."""
    known: dict[str, Any] = {"name": name, "spread": artifact.spread, "turn_j_per_rad": artifact.turn_j_per_rad}
    if isinstance(artifact.net, CompactNet):
        return CompactPredictor(artifact.net, artifact.domain, provenance, **known)
    return ResNetPredictor(artifact.net, artifact.domain, provenance, size=artifact.size, **known)


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

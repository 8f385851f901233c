"""How a model is trained on measured runs, and evaluated: `Learner` takes these by the same names."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from joulemap.model.energy.architectures import ARCHITECTURES, DEFAULT_ARCHITECTURE
from joulemap.service.schemas.base import FilePlace, Request

ModelPlace = Annotated[str, Field(json_schema_extra={"format": "model"})]
"""The name of a model, or its folder."""


class EvaluationOptions(Request):
    """What a run's energy is."""

    charge: bool = Field(
        default=False,
        description="take charge [A s] times the robot's nominal voltage as the energy, for logs whose voltage is "
        "wrong; logs without a voltage are always read like this",
    )


class DistillationOptions(EvaluationOptions):
    """What a student learns from the answers of its teacher."""

    start_from: ModelPlace = Field(
        default="default", description="compact model that the student starts from: default, or a folder"
    )
    answers: int = Field(default=20_000, ge=100, description="places and headings that the teacher is asked for")
    epochs: int | None = Field(default=None, ge=1, description="passes over the data; default: 30")
    seed: int = Field(default=0, ge=0, description="the same seed and data give the same weights")


class TrainingOptions(EvaluationOptions):
    """What is trained, and from what."""

    architecture: Literal[tuple(ARCHITECTURES)] = Field(  # type: ignore[valid-type]
        default=DEFAULT_ARCHITECTURE, description="`compact` is fast and dense; `resnet18` is the paper's network"
    )
    start_from: ModelPlace | None = Field(
        default=None,
        description="model to fine-tune: default, a folder, or none for random weights; default: the shipped one for "
        "compact, none for resnet18",
    )
    backbone: FilePlace | None = Field(
        default=None, description="file of ResNet18 weights with torchvision's names (ImageNet's), for resnet18"
    )
    patch_size: int | None = Field(
        default=None,
        ge=32,
        le=512,
        description="rows of a patch of resnet18; 256 in the paper; default: those of `start_from`, else 64",
    )
    epochs: int | None = Field(
        default=None, ge=1, description="most passes over the data; default: 12 for compact, 60 for resnet18"
    )
    seed: int | None = Field(
        default=None, ge=0, description="the same seed and data give the same weights; default: 0, or the shipped one's"
    )
    resume: bool = Field(default=False, description="continue an interrupted training of the same data and settings")

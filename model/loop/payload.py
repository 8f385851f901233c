"""What a logged payload does to the weight that a model reckons with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.energy.domain import Learned
from model.energy.predictor import Predictor
from model.loop.segments import Segments
from model.robot import Robot


def payload_factor(predictor: Predictor, robot: Robot, segments: Segments) -> NDArray[np.float64]:
    """Weight with the logged payload over the declared weight, as far as the model learned of payloads; 1 where none
    was logged. (n,)"""
    logged = segments.extras.get("payload")
    if logged is None or not isinstance(predictor, Learned):
        return np.ones(len(segments))
    known = np.clip(np.nan_to_num(logged), *predictor.domain.payload_kg)
    return np.asarray(1.0 + known / robot.mass_kg)

"""What an architecture is: how a network is built, what it reads, what it answers, how it is trained and asked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from joulemap.model.errors import InputError, ModelError

if TYPE_CHECKING:  # torch takes seconds to load, and not every architecture needs it to be asked
    import numpy as np
    import torch
    from numpy.typing import NDArray
    from torch import Tensor, nn

    from joulemap.model.energy.architectures.network import Network
    from joulemap.model.energy.examples import Examples, FloatArray
    from joulemap.model.energy.learned import Facts, Learned
    from joulemap.model.energy.tensors import ExampleTensors, NetworkOutput
    from joulemap.model.terrain.heightmap import Heightmap

Net = TypeVar("Net", bound="Network")


@dataclass(frozen=True)
class TrainingDefaults:
    """How networks of an architecture are trained on measured runs unless the caller says otherwise.

    Attributes
    ----------
    learning_rate : float
        Of a fresh network, at the start of the cosine.
    fine_tuning_rate : float, optional
        Of a cross-fitted network; None means `learning_rate`.
    batch : int
        Segments per step.
    epochs : int
        Passes over the data, at most.
    copies : int
        Number of directions from which each segment is learned: as driven, and with the world turned by random angles.
    cross_fitted : bool
        Whether a fine-tuning makes one network without each fold of the runs and takes the mean of their weights.
    least_batch : int
        Fewest segments that one step can use: 2 with batch normalisation.
    threads : int, optional
        Threads of a training; None leaves torch's number.
    """

    learning_rate: float = 1e-3
    fine_tuning_rate: float | None = None
    batch: int = 32
    epochs: int = 60
    copies: int = 1
    cross_fitted: bool = False
    least_batch: int = 1
    threads: int | None = None


class Architecture(ABC, Generic[Net]):
    """One kind of network. The project asks this class and never the type of a network.

    A new architecture defines `name`, `size` and the four abstract methods; the others have defaults. An architecture
    has no state: it is made anew wherever it is needed.

    Attributes
    ----------
    name : str
        Key in `ARCHITECTURES`, and the word in config.json and on the command line.
    size : int
        Rows and columns of the input where nobody says otherwise.
    at_once : int
        Segments that one pass may judge without filling the memory.
    training : TrainingDefaults
        How its networks are trained on measured runs.
    shape_free : bool
        Whether `adapted` can leave rolling and climbing alone, which runs without a map are enough for.
    """

    name: ClassVar[str]
    size: ClassVar[int]
    at_once: ClassVar[int] = 256
    training: ClassVar[TrainingDefaults] = TrainingDefaults()
    shape_free: ClassVar[bool] = False

    @abstractmethod
    def build(self, config: Mapping[str, Any], *, size: int) -> Net:
        """Make an untrained network.

        Parameters
        ----------
        config : mapping
            What `config_of` wrote; empty for the usual network.
        size : int
            Rows and columns of its input.

        Returns
        -------
        Network
            With random weights, on the processor.

        Raises
        ------
        ModelError
            If the description does not fit this version.
        """

    @abstractmethod
    def config_of(self, net: Net) -> dict[str, Any]:
        """Describe a network for config.json, so that `build` can make it again.

        Parameters
        ----------
        net : Network
            Of this architecture.

        Returns
        -------
        dict
            JSON-able; becomes `network` in config.json.
        """

    @abstractmethod
    def cut_inputs(
        self,
        heightmap: Heightmap,
        x: FloatArray,
        y: FloatArray,
        heading_rad: FloatArray,
        *,
        size: int,
        turned_rad: FloatArray,
    ) -> NDArray[np.float32]:
        """Cut what the network sees of the ground out of a heightmap.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        x, y : ndarray of float64, (n,)
            Centres of 1 m segments [m].
        heading_rad : ndarray of float64, (n,)
            Headings [rad].
        size : int
            Rows and columns of an input, as from `input_size`.
        turned_rad : ndarray of float64, (n,)
            Angles [rad] by which the world, ground and motion, is turned clockwise before cutting. Inputs that are cut
            along the heading do not change with it.

        Returns
        -------
        ndarray of float32, (n, size, size)
            Heights [m]; NaN throughout where the map does not know one of them.
        """

    @abstractmethod
    def answer(
        self,
        net: Net,
        data: ExampleTensors,
        part: Tensor,
        *,
        leak: float,
        quarter_turns: int = 0,
        mirror: bool = False,
        jitter: float = 0.0,
    ) -> NetworkOutput:
        """Ask a network for the energy of some examples.

        Parameters
        ----------
        net : Network
            Of this architecture, on the device of `data`.
        data : ExampleTensors
            The examples.
        part : Tensor of int64, (B,)
            Which of them.
        leak : float
            Least slope of the energy where the traction is negative: 0 in predictions, 0.02 in training, 1 where the
            traction itself is wanted, which is then the energy without the hotel load.
        quarter_turns : int, optional
            Quarter turns clockwise of ground and heading, after mirroring: an exact augmentation, ignored by inputs
            that are cut along the heading.
        mirror : bool, optional
            Whether ground and heading are mirrored east to west (left to right of inputs along the heading).
        jitter : float, optional
            Standard deviation of the noise on the robot's features, over their ranges.

        Returns
        -------
        NetworkOutput
            Of the B examples.
        """

    def input_size(self, wanted: int | None) -> int:
        """Return the rows and columns that an input has.

        Parameters
        ----------
        wanted : int, optional
            What the caller asks for. An architecture of fixed size ignores it.

        Returns
        -------
        int
            `wanted`, or the usual size.
        """
        return wanted or self.size

    def initial(self, examples: Examples, start_from: Net | None) -> Net:
        """Return the network that a training starts with.

        Parameters
        ----------
        examples : Examples
            What it will learn from.
        start_from : Network, optional
            A network to fine-tune; it is copied.

        Returns
        -------
        Network
            A fresh network or the copy.
        """
        config = {} if start_from is None else self.config_of(start_from)
        net = self.build(config, size=examples.inputs.shape[1])
        if start_from is not None:
            net.load_state_dict(start_from.state_dict())
        return net

    def adapted(self, net: Net, *, level: float, climb: float, shape: float) -> Net:
        """Return a network whose traction differs by what a regression found, before it is fine-tuned.

        Parameters
        ----------
        net : Network
            Of this architecture; it is not changed.
        level : float
            More traction over the weight.
        climb : float
            More traction over the weight and the tangent of the slope.
        shape : float
            Share by which the part for the shape of the ground grows; -1 takes it away.

        Returns
        -------
        Network
            By default the same one: training must then learn all of it.
        """
        return net

    def scaled(self, net: Net, factor: float) -> Net | None:
        """Return a network that asks for more, or less, of everything.

        Parameters
        ----------
        net : Network
            Of this architecture; it is not changed.
        factor : float
            By which its traction, or its energy where it knows no traction, is multiplied.

        Returns
        -------
        Network or None
            A copy; by default None, for which a training can only say that its sums are off.
        """
        return None

    def device(self) -> torch.device:
        """Return where networks of this architecture are trained and asked: the processor."""
        import torch

        return torch.device("cpu")

    def backbone_of(self, net: Net) -> nn.Module | None:
        """Return the part of a network that a training with a frozen backbone leaves as it is.

        Parameters
        ----------
        net : Network
            Of this architecture.

        Returns
        -------
        Module, optional
            None where the architecture has no such part.
        """
        return None

    def from_backbone(self, path: Path) -> Net:
        """Make a network around the weights of a pre-trained backbone.

        Parameters
        ----------
        path : Path
            File of weights.

        Returns
        -------
        Network
            With the backbone's weights, and random ones elsewhere.

        Raises
        ------
        InputError
            If the architecture has no backbone.
        ModelError
            If the file does not fit.
        """
        raise InputError(f"{path}: the architecture {self.name} has no backbone that weights could be read for")

    def predictor(self, net: Net, facts: Facts) -> Learned:
        """Make a predictor of a trained network.

        Parameters
        ----------
        net : Network
            Of this architecture.
        facts : Facts
            What is known of it beside its weights.

        Returns
        -------
        Learned
            By default one that asks for every segment by itself.
        """
        from joulemap.model.energy.segment_predictor import SegmentPredictor

        return SegmentPredictor(self, net, facts)

    def read(self, config: Mapping[str, Any], weights: Mapping[str, NDArray[Any]], *, size: int) -> Net:
        """Make a network with given weights.

        Parameters
        ----------
        config : mapping
            What `config_of` wrote.
        weights : mapping of str to ndarray
            As they are named in the network.
        size : int
            Rows and columns of its input.

        Returns
        -------
        Network
            In evaluation mode.

        Raises
        ------
        ModelError
            If the weights are those of another network.
        """
        import torch

        net = self.build(config, size=size)
        try:
            net.load_state_dict({name: torch.tensor(array) for name, array in weights.items()}, strict=True)
        except RuntimeError as error:
            raise ModelError(f"the weights do not fit the network: {error}") from error
        return net.eval()

    def predictor_of_weights(
        self, config: Mapping[str, Any], weights: Mapping[str, NDArray[Any]], facts: Facts
    ) -> Learned:
        """Make a predictor of the weights of a trained network, as they lie in its file.

        An architecture that can be asked without torch replaces it.

        Parameters
        ----------
        config, weights : mapping
            As of `read`.
        facts : Facts
            What is known of the network beside its weights.

        Returns
        -------
        Learned
            By default that of `predictor`.

        Raises
        ------
        ModelError
            If the weights are those of another network.
        """
        return self.predictor(self.read(config, weights, size=facts.size), facts)


def check_start(architecture: Architecture[Any], start_from: Network | None) -> None:
    """Refuse to fine-tune a network of another architecture.

    Parameters
    ----------
    architecture : Architecture
        What is to be trained.
    start_from : Network, optional
        What the training starts from.

    Raises
    ------
    ModelError
        If the two do not fit together.
    """
    if start_from is not None and start_from.architecture != architecture.name:
        raise ModelError(
            f"the network to start from is of the architecture {start_from.architecture}: "
            f"a {architecture.name} network cannot be fine-tuned from it",
            architecture=start_from.architecture,
        )

"""Body of all networks: a normaliser and an encoder per observation key, dense layers, and a memory on request.

Letters: T steps, E environments, O entries of a vector, C x H x W an image, F features, M numbers of memory.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf, isfinite, prod

import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policies.recurrent import unroll_memory
from aerial_gym.rl_training.policies.set_encoder import SET_FEATURES, SetEncoder
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.sensors.encoder.file import ACTIVATIONS, convolutions

EPSILON = 1e-5  # Added to the variance, as rl-games and Sample Factory do (`RunningMeanStd`, `RunningMeanStdInPlace`)
LIMIT = 5.0  # Normalised numbers are clamped to this, as both libraries do
OUTLIER = 100.0  # Standard deviations beyond which a return is a fault; a true change moves the spread in few updates


class RunningNormalizer(nn.Module):
    """``clamp((x - mean) / sqrt(var + epsilon), +-limit)`` with the mean and variance of all samples so far."""

    mean: Tensor
    var: Tensor
    count: Tensor
    std: Tensor

    def __init__(self, shape: tuple[int, ...] = (), *, limit: float = LIMIT, outlier: float = inf) -> None:
        """Take the shape of a sample; before the first update nothing is changed but clamped.

        Samples are clipped to ``outlier`` standard deviations from the running mean before they count. Statistics never
        decay, so that one impossible reward would otherwise spoil all later values.
        """
        super().__init__()
        self.limit, self.outlier = limit, outlier
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("var", torch.ones(shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("std", torch.ones(shape), persistent=False)
        self.register_load_state_dict_post_hook(lambda module, _: module._update_std())

    def forward(self, samples: Tensor) -> Tensor:
        """Return samples (..., O) normalised and clamped."""
        return ((samples - self.mean) / self.std).clamp(-self.limit, self.limit)

    def inverse(self, normal: Tensor) -> Tensor:
        """Return ``x std + mean``, the inverse of ``forward`` within its limit."""
        return normal * self.std + self.mean

    @torch.no_grad()
    def update(self, samples: Tensor, ranks: Ranks = ALONE) -> None:
        """Update mean and variance by samples, (N, O), of all processes, without waiting.

        Source:
            Chan, Golub, LeVeque (1979), Updating formulae and a pairwise algorithm for computing sample variances, eq. 2.1.
        """
        if isfinite(self.outlier):
            reach = torch.where(self.count > 0.0, self.outlier * self.std, inf)
            samples = samples.clamp(self.mean - reach, self.mean + reach)
        (var, mean), number = ranks.var_mean(samples), samples.shape[0] * ranks.size
        total = self.count + number
        share = (number / total).to(mean.dtype)
        delta = mean - self.mean
        self.var.copy_((1.0 - share) * self.var + share * var + share * (1.0 - share) * delta * delta)
        self.mean.add_(share * delta)
        self.count.copy_(total)
        self._update_std()

    def set_statistics(self, mean: Tensor, var: Tensor) -> None:
        """Take the mean and variance that another library counted."""
        self.mean.copy_(mean)
        self.var.copy_(var)
        self._update_std()

    def _update_std(self) -> None:
        self.std.copy_((self.var + EPSILON).sqrt())


IMAGE_CHANNELS = (16, 32, 64, 64)  # Channels of the image convolutions, each with stride 2
IMAGE_FEATURES = 128  # Number of features of an image


@dataclass(frozen=True, kw_only=True)
class NetworkBodyCfg:
    """Shape of a body."""

    shapes: Mapping[str, tuple[int, ...]]  # Input shapes by observation key: (O,) for a vector, (C, H, W) for an image
    hidden_layers: tuple[int, ...]  # Widths of the layers behind the encoders
    activation: str = "elu"  # `elu`, `relu` or `tanh`
    memory: int = 0  # Numbers of a gated recurrent unit behind the layers; 0: none
    normalize: bool = True  # Whether vectors are normalised by their running mean and deviation
    limit: float = LIMIT  # Limit of normalised numbers
    sets: Mapping[str, int] = field(default_factory=dict)  # Numbers of an entity by the keys that are sets of entities


class NetworkBody(nn.Module):
    """Network from observations to features; its memory is an argument and a result, so that it holds no state."""

    def __init__(self, cfg: NetworkBodyCfg, *, beside: "NetworkBody | None" = None) -> None:
        """Make the layers with torch's initial weights; normalisers of common keys are shared with ``beside``."""
        super().__init__()
        self.cfg, self.memory_size = cfg, cfg.memory
        self.normalizers, self.encoders = nn.ModuleDict(), nn.ModuleDict()
        width = 0
        for key, shape in cfg.shapes.items():
            if len(shape) == 3:
                self.encoders[key] = image_encoder(shape, cfg.activation)
                width += IMAGE_FEATURES
            elif key in cfg.sets and len(shape) == 1 and cfg.sets[key] > 1 and shape[0] % cfg.sets[key] == 0:
                self.encoders[key] = SetEncoder(cfg.sets[key], cfg.activation)
                width += SET_FEATURES
            elif len(shape) == 1 and key not in cfg.sets:
                if cfg.normalize:
                    known = None if beside is None or key not in beside.normalizers else beside.normalizers[key]
                    self.normalizers[key] = known or RunningNormalizer(shape, limit=cfg.limit)
                width += shape[0]
            else:
                raise ConfigError(
                    f"observation {key!r} has shape {shape}: must be a vector (O,), an image (C, H, W), or a vector "
                    f"of whole entities of sets = {dict(cfg.sets)!r}"
                )
        self.layers = dense_layers((width, *cfg.hidden_layers), cfg.activation)
        self.cell = nn.GRUCell(cfg.hidden_layers[-1], cfg.memory) if cfg.memory else None
        self.num_features = cfg.memory or cfg.hidden_layers[-1]

    def input_widths(self, shapes: Mapping[str, Sequence[int]]) -> list[int]:
        """Return the numbers of inputs of the first layer by key, for observations of ``shapes``."""
        features = {key: SET_FEATURES if key in self.cfg.sets else IMAGE_FEATURES for key in self.encoders}
        return [features.get(key) or shapes[key][0] for key in self.cfg.shapes]

    def network_inputs(self, observation: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the input tensors by key, with vectors normalised; weight updates do not change them."""
        return {
            key: self.normalizers[key](observation[key]) if key in self.normalizers else observation[key]
            for key in self.cfg.shapes
            if key in observation
        }

    def forward(self, prepared: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return features (E, F) and memory (E, M) after one step, from prepared keys (E, ...) and memory (E, M)."""
        features = self._encode(prepared)
        if self.cell is None:
            return features, memory
        memory = self.cell(features, memory)
        return memory, memory

    def sequence_outputs(self, prepared: Mapping[str, Tensor], memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return features (T, E, F) of a sequence, and the memory (T, E, M) after each of its steps.

        Args:
            prepared: Keys, (T, E, ...).
            memory: Before the sequence, (E, M).
            begins: Whether an episode begins with this observation, bool, (T, E): the memory is then empty.
        """
        features = self._encode(prepared)
        if self.cell is None:
            return features, memory.expand(len(features), *memory.shape)
        remembered = unroll_memory(self.cell, features, memory, begins)
        return remembered, remembered

    def _encode(self, prepared: Mapping[str, Tensor]) -> Tensor:
        encoders = self.encoders
        parts = [encoders[key](prepared[key]) if key in encoders else prepared[key] for key in self.cfg.shapes]
        return self.layers(torch.cat(parts, dim=-1) if len(parts) > 1 else parts[0])


def dense_layers(widths: tuple[int, ...], activation: str) -> nn.Sequential:
    """Return fully connected layers, each with an activation."""
    parts = [(nn.Linear(before, after), ACTIVATIONS[activation]()) for before, after in pairwise(widths)]
    return nn.Sequential(*(part for pair in parts for part in pair))


class ImageNetwork(nn.Module):
    """Images of any leading dimensions and type as one batch of floats: 8 bits as 0 to 1.

    Where nothing is learned from them, the steps of a sequence are taken one by one: as floats they take much memory.
    """

    def __init__(self, shape: tuple[int, ...], network: nn.Module) -> None:
        super().__init__()
        self.shape, self.network = shape, network  # (C, H, W) of an image, and the network that takes floats of it

    def forward(self, images: Tensor) -> Tensor:
        """Return features (..., F) of images (..., C, H, W)."""
        if images.ndim > 4 and not torch.is_grad_enabled():
            return torch.stack([self(step) for step in images])
        flat = images.reshape(-1, *self.shape)
        floats = flat.to(next(self.network.parameters()).dtype)
        pixels = floats / 255.0 if flat.dtype == torch.uint8 else floats
        return self.network(pixels).reshape(*images.shape[:-3], -1)


def image_encoder(shape: tuple[int, ...], activation: str) -> nn.Module:
    """Return a convolutional network from images (..., C, H, W) to ``IMAGE_FEATURES`` numbers."""
    parts, passed = convolutions(shape, IMAGE_CHANNELS, activation)
    parts += [nn.Flatten(), nn.Linear(prod(passed[-1]), IMAGE_FEATURES), ACTIVATIONS[activation]()]
    return ImageNetwork(shape, nn.Sequential(*parts))

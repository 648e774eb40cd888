"""Image encoder: a variational autoencoder of range images, the convolutions that all image networks share, and its file.

Letters: B images, H x W pixels, C channels, L latents.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.checks import require_count
from aerial_gym.config.loader import convert
from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.config.storage import read_archive, write_archive
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.interop import usual_settings

ACTIVATIONS = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}  # By the name in the settings
SMALLEST_IMAGE = 4  # Layers end where an image would have fewer rows or columns


@dataclass(frozen=True, kw_only=True)
class AutoencoderCfg:
    """Shape of an autoencoder."""

    rows: int  # Pixels in a column, >= 1
    columns: int  # Pixels in a row, >= 1
    latents: int = 64  # Number of latents of an image, >= 1; navigation takes 64
    channels: tuple[int, ...] = (32, 64, 128)  # Channels of the layers, each of which halves the image, each >= 1
    activation: str = "elu"  # `elu`, `relu` or `tanh`

    def __post_init__(self) -> None:
        require_count(self, "rows", "columns", "latents")
        if not self.channels or min(self.channels) < 1:
            raise ConfigError(f"AutoencoderCfg.channels = {self.channels!r}: needs numbers >= 1")
        if self.activation not in ACTIVATIONS:
            raise ConfigError(f"AutoencoderCfg.activation = {self.activation!r}: must be {', '.join(ACTIVATIONS)}")


def convolutions(
    shape: tuple[int, ...], channels: tuple[int, ...], activation: str
) -> tuple[list[nn.Module], list[tuple[int, int, int]]]:
    """Return stride-2 convolutions with activations that shrink an image (C, H, W), and the shapes between them.

    The shapes begin with that of the image; with n layers there are n + 1.
    """
    parts: list[nn.Module] = []
    shapes = [(shape[0], shape[1], shape[2])]
    for wide in channels:
        before, rows, columns = shapes[-1]
        if min(rows, columns) < 2 * SMALLEST_IMAGE:
            break
        parts += [nn.Conv2d(before, wide, kernel_size=3, stride=2, padding=1), ACTIVATIONS[activation]()]
        shapes.append((wide, (rows + 1) // 2, (columns + 1) // 2))
    return parts, shapes


class Autoencoder(nn.Module):
    """Encoder to a normal distribution of latents, and decoder from latents; pixels are shares of the largest distance."""

    def __init__(self, cfg: AutoencoderCfg) -> None:
        """Make the layers, with torch's own first weights."""
        super().__init__()
        self.cfg = cfg
        down, shapes = convolutions((1, cfg.rows, cfg.columns), cfg.channels, cfg.activation)
        channels, rows, columns = shapes[-1]
        width = channels * rows * columns
        self.encoder = nn.Sequential(*down, nn.Flatten())
        self.mean, self.log_variance = nn.Linear(width, cfg.latents), nn.Linear(width, cfg.latents)
        up: list[nn.Module] = [nn.Linear(cfg.latents, width), nn.Unflatten(1, (channels, rows, columns))]
        for before, after in zip(reversed(shapes[1:]), reversed(shapes[:-1]), strict=True):
            up += [
                ACTIVATIONS[cfg.activation](),
                nn.Upsample(size=after[1:]),
                nn.Conv2d(before[0], before[0], 3, padding=1),
            ]
            up += [ACTIVATIONS[cfg.activation](), nn.Conv2d(before[0], after[0], 3, padding=1)]
        self.decoder = nn.Sequential(*up)

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and logarithm of the variance of the latents, (B, L) each, of images (B, H, W)."""
        features = self.encoder(images.unsqueeze(1))
        return self.mean(features), self.log_variance(features)

    def decode(self, latents: Tensor) -> Tensor:
        """Return images (B, H, W) of latents (B, L)."""
        return self.decoder(latents).squeeze(1)


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Return the divergence of normal distributions of latents from a standard one [nat], (B,); both (B, L).

    Source: Kingma and Welling (2014), Auto-Encoding Variational Bayes, appendix B.
    """
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)


def negative_evidence(images: Tensor, decoded: Tensor, mean: Tensor, log_variance: Tensor) -> Tensor:
    """Return the bound of an image's negative log evidence [nat], up to a constant: ``H W ln(sigma) + divergence``.

    The standard deviation of a pixel is its maximum-likelihood value for the batch, the root mean squared error, so that no
    weight between the two terms is needed.

    Source:
        Rybkin, Daniilidis, Levine (2021), Simple and Effective VAE Training with Calibrated Decoders, section 3.3.
    """
    pixels = images[0].numel()
    squares = (images - decoded).square().mean().clamp_min(LEAST_VARIANCE)
    return 0.5 * pixels * torch.log(squares) + divergence(mean, log_variance).mean()


LEAST_VARIANCE = 1e-8  # Of a pixel, of shares: 1 mm of 10 m; an image that is explained better is explained
ENCODERS = CONFIG_DIR / "encoders"  # Folder of the encoders that come with the package, `NAME.pt`
FILE_KIND = "encoder"  # Name of the file kind in errors
HOW = "Train one with aerial-gym train-encoder"  # Remedy in most errors


@dataclass(frozen=True, kw_only=True)
class EncoderImageCfg:
    """Image format that a sensor must share with the encoder's training."""

    model: str  # Ray model, as in a sensor file
    kind: str  # `depth` or `range`
    rows: int  # Pixels in a column
    columns: int  # Pixels in a row
    max_range: float  # Longest measured distance [m]
    hfov_deg: float | None  # Horizontal field of view [deg] of a camera; None for other sensors

    def __str__(self) -> str:
        wide = "" if self.hfov_deg is None else f", {self.hfov_deg:g} degrees wide"
        return f"{self.columns} x {self.rows} pixels of {self.model}{wide}, {self.kind} to {self.max_range:g} m"


def encoder_image_format(cfg: RangeSensorCfg) -> EncoderImageCfg:
    """Return the image format of a sensor that an encoder depends on."""
    return EncoderImageCfg(
        model=cfg.model, kind=cfg.kind, rows=cfg.height, columns=cfg.width, max_range=cfg.max_range,
        hfov_deg=getattr(cfg, "hfov_deg", None),
    )  # fmt: skip


def normalize_image(image: Tensor, cfg: RangeSensorCfg) -> Tensor:
    """Return an image of distances as shares of the largest, 0 to 1, in its shape."""
    largest, empty = cfg.largest_and_empty_share
    return torch.where(image >= 0.0, (image / largest).clamp_max(1.0), empty)


class Encoder(nn.Module):
    """The mean of the latents of an image; weights of 16 bits as in the file, computed with in 32.

    Rows of a batch are independent up to rounding, as libraries choose the order of sums by batch size.
    """

    def __init__(self, network: Autoencoder, seen: EncoderImageCfg, *, trained: Mapping[str, object]) -> None:
        """Take a network, its image format, and data of its training (texts and numbers)."""
        super().__init__()
        self.cfg, self.seen, self.trained = network.cfg, seen, dict(trained)
        self.layers = deepcopy(nn.Sequential(network.encoder, network.mean))
        for parameter in self.layers.parameters():
            parameter.data = parameter.data.half().float()
        self.requires_grad_(False).eval()

    @property
    def num_latents(self) -> int:
        """Number of latents, L."""
        return self.cfg.latents

    def forward(self, shares: Tensor) -> Tensor:
        """Return the means of the latents (B, L) of images (B, H, W) of shares of the largest distance."""
        return self.layers(shares.unsqueeze(1))

    def check_fits(self, cfg: RangeSensorCfg, *, name: str, label: str) -> None:
        """Raise ``ConfigError`` if the sensor ``name`` has other images; ``label`` names the encoder."""
        actual = encoder_image_format(cfg)
        if actual != self.seen:
            raise ConfigError(
                f"{label}: knows images of {self.seen}; sensor {name} has {actual}. Choose the robot of its training, "
                f"{self.trained.get('robot', '?')}, or another encoder. {HOW} --robot ROBOT"
            )

    def save(self, path: str | Path) -> None:
        """Write the file; raise ``StorageError`` if that cannot be."""
        model = {name: value.half().cpu() for name, value in self.layers.state_dict().items()}
        payload = {"network": asdict(self.cfg), "seen": asdict(self.seen), "trained": self.trained, "model": model}
        write_archive(path, payload)


def encoder_file(name: str | Path) -> Path:
    """Return the file of an encoder: a path, or the name of one that comes with the package (else ``UnknownNameError``)."""
    path = Path(name)
    if path.suffix == ".pt" or path.exists():
        return path
    own = ENCODERS / f"{name}.pt"
    if not own.exists():
        known = ", ".join(sorted(each.stem for each in ENCODERS.glob("*.pt"))) or "none"
        raise UnknownNameError(f"no encoder {str(name)!r}. Known: {known}, or a file NAME.pt. {HOW}")
    return own


@usual_settings
def load_encoder(name: str | Path, *, device: torch.device | str = "cpu") -> Encoder:
    """Return the encoder in a file, or one that comes with the package; raise ``ConfigError`` for a damaged file."""
    path = encoder_file(name)
    payload = read_archive(path, FILE_KIND)
    try:
        cfg = convert(AutoencoderCfg, payload["network"], str(path))
        seen = convert(EncoderImageCfg, payload["seen"], str(path))
        encoder = Encoder(Autoencoder(cfg), seen, trained=payload["trained"])
        encoder.layers.load_state_dict({name: value.float() for name, value in payload["model"].items()})
    except (KeyError, AttributeError, TypeError, RuntimeError) as error:
        reason = (str(error).strip().splitlines() or [""])[-1].strip()
        raise ConfigError(f"{FILE_KIND} {path}: holds no encoder ({reason}). {HOW}") from None
    bad = [key for key, value in encoder.state_dict().items() if not bool(value.isfinite().all())]
    if bad:
        raise ConfigError(f"{FILE_KIND} {path}: {bad[0]} holds numbers that are NaN or infinite. {HOW}")
    return encoder.to(device)

"""Errors and picture of images, reconstructed from a few numbers: by encoder, principal components, or the mean image.

Letters: N images, H x W pixels, P = H W, L latents.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.storage import storage_errors
from aerial_gym.rl_training.encoder.scenes import ImageSet
from aerial_gym.sensors.encoder.file import Autoencoder, Encoder

NEAR_M = 3.0  # Distance below which a pixel is near [m]: the path of 1.5 s at 2 m/s
MOST_EXACT = 4096  # Pixels up to which principal components come from the covariance; beyond, randomised
ACTIVE = 0.01  # Variance of a mean above which a latent is active. Source: Burda et al. (2016), section 5.2
AT_ONCE = 1024  # Images that are encoded at once
Reconstruction = Callable[[Tensor], Tensor]  # Function from images (N, H, W) to their reconstruction, (N, H, W)


@dataclass(frozen=True, kw_only=True)
class ImageErrors:
    """Pixel errors over all images [m]."""

    rms_m: float  # Root of the mean squared error [m]
    mean_m: float  # Mean absolute error [m]
    near_rms_m: float | None  # RMS error of pixels nearer than `NEAR_M` [m]; None if there is none


def image_errors(told: Tensor, target: Tensor, *, largest: float) -> ImageErrors:
    """Return the errors of images (N, H, W) of shares of a largest distance [m]."""
    error = (told.clamp(0.0, 1.0) - target) * largest
    near = target * largest < NEAR_M
    near_rms = float(error[near].square().mean().sqrt()) if bool(near.any()) else None
    return ImageErrors(rms_m=float(error.square().mean().sqrt()), mean_m=float(error.abs().mean()), near_rms_m=near_rms)


def reconstruct_by_mean(train: ImageSet) -> Reconstruction:
    """Return the mean of the targets for every image."""
    mean = train.target.mean(0)
    return lambda seen: mean.expand_as(seen)


def reconstruct_by_components(train: ImageSet, latents: int) -> Reconstruction:
    """Return the reconstruction from the first principal components of the images, by least squares. With equal target and
    image this is the optimal linear encoder and decoder of this size on its training images (Eckart and Young 1936)."""
    seen, target = train.seen.flatten(1), train.target.flatten(1)
    mean, aim = seen.mean(0), target.mean(0)
    centred = seen - mean
    if seen.shape[1] <= MOST_EXACT:
        _, vectors = torch.linalg.eigh((centred.T @ centred).double())
        basis = vectors.flip(1)[:, :latents].float()
    else:
        basis = torch.pca_lowrank(centred, q=min(latents + 16, len(seen)), center=False, niter=4)[2][:, :latents]
    numbers = centred @ basis
    gram = (numbers.T @ numbers).double()
    back = torch.linalg.lstsq(gram.cpu(), (numbers.T @ (target - aim)).double().cpu(), driver="gelsd").solution
    decoder = back.float().to(seen.device)
    return lambda images: (aim + (images.flatten(1) - mean) @ basis @ decoder).reshape(images.shape)


def reconstruct_by_encoder(encoder: Encoder, network: Autoencoder) -> Reconstruction:
    """Return the reconstruction by the decoder from the means of an encoder."""

    @torch.no_grad()
    def reconstruct(images: Tensor) -> Tensor:
        return torch.cat([network.decode(encoder(part)) for part in images.split(AT_ONCE)])

    return reconstruct


@torch.no_grad()
def count_active_latents(encoder: Encoder, images: Tensor) -> int:
    """Return the number of latents with a variance above ``ACTIVE`` over images (N, H, W)."""
    means = torch.cat([encoder(part) for part in images.split(AT_ONCE)])
    return int((means.var(0) > ACTIVE).sum())


def draw_reconstructions(rows: Mapping[str, Tensor], path: Path, *, largest: float) -> None:
    """Write images of shares of a largest distance [m], (N, H, W) of each row by its title, near ones dark."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(next(iter(rows.values())))
    _, height, width = next(iter(rows.values())).shape
    figure = Figure(figsize=(1.9 * count + 0.8, 2.1 * len(rows) * height / width + 0.6), dpi=100, layout="constrained")
    axes = figure.subplots(len(rows), count, squeeze=False)
    shown = None
    for line, (title, images) in zip(axes, rows.items(), strict=True):
        for place, image in zip(line, images, strict=True):
            shown = place.imshow(image.cpu().numpy() * largest, vmin=0.0, vmax=largest, cmap="viridis")
            place.set_xticks([])
            place.set_yticks([])
        line[0].set_ylabel(title, fontsize=9)
    if shown is not None:
        figure.colorbar(shown, ax=axes, label="m", shrink=0.8)
    with storage_errors(path):
        FigureCanvasAgg(figure).print_figure(path)

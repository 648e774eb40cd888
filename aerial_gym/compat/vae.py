"""The image encoder of the Aerial Gym Simulator: encoders of this package. Letters: E images, H x W pixels, L latents."""

import logging
from pathlib import Path
from typing import Any, NoReturn

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.interop import resolve_device
from aerial_gym.sensors.encoder.file import HOW, load_encoder

STANDARD_ENCODER = "collision_40x24"  # In place of that simulator's weights, which are not here


class VAEImageEncoder:
    """Mean latents of depth images, by a file of ``aerial-gym train-encoder``, or by ``STANDARD_ENCODER`` without one."""

    def __init__(self, config: Any, device: str | torch.device = "auto") -> None:
        """Load the encoder; raise ``ConfigError`` if it has another number of latents than the configuration."""
        self.config, file = config, Path(config.model_folder, config.model_file)
        if not file.is_file():
            logging.getLogger(__name__).warning(
                f"model_file = {str(file)!r}: no such file; weights of that simulator are not here. The encoder "
                f"{STANDARD_ENCODER!r} takes its place, so train policies again. {HOW}"
            )
        self.encoder = load_encoder(file if file.is_file() else STANDARD_ENCODER, device=resolve_device(str(device)))
        latents = self.encoder.num_latents
        if latents != config.latent_dims:
            raise ConfigError(
                f"latent_dims = {config.latent_dims!r}: the encoder has {latents}. {HOW} --latents NUMBER"
            )

    @torch.no_grad()
    def encode(self, image_tensors: Tensor) -> Tensor:
        """Return the latents (E, L) of images (E, H, W), shares of the largest distance; a negative one is near."""
        images = image_tensors.reshape(-1, 1, *image_tensors.shape[-2:]).clamp(0.0, 1.0)
        size = (self.encoder.cfg.rows, self.encoder.cfg.columns)
        return self.encoder(interpolate(images, size, mode=self.config.interpolation_mode).squeeze(1))

    def decode(self, latent_spaces: Tensor) -> NoReturn:
        """Refuse: encoder files have no decoder."""
        raise CapabilityError("decode: encoder files have no decoder. aerial-gym train-encoder draws decoded images")

    def get_latent_dims_size(self) -> int:
        """Return the number of latents L."""
        return self.encoder.num_latents

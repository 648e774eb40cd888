"""Encoder latents of the first range sensor's image, made when a term reads them.

Letters: E environments, L latents.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SensorManager
from aerial_gym.sensors.encoder.file import HOW, Encoder, load_encoder, normalize_image
from aerial_gym.task.terms.observations import LATENTS
from aerial_gym.task.values import Values
from aerial_gym.task.vision.cells import first_sensor


class Latents:
    """Declares the buffer ``LATENTS`` of a task, and encodes each image."""

    def __init__(self, sensors: SensorManager, gtd: GlobalTensorDictionary, *, robot: str, encoder: str | None) -> None:
        """Take the sensors, the dictionary with their images, what a message calls the robot, and the encoder by its name.

        The encoder is loaded when a term reads its latents.
        """
        self._sensors, self._gtd, self._robot, self._name = sensors, gtd, robot, encoder
        self._encoder: Encoder | None = None
        self._latents: Tensor | None = None

    @property
    def buffer_makers(self) -> Mapping[str, Callable[..., Tensor]]:
        """Return the functions that make this buffer for ``Values``, by its name."""
        return {LATENTS: self._declare}

    @torch.no_grad()
    def measure(self) -> None:
        """Write the latents of the present image; launched, not waited for."""
        if self._encoder is not None and self._latents is not None:
            self._latents.copy_(self._encoder(normalize_image(self._image, self._cfg)))

    def _declare(self, values: Values, reader: str) -> Tensor:
        sensor = first_sensor(self._sensors, reader, robot=self._robot)
        if self._name is None:
            raise ConfigError(
                f"{reader}: needs an encoder: --encoder FILE, encoder: FILE in a task, or make_task(encoder=...). {HOW}"
            )
        self._image, self._cfg = self._gtd["depth_range_pixels"][:, 0], self._sensors.casters[sensor].cfg
        encoder = load_encoder(self._name, device=self._gtd.device)
        encoder.check_fits(self._cfg, name=sensor, label=f"encoder {self._name}")
        meaning = f"latents of the image of {sensor} by encoder {self._name}"
        self._encoder = encoder
        self._latents = values.declare(LATENTS, (encoder.num_latents,), meaning=meaning)
        return self._latents

"""Raw image observations: distances, ids or colours as shares of a largest value, in 8, 16 or 32 bits, with history.

Letters: E environments, S sensors, H x W pixels, P numbers of an image (S H W, and K for each of these with colours).
"""

from collections.abc import Mapping

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.sensors import SensorManager
from aerial_gym.task.kernels.frames import make_frame_kernel
from aerial_gym.task.values import Values

TYPES = {
    "uint8": (torch.uint8, wp.uint8),
    "float16": (torch.float16, wp.float16),
    "float32": (torch.float32, wp.float32),
}
"""Of torch and of Warp, by the name in a configuration."""


class TaskImages:
    """The images that a task gives, by name, (E, history S, H, W) or with the components of a pixel behind."""

    def __init__(self, cfgs: Mapping[str, ImageCfg], values: Values, sensors: SensorManager) -> None:
        """Declare the images and make their launches; raise ``UnknownNameError`` if the robot has no such image."""
        self.frames: dict[str, Tensor] = {}  # Observed images by name, overwritten by every step
        begun = values.find("begun", "images")
        all_rows, none = torch.ones_like(begun), torch.zeros_like(begun)
        self._kept_alive: list[Tensor] = [begun, all_rows, none]
        self._of_step: list[ReusableLaunch] = []
        self._of_reset: list[ReusableLaunch] = []
        if cfgs:
            start_warp()
        for name, cfg in cfgs.items():
            image = values.find(cfg.key, f"image {name!r}")
            kind, warp_kind = TYPES[cfg.dtype]
            envs, count, *pixels = image.shape
            shape = (cfg.history * count, *pixels)
            frames = values.declare(f"image_{name}", shape, dtype=kind, meaning=f"image {name!r} of the task")
            largest, empty = image_scale(image, cfg, sensors)
            source = wp.int32 if image.dtype == torch.int32 else wp.float32
            flat, target = image.reshape(envs, -1), frames.view(envs, cfg.history, -1)
            scale = (largest, 255.0 if cfg.dtype == "uint8" else 1.0, empty)
            self._kept_alive += [image, frames]
            self.frames[name] = frames
            for launches, mask, new in ((self._of_step, all_rows, none), (self._of_reset, begun, begun)):
                launches.append(
                    ReusableLaunch(
                        make_frame_kernel(source, warp_kind, cfg.history),
                        dim=tuple(flat.shape),
                        inputs=[flat, mask, new, *scale],
                        outputs=[target],
                        device=image.device,
                    )
                )

    def write_frames(self, *, begun: bool) -> None:
        """Write the present images; launched on torch's current stream, not waited for.

        ``begun``: of the environments whose episode has just begun, and as all frames; otherwise of all, as the newest one.
        """
        for launch in self._of_reset if begun else self._of_step:
            launch.launch(self._kept_alive[0])


def image_scale(image: Tensor, cfg: ImageCfg, sensors: SensorManager) -> tuple[float, float]:
    """Return the value of an image that maps to 1, in its unit, and the share for an empty (negative) pixel."""
    if "depth" in cfg.key or "disparity" in cfg.key:
        own = [name for name in sensors.casters if cfg.key.startswith(f"{name}_")]
        largest, empty = sensors.casters[own[0] if own else next(iter(sensors.casters))].cfg.distance_scale
    else:
        largest, empty = (255.0 if image.dtype == torch.int32 else 1.0), 0.0
    return (largest if cfg.largest is None else cfg.largest), empty

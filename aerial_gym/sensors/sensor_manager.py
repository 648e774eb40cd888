"""The sensor manager: the cameras of a robot, their images in the GTD, and when they are taken.

Letters: E environments, S sensors of one kind, H x W pixels.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.views import check_tensor
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.errors import ShapeError
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.sensors.ray_caster import RayCaster

_OWNER = "SensorManager"


class SensorManager:
    """Owns the images. The first camera has the plain keys, a further one has its own name in front of them."""

    def __init__(
        self,
        cfgs: Mapping[str, CameraCfg],
        gtd: GlobalTensorDictionary,
        scene: Scene,
        *,
        position: Tensor,
        attitude: Tensor,
        num_envs: int,
        device: torch.device,
    ) -> None:
        """Declare the images and make a ray caster for each camera.

        Args:
            cfgs: Cameras by name, in order.
            gtd: Receives ``depth_range_pixels`` (E, S, H, W) and, if the camera segments, ``segmentation_pixels``; for
                further cameras ``<name>_depth_range_pixels`` and ``<name>_segmentation_pixels``.
            scene: What they see.
            position: Body origin [m], world, (E, 3), strided or not; read at every capture.
            attitude: Body to world, xyzw, unit, (E, 4), likewise.
            num_envs: Number of environments E.
            device: Where the tensors are.

        Raises:
            ShapeError: If a tensor does not fit.
        """
        if num_envs != scene.num_envs:
            raise ShapeError(f"num_envs = {num_envs}: the scene has {scene.num_envs} environments")
        self._num_envs, self._device = num_envs, torch.device(device)
        self.casters: dict[str, RayCaster] = {}
        for name, cfg in cfgs.items():
            first = not self.casters
            if first:
                for letter, size in (("S", 1), ("H", cfg.height), ("W", cfg.width)):
                    gtd.define_size(letter, size)
            shape = ("E", "S", "H", "W") if first else ("E", 1, cfg.height, cfg.width)
            distance, segmentation = _declare_images(gtd, cfg, shape, prefix="" if first else f"{name}_")
            self.casters[name] = RayCaster(
                cfg,
                scene,
                position=position,
                attitude=attitude,
                distance_out=distance,
                segmentation_out=segmentation,
            )

    def capture(self) -> None:
        """Take the images of all cameras from the present poses; launched on torch's current stream, not waited for."""
        for caster in self.casters.values():
            caster.cast()

    def reset(self, mask: Tensor) -> None:
        """Put the mounts of masked environments, bool (E,), back in place; images change at the next capture."""
        check_tensor("mask", mask, (self._num_envs,), device=self._device, dtype=torch.bool)
        for caster in self.casters.values():
            caster.reset(mask)


def _declare_images(
    gtd: GlobalTensorDictionary, cfg: CameraCfg, shape: tuple[str | int, ...], *, prefix: str
) -> tuple[Tensor, Tensor | None]:
    kind = "along the optical axis" if cfg.kind == "depth" else "along the ray"
    depth = TensorSpec(
        key=f"{prefix}depth_range_pixels",
        shape=shape,
        unit=f"{cfg.max_range:g} m" if cfg.normalize else "m",
        frame="sensor",
        owner=_OWNER,
        meaning=f"distance {kind}; too far {cfg.far_pixel:g}, too near {cfg.near_pixel:g}",
    )
    ids = TensorSpec(
        key=f"{prefix}segmentation_pixels",
        shape=shape,
        unit="-",
        frame="sensor",
        owner=_OWNER,
        meaning="semantic id of what the pixel sees; nothing -2",
        dtype=torch.int32,
    )
    return gtd.declare(depth), gtd.declare(ids) if cfg.segmentation else None

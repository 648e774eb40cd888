"""Range sensors of a robot: their images in the GTD and their sample times.

Letters: E environments, B vehicles of all of them (E where each has one), S sensors of one kind, H x W pixels.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.scene_arrays import check_tensor
from aerial_gym.config.sensor import RangeSensorCfg, RosetteCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.interop import plain_device, with_usual_settings
from aerial_gym.math.random import Randomness
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.registry.state import add_prefix
from aerial_gym.sensors.images import CLOCK_MARGIN, DelayLine, declare_images, latency_steps, zero_images_like
from aerial_gym.sensors.mounts import Carrier, OwnLinks, Pose

if TYPE_CHECKING:
    from aerial_gym.sensors.ray_caster import RayCaster

_OWNER = "SensorManager"


@with_usual_settings
class SensorManager:
    """Owner of the images. The first sensor has the plain keys, the keys of others are prefixed by their names."""

    casters: "dict[str, RayCaster]"

    def __init__(
        self, cfgs: Mapping[str, RangeSensorCfg], gtd: GlobalTensorDictionary, scene: Scene, body: Carrier, *,
        num_envs: int, device: torch.device, dt: float | None = None, random: Randomness | None = None,
        poses: Mapping[str, Pose | None] | None = None, carriers: Mapping[str, Carrier] | None = None,
        own: OwnLinks | None = None,
    ) -> None:  # fmt: skip
        """Declare the images and make a ray caster for each sensor.

        Args:
            gtd: Receives the keys of ``IMAGES`` that a sensor has, (B, S, H, W) or (B, S, H, W, 2 or 3); for further sensors
                with ``<name>_`` in front.
            body: With velocities for sensors with optical flow or a scan time.
            dt: Time between two captures [s]; needed by sensors with a rate or a latency.
            poses: Of mounts in the body frame, instead of the nominal placement of a sensor, by its name.
            carriers: Links that carry sensors, by the names of these; the others sit on the body.
            own: Links of the vehicles, among those that the scene shows.
            num_envs: Number of vehicles B.
        """
        if cfgs and num_envs % scene.num_envs:
            raise ShapeError(f"num_envs = {num_envs}: the scene has {scene.num_envs} environments")
        self._num_envs, self._device, self._dt = num_envs, plain_device(device), dt
        self.casters = {}
        self._clock: dict[str, Tensor] = {}
        self._delay: dict[str, DelayLine] = {}
        for name, cfg in cfgs.items():
            from aerial_gym.sensors.ray_caster import RayCaster  # only here: an import of Warp functions takes long

            self._check_timing(name, cfg)
            carrier = (carriers or {}).get(name, body)
            first = not self.casters
            if first:
                for letter, size in (("S", cfg.count), ("H", cfg.height), ("W", cfg.width)):
                    gtd.define_size(letter, size)
            shape = ("E", "S", "H", "W") if first else ("E", cfg.count, cfg.height, cfg.width)
            seen = declare_images(gtd, cfg, shape, prefix="" if first else f"{name}_", owner=_OWNER)
            steps = latency_steps(cfg.latency_s, self._dt) if self._dt else 0
            taken = zero_images_like(seen) if steps else seen
            if steps:
                self._delay[name] = DelayLine(taken, seen, steps)
            self.casters[name] = RayCaster(
                cfg, scene, taken, carrier, random=random, number=len(self.casters), pose=(poses or {}).get(name),
                own=own,
            )  # fmt: skip
            if cfg.rate_hz is not None:
                self._clock[name] = torch.full((num_envs,), 1.0 / cfg.rate_hz, device=device)

    def _check_timing(self, name: str, cfg: RangeSensorCfg) -> None:
        for field in ("rate_hz", "latency_s"):
            if getattr(cfg, field) and self._dt is None:
                raise ConfigError(f"sensor {name}: {field} = {getattr(cfg, field)!r} needs the length of a step")
        if isinstance(cfg, RosetteCfg) and (cfg.rate_hz or 0.0) * (self._dt or 0.0) > 1.0 + CLOCK_MARGIN:
            raise ConfigError(
                f"sensor {name}: rate_hz = {cfg.rate_hz!r}: must be at most {1.0 / (self._dt or 1.0):g}, one frame a step, so "
                "that its scan keeps time. Make steps shorter, or frames longer (more columns)"
            )

    def capture(self, mask: Tensor | None = None) -> None:
        """Take the images that are due from the present poses; launched on torch's current stream, not waited for.

        With a mask, bool (B,), the other vehicles are neither read nor advanced.

        Images of a sensor with a latency appear that much later, rounded to whole steps; after a reset the first image of a
        vehicle appears at once.

        A sensor without a rate takes an image at every call. One with a rate keeps its last image between its sample times,
        which count from the reset of each vehicle.
        """
        for name, clock in self._clock.items():
            caster = self.casters[name]
            period = 1.0 / (caster.cfg.rate_hz or 1.0)
            torch.ge(clock, (1.0 - CLOCK_MARGIN) * period, out=caster.due)
            if mask is not None:
                caster.due.logical_and_(mask)
            passed = (self._dt or 0.0) if mask is None else (self._dt or 0.0) * mask
            clock.sub_(period * caster.due).add_(passed)
        for name, caster in self.casters.items():
            if mask is not None and name not in self._clock:
                caster.due.copy_(mask)
            caster.cast()
            if mask is not None and name not in self._clock:
                caster.due.fill_(True)
        for delay in self._delay.values():
            delay.push_images(mask)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        parts: list[tuple[str, Mapping[str, Tensor]]] = [("clock", self._clock)]
        parts += [(f"caster.{name}", caster.state_tensors()) for name, caster in self.casters.items()]
        parts += [(f"delay.{name}", delay.state_tensors()) for name, delay in self._delay.items()]
        return {name: tensor for prefix, part in parts for name, tensor in add_prefix(prefix, part).items()}

    def draws(self) -> dict[str, Tensor]:
        """Return the poses of sensors with random placement: position [m], (E, S, 3), and attitude, (E, S, 4), body."""
        poses = {}
        for name, caster in self.casters.items():
            if caster.places.is_drawn:
                poses[f"sensors.{name}.position"] = caster.places.position
                poses[f"sensors.{name}.attitude"] = caster.places.attitude
        return poses

    def reset(self, mask: Tensor) -> None:
        """Reset the mounts of masked vehicles, bool (B,); their images are due at the next capture."""
        check_tensor("mask", mask, (self._num_envs,), device=self._device, dtype=torch.bool)
        for delay in self._delay.values():
            delay.reset(mask)
        for name, caster in self.casters.items():
            caster.reset(mask)
            if name in self._clock:
                self._clock[name].masked_fill_(mask, 1.0 / (caster.cfg.rate_hz or 1.0))

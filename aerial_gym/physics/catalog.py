"""The table of registered physics backends."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry

if TYPE_CHECKING:
    from aerial_gym.physics.backend import PhysicsBackend

BACKENDS: "Registry[Callable[[], PhysicsBackend]]" = Registry("physics backend")
"""Constructors of backends by name."""

for _name, _place in (
    ("torch", "aerial_gym.physics.torch_backend:TorchBackend"),
    ("warp", "aerial_gym.physics.warp_backend:WarpBackend"),
    ("mujoco", "aerial_gym.physics.mujoco.backend:MujocoBackend"),
    ("mujoco_warp", "aerial_gym.physics.mujoco.backend:MujocoWarpBackend"),
):
    _home = ImportPath(_place)
    BACKENDS.register_later(_name, _home.load, summary=_home.summary)

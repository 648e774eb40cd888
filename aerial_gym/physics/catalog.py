"""The tables of registered physics backends and rotor maps."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import class_converter, instance_converter

if TYPE_CHECKING:
    from aerial_gym.physics.backend import PhysicsBackend
    from aerial_gym.physics.rotor_maps import RotorMap

BACKENDS: "Registry[Callable[[], PhysicsBackend]]" = Registry("physics backend")  # Constructors of backends by name

for _name, _place in (
    ("torch", "aerial_gym.physics.torch_backend:TorchBackend"),
    ("warp", "aerial_gym.physics.warp_backend:WarpBackend"),
    ("mujoco", "aerial_gym.physics.mujoco.backend:MujocoBackend"),
    ("mujoco_warp", "aerial_gym.physics.mujoco.backend:MujocoWarpBackend"),
):
    _home = ImportPath(_place)
    BACKENDS.register_later(_name, _home.load, summary=_home.summary)

BACKENDS.accept_plugins(backend=class_converter())

ROTOR_MAPS: "Registry[RotorMap]" = Registry("rotor map")  # Functions of a rotor's speed by name (`RotorCfg.rotor_map`)
_home = ImportPath("aerial_gym.physics.rotor_maps:PolynomialMap")
ROTOR_MAPS.register_later("polynomial", _home.make, summary=_home.summary)
ROTOR_MAPS.accept_plugins(rotor_map=instance_converter("aerial_gym.physics.rotor_maps:RotorMap"))

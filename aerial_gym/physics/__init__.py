"""Rigid body, rotors, effects, and the backends that advance them."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.physics.backend import Capabilities, ControlLaw, PhysicsBackend
    from aerial_gym.physics.catalog import BACKENDS, ROTOR_MAPS
    from aerial_gym.physics.effects import EFFECTS
    from aerial_gym.physics.ground import Ground
    from aerial_gym.physics.integrators import INTEGRATORS
    from aerial_gym.physics.model import Model, build_model, effects_from_config
    from aerial_gym.physics.rigid_body import Accelerations, accelerations, condition_in
    from aerial_gym.physics.rotor_maps import RotorMap, rotor_state_for_thrust
    from aerial_gym.physics.state import BodyState, state_at_rest
    from aerial_gym.physics.substep_hook import SubstepHook, Trajectory
    from aerial_gym.physics.torch_backend import TorchBackend, advance, advance_remembering
    from aerial_gym.physics.vehicle import Vehicle, vehicle_from_config
    from aerial_gym.physics.warp_backend import WarpBackend

__all__ = [
    "BACKENDS", "EFFECTS", "INTEGRATORS", "ROTOR_MAPS", "Accelerations", "BodyState", "Capabilities", "ControlLaw",
    "Ground", "Model", "PhysicsBackend", "RotorMap", "SubstepHook", "TorchBackend", "Trajectory", "Vehicle",
    "WarpBackend", "accelerations", "advance", "advance_remembering", "build_model", "condition_in",
    "effects_from_config", "rotor_state_for_thrust", "state_at_rest", "vehicle_from_config",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)

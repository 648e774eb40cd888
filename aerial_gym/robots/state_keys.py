"""Keys of a robot in the Global Tensor Dictionary.

All states belong to the same instant: the derived ones are refreshed once, after the physics.
Letters: E environments, R rotors, U entries of an action.
"""

from dataclasses import dataclass

from torch import Tensor

from aerial_gym.config.joint import JointsCfg
from aerial_gym.physics import BodyState
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.robots.joints.states import declare_joints
from aerial_gym.robots.secondary_states import FiniteCheck, SecondaryStates


@dataclass(frozen=True, kw_only=True)
class RobotTensors:
    """The robot's tensors in the GTD."""

    state: BodyState  # Written by the physics
    derived: SecondaryStates  # Written after the physics and after a reset
    actions: Tensor  # (E, U)
    prev_actions: Tensor  # (E, U)


def _spec(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> TensorSpec:
    return TensorSpec(key=key, shape=("E", width), unit=unit, frame=frame, owner=owner, meaning=meaning)


def declare_robot_tensors(
    gtd: GlobalTensorDictionary, root_state: Tensor, joints: JointsCfg | None = None
) -> RobotTensors:
    """Declare every key of a robot; ``root_state`` is its row (E, 13) of ``vec_root_tensor``, ``joints`` its joints, if any.

    The physics works on tensors of its own for each quantity: rows of 13 numbers would halve its speed on a GPU, where
    neighbouring threads then touch memory 52 bytes apart (``docs/results/performance.md``).
    """

    def new(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> Tensor:
        return gtd.declare(_spec(key, width, unit, frame, owner, meaning))

    rows = "copy of position, xyzw, velocity, angular velocity; row 0 of vec_root_tensor"
    gtd.declare(_spec("robot_state_tensor", 13, "m, -, m/s, rad/s", "world", "robot", rows), view=root_state)
    state = BodyState(
        position=new("robot_position", 3, "m", "world", "physics", "body origin"),
        attitude=new("robot_orientation", 4, "-", "world", "physics", "body to world, xyzw"),
        lin_vel=new("robot_linvel", 3, "m/s", "world", "physics", "velocity of the origin"),
        ang_vel=new("robot_body_angvel", 3, "rad/s", "body", "physics", "angular velocity"),
        rotor_speed=new(
            "rotor_speed", "R", "rad/s", "-", "physics", "speed of each rotor; in force mode its thrust [N]"
        ),
    )
    if joints is not None:
        state = ArticulatedState(**vars(state), **declare_joints(gtd, joints))
    state.attitude[:, 3] = 1.0
    actions = new("robot_actions", "U", "see controller", "-", "robot", "last action")
    derived = SecondaryStates(
        state,
        root_state=root_state,
        ang_vel_world=new("robot_angvel", 3, "rad/s", "world", "robot", "angular velocity"),
        lin_vel_body=new("robot_body_linvel", 3, "m/s", "body", "robot", "velocity of the origin"),
        vehicle_attitude=new("robot_vehicle_orientation", 4, "-", "world", "robot", "yaw alone, xyzw"),
        vehicle_lin_vel=new("robot_vehicle_linvel", 3, "m/s", "vehicle", "robot", "velocity of the origin"),
        euler=new("robot_euler_angles", 3, "rad", "-", "robot", "ZYX roll, pitch, yaw in (-pi, pi]"),
        checked=FiniteCheck(actions=actions, non_finite=gtd["non_finite"], crashes=gtd["crashes"]),
    )
    return RobotTensors(
        state=state,
        derived=derived,
        actions=actions,
        prev_actions=new("robot_prev_actions", "U", "see controller", "-", "robot", "action before, at the step rate"),
    )

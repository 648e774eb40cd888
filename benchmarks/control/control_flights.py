"""Flights of a robot under a controller: from drawn starts, after a step, in wind, and with rotors at their limits.

All fly in one simulation of 10 s. Environment 0 starts at rest and receives a step. Environment 1 hovers in wind. Environment 2
receives the step, and full climb in the first half second. The others start as a reset draws them (seed 0), with the command to
rest. Drives of joints hold the reference pose; the servo of a tail holds the heading.
Backend `warp` on the CPU; the seed decides every number.
Letters: E environments, R rotors.
"""

from dataclasses import dataclass, replace
from math import inf, isfinite, nan

import torch
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop
from aerial_gym.control.allocation import Allocation
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.joints.tail_servo import derive_tail_servo

GRAVITY = 9.81  # That of every registered sim [m/s²]
STEP, IN_WIND, AT_LIMITS, DRAWN = 0, 1, 2, slice(3, 19)  # Environments

SPAN = 10.0
SAMPLE = 0.02  # Time between two looks at the state [s]
FAR_BELOW = -1000.0  # Height of the ground [m]: a robot with ground effect flies as if there were none
SETTLED = 0.02  # Share of the step

WIND, PUSH = 3.0, 0.1
"""Wind along x [m/s], and what it pushes a resting vehicle with, as a share of the weight. None of the robots that fly in air
declares a drag, so that each is given the one for which this is so, linear in the velocity along body x and y."""

CLIMB, FULL = 100.0, 0.5
"""What is asked upwards, in the units of the command, and for how long [s]: no rotors have as much."""

NEAR_LIMIT = 0.02
"""Of a rotor at a limit: distance from it, as a share of the range of its speed, in force mode of its thrust."""

STEPS = dict.fromkeys(("position", "pose", "steering", "velocity", "acceleration"), 1.0) | {
    "attitude": 0.2,
    "rates": 0.5,
}
UNITS = {
    **{"position": "m", "pose": "m", "steering": "m/s", "velocity": "m/s", "acceleration": "m/s²", "attitude": "rad"},
    "rates": "rad/s",
}
RESPONSES = {
    **{"position": "robot_position", "pose": "robot_position", "attitude": "robot_euler_angles"},
    **{"steering": "robot_vehicle_linvel", "velocity": "robot_vehicle_linvel", "rates": "robot_body_angvel"},
}
"""Key of the response to the command of a law; the acceleration is computed."""

MEANT_FOR = {"lmf2": "lmf2", "magpie": "magpie", "octarotor": "base_octarotor", "rov": "base_rov"}
"""Robots whose gains a controller means by the first part of its name."""


@dataclass(frozen=True)
class ControlFlight:
    """Results of the flights of a robot under a controller at a sim."""

    robot: str
    controller: str
    law: str
    sim: str
    error: float
    """Largest of the drawn starts after 10 s, in ``UNITS``, over what the law controls; infinite where it ended in NaN."""

    settling_s: float  # Until the step stays within 2 %; infinite if it does not
    overshoot: float  # Beyond the step, as a share of it
    tilt_rad: float  # Largest angle between body z and world z of the drawn starts in the last second
    wind_error: float  # In wind after 10 s, in ``UNITS``; NaN under water
    wind_largest: float  # The largest there was
    limit_share: float  # Share of the half second at full thrust in which a rotor is at a limit
    limit_settling_s: float  # Until the step stays within 2 %, from the beginning of that half second on
    limit_overshoot: float  # Beyond the step, as a share of it
    limit_error: float  # After 10 s, in ``UNITS``, over what the law controls
    response: tuple[float, ...]  # To the step, as a share of it, at each sample


def robots_by_dynamics(*, bend: bool = False) -> dict[str, RobotCfg]:
    """Return the registered robots with distinct flight dynamics, by the first name of each: rigid ones, or those with joints.
    Robots on a stand do not fly."""
    result: dict[str, RobotCfg] = {}
    for name in ROBOTS:
        robot = ROBOTS.get(name)
        chosen = robot.joints is not None and robot.joints.floating if bend else robot.joints is None
        if chosen and _flight_key(robot) not in map(_flight_key, result.values()):
            result[name] = robot
    return result


def _flight_key(robot: RobotCfg) -> tuple[object, ...]:
    """Return the parts of a robot's configuration that determine its flight."""
    return robot.body, robot.rotor, robot.mounts, robot.joints, robot.control.buoyancy


def holds_shape(robot: RobotCfg) -> bool:
    """Return whether every drive of a robot takes an angle; other drives do not hold their joints without a joint law."""
    layout = () if robot.joints is None else robot.joints.layout
    return all(joint.drive is None or joint.drive.mode == "position" for joint in layout)


def geometric_controllers(*, derived_gains: bool = True) -> dict[str, ControllerCfg]:
    """Return the registered controllers that take their gains from the robot, or those with gains of their own."""
    known = {name: CONTROLLERS.get(name) for name in CONTROLLERS}
    return {name: cfg for name, cfg in known.items() if cfg.law in STEPS and (cfg.gains is None) == derived_gains}


def robot_controllers() -> dict[str, ControllerCfg]:
    """Return the registered controllers with the gains of one robot, ``target_robot``."""
    return geometric_controllers(derived_gains=False)


def target_robot(controller: str) -> str:
    """Return the robot for whose gains a controller is named."""
    return MEANT_FOR[controller.partition("_")[0]]


def misfit_reason(
    robot: RobotCfg, controller: ControllerCfg, sim: SimCfg | None = None, *, names: tuple[str, str] = ("this", "it")
) -> str:
    """Return the reason why a controller does not fit a robot at a sim (default `base_sim`), or an empty text."""
    sim = SIMS.get("base_sim") if sim is None else sim
    try:
        check_closed_loop(robot, controller, gravity=sim.gravity, dt=sim.dt, integrator=sim.integrator, names=names)
    except ConfigError as error:
        return str(error)
    return ""


def axes_with_torque(robot: RobotCfg) -> tuple[bool, ...]:
    """Return the mask of body axes with torque authority, (3,)."""
    allocation = Allocation(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), GRAVITY)
    return tuple((allocation.torque_authority(robot.body.mass * GRAVITY) > 0.0).tolist())


def fly_robot(robot: RobotCfg, controller: ControllerCfg, sim: SimCfg, *, names: tuple[str, str, str]) -> ControlFlight:
    """Fly a robot and return the results; ``names`` are those of robot, controller and sim."""
    law, can_turn = controller.law, axes_with_torque(robot)
    in_air = robot.control.buoyancy == 0.0
    env = EnvManager(
        sim=sim,
        env=replace(
            ENVIRONMENTS.get("empty_env"), physics_steps_per_env_step=round(SAMPLE / sim.dt), ground_height=FAR_BELOW
        ),
        robot=_add_drag(robot) if in_air else robot,
        controller=controller,
        num_envs=DRAWN.stop,
        device=torch.device("cpu"),
        seed=0,
    )
    env.reset()
    gtd = env.gtd
    _set_hover_states(gtd, robot, in_air=in_air)
    env.robot_manager.refresh_model()
    actions = torch.zeros_like(gtd["robot_actions"])
    drives = DriveCommands(robot, sim.dt)
    channel = {"attitude": 1, "rates": 3 if can_turn[2] else 1}.get(law, 0)
    upwards = 0 if law in ("attitude", "rates") else 2
    actions[[STEP, AT_LIMITS], channel] = STEPS[law]
    axis = channel - 1 if law in ("attitude", "rates") else 0
    low, high = _rotor_limits(robot)
    before, errors, responses, tilts, at_limit = gtd["robot_linvel"].clone(), [], [], [], []
    for sample in range(round(SPAN / SAMPLE)):
        actions[AT_LIMITS, upwards] = CLIMB if sample < round(FULL / SAMPLE) else 0.0
        drives.write_commands(gtd, actions)
        env.step(actions)
        acceleration = (gtd["robot_linvel"] - before) / SAMPLE
        before = gtd["robot_linvel"].clone()
        response = acceleration if law == "acceleration" else gtd[RESPONSES[law]]
        controlled = response[:, :2] if law == "attitude" else response
        controlled = controlled * torch.tensor(can_turn) if law == "rates" else controlled
        wanted = torch.zeros_like(controlled)
        wanted[[STEP, AT_LIMITS], axis] = STEPS[law]
        errors.append((controlled - wanted).norm(dim=-1))
        responses.append(response[:, axis] / STEPS[law])
        x, y, *_ = gtd["robot_orientation"][DRAWN].unbind(-1)
        tilts.append(float(torch.acos((1.0 - 2.0 * (x**2 + y**2)).clamp(-1.0, 1.0)).max()))
        margin = NEAR_LIMIT * (high - low)
        speed = gtd["rotor_speed"][AT_LIMITS]
        at_limit.append(bool(((speed < low + margin) | (speed > high - margin)).any()))
    error, response = torch.stack(errors).nan_to_num(nan=inf), torch.stack(responses)
    settled, overshoot = time_to_settle_and_overshoot(response[:, STEP].tolist())
    limit_settled, limit_overshoot = time_to_settle_and_overshoot(response[:, AT_LIMITS].tolist())
    return ControlFlight(
        robot=names[0], controller=names[1], law=law, sim=names[2],
        error=float(error[-1, DRAWN].max()), settling_s=settled, overshoot=overshoot,
        tilt_rad=max(tilts[-round(1.0 / SAMPLE) :]),
        wind_error=float(error[-1, IN_WIND]) if in_air else nan,
        wind_largest=float(error[:, IN_WIND].max()) if in_air else nan,
        limit_share=sum(at_limit[: round(FULL / SAMPLE)]) * SAMPLE / FULL,
        limit_settling_s=limit_settled, limit_overshoot=limit_overshoot, limit_error=float(error[-1, AT_LIMITS]),
        response=tuple(response[:, STEP].tolist()),
    )  # fmt: skip


class DriveCommands:
    """Drive commands, after those of the law: the reference pose, and for a servo tail the angle that holds the heading."""

    def __init__(self, robot: RobotCfg, dt: float) -> None:
        joints = () if robot.joints is None else robot.joints.layout
        self._held = torch.tensor([joint.reference for joint in joints if joint.drive is not None])
        try:
            self._servo = derive_tail_servo(robot, dt=dt)
        except ConfigError:  # no tail on a servo
            self._servo = None

    def write_commands(self, gtd: GlobalTensorDictionary, actions: Tensor) -> None:
        """Write the commands of a step into the actions."""
        if self._servo is not None:
            ahead = torch.zeros(len(actions))
            self._held = self._servo.command_angle(gtd["robot_orientation"], gtd["robot_body_angvel"], ahead).unsqueeze(
                -1
            )
        actions[:, actions.shape[1] - self._held.shape[-1] :] = self._held


def _add_drag(robot: RobotCfg) -> RobotCfg:
    """Return a robot with effects that ``_set_hover_states`` sets per environment; as they are here they do nothing."""
    still = {"constant_wind": dict.fromkeys("xyz", 0.0), "rotor_drag": dict.fromkeys(("dx", "dy", "dz"), 0.0)}
    return replace(
        robot, effects={**robot.effects, **still}, effects_source="benchmarks.control.control_flights: WIND, PUSH"
    )


def _set_hover_states(gtd: GlobalTensorDictionary, robot: RobotCfg, *, in_air: bool) -> None:
    """Put those that are not drawn to hover at the origin, and one of them into wind."""
    weight = torch.zeros(1, 6)
    weight[:, 2] = robot.body.mass * GRAVITY - robot.control.buoyancy
    hover = Allocation(vehicle_from_config(robot, num_envs=1), GRAVITY).speed_for_wrench(weight)
    gtd["rotor_speed"][: DRAWN.start] = hover
    for key in ("robot_position", "robot_linvel", "robot_body_angvel", "robot_orientation"):
        gtd[key][: DRAWN.start] = 0.0
    gtd["robot_orientation"][: DRAWN.start, 3] = 1.0
    if in_air:
        gtd["effect_constant_wind"][IN_WIND, 0] = WIND
        gtd["effect_rotor_drag"][IN_WIND, :2] = PUSH * robot.body.mass * GRAVITY / WIND


def _rotor_limits(robot: RobotCfg) -> tuple[Tensor, Tensor]:
    """Return lowest and highest speeds of the rotors [rad/s], in force mode thrusts [N], (R,)."""
    vehicle = vehicle_from_config(robot, num_envs=1)
    allocation = Allocation(vehicle, GRAVITY)
    return state_for_thrust(vehicle, allocation.low)[0], state_for_thrust(vehicle, allocation.high)[0]


def time_to_settle_and_overshoot(response: list[float]) -> tuple[float, float]:
    """Return settling time [s] and overshoot of a response to a unit step, sampled from ``SAMPLE`` on. Both are infinite where
    there is NaN in it."""
    if not all(map(isfinite, response)):
        return inf, inf
    outside = [i for i, value in enumerate(response) if abs(value - 1.0) > SETTLED]
    last = outside[-1] + 1 if outside else 0
    settling = (last + 1) * SAMPLE if last < len(response) else inf
    return settling, max(max(response) - 1.0, 0.0)

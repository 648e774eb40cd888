"""Wakes between the vehicles of an environment: one pass before each launch of the physics.

The law is that of the effect ``downwash``, which states the force of a vehicle that hovers and is like the one that feels it.
Another source is taken as geometrically similar: lengths scale with its rotors, the momentum of its wake with its lift. Lift is
the upward part of its thrust at present. The momentum flux through any height then stays that of the source.
Letters: E environments, T vehicles of an environment over all kinds (*slots*), V those of one kind, B = E V, N = E T rows over
all kinds, R rotors, P parameters of the law.
"""

from collections.abc import Sequence
from functools import partial
from math import isnan

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.vehicle_collision import Slot, SlotTable
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch
from aerial_gym.interop.rows import RowFunction
from aerial_gym.math.quaternion import world_up
from aerial_gym.math.rows import dot
from aerial_gym.math.warp_functions import rotate, vector_type
from aerial_gym.physics import Vehicle
from aerial_gym.physics.effects.wakes import WakeSum
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots.robot_manager import RobotManager


def wake_source(vehicle: Vehicle, position: Tensor, attitude: Tensor, rotor_speed: Tensor) -> Tensor:
    """Return body origin [m], world, and lift [N], (B, 4): the upward part of all thrusts, none below zero."""
    upward = dot(vehicle.rotor_axis, world_up(attitude).unsqueeze(1))
    lift = (rotor_thrust(vehicle, rotor_speed) * upward).sum(-1, keepdim=True)
    return torch.cat((position, torch.where(lift > 0.0, lift, 0.0)), dim=1)  # NaN as well: it stays with its vehicle


def make_wake_kernel(effect: WakeSum) -> wp.Kernel:
    """Return the kernel that sums a law over the other vehicles."""
    num_params = len(effect.wake.parameters)
    numbers = vector_type(num_params)
    push = trace_to_warp("push", {"away": wp.vec3, "params": numbers}, effect.wake.push, [float])

    @wp.kernel(module="unique", enable_backward=False)
    def sum_wakes(
        # params
        slots: wp.array[Slot],  # (T,)
        first_slot: int,  # of this kind
        size: wp.array[float],  # (T,) of the rotors, relative to those of this kind
        weight: float,  # of this kind [N]
        com: wp.array[wp.vec3],  # (B,) from the body origin, body [m]
        # state
        sources: wp.array[wp.vec4],  # (N,) body origin, world [m], lift [N]
        attitude: wp.array[wp.quat],  # (B,) body to world, xyzw
        # out
        params_out: wp.array2d[float],  # (B, P + 1) read up to P, the sum of forces [N] is written behind
    ):
        """Write the downward force of the wakes of all other vehicles on each vehicle of a kind."""
        env, v = wp.tid()
        i = first_slot + v
        own = env * slots[i].row_step + v
        params = numbers()
        for k in range(wp.static(num_params)):
            params[k] = params_out[own, k]
        place = sources[slots[i].first_row + env * slots[i].row_step]
        center = wp.vec3(place[0], place[1], place[2]) + rotate(attitude[own], com[own])
        total = wp.float32(0.0)
        for j in range(slots.shape[0]):
            if j != i:
                source = sources[slots[j].first_row + env * slots[j].row_step]
                away = wp.vec3(source[0], source[1], source[2]) - center
                total += push(away / size[j], params) * source[3] / (weight * size[j] * size[j])
        params_out[own, wp.static(num_params)] = total

    return sum_wakes


class Wakes:
    """The pass; all views are made at construction."""

    def __init__(self, slots: SlotTable, robots: Sequence[RobotManager], sizes: Sequence[float]) -> None:
        """Record the launches for the robots of each kind, with the sizes of their rotors [m]."""
        device = robots[0].com.device
        self._sources = torch.zeros(slots.rows(len(robots) - 1).stop, 4, device=device)
        table = slots.array(device)
        self._fill = [self._source_launch(robot, slots.rows(number)) for number, robot in enumerate(robots)]
        self._sum: list[ReusableLaunch] = []
        for number, (robot, size) in enumerate(zip(robots, sizes, strict=True)):
            ratios = [each / size for each, count in zip(sizes, slots.counts, strict=True) for _ in range(count)]
            weight = float(robot.declared.mass[0]) * STANDARD_GRAVITY
            for effect, params in robot.wakes:
                self._sum.append(ReusableLaunch(
                    make_wake_kernel(effect), dim=(slots.num_envs, slots.counts[number]),
                    inputs=[
                        table, slots.first_slot(number), torch.tensor(ratios, device=device), weight, robot.com,
                        self._sources, robot.tensors.state.attitude,
                    ],
                    outputs=[params], device=device,
                ))  # fmt: skip

    def _source_launch(self, robot: RobotManager, rows: slice) -> partial[object]:
        state = robot.tensors.state
        inputs = state.position, state.attitude, state.rotor_speed
        function = RowFunction(partial(wake_source, robot.model.vehicle), inputs, lifts=True)
        return partial(function, *inputs, out=[self._sources[rows]])

    def measure(self) -> None:
        """Write the forces of all wakes at the present states, on torch's current stream."""
        for fill in self._fill:
            fill()
        for launch in self._sum:
            launch.launch(self._sources)


def make_wakes(slots: SlotTable, robots: Sequence[RobotManager], names: Sequence[str]) -> Wakes | None:
    """Return the pass for the robots of each kind, by name; None if none of them feels wakes.

    Raises:
        ConfigError: If robot files of several kinds lack the radius of their rotors.
    """
    if not any(robot.wakes for robot in robots):
        return None
    if len(robots) == 1:
        return Wakes(slots, robots, [1.0])
    areas = [float(robot.declared.rotor_radius[0].square().sum()) for robot in robots]
    lacking = [name for name, area in zip(names, areas, strict=True) if isnan(area)]
    if lacking:
        raise ConfigError(f"effect downwash of several kinds: give rotor.radius [m] of robot {', '.join(lacking)}")
    return Wakes(slots, robots, [area**0.5 for area in areas])

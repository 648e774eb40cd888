"""Wakes between the vehicles of an environment: one pass before each launch of the physics.

The law is that of the effect ``downwash``, which states the force of a vehicle that hovers and is like the one that feels it.
Distances are those between body origins. Another source is taken as geometrically similar: lengths scale with its rotors, the
momentum of its wake with its lift. Lift is the upward part of its thrust at present. The momentum flux through any height then
stays that of the source.

A launch takes the sources of one kind, and each of its threads one vehicle that feels them. The thread computes the lift of all
sources of its environment itself: neighbours share the loads, and a launch for the lifts would cost more.
Letters: E environments, V vehicles of the kind that feels the wakes in an environment, B = E V, S vehicles of the kind of the
sources, R rotors, P parameters of the law.
"""

from collections.abc import Sequence
from functools import partial
from math import isnan

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.vehicle_collision import SlotTable
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch
from aerial_gym.math.quaternion import world_up
from aerial_gym.math.rows import dot
from aerial_gym.math.warp_functions import load_quat, load_vec4, vector_type
from aerial_gym.physics import Vehicle
from aerial_gym.physics.effects.wakes import WakeSum
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots.robot_manager import RobotManager


def wake_lift(vehicle: Vehicle, attitude: Tensor, rotor_speed: Tensor) -> Tensor:
    """Return the lift [N], (E,): the upward part of all thrusts, none below zero."""
    upward = dot(vehicle.rotor_axis, world_up(attitude).unsqueeze(1))
    lift = (rotor_thrust(vehicle, rotor_speed) * upward).sum(-1)
    return torch.where(lift > 0.0, lift, 0.0)  # NaN as well: it stays with its vehicle


MOST_UNROLLED = 8  # Most sources in a row without a loop, whose loads overlap


def make_wake_kernel(effect: WakeSum, source: Vehicle, count: int) -> wp.Kernel:
    """Return the kernel that sums a law over ``count`` vehicles of a source's kind, with the thrust curve of the first one."""
    width = max(each for each in range(1, MOST_UNROLLED + 1) if count % each == 0)
    num_params, num_rotors = len(effect.wake.parameters), source.num_rotors
    numbers, rotors = vector_type(num_params), vector_type(num_rotors)
    first = source.map_rows(lambda rows: rows[:1])
    push = trace_to_warp("push", {"away": wp.vec3, "params": numbers}, effect.wake.push, [float])
    lift = trace_to_warp("lift", {"attitude": wp.quat, "rotor_speed": rotors}, partial(wake_lift, first), [float])

    @wp.kernel(module="unique", enable_backward=False)
    def sum_wakes(
        # params
        count: int,  # S
        shrink: float,  # size of the rotors that feel the wakes, relative to those of the sources
        share: float,  # of the law's force per lift [1/N]
        own_count: int,  # V
        is_own: wp.bool,  # whether vehicles of one kind feel each other
        begins: wp.bool,  # whether the sum starts from zero
        # state
        position: wp.array[wp.vec3],  # (E S,) body origins of the sources, world [m]
        attitude: wp.array[wp.quat],  # (E S,) body to world, xyzw
        rotor_speed: wp.array[rotors],  # (E S,) [rad/s] or [N]
        own_position: wp.array[wp.vec3],  # (B,) body origins, world [m]
        # out
        params_out: wp.array2d[float],  # (B, P + 1) read up to P, the sum of forces [N] is written behind
        memory_out: wp.array[float],  # (B,) the same sum, where the physics reads it
    ):
        """Add the downward force of the wakes of other vehicles on each vehicle of a kind."""
        env, v = wp.tid()
        own = env * own_count + v
        params = numbers()
        for k in range(wp.static(num_params)):
            params[k] = params_out[own, k]
        total = wp.where(begins, 0.0, params_out[own, wp.static(num_params)])
        origin = own_position[own]
        for begin in range(0, count, wp.static(width)):
            for k in range(wp.static(width)):
                i = env * count + begin + k
                if wp.static(num_rotors == 4):  # noqa: SIM108 (Warp compiles one branch)
                    speed = load_vec4(rotor_speed, i)
                else:
                    speed = rotor_speed[i]
                felt = push((position[i] - origin) * shrink, params) * lift(load_quat(attitude, i), speed) * share
                total += wp.where(
                    is_own and begin + k == v, 0.0, felt
                )  # without a branch, loads of several sources overlap
        params_out[own, wp.static(num_params)] = total
        memory_out[own] = total

    return sum_wakes


MEMORY = 11  # Place of `memory_out` among the arguments of the kernel


class Wakes:
    """The pass; its launches are recorded at construction."""

    def __init__(self, slots: SlotTable, robots: Sequence[RobotManager], sizes: Sequence[float]) -> None:
        """Record the launches for the robots of each kind, with the sizes of their rotors [m]."""
        self._robots = [robot for robot in robots if robot.wakes]
        self._memory = self._current_memory()
        felt = [(number, wake) for number, robot in enumerate(robots) for wake in robot.wakes]
        self._launches = [  # of each wake, with sources in the order of slots
            [self._launch(slots, robots, sizes, feels, source, wake, memory) for source in range(len(robots))]
            for (feels, wake), memory in zip(felt, self._memory, strict=True)
        ]

    def _current_memory(self) -> list[Tensor]:
        return [memory for robot in self._robots for memory in robot.backend.wake_memory()]

    @staticmethod
    def _launch(
        slots: SlotTable, robots: Sequence[RobotManager], sizes: Sequence[float], feels: int, source: int,
        wake: tuple[WakeSum, Tensor], memory: Tensor,
    ) -> ReusableLaunch:  # fmt: skip
        """Record the launch for two kinds by their numbers."""
        own, other, (effect, params) = robots[feels], robots[source], wake
        shrink = sizes[feels] / sizes[source]
        weight = float(own.declared.mass[0]) * STANDARD_GRAVITY
        state, sources = own.tensors.state, other.tensors.state
        return ReusableLaunch(
            make_wake_kernel(effect, other.model.vehicle, slots.counts[source]), dim=(slots.num_envs, slots.counts[feels]),
            inputs=[
                slots.counts[source], shrink, shrink * shrink / weight, slots.counts[feels], feels == source, source == 0,
                sources.position, sources.attitude, sources.rotor_speed, state.position,
            ],
            outputs=[params, memory], device=params.device,
        )  # fmt: skip

    def measure(self) -> None:
        """Write the forces of all wakes at the present states, on torch's current stream."""
        memory = self._current_memory()
        for launches, old, new in zip(self._launches, self._memory, memory, strict=True):
            for launch in launches:
                if new.data_ptr() != old.data_ptr():  # written parameters needed another physics kernel
                    launch.set_param_at_index(MEMORY, new)
                launch.launch(new)
        self._memory = memory


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

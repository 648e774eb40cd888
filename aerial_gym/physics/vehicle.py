"""The parameters of a batch of multirotors as tensors, one row per environment.

A parameter that is the same everywhere is one row seen E times (stride 0): it costs no memory, and the fused kernels read it
once instead of per environment.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

from dataclasses import dataclass
from math import nan

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg


def share_row(row: Tensor, num_envs: int) -> Tensor:
    """Return one row (...) as the read-only rows (E, ...) of all environments."""
    return row.as_strided((num_envs, *row.shape), (0, *row.stride()))


def is_shared(rows: Tensor) -> bool:
    """Return whether all rows (E, ...) are one: made by ``share_row``."""
    return rows.stride(0) == 0


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Everything rigid body and rotors need; effects that act on a parameter replace it here."""

    mass: Tensor
    """Mass [kg], (E,)."""

    inertia: Tensor
    """About the centre of mass [kg m²], body axes, (E, 3, 3)."""

    com: Tensor
    """Centre of mass from the body origin [m], body, (E, 3)."""

    rotor_position: Tensor
    """Hubs from the body origin [m], body, (E, R, 3)."""

    rotor_axis: Tensor
    """Unit directions of thrust, body, (E, R, 3)."""

    rotor_spin: Tensor
    """+1 or -1: sense of rotation about the axis, (E, R)."""

    thrust_map: Tensor
    """Thrust polynomial c0, c1, c2 [N, N s, N s²] of the speed [rad/s], (E, R, 3)."""

    torque_map: Tensor
    """Drag torque polynomial q0, q1, q2 [N m, N m s, N m s²], (E, R, 3)."""

    time_constant_up: Tensor
    """Lag of a rising speed [s], (E, R)."""

    time_constant_down: Tensor
    """Lag of a falling speed [s], (E, R)."""

    rotor_radius: Tensor
    """Radii of the propellers [m], (E, R); NaN where the robot file gives none."""

    battery: Tensor
    """Nominal, full and empty voltage [V], internal resistance [Ohm], capacity [A s] and efficiency, (E, 6); NaN where the
    robot file gives none."""

    speed_low: Tensor
    """Lowest speed that can be commanded [rad/s], (E, R)."""

    speed_high: Tensor
    """Highest speed that can be commanded [rad/s], (E, R)."""

    @property
    def num_envs(self) -> int:
        """Number of environments E."""
        return self.mass.shape[0]

    @property
    def num_rotors(self) -> int:
        """Number of rotors R."""
        return self.rotor_spin.shape[1]


def vehicle_from_config(
    robot: RobotCfg, *, num_envs: int, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
) -> Vehicle:
    """Return the declared vehicle, its parameters shared by all environments."""

    def rows(values: object) -> Tensor:
        return share_row(torch.tensor(values, dtype=dtype, device=device), num_envs)

    cell = robot.battery
    battery = [nan] * 6
    if cell is not None:
        voltages = cell.nominal_voltage, cell.full_voltage, cell.empty_voltage
        battery = [*voltages, cell.internal_resistance, cell.capacity, cell.efficiency]
    rotor, layout, count = robot.rotor, robot.mounts.layout, robot.num_rotors
    axis = torch.tensor([mount.axis for mount in layout], dtype=dtype, device=device)
    return Vehicle(
        mass=rows(robot.body.mass),
        inertia=rows(robot.body.inertia),
        com=rows(robot.body.com),
        rotor_position=rows([mount.position for mount in layout]),
        rotor_axis=share_row(axis / axis.norm(dim=-1, keepdim=True), num_envs),
        rotor_spin=rows([float(mount.spin) for mount in layout]),
        thrust_map=rows([rotor.thrust_map] * count),
        torque_map=rows([rotor.torque_coefficients] * count),
        time_constant_up=rows([rotor.time_constant_up] * count),
        time_constant_down=rows([rotor.time_constant_down] * count),
        rotor_radius=rows([nan if rotor.radius is None else rotor.radius] * count),
        battery=rows(battery),
        speed_low=rows([rotor.speed_at(rotor.thrust_range[0])] * count),
        speed_high=rows([rotor.speed_at(rotor.thrust_range[1])] * count),
    )

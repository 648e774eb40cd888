"""The parameters of a batch of multirotors as tensors, one row per environment.

A shared parameter is one row, viewed E times with stride 0. It costs no memory, and the fused kernels read it once.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import nan

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.rotor_maps import POLYNOMIAL, RotorMap, find_rotor_map, rotor_state_for_thrust


def share_row(row: Tensor, num_envs: int) -> Tensor:
    """Return one row (...) as read-only rows (E, ...) of all environments."""
    if torch._C._len_torch_dispatch_stack() > 0:  # a trace, where rows need no memory
        return row.expand(num_envs, *row.shape)
    return row.as_strided((num_envs, *row.shape), (0, *row.stride()))


def is_shared(rows: Tensor) -> bool:
    """Return whether all rows (E, ...) share memory, as from ``share_row``."""
    return rows.stride(0) == 0


def move_rows(rows: Tensor, device: torch.device | str) -> Tensor:
    """Return rows (E, ...) on a device; shared ones stay shared."""
    return share_row(rows[0].to(device), rows.shape[0]) if is_shared(rows) else rows.to(device)


def is_same_row(new: Tensor, kept: Tensor) -> bool:
    """Return whether rows are shared and equal those of ``kept``; waits for the device."""
    return is_shared(new) and torch.equal(new[0], kept[0])


def own_rows(rows: Tensor) -> Tensor:
    """Return a copy (E, ...) with memory for every row, unshared even for E = 1."""
    return torch.empty(rows.shape, dtype=rows.dtype, device=rows.device).copy_(rows)


_OF_BODY = {"mass", "inertia", "com", "battery"}  # Tensors of a vehicle without a rotor dimension


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Parameters of rigid body and rotors; effects on a parameter replace it here."""

    mass: Tensor  # Mass [kg], (E,)
    inertia: Tensor  # Inertia about the centre of mass [kg m²], body axes, (E, 3, 3)
    com: Tensor  # Centre of mass from the body origin [m], body, (E, 3)
    rotor_position: Tensor  # Hubs from the body origin [m], body, (E, R, 3)
    rotor_axis: Tensor  # Unit directions of thrust, body, (E, R, 3)
    rotor_spin: Tensor  # +1 or -1: sense of rotation about the axis, (E, R)

    thrust_map: Tensor
    """Coefficients of the thrust in ``rotor_map``, (E, R, 3): of the polynomial c0, c1, c2 [N, N s, N s²] of the speed
    [rad/s]; in force mode 0, 1, 0 of the thrust."""

    torque_map: Tensor  # Coefficients of the drag torque, (E, R, 3): q0, q1, q2 [N m, N m s, N m s²] or 0, ratio, 0
    reverse_thrust_map: Tensor  # Coefficients of a reversed rotor's thrust, of its absolute speed, (E, R, 3)
    reverse_torque_map: Tensor  # Coefficients of the drag torque of a reversed rotor, likewise, (E, R, 3)
    time_constant_up: Tensor  # Time constant of a growing magnitude of speed, or thrust in force mode [s], (E, R)
    time_constant_down: Tensor  # Time constant of a falling one [s], (E, R); the same tensor if both are equal
    slew_rate: Tensor  # Largest growth of the magnitude of the speed [rad/s²], or thrust [N/s], (E, R); inf: any
    slew_rate_down: Tensor  # Largest rate of fall of the magnitude, likewise
    dead_band: Tensor  # Dead band [rad/s], in force mode [N], (E, R): commands of smaller magnitude stop the rotor
    rotor_radius: Tensor  # Radii of the propellers [m], (E, R); NaN if unknown
    battery: Tensor  # Nominal, full, empty voltage [V], resistance [Ohm], capacity [A s], efficiency, (E, 6), or NaN
    speed_low: Tensor  # Lowest command of speed [rad/s], in force mode of thrust [N], (E, R)
    speed_high: Tensor  # Highest command, likewise, (E, R)
    traits: frozenset[str] = frozenset()  # Traits beyond a plain speed, of `ROTOR_TRAITS`, which select formulas
    rotor_map: RotorMap = POLYNOMIAL  # Functions of thrust and drag torque of all rotors

    @property
    def num_envs(self) -> int:
        """Number of environments E."""
        return self.mass.shape[0]

    @property
    def num_rotors(self) -> int:
        """Number of rotors R."""
        return self.rotor_spin.shape[1]

    @property
    def plain(self) -> bool:
        """Whether all rotors have unsigned speeds with a first-order lag only."""
        return not self.traits

    @property
    def upright(self) -> bool:
        """Whether every rotor of every environment thrusts along body z, by construction; reads the device."""
        axis = self.rotor_axis
        return is_shared(axis) and bool((axis[0] == axis.new_tensor((0.0, 0.0, 1.0))).all())

    @property
    def rotor_lever(self) -> Tensor:
        """Hubs from the centre of mass [m], body, (E, R, 3); (1, R, 3) where all environments have the same."""
        if is_shared(self.rotor_position) and is_shared(self.com):
            return share_row(self.rotor_position[0] - self.com[0], 1)
        return self.rotor_position - self.com.unsqueeze(1)

    @property
    def rotor_moment(self) -> Tensor:
        """Torque per thrust about the centre of mass [m], (E, R, 3)."""
        return torch.linalg.cross(self.rotor_lever, self.rotor_axis, dim=-1)

    @property
    def rotor_reaction(self) -> Tensor:
        """Torque on the body per drag torque, (E, R, 3): against the spin."""
        return -self.rotor_spin.unsqueeze(-1) * self.rotor_axis

    def tensors_by_name(self) -> dict[str, Tensor]:
        """Return all tensors by name, each (E, ...)."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Tensor)}

    def rows_for_all_envs(self, numbers: Tensor | Sequence[float]) -> Tensor:
        """Return numbers (...) as rows (E, ...) that all environments share, in the float type of the vehicle."""
        return share_row(torch.as_tensor(numbers, dtype=self.mass.dtype, device=self.mass.device), self.num_envs)

    def map_rows(self, change: Callable[[Tensor], Tensor]) -> "Vehicle":
        """Return the vehicle with ``change(rows)`` in place of every tensor."""
        return replace(self, **{name: change(rows) for name, rows in self.tensors_by_name().items()})

    def to_dtype(self, dtype: torch.dtype) -> "Vehicle":
        """Return the vehicle in another float type; shared rows stay shared."""
        return self.map_rows(
            lambda rows: share_row(rows[0].to(dtype), rows.shape[0]) if is_shared(rows) else rows.to(dtype, copy=True)
        )

    def to_device(self, device: torch.device | str) -> "Vehicle":
        """Return the vehicle on a device. Fields that are one tensor stay one."""
        if self.mass.device == torch.device(device):
            return self
        moved = {id(rows): move_rows(rows, device) for rows in self.tensors_by_name().values()}
        return self.map_rows(lambda rows: moved[id(rows)])

    def of_rotors(self, rotors: Sequence[int]) -> "Vehicle":
        """Return the vehicle with some of its rotors, by index from 0; shared rows stay shared."""
        numbers = list(rotors)

        def some(rows: Tensor) -> Tensor:
            return share_row(rows[0][numbers], rows.shape[0]) if is_shared(rows) else rows[:, numbers]

        return replace(
            self, **{name: some(rows) for name, rows in self.tensors_by_name().items() if name not in _OF_BODY}
        )

    def with_scaled_maps(self, *, thrust: Tensor | None = None, torque: Tensor | None = None) -> "Vehicle":
        """Return the vehicle with factors (E, R) or (E, 1) on thrust and drag torque, for both directions of spin."""
        changes = {}
        for factor, names in (
            (thrust, ("thrust_map", "reverse_thrust_map")),
            (torque, ("torque_map", "reverse_torque_map")),
        ):
            if factor is not None:
                changes |= {name: factor.unsqueeze(-1) * getattr(self, name) for name in names}
        return replace(self, **changes)


def vehicle_from_config(
    robot: RobotCfg, *, num_envs: int, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
) -> Vehicle:
    """Return the declared vehicle, its parameters shared by all environments; computed on the CPU."""

    def rows(values: object) -> Tensor:
        return share_row(torch.tensor(values, dtype=dtype), num_envs)

    cell = robot.battery
    battery = [nan] * 6
    if cell is not None:
        voltages = cell.nominal_voltage, cell.full_voltage, cell.empty_voltage
        battery = [*voltages, cell.internal_resistance, cell.capacity, cell.efficiency]
    rotors, layout = robot.rotor_types, robot.mounts.layout
    up, down = ([getattr(rotor, f"time_constant_{way}") for rotor in rotors] for way in ("up", "down"))
    rising = rows(up)
    axis = torch.tensor([mount.axis for mount in layout], dtype=dtype)
    vehicle = Vehicle(
        mass=rows(robot.body.mass),
        inertia=rows(robot.body.inertia),
        com=rows(robot.body.com),
        rotor_position=rows([mount.position for mount in layout]),
        rotor_axis=share_row(axis / axis.norm(dim=-1, keepdim=True), num_envs),
        rotor_spin=rows([float(mount.spin) for mount in layout]),
        thrust_map=rows([rotor.thrust_coefficients for rotor in rotors]),
        torque_map=rows([rotor.torque_coefficients for rotor in rotors]),
        reverse_thrust_map=rows([rotor.reverse_thrust_coefficients for rotor in rotors]),
        reverse_torque_map=rows([rotor.reverse_torque_coefficients for rotor in rotors]),
        time_constant_up=rising,
        time_constant_down=rising if down == up else rows(down),
        slew_rate=rows([rotor.slew_rates[0] for rotor in rotors]),
        slew_rate_down=rows([rotor.slew_rates[1] for rotor in rotors]),
        dead_band=rows([rotor.dead_band for rotor in rotors]),
        rotor_radius=rows([nan if rotor.radius is None else rotor.radius for rotor in rotors]),
        battery=rows(battery),
        speed_low=rows([rotor_state_for_thrust(rotor, rotor.thrust_range[0]) for rotor in rotors]),
        speed_high=rows([rotor_state_for_thrust(rotor, rotor.thrust_range[1]) for rotor in rotors]),
        traits=robot.rotor_traits,
        rotor_map=find_rotor_map(rotors),
    )
    _check_numbers(vehicle)
    return vehicle.to_device(device)


def _check_numbers(vehicle: Vehicle) -> None:
    """Raise ``ConfigError`` for numbers of the robot file beyond the range of float32, which kernels use."""
    first = {name: rows[:1].float() for name, rows in vehicle.tensors_by_name().items()}
    for name, row in first.items():
        may_lack = name.startswith("slew_rate") or name in ("rotor_radius", "battery")
        if not may_lack and not bool(row.isfinite().all()):
            raise ConfigError(
                f"robot: {name} = {row[0].tolist()}: is beyond float32. Check the units of the robot file"
            )
    for name in ("mass", "time_constant_up", "time_constant_down"):
        if not bool((first[name] > 0.0).all()):
            raise ConfigError(f"robot: {name} is zero in float32. Check the units of the robot file")
    if not bool(torch.linalg.inv_ex(first["inertia"]).inverse.isfinite().all()):
        raise ConfigError("robot: inertia has no inverse in float32. Check the units of the robot file")

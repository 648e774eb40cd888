"""Low-passed forces and accelerations of the vehicle, from the forces on it in every row.

The low-pass commutes with factors that all rows share: mass, inertia, axes. So the forces of each effect, and the powers of
rotor speeds before a map's coefficients, are filtered separately and cached; only changed ones are filtered again. Letters:
E rows, T rows kept, R rotors, K coefficients of a map.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.physics import Accelerations
from aerial_gym.physics.effects import WrenchEffect
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import ForceBreakdown
from aerial_gym.physics.rotors import map_terms, rotor_matrix
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.rows.dataset import Dataset

KEPT = 2  # Number of cached results per effect and sensor, as in ``physics.answers``


@dataclass(frozen=True, kw_only=True)
class SensorDelays:
    """Delays of the sensors on the clock of the rows, by flight [s]."""

    force: tuple[float, ...]  # Delay of the accelerometer, or of the derived force
    gyro: tuple[float, ...]


class BandResponse:
    """Low-passed forces on the vehicle along some flights."""

    def __init__(self, data: Dataset) -> None:
        self._data = data
        self._known: dict[str, list[tuple[Tensor, tuple[float, ...], Tensor]]] = {}
        on_time = (0.0,) * len(data.times)
        self._on_time = SensorDelays(force=on_time, gyro=on_time)
        rates = data.state["ang_vel"]
        products = (rates.unsqueeze(2) * rates.unsqueeze(1)).flatten(1)
        self._motion_rows = torch.cat((data.ang_acc, products), dim=1)
        self._motion = self._lowpass_rows(self._motion_rows, on_time)
        """Measured angular acceleration and products of angular velocities, (3 + 9, T)."""

        self._lead, self._late_motion = on_time, self._motion

    def accelerations_in_band(
        self,
        model: Model,
        rotor_speed: Tensor,
        acting: ForceBreakdown,
        *,
        about: Tensor | None = None,
        late: SensorDelays | None = None,
    ) -> Accelerations:
        """Return specific force [m/s²] and angular acceleration [rad/s²] of the body origin in the band, (T, 3) each.

        The rotation is measured, so errors of the torque model do not enter the forces. ``rotor_speed``: true speeds
        [rad/s], (E, R). ``about``: point of the torques of effects at hubs [m], body, (3,); None: the centre of mass.
        ``late``: sensor delays; None: zero.
        """
        late = late or self._on_time
        vehicle, wrench = model.vehicle, self._wrench_in_band(model, rotor_speed, acting, about, late.force)
        if late.gyro != late.force:
            wrench[3:] = self._wrench_in_band(model, rotor_speed, acting, about, late.gyro)[3:]
        _, products = _motion_selectors()
        spin = products @ vehicle.inertia[0]  # w (J w)^T, J is symmetric
        gyroscopic = torch.stack([spin[:, i, j] - spin[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))])
        force = wrench[:3] / vehicle.mass[0] - self.lever_arm_acceleration(vehicle.com[0], late)
        torque = model.inertia_inverse[0] @ (wrench[3:] - gyroscopic @ self._motion)
        return Accelerations(specific_force=force.T, ang_acc=torque.T)

    def _wrench_in_band(
        self, model: Model, rotor_speed: Tensor, acting: ForceBreakdown, about: Tensor | None, late: tuple[float, ...]
    ) -> Tensor:
        """Return the total forces and torques in the band, (6, T), with a delay [s] per flight."""
        vehicle = model.vehicle

        def law_rows(name: str, rows: Tensor, law: Callable[[Tensor], Tensor] = lambda rows: rows) -> Tensor:
            return self._rows_in_band(name, late, rows, law)

        terms = law_rows("rotors", rotor_speed, lambda speed: map_terms(vehicle, speed).permute(1, 0, 2))  # (K, R, T)
        maps = (vehicle.thrust_map, vehicle.reverse_thrust_map), (vehicle.torque_map, vehicle.reverse_torque_map)
        coefficients = [torch.cat([rows[0] for rows in pair], dim=1).T[: len(terms), :, None] for pair in maps]
        thrust, drag = ((of_each * terms).sum(0) for of_each in coefficients)
        for name, more in acting.thrusts:
            thrust = thrust + law_rows(f"thrust of {name}", more)
        wrench = rotor_matrix(vehicle).T @ torch.cat((thrust, drag))  # (6, T)
        at_hubs = {effect.name for effect, _ in model.effects[WrenchEffect] if effect.at_hubs}
        parts = [(name, law_rows(name, rows)) for name, rows in acting.wrenches]
        parts += [(name, params[0] @ law_rows(f"regressor of {name}", rows)) for name, rows, params in acting.linear]
        for name, part in parts:
            wrench = wrench + part
            if about is not None and name in at_hubs:
                wrench[3:] += torch.linalg.cross((about - vehicle.com[0])[:, None], part[:3], dim=0)
        return wrench

    def lever_arm_acceleration(self, place: Tensor, late: SensorDelays) -> Tensor:
        """Return ``alpha x r + w (w r) - w² r`` [m/s²], (3, T), of a point r [m], body, with the delay of the force."""
        turning, products = _motion_selectors()
        square = products.diagonal(dim1=1, dim2=2).sum(dim=1)
        lever = torch.linalg.cross(turning, place[None]) + products @ place - square[:, None] * place
        return lever.T @ self._rotation_in_band(late)

    def _rotation_in_band(self, late: SensorDelays) -> Tensor:
        """Return the measured rotation, (12, T), with the delay of the force."""
        lead = tuple(force - gyro for force, gyro in zip(late.force, late.gyro, strict=True))
        if not any(lead):
            return self._motion
        if lead != self._lead:
            self._lead, self._late_motion = lead, self._lowpass_rows(self._motion_rows, lead)
        return self._late_motion

    def _rows_in_band(
        self, name: str, late: tuple[float, ...], rows: Tensor, law: Callable[[Tensor], Tensor]
    ) -> Tensor:
        """Return a function of rows (E, ...) in the band, (..., T), cached by tensor and delay."""
        kept = self._known.setdefault(name, [])
        for number, (before, delays, filtered) in enumerate(kept):
            if rows is before and late == delays:
                kept.insert(0, kept.pop(number))
                return filtered
        values = law(rows)
        filtered = self._lowpass_rows(values.flatten(1), late).unflatten(0, values.shape[1:])
        kept.insert(1, (rows, late, filtered))
        del kept[2 * KEPT :]
        return filtered

    def _lowpass_rows(self, rows: Tensor, late: tuple[float, ...]) -> Tensor:
        """Return low-passed rows (E, K) as columns (K, T)."""
        return torch.from_numpy(self._data.columns_in_band(rows.T.contiguous().numpy(), late))


def _motion_selectors() -> tuple[Tensor, Tensor]:
    """Return selectors of the motion's columns: angular acceleration (12, 3), products of rates (12, 3, 3)."""
    unit = torch.eye(12, dtype=torch.float64)
    return unit[:, :3], unit[:, 3:].view(-1, 3, 3)


def split_columns(rows: Tensor) -> list[Array]:
    """Return the columns (T,) of rows (T, K)."""
    return list(rows.T.contiguous().numpy())

"""What a vehicle feels in the band, from what acts on it in every row.

A low-pass of a sum is the sum of low-passes, and what is the same in all rows may as well come after it: mass, inertia, axes.
So forces are brought into the band effect by effect, each once, and only what has changed is filtered again.
Letters: E rows, T rows kept, R rotors.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.physics import Accelerations
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import Acting
from aerial_gym.physics.rotors import rotor_matrix, rotor_torque
from aerial_gym.sim2real.predict.dataset import Dataset
from aerial_gym.sim2real.predict.slow_columns import SlowColumns

Array = NDArray[np.float64]

KEPT = 2
"""Results kept of each effect, as many as answers (``physics.answers``)."""


class InBand:
    """Forces on the vehicle along some flights, brought into the band."""

    def __init__(self, data: Dataset) -> None:
        """Take the flights."""
        self._data = data
        self._thrust, self._drag = SlowColumns(data.in_band), SlowColumns(data.in_band)
        self._known: dict[str, list[tuple[Tensor, Tensor]]] = {}
        rates = data.state["ang_vel"]
        products = (rates.unsqueeze(2) * rates.unsqueeze(1)).flatten(1)
        self._motion = self._slow(torch.cat((data.ang_acc, products), dim=1))
        """Angular acceleration and products of angular velocities as measured, (3 + 9, T)."""

    def felt(self, model: Model, rotor_speed: Tensor, acting: Acting) -> Accelerations:
        """Return specific force [m/s²] and angular acceleration [rad/s²] of the body origin in the band, (T, 3) each.

        The lever of the accelerometer turns as measured: an error of the torque model stays out of the forces.

        Args:
            model: The same in all rows.
            rotor_speed: True speeds [rad/s], (E, R).
            acting: Forces in every row, linear ones apart or not.
        """
        vehicle = model.vehicle
        thrust, drag = (
            torch.from_numpy(np.stack(slow.of(rows.numpy())))
            for slow, rows in ((self._thrust, acting.thrust), (self._drag, rotor_torque(vehicle, rotor_speed)))
        )
        for name, more in acting.thrusts:
            thrust = thrust + self._of(f"thrust of {name}", more)
        wrench = rotor_matrix(vehicle).T @ torch.cat((thrust, drag))  # (6, T)
        for name, rows in acting.wrenches:
            wrench = wrench + self._of(name, rows)
        for name, regressor, params in acting.linear:
            wrench = wrench + params[0] @ self._of(f"regressor of {name}", regressor)
        unit = torch.eye(12, dtype=wrench.dtype)
        turning, products = unit[:, :3], unit[:, 3:].view(-1, 3, 3)
        spin = products @ vehicle.inertia[0]  # w (J w)^T, J is symmetric
        gyroscopic = torch.stack([spin[:, i, j] - spin[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))])
        square = products.diagonal(dim1=1, dim2=2).sum(dim=1)
        lever = (
            torch.linalg.cross(turning, vehicle.com[:1]) + products @ vehicle.com[0] - square[:, None] * vehicle.com[0]
        )
        force = wrench[:3] / vehicle.mass[0] - lever.T @ self._motion
        torque = model.inertia_inverse[0] @ (wrench[3:] - gyroscopic @ self._motion)
        return Accelerations(specific_force=force.T, ang_acc=torque.T)

    def _of(self, name: str, rows: Tensor) -> Tensor:
        """Return what an effect does in the band, (..., T), of the same tensor (E, ...) as before or of another one."""
        kept = self._known.setdefault(name, [])
        for number, (before, found) in enumerate(kept):
            if rows is before:
                kept.insert(0, kept.pop(number))
                return found
        found = self._slow(rows.flatten(1)).unflatten(0, rows.shape[1:])
        kept.insert(1, (rows, found))
        del kept[KEPT:]
        return found

    def _slow(self, rows: Tensor) -> Tensor:
        """Return rows (E, K) in the band, (K, T)."""
        return torch.from_numpy(self._data.in_band(rows.T.contiguous().numpy()))


def columns_of(rows: Tensor) -> list[Array]:
    """Return the columns (T,) of rows (T, K)."""
    return list(rows.T.contiguous().numpy())

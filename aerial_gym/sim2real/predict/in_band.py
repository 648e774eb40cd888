"""What a vehicle feels in the band, from what acts on it in every row.

A low-pass of a sum is the sum of low-passes, and what is the same in all rows may as well come after it: mass, inertia, axes.
So forces are brought into the band effect by effect, each once, and only what has changed is filtered again.
Letters: E rows, T rows kept, R rotors.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.math.rows import times
from aerial_gym.physics import Accelerations
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import Acting
from aerial_gym.physics.rotors import rotor_torque, rotor_wrench
from aerial_gym.sim2real.predict.dataset import Dataset
from aerial_gym.sim2real.predict.rows import expand_rows, one_row
from aerial_gym.sim2real.predict.slow_columns import SlowColumns

Array = NDArray[np.float64]

KEPT = 3
"""Results kept of each effect: first the one asked for most, that of the model about which others differ."""


class InBand:
    """Forces on the vehicle along some flights, brought into the band."""

    def __init__(self, data: Dataset) -> None:
        """Take the flights."""
        self._data = data
        self._thrust, self._drag = SlowColumns(data.all_slow), SlowColumns(data.all_slow)
        self._known: dict[str, list[tuple[Tensor, Tensor]]] = {}
        rates = data.state["ang_vel"]
        self._turning = self._slow(data.ang_acc)  # as measured (T, 3)
        self._rates = self._slow((rates.unsqueeze(2) * rates.unsqueeze(1)).flatten(1)).view(-1, 3, 3)

    def felt(self, model: Model, rotor_speed: Tensor, acting: Acting) -> Accelerations:
        """Return specific force [m/s²] and angular acceleration [rad/s²] of the body origin in the band, (T, 3) each.

        The lever of the accelerometer turns as measured: an error of the torque model stays out of the forces.

        Args:
            model: The same in all rows.
            rotor_speed: True speeds [rad/s], (E, R).
            acting: Forces in every row.
        """
        count = self._turning.shape[0]
        vehicle = expand_rows(one_row(model.vehicle, 0), count)
        thrust, drag = (
            torch.from_numpy(np.stack(slow.of(rows.numpy()), axis=1))
            for slow, rows in ((self._thrust, acting.thrust), (self._drag, rotor_torque(model.vehicle, rotor_speed)))
        )
        for name, more in acting.thrusts:
            thrust = thrust + self._of(f"thrust of {name}", more)
        force, torque = rotor_wrench(vehicle, thrust, drag)
        for name, wrench in acting.wrenches:
            slow = self._of(name, wrench)
            force, torque = force + slow[:, :3], torque + slow[:, 3:]
        spin = self._rates @ vehicle.inertia[0]  # w (J w)^T
        gyroscopic = torch.stack([spin[:, i, j] - spin[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], dim=1)
        centripetal = self._rates - self._rates.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] * torch.eye(3).to(spin)
        lever = torch.linalg.cross(self._turning, vehicle.com) + centripetal @ vehicle.com[0]
        return Accelerations(
            specific_force=force / vehicle.mass[:1] - lever,
            ang_acc=times(torque - gyroscopic, model.inertia_inverse[0].T),
        )

    def _of(self, name: str, rows: Tensor) -> Tensor:
        """Return what an effect does in the band, of the same tensor as before or of another one."""
        kept = self._known.setdefault(name, [])
        for number, (before, found) in enumerate(kept):
            if rows is before:
                kept.insert(0, kept.pop(number))
                return found
        found = self._slow(rows)
        kept.insert(1, (rows, found))
        del kept[KEPT:]
        return found

    def _slow(self, rows: Tensor) -> Tensor:
        return torch.from_numpy(self._data.all_slow(rows.numpy()))


def columns_of(rows: Tensor) -> list[Array]:
    """Return the columns (T,) of rows (T, K)."""
    return list(rows.T.contiguous().numpy())

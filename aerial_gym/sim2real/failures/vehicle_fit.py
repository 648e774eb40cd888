"""Test whether the declared vehicle fits a flight at all, before failures are named against it. Letters: K blocks, R rotors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.failures.flight_event import FlightEvent
from aerial_gym.sim2real.failures.rotor_work import RotorOutput
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.moments import share_of_independent_rows
from aerial_gym.sim2real.predict.tolerances import Tolerances

FIRST_S = 30.0  # Time from the first row in which the fit is tested [s]
SIGNIFICANCE = 0.001  # Largest p-value of a misfit


@dataclass(frozen=True, kw_only=True)
class VehicleMisfit(FlightEvent):
    """A declared vehicle whose mean rotor outputs differ from the measured ones beyond noise and tolerances."""

    quantity: str  # speed or thrust
    p_value: float  # Probability of so large a chi-square with the declared vehicle

    @property
    def finding(self) -> Finding:
        """Return the largest mean difference, relative to hover."""
        off, half_width = self.params["difference"], 1.96 * self.std["difference"]
        values = {"rotor": round(self.params["motor"]), "quantity": self.quantity}
        values |= {"difference_share": off, "half_width_share": half_width, "p_value": self.p_value}
        return Finding("vehicle_misfit", self.flight, values)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        one = {"flight": self.flight, "name": self.name, "params": self.params, "std": self.std}
        return {**one, "p_value": self.p_value, "sentence": self.finding}


def find_misfit(
    works: Sequence[RotorOutput], robot: RobotCfg, tolerances: Tolerances, flight: str
) -> VehicleMisfit | None:
    """Return the clearest misfit of the declared vehicle in some blocks; None if it fits.

    The mean difference d of each rotor's output from its expectation has the variance ``s² / n + t²``: scatter s of n
    independent blocks, tolerance t. The sum of ``d² / (s² / n + t²)`` over R rotors is chi-square with R degrees of freedom.
    """
    misfits = []
    for work in works:
        if len(work.time) < 2:
            continue
        left = work.done - work.expected
        off = left.mean(axis=0)
        independent = np.maximum(len(left) * share_of_independent_rows(left), 1.0)
        std = np.sqrt(left.var(axis=0, ddof=1) / independent + output_tolerance(work.quantity, robot, tolerances) ** 2)
        p_value = float(special.chdtrc(off.size, float(((off / std) ** 2).sum())))
        if p_value < SIGNIFICANCE:
            misfits.append(_misfit_of_rotor(work, off, std, p_value, flight))
    return min(misfits, key=lambda one: one.p_value, default=None)


def _misfit_of_rotor(work: RotorOutput, off: Array, std: Array, p_value: float, flight: str) -> VehicleMisfit:
    """Return a misfit with the rotor that differs most."""
    worst = int(np.argmax(np.abs(off / std)))
    params = {"time": float(work.time[0]), "motor": worst + 1.0, "difference": float(off[worst])}
    more = {"quantity": work.quantity, "p_value": p_value, "std": {"difference": float(std[worst])}}
    return VehicleMisfit(flight=flight, name="vehicle_misfit", params=params, **more)


def output_tolerance(quantity: str, robot: RobotCfg, tolerances: Tolerances) -> float:
    """Return the standard deviation of a rotor's mean output, relative to hover, that the tolerances cause."""
    if quantity == "speed":
        return float(np.hypot(tolerances.nominal_voltage, 0.5 * tolerances.thrust))
    arm = float(np.mean([np.hypot(*mount.position[:2]) for mount in robot.mounts.layout]))
    lever, bias = np.sqrt(2.0) * tolerances.com / max(arm, tolerances.com), tolerances.acc_bias / STANDARD_GRAVITY
    return float(np.linalg.norm((tolerances.thrust, tolerances.mass, lever, bias)))

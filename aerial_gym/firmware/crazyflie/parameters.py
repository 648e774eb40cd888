"""Parameters of the firmware's controllers, by ``group.name``, for gains of the controllers here."""

from collections.abc import Iterable
from typing import Any

from torch import Tensor

from aerial_gym.control.crazyflie.brescianini import BrescianiniGains
from aerial_gym.control.crazyflie.geometric import IntegralGains
from aerial_gym.control.crazyflie.mellinger import MellingerGains
from aerial_gym.control.crazyflie.pid import PidGains

AXES, ANGLES = ("x", "y", "z"), ("roll", "pitch", "yaw")


def firmware_parameters(gains: Any) -> dict[str, float]:
    """Return the parameters for gains of any of the controllers. What the firmware has compiled in is not among them."""
    kinds = {PidGains: _pid, MellingerGains: _mellinger, IntegralGains: _lee, BrescianiniGains: _brescianini}
    return {name: float(value) for name, value in kinds[type(gains)](gains)}


def _rows(names: Iterable[str], row: Tensor) -> Iterable[tuple[str, Tensor]]:
    return zip(names, row[0], strict=False)


def _pid(gains: PidGains) -> Iterable[tuple[str, Tensor]]:
    levels = (
        (gains.position, [f"posCtlPid.{axis}K" for axis in AXES]),
        (gains.velocity, [f"velCtlPid.v{axis}K" for axis in AXES]),
        (gains.attitude, [f"pid_attitude.{angle}_k" for angle in ANGLES]),
        (gains.rates, [f"pid_rate.{angle}_k" for angle in ANGLES]),
    )
    for level, names in levels:
        for letter, row in (("p", level.proportional), ("i", level.integral), ("d", level.derivative)):
            yield from _rows((name + letter for name in names), row)
    yield from _rows((f"posCtlPid.{axis}VelMax" for axis in AXES), gains.most_velocity)
    tilt = gains.most_tilt[0, 0]
    yield from (("posCtlPid.rLimit", tilt), ("posCtlPid.pLimit", tilt))
    yield from (("posCtlPid.thrustBase", gains.thrust_base[0, 0]), ("posCtlPid.thrustMin", gains.least_thrust[0, 0]))


def _mellinger(gains: MellingerGains) -> Iterable[tuple[str, Tensor]]:
    yield from (("ctrlMel.mass", gains.mass[0, 0]), ("ctrlMel.massThrust", gains.mass_thrust[0, 0]))
    rows = {
        "kp": gains.position, "kd": gains.velocity, "ki": gains.position_integral, "i_range": gains.position_limit,
        "kR": gains.attitude, "kw": gains.rate, "ki_m": gains.attitude_integral, "i_range_m": gains.attitude_limit,
    }  # fmt: skip
    for name, row in rows.items():
        yield from _rows((f"ctrlMel.{name}_xy", f"ctrlMel.{name}_z"), row[:, 1:])
    yield "ctrlMel.kd_omega_rp", gains.rate_difference[0, 0]


def _lee(gains: IntegralGains) -> Iterable[tuple[str, Tensor]]:
    own = gains.lee
    yield "ctrlLee.mass", own.mass[0]
    rows = {
        "J_": own.inertia.diagonal(dim1=-2, dim2=-1), "Kpos_P": own.position, "Kpos_D": own.velocity,
        "Kpos_I": gains.position_integral, "KR_": own.attitude, "Kw_": own.rate, "KI_": gains.attitude_integral,
    }  # fmt: skip
    for name, row in rows.items():
        yield from _rows((f"ctrlLee.{name}{axis}" for axis in AXES), row)


def _brescianini(gains: BrescianiniGains) -> Iterable[tuple[str, Tensor]]:
    frequency = gains.position.sqrt()
    yield from _rows(("ctrlAtt.tau_xy", "ctrlAtt.tau_z"), 1.0 / frequency[:, 1:])
    yield from _rows(("ctrlAtt.zeta_xy", "ctrlAtt.zeta_z"), (0.5 * gains.velocity / frequency)[:, 1:])
    yield from (("ctrlAtt.tau_rp", 1.0 / gains.attitude[0, 0]), ("ctrlAtt.mixing_factor", gains.mixing[0, 0]))

"""The control law behind a log: firmware, parameters from the log, and actions from its setpoints. Letters: T rows."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import isfinite
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.autopilots import BetaflightCfg, CrazyfliePidCfg, Px4Cfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.catalog import CONTROLLERS
from aerial_gym.control.controllers import make_controller
from aerial_gym.control.px4.parameters import signal_of_thrust_share
from aerial_gym.control.px4.setpoints import Px4SetpointController
from aerial_gym.errors import ConfigError
from aerial_gym.physics import Vehicle
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import interpolate_setpoint
from aerial_gym.sim2real.predict.rows.batches import expand_vehicle, vehicle_of_row

LEVELS = ("rates", "attitude", "position")  # Setpoints that a law follows, from the innermost
LAWS = {
    "px4": {"rates": "px4_rate_control", "attitude": "px4_attitude_control", "position": "px4_position_control"},
    "betaflight": {"rates": "betaflight_rate_control"},
    "crazyflie_pid": {"position": "crazyflie_pid_control"},
}
"""Registered controllers of each autopilot by level."""

FIRMWARES = {"ulog": "px4", "blackbox": "betaflight", "crazyflie": "crazyflie_pid"}  # Autopilot by log format
STEPS_S = {"betaflight": 0.001}  # Control step [s]; its loop has 4 kHz or more, with filters above 100 Hz
STEP_S = 0.002  # Control step of the other laws [s]; PX4's rate loop has 250 to 1000 Hz, the Crazyflie's 500 Hz
AIRMODE_BIT = 22  # Of Betaflight's ``features``. Source: Betaflight 4.5, ``feature.h``, FEATURE_AIRMODE
SHOWN = 6  # Largest number of assumed parameters in a finding


@dataclass(frozen=True, kw_only=True)
class LogAutopilot:
    """A control law that flies recorded setpoints, with its parameters."""

    name: str  # A key of ``LAWS``
    parameters: Px4Cfg | BetaflightCfg | CrazyfliePidCfg
    findings: tuple[Finding, ...] = ()

    @property
    def step(self) -> float:
        """Control step [s]."""
        return STEPS_S.get(self.name, STEP_S)

    @property
    def uses_shares(self) -> bool:
        """Whether the law commands shares of the motors' range, and knows no thrust map."""
        return not isinstance(self.parameters, Px4Cfg) or self.parameters.THR_MDL_FAC is not None

    def law(self, level: str, robot: RobotCfg, vehicle: Vehicle) -> Any:
        """Return the law of a level for the declared vehicle in every environment."""
        own = self.parameters
        if isinstance(own, Px4Cfg) and "force" in vehicle.traits:  # whose thrust curve acts in `scale_commands`
            own = replace(own, THR_MDL_FAC=None)
        cfg = replace(CONTROLLERS.get(LAWS[self.name][level]), **{self.name: own})
        options = {"dt": self.step, "control": robot.control}
        if self.name == "px4":
            return Px4SetpointController(cfg, vehicle, STANDARD_GRAVITY, **options)
        return make_controller(cfg, vehicle, STANDARD_GRAVITY, **options)

    def scale_commands(self, command: Tensor, vehicle: Vehicle, curve: Tensor | None) -> Tensor:
        """Return a law's commands (E, R), those that are shares by the ``command_curve`` of each environment's log, (E, 3)."""
        if curve is None or not self.uses_shares:
            return command
        share = ((command - vehicle.speed_low) / (vehicle.speed_high - vehicle.speed_low)).clamp_min(0.0)
        if isinstance(self.parameters, Px4Cfg) and "force" in vehicle.traits:
            share = signal_of_thrust_share(share, self.parameters.THR_MDL_FAC or 0.0)
        offset, gain, power = curve.split(1, dim=-1)
        return offset + gain * share**power

    def actions(self, level: str, flight: Flight, law: Any, vehicle: Vehicle) -> tuple[Array, Flags] | None:
        """Return the actions of a level and the rows with setpoints, (T, any) and (T,); None if the level is not logged."""
        parts = [_thrust_rows(self.name, flight, law, vehicle)] if level != "position" else []
        if level == "position":
            parts += [_setpoint_rows(flight, "position_setpoint"), _yaw_rows(flight)]
        else:
            parts.append(_setpoint_rows(flight, {"rates": "rate_setpoint", "attitude": "attitude_setpoint"}[level]))
        known = [part for part in parts if part is not None]
        if len(known) < len(parts):
            return None
        if level == "position" and self.name == "px4":
            moving = _setpoint_rows(flight, "velocity_setpoint")
            values, has = moving or (np.zeros((flight.num_rows, 3)), np.ones(flight.num_rows, dtype=bool))
            known.append((np.where(has[:, None], values, 0.0), np.ones_like(has)))
        return np.concatenate([values for values, _ in known], axis=1), np.all([has for _, has in known], axis=0)


def autopilot_of_flight(flight: Flight, robot: RobotCfg, controller: str | None = None) -> LogAutopilot:
    """Return the law of a flight's firmware with its logged parameters, or one that stands in for it.

    Args:
        robot: Declared robot, whose ``control`` holds parameters that no log states.
        controller: Registered controller to take instead of that of the firmware; None for the latter.

    Raises:
        ConfigError: If the controller follows no setpoints that logs hold.
    """
    name, parameters = _firmware(flight, robot), flight.parameters
    if controller is not None:
        if (chosen := CONTROLLERS.get(controller).autopilot) not in LAWS or controller not in LAWS[chosen].values():
            known = ", ".join(law for laws in LAWS.values() for law in laws.values())
            raise ConfigError(f"controller {controller!r}: cannot follow recorded setpoints. Take one of {known}")
        name = chosen
    if name is None:
        usual = {"dataflash": "ArduPilot"}.get(flight.log_format, flight.log_format)
        firmware = str(parameters.get("Firmware revision", usual)).split(" ")[0]
        own = Px4Cfg(THR_MDL_FAC=_number(parameters, "MOT_THST_EXPO"))  # ArduPilot's curve is that of PX4
        finding = Finding("controller_stands_in", "", {"firmware": firmware, "controller": "px4"})
        return LogAutopilot(name="px4", parameters=own, findings=(finding,))
    kinds = {"px4": (Px4Cfg, px4_parameters), "betaflight": (BetaflightCfg, betaflight_parameters)}
    kind, read = kinds.get(name, (CrazyfliePidCfg, lambda _: dict[str, Any]()))
    logged, stated = read(parameters), getattr(robot.control, name)
    cfg = replace(stated or kind(), rate_hz=None, **logged, source="parameters of the log, the robot file and defaults")
    assumed = [f.name for f in fields(kind) if f.name not in ("source", "rate_hz", *logged)]
    assumed = [key for key in assumed if stated is None or getattr(cfg, key) == kind.__dataclass_fields__[key].default]
    values = {"controller": name, "logged": len(logged), "assumed": len(assumed), "examples": assumed[:SHOWN]}
    return LogAutopilot(name=name, parameters=cfg, findings=(Finding("controller_flown", "", values),))


def _firmware(flight: Flight, robot: RobotCfg) -> str | None:
    """Return the autopilot of a log, of a CSV file that which the robot file states; None for an unknown one."""
    if flight.log_format == "csv":
        return next((name for name in LAWS if getattr(robot.control, name) is not None), None)
    name = FIRMWARES.get(flight.log_format)
    revision = str(flight.parameters.get("Firmware revision", ""))
    return None if name == "betaflight" and not revision.startswith("Betaflight") else name


def _number(parameters: Mapping[str, float | str], name: str) -> float | None:
    """Return a logged number >= 0; None if it is missing or no such number."""
    value = parameters.get(name)
    return float(value) if isinstance(value, int | float) and isfinite(value) and value >= 0.0 else None


def px4_parameters(parameters: Mapping[str, float | str]) -> dict[str, Any]:
    """Return the logged parameters of ``Px4Cfg``, without filters beyond half of the control rate."""
    known = {f.name: value for f in fields(Px4Cfg) if (value := _number(parameters, f.name)) is not None}
    known |= {
        name: 0.0 for name, value in known.items() if name.endswith(("_FRQ", "_CUTOFF")) and value >= 0.5 / STEP_S
    }
    return known | ({"MC_AIRMODE": int(known["MC_AIRMODE"])} if "MC_AIRMODE" in known else {})


def betaflight_parameters(parameters: Mapping[str, float | str]) -> dict[str, Any]:
    """Return the parameters of ``BetaflightCfg`` in the header of a blackbox.

    The derivative gain is that of a calm flight (``d_min``), and dynamic cut-offs are at their lower end. Low-passes of higher
    order count as second order; those beyond half of the control rate are left out.
    """
    names = {f.name for f in fields(BetaflightCfg)} - {"rates_type"}  # logged setpoints are body rates
    known: dict[str, Any] = {n: value for n in names if (value := _number(parameters, n)) is not None}
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        gains, least, forward = (_numbers(parameters, key) for key in (f"{name}PID", "d_min", "ff_weight"))
        if len(gains) == 3:
            known |= {f"{key}_{name}": gain for key, gain in zip("pid", gains, strict=True)}
            known |= {f"d_{name}": least[axis]} if len(least) == 3 and least[axis] > 0.0 else {}
        known |= {f"f_{name}": forward[axis]} if len(forward) == 3 else {}
    for name in ("gyro_lpf1", "gyro_lpf2", "dterm_lpf1", "dterm_lpf2"):
        low, kind, cutoff = _numbers(parameters, f"{name}_dyn_hz")[:1], f"{name}_type", f"{name}_static_hz"
        known |= {kind: "PT1" if not known[kind] else "BIQUAD"} if kind in known else {}
        known |= {cutoff: low[0]} if low and low[0] > 0.0 else {}
        known |= {cutoff: 0.0} if known.get(cutoff, 0.0) >= 0.5 / STEPS_S["betaflight"] else {}
    for name, texts in (("iterm_relax", ("OFF", "RP", "RPY", "RP", "RPY")), ("tpa_mode", ("PD", "D"))):
        known |= {name: texts[int(known[name]) % len(texts)]} if name in known else {}
    older = re.match(r"Betaflight 4\.[0-5]\b", str(parameters.get("Firmware revision", "")))  # 4.6 is 2025.12
    known["version"] = "4.5" if older else "4.6"
    features = _number(parameters, "features")
    return known | ({} if features is None else {"airmode": bool(int(features) >> AIRMODE_BIT & 1)})


def _numbers(parameters: Mapping[str, float | str], name: str) -> list[float]:
    """Return the numbers of a header entry; empty if it is missing or holds text."""
    try:
        return [float(text) for text in str(parameters.get(name, "")).split(",")]
    except ValueError:
        return []


def _setpoint_rows(flight: Flight, name: str) -> tuple[Array, Flags] | None:
    """Return a setpoint in the rows of a flight and the rows that it covers; None if it is not logged."""
    if name not in flight.setpoints or flight.setpoints[name][0].size < 2:
        return None
    rows, known = interpolate_setpoint(flight, name)
    if name == "attitude_setpoint":
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)
    return rows, known


def _yaw_rows(flight: Flight) -> tuple[Array, Flags] | None:
    """Return the heading [rad] to hold in each row, (T, 1): of the attitude setpoint, or else the yaw setpoint."""
    attitude = _setpoint_rows(flight, "attitude_setpoint")
    if attitude is None:
        return _setpoint_rows(flight, "yaw_setpoint")
    x, y, z, w = attitude[0].T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))[:, None], attitude[1]


def _thrust_rows(name: str, flight: Flight, law: Any, vehicle: Vehicle) -> tuple[Array, Flags] | None:
    """Return the collective thrust in each row in the unit of the law's action, (T, 1); None if it is not logged."""
    share, force = (_setpoint_rows(flight, f"{kind}thrust_setpoint") for kind in ("", "specific_"))
    mass = float(vehicle.mass[0])
    if share is None and force is None:
        return None
    if name == "px4":
        unit = float(law.gains.unit_thrust[0, 0])
        return share if share is not None else (force[0] * mass / unit, force[1])  # type: ignore[index]
    if share is None:
        return force[0] / STANDARD_GRAVITY - 1.0, force[1]  # type: ignore[index]
    low, high = vehicle.speed_low[:1], vehicle.speed_high[:1]
    speeds = low + (high - low) * torch.from_numpy(share[0])
    lift = rotor_thrust(expand_vehicle(vehicle_of_row(vehicle, 0), len(speeds)), speeds)
    return lift.sum(-1, keepdim=True).numpy() / (mass * STANDARD_GRAVITY) - 1.0, share[1]

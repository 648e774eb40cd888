"""Betaflight's settings for a vehicle: lines of its command line, and the EEPROM that it writes from them.

Names and ranges: Betaflight 4.6, ``cli/settings.c``. Features that ``betaflight_rate_control`` does not model are off.
"""

import subprocess
import tempfile
from collections.abc import Iterable
from os import environ
from pathlib import Path

from torch import Tensor

from aerial_gym.config.autopilots import SCALES, YAW_INTEGRAL, BetaflightCfg
from aerial_gym.control.betaflight.parameters import AXES, BetaflightGains
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.firmware.betaflight.build import FirmwareBuild

VERSION = "4.6"  # Of the source package
GYRO_HZ = 8000  # Rate at which the firmware reads the gyro [1/s]
LARGEST_GAIN = 250  # Of P, I and D; F may be larger
STICK_RATE = 670.0  # Rate at full stick [deg/s] where actions are body rates
EEPROM = "eeprom.bin"
START_S = 5.0  # Longest time that the firmware needs to store its settings [s]

UNMODELLED = """
feature -GPS
feature -ANTI_GRAVITY
aux 0 0 0 1700 2100 0 0
min_check=1000 motor_idle=0 pwr_on_arm_grace=0 small_angle=180 runaway_takeoff_prevention=OFF gyro_calib_duration=50
gyro_overflow_detect=OFF yaw_spin_recovery=OFF airmode_start_throttle_percent=0 rc_smoothing=OFF
simplified_gyro_filter=OFF gyro_lpf1_dyn_min_hz=0 simplified_dterm_filter=OFF dterm_lpf1_dyn_min_hz=0
simplified_pids_mode=OFF anti_gravity_gain=0 throttle_boost=0 yaw_lowpass_hz=0 tpa_low_rate=0
d_max_roll=0 d_max_pitch=0 d_max_yaw=0 feedforward_smooth_factor=0 feedforward_jitter_factor=0 feedforward_boost=0
feedforward_max_rate_limit=0 feedforward_yaw_hold_gain=0
rates_type=ACTUAL
"""
"""Arming by the first auxiliary channel, and everything off that the controller here does not model."""


def firmware_settings(
    cfg: BetaflightCfg, gains: BetaflightGains, *, period: float, yaw_reversed: bool = False
) -> tuple[str, ...]:
    """Return lines of the command line for a configuration and its gains, derived ones included.

    Args:
        period: Time between two runs of the rate loop [s].
        yaw_reversed: Whether the rotors spin against Betaflight's default.

    Raises:
        ConfigError: If the rate does not divide that of the gyro, a gain is beyond the firmware's range, or the
            configuration is that of another version.
    """
    if cfg.version != VERSION:
        raise ConfigError(f"version {cfg.version}: the firmware is Betaflight {VERSION}. Take version: {VERSION!r}")
    values: dict[str, object] = {
        "pid_process_denom": _divisor(period), "yaw_motors_reversed": _switch(yaw_reversed), **_gain_values(gains),
        **{name: getattr(cfg, name) for name in ("iterm_relax", "iterm_windup", "tpa_mode")},
    }  # fmt: skip
    for name in ("gyro_lpf1", "gyro_lpf2", "dterm_lpf1", "dterm_lpf2"):
        values |= {key: getattr(cfg, key) for key in (f"{name}_type", f"{name}_static_hz")}
    for name in ("iterm_relax_cutoff", "pidsum_limit", "pidsum_limit_yaw", "tpa_rate", "tpa_breakpoint"):
        values[name] = getattr(cfg, name)
    for axis in AXES:
        sticks = cfg.rates_type == "ACTUAL"
        values[f"{axis}_rc_rate"] = (getattr(cfg, f"{axis}_center_sensitivity") if sticks else STICK_RATE) / 10.0
        values[f"{axis}_srate"] = (getattr(cfg, f"{axis}_max_rate") if sticks else STICK_RATE) / 10.0
        values[f"{axis}_expo"] = 100.0 * getattr(cfg, f"{axis}_expo") if sticks else 0
    lines = [f"feature {'' if cfg.airmode else '-'}AIRMODE"]
    for line in UNMODELLED.strip().splitlines():
        lines += [f"set {each}" for each in line.split()] if "=" in line else [line]
    return (*lines, *(f"set {name}={_text(value)}" for name, value in values.items()))


def _divisor(period: float) -> int:
    divisor = round(GYRO_HZ * period)
    if not 1 <= divisor <= 16 or abs(divisor / GYRO_HZ - period) > 1e-9:
        raise ConfigError(
            f"time step of {period:g} s: Betaflight's rate loop runs every 1 to 16 periods of {1 / GYRO_HZ:g} s. "
            "Take 0.001, 0.0005 or 0.00025"
        )
    return divisor


def _gain_values(gains: BetaflightGains) -> dict[str, int]:
    """Return the gains in the firmware's units."""
    values, faults = {}, []
    rows: tuple[tuple[str, Tensor], ...] = (
        ("p", gains.rate), ("i", gains.integral), ("d", gains.derivative), ("f", gains.forward)
    )  # fmt: skip
    for letter, row in rows:
        for axis, gain in zip(AXES, row[0].tolist(), strict=True):
            unit = SCALES[letter] * (YAW_INTEGRAL if (letter, axis) == ("i", "yaw") else 1.0)
            values[f"{letter}_{axis}"] = value = round(gain / unit)
            if letter != "f" and value > LARGEST_GAIN:
                faults.append(
                    f"{letter}_{axis} = {value}: Betaflight accepts at most {LARGEST_GAIN}. Give a lower gain"
                )
    if faults:
        raise ConfigError(*faults)
    return values


def _switch(on: bool) -> str:
    return "ON" if on else "OFF"


def _text(value: object) -> str:
    return str(round(value)) if isinstance(value, float) else str(value)


def store_settings(build: FirmwareBuild, lines: Iterable[str]) -> bytes:
    """Return the EEPROM that the firmware stores for the lines of its command line.

    Raises:
        ConfigError: If the firmware refuses a line.
        CapabilityError: If it does not store them.
    """
    lines = tuple(lines)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        start_command_mode, end = "\x02", "save\n"
        (folder / "commands").write_text(start_command_mode + "\n".join((*lines, end)), encoding="ascii")
        env = {**environ, "LD_PRELOAD": str(build.library), "LOCKSTEP_COMMANDS": "commands"}
        try:
            done = subprocess.run(
                [build.program], cwd=folder, env=env, capture_output=True, stdin=subprocess.DEVNULL, timeout=START_S
            )
        except subprocess.TimeoutExpired:
            raise CapabilityError(f"Betaflight did not store its settings within {START_S:g} s") from None
        answer = done.stdout.decode("ascii", "replace")
        if refused := [line.strip("# ") for line in answer.splitlines() if "ERROR" in line]:
            raise ConfigError(*(f"Betaflight refuses a setting: {line}" for line in refused))
        if done.returncode != 0 or "saving" not in answer:
            raise CapabilityError(f"Betaflight did not store its settings (exit status {done.returncode})")
        return (folder / EEPROM).read_bytes()

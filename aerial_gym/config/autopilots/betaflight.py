"""Parameters of Betaflight's rate loop, by the names of its command line, and of its Configurator for rates.

Source: Betaflight 4.5: its documentation (betaflight.com/docs: CLI reference, PID tuning tab, I-term relax, mixer types, tuning
notes of 4.0 to 4.3) and its source, looked up for single facts (``pid.h``, ``pid_init.c``, ``pid.c``, ``mixer.c``, ``rc.c``).
No code was copied. Gains that are left out are derived from the vehicle (``control.betaflight.parameters``).
"""

from dataclasses import dataclass
from math import pi

from aerial_gym.config.autopilots.autopilot import AutopilotTuning
from aerial_gym.config.checks import require, require_choice

PER_DEGREE = 180.0 / pi / 1000.0  # From a thousandth of the motors' range per deg/s to the whole range per rad/s

SCALES = {
    "p": 0.032029 * PER_DEGREE,
    "i": 0.244381 * PER_DEGREE,
    "d": 0.000529 * PER_DEGREE,
    "f": 0.013754 / 100.0 * PER_DEGREE,
}
"""Unit of ``p_roll``, ``i_roll``, ``d_roll``, ``f_roll``: share of the motors' range per rad/s, rad, rad/s² and rad/s² of the
setpoint. Source: Betaflight 4.5, ``pid.h``; a hundredth for f, ``pid_init.c``."""

YAW_INTEGRAL = 2.5  # Factor on the unit of `i_yaw`. Source: Betaflight 4.3 to 4.6, `pid_init.c`, without integrated yaw


@dataclass(frozen=True, kw_only=True)
class BetaflightCfg(AutopilotTuning):
    """Rates, gains, filters and mixer of ``betaflight_rate_control``.

    Every number is >= 0 and finite; None has it derived. Cut-offs of 0 leave a filter out, which is the default: the simulated
    gyro is clean unless the robot says otherwise.
    """

    rate_hz: float | None = None  # Rate of the loop [1/s]; if not given every physics step. 8000 / pid_process_denom
    rates_type: str = "NONE"  # `NONE`: actions are body rates [rad/s]; `ACTUAL`: sticks, -1 to 1, by Actual rates
    roll_center_sensitivity: float = 70.0  # Rate per stick about its centre [deg/s], with ACTUAL
    roll_max_rate: float = 670.0  # Rate at full stick [deg/s], with ACTUAL
    roll_expo: float = 0.0  # Bend of the curve between [-], 0 to 1, with ACTUAL; these three also for the other axes
    pitch_center_sensitivity: float = 70.0
    pitch_max_rate: float = 670.0
    pitch_expo: float = 0.0
    yaw_center_sensitivity: float = 70.0
    yaw_max_rate: float = 670.0
    yaw_expo: float = 0.0
    p_roll: float | None = None  # Proportional gain. Betaflight's default is 45; of pitch 47, of yaw 45
    i_roll: float | None = None  # Integral gain. Betaflight's default is 80; of pitch 84, of yaw 80
    d_roll: float = 0.0  # Derivative gain. Betaflight's default is 30 to 40; of pitch 34 to 46, of yaw 0
    f_roll: float = 0.0  # Feed-forward gain on the slope of the wanted rate. There 120; of pitch 125, of yaw 120
    p_pitch: float | None = None
    i_pitch: float | None = None
    d_pitch: float = 0.0
    f_pitch: float = 0.0
    p_yaw: float | None = None
    i_yaw: float | None = None
    d_yaw: float = 0.0
    f_yaw: float = 0.0
    gyro_lpf1_type: str = "PT1"  # PT1 (first order) or BIQUAD (second order, Butterworth)
    gyro_lpf1_static_hz: float = 0.0  # Cut-off of the first low-pass on body rates [Hz]; 0 for none. Default there: 250
    gyro_lpf2_type: str = "PT1"
    gyro_lpf2_static_hz: float = 0.0  # Of the second [Hz]. Betaflight's default is 500
    dterm_lpf1_type: str = "PT1"
    dterm_lpf1_static_hz: float = 75.0  # Of the first low-pass on the derivative [Hz]
    dterm_lpf2_type: str = "PT1"
    dterm_lpf2_static_hz: float = 150.0  # Of the second [Hz]
    iterm_limit: float = 400.0  # Largest integral, in thousandths of the motors' range

    iterm_windup: float = 85.0
    """Range of the corrections from which the integral of yaw slows down [% of the motors' range]; it stops at 100 %.
    100 switches this off. Roll and pitch are not affected, as in Betaflight 4.2 to 4.5."""

    iterm_relax: str = "RP"  # Axes whose integral rests while the wanted rate changes: OFF, RP (roll and pitch), RPY
    iterm_relax_cutoff: float = 15.0  # Cut-off of the low-pass that detects a change [Hz]
    pidsum_limit: float = 500.0  # Largest correction of roll and pitch, in thousandths of the motors' range
    pidsum_limit_yaw: float = 400.0  # Of yaw
    tpa_mode: str = "D"  # Gains reduced at full throttle: D, or P and D (PD)
    tpa_rate: float = 65.0  # By how much at full throttle [%]
    tpa_breakpoint: float = 1350.0  # Throttle from which it begins, 1000 to 2000

    airmode: bool = True
    """Whether corrections keep their size at low throttle. Without it they shrink below half throttle, to a half at zero
    throttle, where the integrals are also held at zero."""

    source: str = "Derived: aerial_gym.control.betaflight.parameters"  # Source of the numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        kinds = dict.fromkeys(_TYPES, ("PT1", "BIQUAD"))
        kinds |= {"rates_type": ("NONE", "ACTUAL"), "iterm_relax": ("OFF", "RP", "RPY"), "tpa_mode": ("D", "PD")}
        for name, allowed in kinds.items():
            require_choice(self, name, allowed)
        most = {"iterm_windup": 100.0, "tpa_rate": 100.0, "roll_expo": 1.0, "pitch_expo": 1.0, "yaw_expo": 1.0}
        for name, limit in most.items():
            require(self, name, getattr(self, name) <= limit, f"must be at most {limit:g}")
        require(self, "tpa_breakpoint", 1000.0 <= self.tpa_breakpoint < 2000.0, "must be from 1000 to below 2000")


_TYPES = ("gyro_lpf1_type", "gyro_lpf2_type", "dterm_lpf1_type", "dterm_lpf2_type")

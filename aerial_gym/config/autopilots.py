"""Parameters of real autopilots, by the names that these give them; gains that are left out are derived from the vehicle.

PX4 (``control.px4.parameters``): names and numbers of PX4 Autopilot 1.14, parameter reference. Numbers without unit are
normalised as there: 1 is the largest total thrust, or a torque that changes rotor thrusts by about their full range
(``unit_wrench``).

Betaflight (``control.betaflight.parameters``): names of its command line, and of its Configurator for rates. Source: Betaflight
4.5: its documentation (betaflight.com/docs: CLI reference, PID tuning tab, I-term relax, mixer types, tuning notes of 4.0 to
4.3) and its source, looked up for single facts (``pid.h``, ``pid_init.c``, ``pid.c``, ``mixer.c``, ``rc.c``); none was copied.

Crazyflie (``control.crazyflie.parameters``): names of its firmware; counts are those of its PWM: 65535 is all that a rotor
gives. ``config/robots/crazyflie/crazyflie_21.yaml`` has the numbers that a Crazyflie 2 comes with. Source: Bitcraze's
documentation, "Controllers in the Crazyflie" and "Mellinger controller", and its list of parameters; of ``BrescianiniCfg`` the
papers that ``control.crazyflie.brescianini`` names.
"""

from dataclasses import dataclass, fields
from math import inf, pi
from typing import Any, ClassVar

from aerial_gym.config.checks import Vec3, require, require_choice


class AutopilotTuning:
    """Base of the parameters of an autopilot: dataclasses of finite numbers >= 0, where None stands for a derived value."""

    NOT_GAINS: ClassVar[frozenset[str]] = frozenset(("rate_hz", "source"))  # Fields that are no gains
    POSITIVE: ClassVar[frozenset[str]] = frozenset(("rate_hz",))  # Fields that are divided by
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            numbers = [
                each for each in (value if isinstance(value, tuple) else (value,)) if isinstance(each, (int, float))
            ]
            require(self, field.name, all(0.0 <= number < inf for number in numbers), "must be >= 0 and finite")
        for name in self.POSITIVE:
            require(self, name, getattr(self, name, None) != 0.0, "must be > 0")

    @property
    def has_explicit_gains(self) -> bool:
        """Whether any gain, limit or filter is not as the class has it: then the parameters are someone's tuning."""
        return any(getattr(self, f.name) != f.default for f in fields(self) if f.name not in self.NOT_GAINS)


@dataclass(frozen=True, kw_only=True)
class Px4Cfg(AutopilotTuning):
    """Gains, limits and filters of ``px4_rate_control``, ``px4_attitude_control`` and ``px4_position_control``.

    Every number is >= 0 and finite; None has it derived. Cut-offs of 0 leave a filter out, which is the default: the simulated
    gyro is clean unless the robot says otherwise.
    """

    rate_hz: float | None = None  # Rate of the rate loop [1/s]; if not given every physics step. IMU_GYRO_RATEMAX
    MC_ROLLRATE_K: float = 1.0  # Scale of P, I and D of roll [-]
    MC_ROLLRATE_P: float | None = None  # Torque per rate error [s/rad]. PX4's default is 0.15
    MC_ROLLRATE_I: float | None = None  # Torque per integrated rate error [1/rad]. PX4's default is 0.2
    MC_ROLLRATE_D: float = 0.0  # Torque per measured angular acceleration [s²/rad]. PX4's default is 0.003
    MC_ROLLRATE_FF: float = 0.0  # Torque per wanted rate [s/rad]
    MC_RR_INT_LIM: float | None = None  # Largest torque of the integral [-]. PX4's default is 0.3
    MC_PITCHRATE_K: float = 1.0  # As for roll, and so are the next
    MC_PITCHRATE_P: float | None = None  # [s/rad]. PX4's default is 0.15
    MC_PITCHRATE_I: float | None = None  # [1/rad]. PX4's default is 0.2
    MC_PITCHRATE_D: float = 0.0  # [s²/rad]. PX4's default is 0.003
    MC_PITCHRATE_FF: float = 0.0  # [s/rad]
    MC_PR_INT_LIM: float | None = None  # [-]. PX4's default is 0.3
    MC_YAWRATE_K: float = 1.0  # As for roll, and so are the next
    MC_YAWRATE_P: float | None = None  # [s/rad]. PX4's default is 0.2
    MC_YAWRATE_I: float | None = None  # [1/rad]. PX4's default is 0.1
    MC_YAWRATE_D: float = 0.0  # [s²/rad]
    MC_YAWRATE_FF: float = 0.0  # [s/rad]
    MC_YR_INT_LIM: float | None = None  # [-]. PX4's default is 0.3
    MC_YAW_TQ_CUTOFF: float = 0.0  # Of the low-pass on the yaw torque [Hz]; 0 for none. PX4's default is 2
    IMU_GYRO_CUTOFF: float = 0.0  # Of the second-order low-pass on body rates [Hz]; 0 for none. PX4's default is 40
    IMU_GYRO_NF0_FRQ: float = 0.0  # Middle of the first notch filter on body rates [Hz], before the low-pass; 0: none
    IMU_GYRO_NF0_BW: float = 20.0  # Its width, between the frequencies at which half of the power passes [Hz], > 0
    IMU_GYRO_NF1_FRQ: float = 0.0  # Middle of the second one [Hz]; 0 for none
    IMU_GYRO_NF1_BW: float = 20.0  # Its width [Hz], > 0
    IMU_DGYRO_CUTOFF: float = 30.0  # Of the first-order low-pass on the angular acceleration [Hz]; 0 for none
    MC_ROLL_P: float | None = None  # Body rate per attitude error [1/s]. PX4's default is 6.5
    MC_PITCH_P: float | None = None  # Likewise [1/s]. PX4's default is 6.5
    MC_YAW_P: float | None = None  # Likewise [1/s]. PX4's default is 2.8
    MC_YAW_WEIGHT: float = 0.4  # Weight of yaw against roll and pitch in the attitude error [-], > 0 and <= 1
    MC_ROLLRATE_MAX: float = 220.0  # Largest rate that the attitude controller wants [deg/s]
    MC_PITCHRATE_MAX: float = 220.0  # Likewise [deg/s]
    MC_YAWRATE_MAX: float = 200.0  # Likewise [deg/s]
    MPC_XY_P: float | None = None  # Velocity per position error [1/s]. PX4's default is 0.95
    MPC_Z_P: float | None = None  # Likewise [1/s]. PX4's default is 1
    MPC_XY_VEL_P_ACC: float | None = None  # Acceleration per velocity error [1/s]. PX4's default is 1.8
    MPC_Z_VEL_P_ACC: float | None = None  # Likewise [1/s]. PX4's default is 4
    MPC_XY_VEL_I_ACC: float | None = None  # Acceleration per integrated velocity error [1/s²]. PX4's default is 0.4
    MPC_Z_VEL_I_ACC: float | None = None  # Likewise [1/s²]. PX4's default is 2
    MPC_XY_VEL_D_ACC: float = 0.0  # Acceleration per measured acceleration [-]. PX4's default is 0.2
    MPC_Z_VEL_D_ACC: float = 0.0  # Likewise [-]
    MPC_VELD_LP: float = 5.0  # Of the first-order low-pass on the measured acceleration [Hz]; 0 for none
    MPC_XY_VEL_MAX: float = 12.0  # Largest horizontal speed that is wanted [m/s]
    MPC_Z_VEL_MAX_UP: float = 3.0  # Largest climb [m/s]
    MPC_Z_VEL_MAX_DN: float = 1.5  # Largest descent [m/s]
    MPC_TILTMAX_AIR: float | None = None  # Largest tilt that is wanted [deg], > 0 and < 90. PX4's default is 45
    MPC_THR_HOVER: float | None = None  # Assumed hover thrust [-]. PX4's default is 0.5; it is estimated in flight

    MPC_THR_MIN: float | None = None
    """Least collective thrust [-]. PX4's default is 0.12; here at most half of the hover thrust, if not given."""

    MPC_THR_MAX: float = 1.0  # Largest collective thrust [-]
    MPC_THR_XY_MARG: float = 0.3  # Horizontal thrust that is kept while climbing at the limit [-]

    THR_MDL_FAC: float | None = None
    """Share f of the quadratic part in the believed thrust ``f s² + (1 - f) s`` of a motor signal s between its lowest and
    highest speed [-], 0 to 1. If not given the autopilot knows the thrust map of the robot file."""

    MC_AIRMODE: int | None = None
    """Priority under motor saturation: PX4's order, in which thrust rises for no torque (0), for roll
    and pitch (1), or for yaw as well (2). If not given, that of ``ControllerCfg.allocation``. PX4's default is 0."""

    source: str = "Derived: aerial_gym.control.px4.parameters"  # Source of the numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, low, high in (
            ("rate_hz", 0.0, inf), ("MC_YAW_WEIGHT", 0.0, 1.0), ("MPC_TILTMAX_AIR", 0.0, 89.9), ("MPC_THR_MAX", 0.0, 1.0),
            ("MPC_XY_VEL_P_ACC", 0.0, inf), ("IMU_GYRO_NF0_BW", 0.0, inf), ("IMU_GYRO_NF1_BW", 0.0, inf),
        ):  # fmt: skip
            value = getattr(self, name)
            require(self, name, value is None or low < value <= high, f"must be > {low:g} and at most {high:g}")
        require(self, "THR_MDL_FAC", (self.THR_MDL_FAC or 0.0) <= 1.0, "must be from 0 to 1")
        require(self, "MC_AIRMODE", self.MC_AIRMODE in (None, 0, 1, 2), "must be 0, 1 or 2, or left out")


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
    version: str = "4.6"  # Betaflight whose integrals it has: 4.6, or 4.5, as also 4.2 to 4.4
    iterm_limit: float = 400.0  # Largest integral of 4.5, in thousandths of the motors' range

    iterm_windup: float = 80.0
    """In 4.6 the largest integral [% of ``pidsum_limit`` and ``pidsum_limit_yaw``]. In 4.5 the range of the corrections from
    which the integral of yaw slows down [% of the motors' range]; it stops at 100 %. Betaflight's default is 80, in 4.5 85."""

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
        kinds = {**dict.fromkeys(_TYPES, ("PT1", "BIQUAD")), "rates_type": ("NONE", "ACTUAL"), "tpa_mode": ("D", "PD")}
        kinds |= {"iterm_relax": ("OFF", "RP", "RPY"), "version": ("4.5", "4.6")}
        for name, allowed in kinds.items():
            require_choice(self, name, allowed)
        most = {"iterm_windup": 100.0, "tpa_rate": 100.0, "roll_expo": 1.0, "pitch_expo": 1.0, "yaw_expo": 1.0}
        for name, limit in most.items():
            require(self, name, getattr(self, name) <= limit, f"must be at most {limit:g}")
        require(self, "tpa_breakpoint", 1000.0 <= self.tpa_breakpoint < 2000.0, "must be from 1000 to below 2000")


_TYPES = ("gyro_lpf1_type", "gyro_lpf2_type", "dterm_lpf1_type", "dterm_lpf2_type")


@dataclass(frozen=True, kw_only=True)
class MellingerCfg(AutopilotTuning):
    """Parameters of ``crazyflie_mellinger_control``: group ``ctrlMel``. It runs at ``ControllerCfg.rate_hz``, there 500 Hz."""

    POSITIVE: ClassVar[frozenset[str]] = frozenset(("mass", "massThrust"))
    mass: float | None = None  # Vehicle mass in the firmware's settings [kg]
    massThrust: float | None = None  # Counts per newton of all rotors together
    kp_xy: float | None = None  # Force per position error [N/m], along world x and y; names in `_z`: along or about z
    kd_xy: float | None = None  # Per velocity error [N s/m]
    ki_xy: float = 0.0  # Per integrated position error [N/(m s)]; that of a Crazyflie is 0.05
    i_range_xy: float = 2.0  # Largest integrated error [m s]
    kp_z: float | None = None
    kd_z: float | None = None
    ki_z: float = 0.0
    i_range_z: float = 0.4
    kR_xy: float | None = None  # Moment per attitude error [counts], of which 2 is a radian, about body x and y
    kw_xy: float | None = None  # Per rate error [counts s/rad]
    ki_m_xy: float = 0.0  # Per integrated attitude error [counts/s]
    i_range_m_xy: float = 1.0  # Largest integrated error [s]
    kd_omega_rp: float = 0.0  # Per difference of the rate error [counts s²/rad], about body x and y
    kR_z: float | None = None
    kw_z: float | None = None
    ki_m_z: float = 0.0
    i_range_m_z: float = 1500.0
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class CrazyfliePidCfg(AutopilotTuning):
    """Parameters of ``crazyflie_pid_control``; attitude and rates run at ``rate_hz``, the rest at ``ControllerCfg.rate_hz``.

    Three numbers are of x, y, z, or of roll, pitch, yaw.
    """

    rate_hz: float | None = None  # Rate of the attitude and rate loops [1/s]. Default: every physics step; there 500
    position_kp: Vec3 | None = None  # Velocity per position error [1/s]: `posCtlPid.xKp`, `yKp`, `zKp`
    position_ki: Vec3 = (0.0, 0.0, 0.0)  # Per integrated one [1/s²]: `posCtlPid.xKi`, ..

    velocity_max: Vec3 = (1.0, 1.0, 1.0)  # Largest velocity setpoint [m/s], clamp a tenth above: `posCtlPid.xVelMax`

    velocity_kp: Vec3 | None = None
    """Tilt per velocity error [deg s/m], along z output, a thousand counts each, [s/m]: ``velCtlPid.vxKp``, ..."""

    velocity_ki: Vec3 | None = None  # Per integrated one [deg/m], [1/m]: `velCtlPid.vxKi`, ..
    tilt_limit: float = 20.0  # Largest roll and pitch [deg]: `posCtlPid.rLimit`, `pLimit`
    thrust_base: float | None = None  # Counts that hover: `posCtlPid.thrustBase`
    thrust_min: float | None = None  # Least counts: `posCtlPid.thrustMin`; if not given 5/9 of those that hover
    attitude_kp: Vec3 | None = None  # Rate per angle [1/s]: `pid_attitude.roll_kp`, ..
    attitude_ki: Vec3 = (0.0, 0.0, 0.0)  # Per integrated one [1/s²]: `pid_attitude.roll_ki`, ..
    attitude_kd: Vec3 = (0.0, 0.0, 0.0)  # Per measured change of the angle [-]: `pid_attitude.roll_kd`, ..
    attitude_limit: Vec3 = (20.0, 20.0, 360.0)  # Largest integrated angle [deg s]
    rate_kp: Vec3 | None = None  # Counts per rate error [s/deg]: `pid_rate.roll_kp`, ..
    rate_ki: Vec3 | None = None  # Per integrated one [1/deg]: `pid_rate.roll_ki`, ..
    rate_kd: Vec3 = (0.0, 0.0, 0.0)  # Per measured change of the rate [s²/deg]: `pid_rate.roll_kd`, ..
    rate_limit: Vec3 | None = None  # Largest integrated rate [deg]; if not given it takes half of the possible moment
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class CrazyflieLeeCfg(AutopilotTuning):
    """Parameters of ``crazyflie_lee_control``: group ``ctrlLee``. It runs at ``ControllerCfg.rate_hz``, there 500 Hz.

    Three numbers are along world x, y, z, or about body x, y, z.
    """

    POSITIVE: ClassVar[frozenset[str]] = frozenset(("mass",))
    mass: float | None = None  # Vehicle mass in the firmware's settings [kg]
    Kpos_P: Vec3 | None = None  # Acceleration per position error [1/s²]; that of a Crazyflie is 7
    Kpos_D: Vec3 | None = None  # Per velocity error [1/s]; that of a Crazyflie is 4

    Kpos_I: Vec3 = (0.0, 0.0, 0.0)
    """Per integrated position error [1/s³]; that of a Crazyflie is 0. It removes the error by wind and overshoots a step."""

    Kpos_I_limit: Vec3 | None = None
    """Largest integrated position error [m s]. If not given half of the acceleration that the inclination allows is left to it.
    The firmware's parameter of that name limits nothing."""

    KR: Vec3 | None = None  # Torque per attitude error [N m/rad]; that of a Crazyflie is 0.007, about z 0.008
    Kw: Vec3 | None = None  # Per rate error [N m s/rad]; that of a Crazyflie is 0.00115, about z 0.002
    KI: Vec3 = (0.0, 0.0, 0.0)  # Per integrated attitude error [N m/(rad s)]; that of a Crazyflie is 0.03
    KI_limit: Vec3 | None = None  # Largest integrated attitude error [rad s]. Default: half the hover torque
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers


@dataclass(frozen=True, kw_only=True)
class BrescianiniCfg(AutopilotTuning):
    """Parameters of ``crazyflie_brescianini_control``: group ``ctrlAtt``, and what a Crazyflie has compiled in.

    Body rates are controlled at ``rate_hz``; the rest runs at ``ControllerCfg.rate_hz``.
    """

    POSITIVE: ClassVar[frozenset[str]] = frozenset(
        ("rate_hz", "tau_xy", "tau_z", "tau_rp", "tau_rp_rate", "tau_yaw_rate", "coll_max", "omega_rp_max", "omega_yaw_max")
    )  # fmt: skip

    rate_hz: float | None = None  # Rate of the body-rate loop [1/s]. Default: every physics step; there 500
    tau_xy: float | None = None  # Time constant of the position [s], along world x and y
    zeta_xy: float | None = None  # Its damping ratio [-]
    tau_z: float | None = None  # Along z
    zeta_z: float | None = None
    tau_rp: float | None = None  # Time constant of the attitude [s]
    mixing_factor: float | None = None  # Weight of the heading error, 0 to 1; that of a Crazyflie is 1

    tau_rp_rate: float | None = None
    """Time constant of body rates about x and y [s]; from here on no parameters of the group, but compiled in."""

    tau_yaw_rate: float | None = None  # About z
    coll_min: float | None = None  # Least thrust per mass [m/s²], 1 there; if not given a tenth of the weight
    coll_max: float | None = None  # Largest thrust per mass [m/s²]. If not given all that the rotors give
    omega_rp_max: float = 30.0  # Largest wanted rate of tilting [rad/s]: that of a Crazyflie, as the next
    omega_yaw_max: float = 10.0  # Largest wanted rate about body z [rad/s]
    source: str = "Derived: aerial_gym.control.crazyflie.parameters"  # Source of the numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "mixing_factor", (self.mixing_factor or 0.0) <= 1.0, "must be from 0 to 1")
        low, high = self.coll_min, self.coll_max
        require(self, "coll_min", low is None or high is None or low < high, f"must be below coll_max = {high!r}")

"""Parameters of PX4's control cascade, by the names that PX4 gives them.

Source: PX4 Autopilot 1.14, parameter reference; what is left out is derived from the vehicle (``control.px4.parameters``), so
that a robot without tuning flies. Numbers without unit are normalised as in PX4: 1 is the largest total thrust, or a torque
that changes rotor thrusts by about their full range (``control.px4.parameters.unit_wrench``).
"""

from dataclasses import dataclass
from math import inf

from aerial_gym.config.autopilots.autopilot import AutopilotTuning
from aerial_gym.config.checks import require


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

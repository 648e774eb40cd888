"""One sample of each finding; ``python -m tests.unit.sim2real.finding_samples`` writes their sentences anew."""

from pathlib import Path

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.wording import text

GOLDEN = Path(__file__).parent / "wording_golden.txt"


def effect(
    name: str, place: str = "", *, probability: float = 0.99, ties: tuple[str, ...] = (), **params: tuple
) -> Finding:
    """Return a found effect; parameters are (value, declared, half width)."""
    units = {parameter.name: unit_suffix(parameter.unit) for parameter in EFFECTS.get(name).parameters}
    values: dict[str, object] = {
        f"{key}_{units[key]}": dict(zip(("value", "declared", "half_width"), numbers, strict=True))
        for key, numbers in params.items()
    }
    return Finding("effect_found", name, {**values, "place": place, "probability": probability, "ties": list(ties)})


EFFECT_SAMPLES = [
    effect("com_offset", x=(-0.0055, 0.0, 0.0006), y=(0.0001, 0.0, 0.0006), z=(-0.0015, 0.0, 0.0006)),
    effect("com_offset", x=(0.004, 0.001, 0.0004), y=(0.002, 0.0, 0.0002), z=(0.0009, 0.0, 0.0003)),
    effect("com_offset", x=(0.0001, 0.0, 0.0006), y=(0.0, 0.0, 0.0005)), effect("com_offset", x=(0.004, 0.0, None)),
    effect("com_offset", probability=0.8, x=(-0.0055, 0.0, 0.0006)),
    effect("com_offset", ties=("weak_motor",), x=(-0.0055, 0.0, 0.0006)),
    effect("weak_motor", "front left", motor=(3.0, 1.0, None), scale=(0.96, 1.0, 0.004)),
    effect("weak_motor", motor=(3.0, 1.0, None), scale=(1.04, 1.0, 0.004)),
    effect("thrust_coefficient", scale=(0.95, 1.0, 0.006)), effect("torque_ratio", scale=(1.2, 1.0, 0.03)),
    effect("rotor_speed_scale", scale=(0.97, 1.0, 0.002)),
    effect("tachometer_scale", "front left", motor=(4.0, 1.0, None), scale=(1.04, 1.0, 0.002)),
    effect("motor_gain", motor=(2.0, 1.0, None), scale=(0.95, 1.0, 0.002)), effect("payload_mass", dm=(0.0124, 0.0, 0.0012)),
    effect("payload_mass", dm=(-0.0124, 0.0, 0.0012)), effect("motor_time_constant", tau=(0.0437, 0.038, 0.0004)),
    effect("motor_asymmetry", tau_up=(0.0437, 0.04, 0.0004), tau_down=(0.06, 0.04, 0.002)),
    effect("actuation_delay", delay=(0.012, 0.0, 0.001)), effect("actuation_delay", delay=(0.012, 0.005, 0.001)),
    effect("battery_sag", gain=(0.8, 0.0, 0.05)), effect("thrust_voltage", k=(0.5, 0.0, 0.04)),
    effect("rotor_inertia", jr=(3.1e-6, 0.0, 2e-7)),
    effect("motor_tilt", "rear right", motor=(2.0, 1.0, None), roll=(0.03, 0.0, 0.004), pitch=(-0.02, 0.0, 0.004)),
    effect("joint_spring", compliance=(0.1, 0.0, 0.01), tau=(0.02, 0.02, 0.004), hinge=(0.4, 0.4, None)),
    effect("joint_creep", compliance=(0.1, 0.0, 0.01), tau=(3.0, 3.0, 0.4), hinge=(0.4, 0.4, None)),
    effect("slung_payload", mass=(0.12, 0.0, 0.01), length=(1.2, 1.0, 0.04), damping=(0.01, 0.0, 0.002)),
    effect("inertia_error", sx=(1.12, 1.0, 0.02), sy=(0.9, 1.0, 0.02), sz=(1.01, 1.0, 0.03)),
    effect("torque_gain", sx=(0.8, 1.0, 0.02), sy=(1.0, 1.0, 0.02), sz=(1.01, 1.0, 0.03)),
    effect("arm_length", scale=(0.93, 1.0, 0.01)),
    effect("products_of_inertia", xy=(0.12, 0.0, 0.02), xz=(-0.08, 0.0, 0.02), yz=(0.01, 0.0, 0.02)),
    effect("constant_wind", x=(1.2, 0.0, 0.1), y=(-0.6, 0.0, 0.1), z=(0.02, 0.0, 0.1)),
    effect("constant_wind", x=(0.05, 0.0, 0.1)),
    effect("wind_shear", x=(1.2, 0.0, 0.1), y=(0.0, 0.0, 0.1), z_ref=(2.0, 2.0, None), exponent=(0.2, 0.14, 0.05)),
    effect("gusts", std=(0.52, 0.0, 0.04), corr_time=(1.1, 1.0, 0.3)), effect("ground_effect", k=(3.2, 0.0, 0.4)),
    effect("ceiling_effect", k=(1.2, 0.0, 0.2)), effect("ceiling_effect_curve", g2=(0.08, 0.0, 0.01), g4=(-0.02, 0.0, 0.01)),
    effect("ground_effect_curve", g1=(0.1, 0.0, 0.02)), effect("downwash", force=(0.5, 0.0, 0.06), sigma=(0.3, 0.3, 0.02)),
    effect("downwash", sigma=(0.3, 0.3, 0.02)),
    effect("slung_payload_rod", mass=(0.12, 0.0, 0.01), length=(1.2, 1.0, 0.04)),
    effect("downwash_jet", force=(0.5, 0.0, 0.06), spread=(0.25, 0.2, 0.02)),
    effect("downwash_core", force=(0.5, 0.0, 0.06), sigma=(0.3, 0.3, 0.02), power=(8.0, 2.0, 2.0)),
    effect("imu_bias", ax=(0.12, 0.0, 0.01), ay=(0.0, 0.0, 0.01), gz=(-0.02, 0.0, 0.003)),
    effect("imu_bias", ax=(0.001, 0.0, 0.01)),
    effect("imu_misalignment", roll=(0.02, 0.0, 0.002), pitch=(-0.01, 0.0, 0.002), yaw=(0.0, 0.0, 0.002)),
    effect("attitude_bias", roll=(0.02, 0.0, 0.002), pitch=(-0.01, 0.0, 0.002), yaw=(0.0, 0.0, 0.002)),
    effect("command_curve", offset=(0.24, 0.0, 0.01), gain=(0.79, 1.0, 0.01), power=(0.71, 1.0, 0.02)),
    effect("rotor_drag", dx=(0.12, 0.0, 0.02), dy=(0.1, 0.0, 0.02), dz=(0.05, 0.0, 0.02)),
    effect("rotor_drag", dx=(0.12, 0.1, 0.02), dy=(0.1, 0.1, 0.02)),
    effect("quadratic_drag", dx=(0.012, 0.0, 0.002), dy=(0.01, 0.0, 0.002)),
    effect("quadratic_drag_of_axes", dx=(0.012, 0.0, 0.002)),
    effect("rotor_drag_of_thrust", dx=(0.12, 0.0, 0.02), k=(0.2, 0.0, 0.03)),
    effect("h_force_flapping", kh=(1.2e-5, 0.0, 1e-6), kf=(2e-6, 0.0, 4e-7)),
    effect("axial_inflow", ka=(1.2e-5, 0.0, 1e-6)), effect("thrust_curve", k=(-0.2, 0.0, 0.03)),
    effect("translational_lift", kt=(0.005, 0.0, 0.001)),
    effect("blade_element", share=(0.8, 0.0, 0.1)), effect("vortex_ring", k=(0.2, 0.0, 0.05)),
    effect("motor_failure", "front", motor=(1.0, 1.0, None), scale=(0.5, 1.0, 0.01), time=(4.2, 0.0, 0.02)),
    effect("stuck_rotor", motor=(1.0, 1.0, None), time=(4.2, 0.0, 0.02)),
    effect("brown_out", scale=(0.8, 1.0, 0.01), time=(5.0, 0.0, 0.02), duration=(0.5, 0.0, None)),
    effect("random_force", x=(0.1, 0.0, 0.02)),
]  # fmt: skip

STRAINED = ("mass", "acc_bias_x", "sensor_delay_gyro", "imu_place_x", "attitude_x", "joint_rest", "rotor_motion_4")
STRAINED = (*STRAINED, "answered_noise_x")
PROCESSES = ("memory", "line", "shape", "axes", "flights", "heading")
TIED = {"parameter": "sz", "other": "torque_ratio", "params": {"scale": 0.62}, "log_odds": 0.4}
TIMES = {"before_s": 59.99, "after_s": 0.0, "shift_s": 60.0}
WRAPPED = {"counter": "the minute", **TIMES, "sample": 40, "topic": "esc_status"}
FAILURE = {"failure": "motor_failure", "rotor": 3, "place": "rear left", "share": 0.85}
FAILURE |= {"share_low": 0.84, "share_high": 0.86, "time_s": 5.0, "time_low_s": 4.988, "time_high_s": 5.012}
RISES = {"before_m_s2": 0.21, "after_m_s2": 0.24, "rise": 0.14, "rise_low": 0.02, "rise_high": 0.21}
FALLS = [
    {"quantity": "angular_acceleration.y", "before_rad_s2": 17.2, "after_rad_s2": 0.45},
    {"quantity": "free.velocity.1", "before_m_s": 1.2, "after_m_s": 0.31},
]
EXCESS = [
    {"channel": "specific_force.z", "rms_m_s2": 0.31, "floor_m_s2": 0.08},
    {"channel": "rotor_speed.1", "rms_rad_s": 3.0, "floor_rad_s": 2.0},
]
X, XZ = ["specific_force.x"], ["specific_force.x", "angular_acceleration.z"]
NUMBERS = [{"name": "stiffness", "value": 0.9, "declared": 1.2}, {"name": "rest", "value": 0.1, "declared": 0.0}]
CHANGED = [{"channel": "specific_force.y", "with_m_s2": 0.1, "without_m_s2": 0.2}]
OBJECTION = [{"code": "may_be_noise", "subject": "gusts", "values": {"p_value": 0.02}}]
LOST = [{"code": "share_small", "subject": "", "values": {"share": 0.04}}]
SPANS = {"time_s": 5.0, "time_low_s": 4.99, "time_high_s": 5.01}
SIZE = {"size_m": [1.0, 0.0, 0.0], "half_width_m": [0.01] * 3}
LAG = {"declared": 0.038, "unit": "s", "tolerance": 0.0095}
BROWN_OUT = {**SPANS, "failure": "brown_out", "share": 0.8, "share_low": 0.79, "share_high": 0.81, "duration_s": 0.5}

SAMPLES = [
    *EFFECT_SAMPLES, Finding("failure_found", "train_2", FAILURE),
    Finding("failure_found", "train_2", {"failure": "stuck_rotor", "rotor": 2, "place": "", "state_rad_s": 812.0} | SPANS),
    Finding("failure_found", "f1", BROWN_OUT),
    Finding("joint_found", "arm0", {"numbers": NUMBERS, "changed": ["stiffness", "rest"]}),
    Finding("joint_found", "arm0", {"numbers": [], "changed": ["law"]}), Finding("effects_none"),
    Finding("declared_explains", "", {"until_failure": False, "rigid": False}),
    Finding("declared_explains", "", {"until_failure": True, "rigid": True}),
    Finding("errors_fall", "", {"errors": FALLS}), Finding("no_error_falls"), Finding("gusts_lower_no_error"),
    Finding("error_rises", "specific_force.x", {"quantity": "specific_force.x", **RISES, "more": 2}),
    Finding("error_rises", "specific_force.x", {"quantity": "specific_force.x", **RISES, "more": 0}),
    Finding("error_may_rise", "specific_force.y", {"quantity": "specific_force.y", **RISES, "more": 1}),
    Finding("remains_unexplained", "", {"channels": XZ, "errors": EXCESS}),
    Finding("remains_unexplained", "", {"channels": XZ}),
    Finding("structure_found", "position", {"channel": "specific_force.z", "freq_hz": None, "share": 0.53}),
    Finding("structure_found", "periodic", {"channel": "specific_force.z", "freq_hz": 7.0, "share": 0.53}),
    Finding("effect_tied", "com_offset", {"others": ["motor_tilt", "weak_motor"]}),
    Finding("effects_open", "", {"effects": ["ground_effect", "axial_inflow"]}),
    Finding("left_open", "", {"channels": XZ}), Finding("offsets_of_flights", "", {"channels": X}),
    Finding("remains_near_floor", "", {"offsets": False}), Finding("remains_near_floor", "", {"offsets": True}),
    Finding("gusts_reach_floor", "gusts"), Finding("floor_unknown"), Finding("forces_not_judged"),
    Finding("fly", "circle at 3 m/s, heading held", {"tells": ["com_offset", "weak_motor"]}),
    Finding("fly", "climb and descend, up to 2 m/s", {"tells": ["axial_inflow"]}),
    Finding("weigh_or_log", "", {"tells": ["payload_mass", "thrust_coefficient"]}),
    *(Finding("fly_structure", kind) for kind in ("position", "heading", "velocity", "voltage", "time", "periodic")),
    *map(Finding, ("inspect_rest", "log_velocity", "log_faster", "train_like_test", "test_like_train")),
    *map(Finding, ("load_robot_file", "keep_declared")), Finding("keep_declared_where", "", {"errors": XZ}),
    Finding("keep_declared_for_harm"), Finding("trust_as_trained"),
    *map(Finding, ("trust_corrected", "trust_declared", "trust_as_shown", "trust_nothing", "trust_ambiguous")),
    Finding("ties_named", "com_offset", {"others": ["motor_tilt", "weak_motor"]}),
    Finding("certain_beside_ties", "", {"effects": ["rotor_drag"]}),
    Finding("correction_harms", "", {"errors": [*XZ, "free.velocity.0.5"]}),
    Finding("correction_helps", "", {"errors": [*XZ, "given_attitude.velocity"]}),
    Finding("open_in_channels", "", {"channels": X}), Finding("rigid_vehicle_only"),
    Finding("until_failure_only", "", {"flights": ["train_1", "test_2"]}),
    Finding("effect_found", "com_offset", {**EFFECT_SAMPLES[0].values, "material": None}),
    Finding("effect_immaterial", "rotor_drag", {"channel": "specific_force.x", **RISES, "least": 0.05}),
    Finding("materiality_open", "rotor_drag", {"channel": "specific_force.x", **RISES}),
    Finding("doubt_by_test", "slung_payload", {"other": "payload_mass", "log_odds": -3.4}),
    Finding("left_open_note", "", {"channels": XZ}), Finding("parameter_tied", "inertia_error", TIED),
    Finding("parameters_tied", "rotor_drag", {"parameters": ["dx", "dy"], "others": ["quadratic_drag", "h_force_flapping"]}),
    Finding("values_tied", "payload_mass", {
        "replaced": ["payload_mass"], "others": [{"effect": "thrust_coefficient", "params": {"scale": 0.87}}], "loss": 0.31,
    }),
    Finding("remainder_larger", "constant_wind", {"channels": XZ}),
    Finding("stands_in", "thrust_coefficient", {"structure": "time", "flights": 4}),
    Finding("offsets_sizes", "", {"offsets": [{"channel": "specific_force.x", "rms_m_s2": 0.0123}]}),
    Finding("values_redeclared", "", {"values": [{"value": "thrust_1", "deviation_std": 4.7}]}),
    *(Finding("tolerance_strained", name, {"deviation_std": 4.0}) for name in STRAINED),
    Finding("tolerances_cut_off", "", {"tolerances": ["sensor_delay_gyro"], "deviation_std": 5.0}),
    Finding("strained_changes", "", {"errors": CHANGED}), Finding("strained_changes_little"),
    Finding("band_limited", "", {"band_hz": 5.0, "slowest_hz": 25.0}), Finding("few_flights", "", {"flights": 2}),
    Finding("joints_held", "", {"joints": ["arm0", "arm1"]}),
    Finding("failure_suspected", "train_2", {**FAILURE, "log_odds": 24.8}),
    Finding("vehicle_misfit", "flight", {
        "rotor": 2, "quantity": "thrust", "difference_share": 0.12, "half_width_share": 0.014, "p_value": 1e-9,
    }),
    Finding("train_with_failure", "f1", {"effect": "motor_failure", "params": {"motor": 2.0, "scale": 0.5, "time": 3.0}}),
    Finding("gusts_are_random", "gusts"), Finding("law_preferred", "gusts", {"law": "A", "other": "B", "log_odds": 12.34}),
    Finding("laws_tied", "rotor_drag", {"law": "A", "other": "B", "log_odds": 1.25}),
    Finding("gusts_refused", "gusts", {"objections": OBJECTION}),
    Finding("may_be_noise", "gusts", {"p_value": 0.02}), Finding("adds_too_little", "gusts"),
    Finding("wrong_corr_time", "gusts", {"corr_time_s": 0.04}),
    *(Finding("rival_process", "gusts", {"process": name, "p_value": 1e-6}) for name in PROCESSES),
    Finding("rival_less_probable", "wind_shear", {"log_odds": -3.5}),
    Finding("rival_wider", "wind_shear", {"effect": "constant_wind"}),
    Finding("rival_not_rejected", "wind_shear", {"effect": "constant_wind"}),
    Finding("learned_added", "learned_residual", {"rows": 800, "rows_outside": 12}),
    Finding("learned_share", "", {"shares": {"specific_force.x": 0.4, "specific_force.y": -0.02}}),
    Finding("learned_share", "", {"shares": {"specific_force.x": 0.4}, "named_shares": {"specific_force.x": 0.5}}),
    Finding("learned_share", "", {"shares": {}}), Finding("learned_refused", "learned_residual", {"objections": LOST}),
    Finding("gain_by_chance", "", {"p_value": 0.03}), Finding("few_flights_better", "", {"share": 0.5}),
    Finding("gain_small", "", {"share": 0.01}), Finding("channel_worse", "specific_force.x", {"share": 0.14}),
    Finding("channel_worse_in_flights", "specific_force.x", {"share": 0.5}), *map(Finding, ("no_velocity", "no_force")),
    Finding("share_small", "", {"share": 0.04}), Finding("rollouts_lack_velocity", "all logs"),
    Finding("rollouts_lack_attitude", "f1, f2"), Finding("errors_at_floor", "", {"channels": 9}),
    Finding("errors_above_floor", "", {"above": 7, "channels": 9, "channel": "specific_force.z", "ratio": 4.37}),
    Finding("rollouts_too_short", "", {"shortest_s": 0.1}),
    Finding("controller_flown", "", {"controller": "px4", "logged": 41, "assumed": 6, "examples": ["MC_YAWRATE_K"]}),
    Finding("controller_stands_in", "", {"firmware": "Indiflight", "controller": "px4"}),
    Finding("setpoints_missing", "f1, f2"),
    Finding("joint_effort", "arm0", {"before_n_m": 0.12, "after_n_m": 0.03}),
    Finding("joints_felt", "", {"errors_before_and_after": {"specific_force.x": [0.3, 0.1]}}),
    Finding("not_excited", "ground_effect"),
    Finding("kinematics_disagree", "imu_misalignment", {"channel": "kinematic_rate.z", "rise": 0.3}),
    *map(Finding, ("no_soft_arms", "acts_on_links", "no_inertial_sensor", "torques_not_compared", "interval_holds_neutral")),
    Finding("parameters_unknown"), Finding("no_such_effect", "drag_of_a_tether", {"alike": "rotor_drag"}),
    *(Finding("logs_lack", "downwash", {"flights": "all logs", "need": need}) for need in ("position", "lin_vel",
        "ceiling_height", "other_position", "battery")),
    Finding("voltage_too_steady", "battery_sag", {"share": 0.004}),
    Finding("thrust_slope_open", "thrust_curve"),
    Finding("commands_too_coarse", "motor_time_constant", {"row_ms": 50.0, "lag_ms": 40.0}),
    Finding("effect_refused", "joint_spring", {"error": "joint_spring: needs a robot without joints"}),
    Finding("flights_disagree", "rotor_drag", {"log_odds": 12.0}),
    Finding("at_bound", "rotor_drag", {"parameters": ["dx", "dy"]}),
    Finding("not_told_from_nothing", "rotor_drag", {"log_odds": 1.2, "least_log_odds": 4.59512}),
    *map(Finding, ("told_beside_another", "only_linear", "less_probable", "gusts_no_floor", "gusts_no_forces")),
    Finding("gusts_no_drag", "gusts"), Finding("trifle", "rotor_drag", {"rise": 0.02}),
    *(Finding("follows_structure", "rotor_drag", {"structure": "heading", "flights": n}) for n in (1, 2)),
    # logs
    Finding("flight_left_out", "", {"error": "f9.csv: ang_vel 2 is 0 in every row"}),
    Finding("quantities_absent", "", {"quantities": ["rotor_speed", "rotor_command", "battery"]}),
    Finding("topic_left_out", "all logs", {"topic": "esc_status", "error": "topic esc_status has 1 usable rows, needs 2"}),
    Finding("battery_left_out", "f1", {"error": "f1.csv, line 3: vbat is empty"}), Finding("file_damaged", "f1"),
    Finding("bytes_left_out", "f1", {"bytes": 700, "total": 90000}),
    Finding("checksum_wrong", "f1"),
    Finding("frames_damaged", "f1", {"damaged": 3, "lost": 40, "total": 9000}),
    Finding("position_jumps_left", "f1", {"most": 20}),
    Finding("sensor_bias", "f1", {"sensor": "gyro", "bias_rad_s": [-0.1, 0.0, 0.2], "half_width_rad_s": [0.01, 0.01, None]}),
    Finding("sensor_bias", "f1", {"sensor": "accelerometer", "bias_m_s2": [0.3, 0.0, 0.0], "half_width_m_s2": [0.05] * 3}),
    Finding("sensor_turned", "f1", {"sensor": "gyro", "angle_deg": [0.0, 0.0, 3.1], "half_width_deg": [0.2, 0.2, 0.3]}),
    Finding("sensor_late", "f1", {"sensor": "gyro", "late_ms": 6.1, "half_width_ms": 0.4}),
    Finding("sensor_late", "f1", {"sensor": "accelerometer", "late_ms": -6.1, "half_width_ms": 0.4}),
    Finding("velocity_factor", "f1", {"axes": ["x"], "factor": [1.09], "low": [1.08], "high": [1.11]}),
    Finding("sensor_dropout", "f1", {"sensor": "gyro", "time_s": 4.2}), Finding("row_without_state"),
    Finding("row_with_bad_stamp", "", {"stamp_s": 4.0}),
    Finding("rows_with_bad_stamps", "f1", {"rows": 5, "total": 800, "lines": [7, 9, 12]}),
    Finding("rows_not_of_header", "f1", {"rows": 1, "total": 800, "lines": [7], "fields": 21}),
    Finding("rows_without_numbers", "f1", {"rows": 1, "total": 800, "lines": [7], "column": "acc_x", "field": "inf"}),
    Finding("rows_without_quaternion", "f1", {"rows": 2, "total": 800, "times_s": [1.5, 2.25]}),
    Finding("log_simulated", "f1", {"evidence": ["SYS_HITL = 1", "hardware PX4_SITL"]}),
    Finding("sensor_at_rest", "f1", {"sensor": "gyro", "other": "attitude", "gain": 0.0013, "half_width": 0.01}),
    Finding("sensor_gain", "f1", {"column": "acc_z", "other": "velocity", "gain_ratio": 0.91, "half_width_ratio": 0.01}),
    Finding("vertical_force_off", "f1", {"mean_m_s2": 3.94, "offset_m_s2": 0.785}),
    Finding("topic_covers_part", "f1", {"topic": "esc_status[0]", "covered_s": 3.0, "log_s": 31.5}),
    Finding("stream_too_late", "f1", {"topic": "mocap[0]", "late_ms": 412.0, "half_width_ms": 3.0}),
    Finding("stream_moved", "f1", {"topic": "vehicle_attitude[0]", "late_ms": -5.3, "half_width_ms": 0.2}),
    *(
        Finding("rotors_too_slow", "f1", {"quantity": "rotor_command", "rate_hz": 10.03, "torques": torques})
        for torques in (False, True)
    ),
    Finding("flight_state_unknown", "f1"), Finding("commands_mixed", "f1"),
    Finding("rotor_unit_assumed", "f1", {"topic": "/motor_speeds", "unit": "rad/s"}),
    Finding("rotor_speeds_not_shared", "f1", {"without": ["f3", "f4"]}),
    Finding("rotor_order_of_firmware", "f1", {"firmware": "PX4"}),
    Finding("reset_undone", "f1", {"quantity": "attitude", "time_s": 12.25, "angle_deg": 17.3}),
    Finding("reset_undone", "f1", {"quantity": "position", "time_s": 12.25, "distance_m": 0.82}),
    Finding("relative_commands_scaled", "f1", {"full": 1104.0, "unit": "rad/s", "by_speeds": False}),
    Finding("relative_commands_scaled", "f1", {"full": 1104.0, "unit": "rad/s", "by_speeds": True}),
    Finding("samples_with_bad_stamps", "f1", {"topic": "esc_status", "samples": 1, "total": 800, "places": [40]}),
    Finding("clock_set_back", "f1", {"before_s": 9.0, "after_s": 4.0, "shift_s": 5.01, "line": 902}),
    Finding("clock_wrapped", "f1", WRAPPED), Finding("clock_wrapped", "f1", {**WRAPPED, "may_be_restart": True}),
    Finding("rows_copied", "f1", {"rows": 3}),
    Finding("blocks_ordered", "f1", {"blocks": 2, "places": [40, 90], "topic": ""}),
    Finding("blocks_ordered", "f1", {"blocks": 1, "places": [40], "topic": "esc_status"}),
    Finding("fields_filled", "f1", {"fields": 2, "first": "cmd_1", "last": "cmd_4", "held": True}),
    Finding("fields_filled", "f1", {"fields": 2, "first": "rotor_1", "last": "rotor_4", "held": False}),
    Finding("battery_without_voltage", "f1"), Finding("battery_filled", "f1", {"rows": 3, "total": 800}),
    Finding("mapping_note", "all logs", {"text": "Rotors stand in the order of PX4's outputs."}),
    *(Finding(code, "all logs") for code in ("attitude_level", "attitude_integrated", "wind_not_declared")),
    *(Finding(code, "all logs") for code in ("velocity_derived", "velocity_unknown", "force_derived", "rates_derived")),
    *(Finding(code, "all logs") for code in ("one_command", "torques_not_logged", "commands_copied")),
    Finding("other_vehicle", "f1", {"file": "swap_two.csv"}),
    Finding("flown_with", "f1", {"file": "two.csv", "share": 0.98, "clock_s": 0.0, "nearest_m": 0.31, "farthest_m": 2.0}),
    Finding("vehicle_alone", "first", {"verdict": "none", "effects": {}}),
    Finding("vehicle_alone", "second", {"verdict": "explained", "effects": {"payload_mass": {"dm": 0.0512}}}),
    Finding("clock_confirmed", "a and b", {"offset_s": 0.01, "half_width_s": 0.02}),
    Finding("clock_contradicted", "a and b", {"offset_s": -0.23, "half_width_s": 0.02}),
    Finding("clock_unchecked", "a and b"),
    Finding("clock_undecided", "a and b"),
    *(Finding(f"gusts_{kind}", "gusts", {"correlation": 0.93, "low": 0.81, "high": 0.99})
      for kind in ("shared", "separate", "undecided")),
    Finding("flown_with", "f2", {"file": "one.csv", "share": 1.0, "clock_s": -0.25}),
    Finding("relative_position_unknown", "f3", {"file": "one.ulg"}),
    Finding("wind_declared", "f1", {"wind_m_s": [-4.2, 0.0, 0.0]}),
    Finding("rows_cut", "f1", {"rows": 15, "gap_s": 0.16}),
    Finding("spins_reversed", "", {"columns": "rotor_1..4", "gain_ratio": -0.9, "half_width_ratio": 0.2}),
    Finding("rows_lost", "", {"share": 0.03, "longest_s": 0.06}),
    Finding("steps_resampled", "f1", {"shortest_s": 0.004, "longest_s": 0.007, "step_s": 0.005}),
    Finding("on_ground", "f1", {"share": 0.12}), Finding("commands_scaled", "f1", {"factor": 0.909, "height_m": 0.5}),
    Finding("rotor_log_moved", "f1", {"lead_ms": 20.0, "half_width_ms": 0.98, "with_commands": False}),
    Finding("rotor_log_moved", "f1", {"lead_ms": 20.0, "half_width_ms": 0.98, "with_commands": True}),
    Finding("position_jump", "f1", {**SIZE, "start_s": 4.0, "end_s": 4.0, "moved_back": True}),
    Finding("position_jump", "f1", {**SIZE, "start_s": 4.0, "end_s": 4.2, "moved_back": False}),
    Finding("samples_slow", "f1", {"sensor": "ang_vel", "rate_hz": 50.0, "log_rate_hz": 200.0}),
    Finding("samples_repeated", "f1", {"sensor": "position", "share": 0.05, "longest_rows": 2}),
    # test stand
    Finding("test_left_out", "2", {"error": "a.csv, test 2: has 3 rows"}),
    Finding("rows_without_speed", "a.csv", {"rows": 1}), Finding("few_steps", "", {"rising": 2, "falling": 1}),
    Finding("rows_far_apart", "", {"step_s": 0.02}), Finding("thrust_from_gravity", "hover4"),
    Finding("scatter_unknown", "", {"repeats": 3, "needed": 4}), Finding("mass_added", "", {"added_kg": 0.0027}),
    Finding("battery_range", "", {"baseline_v": [3.7, 3.9], "flights_v": [3.6, 3.8]}),
    Finding("other_cause", "", {"probability": 0.012}),
    Finding("curvature_kept", "a.csv", {"quantity": "thrust", "cubic_n": 0.012, "chosen_n": 0.034}),
    Finding("curvature_kept", "a.csv", {"quantity": "torque", "cubic_n_m": 0.0012, "chosen_n_m": 0.0034}),
    *map(Finding, ("mass_exact", "no_unseen_log", "flights_differ", "balance_assumptions", "weigh_vehicle")),
    *map(Finding, ("measure_thrust", "turn_with_gyro", "swap_propeller", "links_as_declared", "thrust_scale_fitted")),
    Finding("intervals_of_flights"), Finding("joint_driven", "arm0"), Finding("joint_creeps", "arm0"),
    Finding("published_law", "", {"stiffness": 5834.85, "damping": 229.24, "rest": 0.12566}), Finding("one_record"),
    Finding("axes_open", "", {"first": 2, "second": 3}),
    # preflight
    Finding("constant_measured", "rotor_lag", {**LAG, "value": 0.0362, "low": 0.0351, "high": 0.0374}),
    Finding("constant_assumed", "rotor_lag", {**LAG, "reason": "no_rotor_speeds"}),
    Finding("constant_contradicted", "gyro_scale_z", {
        "declared": 1.0, "unit": "", "tolerance": 0.015, "value": 1.03, "low": 1.029, "high": 1.031,
        "setting": "the factor of the gyro about z", "new": 0.971, "tied": [], "remedy": "",
    }),
    Finding("constant_contradicted", "thrust_per_weight", {
        "declared": 1.0, "unit": "", "tolerance": 0.04, "value": 0.9, "low": 0.897, "high": 0.903,
        "setting": "effects.thrust_coefficient.scale", "new": 0.9, "tied": ["mass"], "remedy": "weigh",
    }),
    Finding("gyro_sign_measured", "x", {"gain_ratio": 0.998}), Finding("gyro_sign_assumed", "z"),
    Finding("gyro_sign_contradicted", "y", {"gain_ratio": -1.003}), Finding("rotor_layout_measured"),
    Finding("rotor_layout_assumed"), Finding("rotor_order_contradicted", "", {"rotors": [2, 3], "order": [1, 3, 2, 4]}),
    Finding("spins_contradicted", "", {"rotors": [3], "all": False}),
    Finding("spins_contradicted", "", {"rotors": [1, 2, 3, 4], "all": True}),
    Finding("outside_training", "roll rate [rad/s]", {
        "low": -3.87, "high": 3.74, "trained_low": -0.815, "trained_high": 0.772, "share": 0.1,
    }),
]  # fmt: skip
"""Of every code, and of every template of an effect."""


def golden() -> str:
    """Return the sentences of all samples, a line each."""
    return "".join(f"{one.code} | {one.subject} | {text(one)}\n" for one in SAMPLES)


if __name__ == "__main__":
    GOLDEN.write_text(golden(), encoding="utf-8")

"""Sentences of the preflight check."""

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import Template, join_words, number_text

LABELS = {
    "gyro_scale": "scale of the gyro",
    "accelerometer_scale": "scale of the accelerometer",
    "accelerometer_bias": "bias of the accelerometer",
    "attitude_latency": "latency of the attitude",
    "lin_vel_latency": "latency of the velocity",
    "position_latency": "latency of the position",
    "thrust_per_weight": "thrust per weight, relative to the file",
    "thrust_exponent": "exponent of the rotor speed in the thrust",
    "inertia_roll": "inertia about x",
    "inertia_pitch": "inertia about y",
    "inertia_yaw": "inertia about z",
    "torque_ratio": "yaw torque per thrust",
    "rotor_lag": "rotor lag",
    "motor_latency": "dead time of the motors",
    "speed_per_command": "rotor speed per commanded speed",
    "nominal_voltage": "rotor speed per commanded speed at the nominal voltage",
    "voltage_reading": "rotor speed per commanded speed at the logged voltage",
    "link_rate": "rate of commands on the link",
    "link_jitter": "jitter of commands",
    "packet_loss": "share of lost commands",
    "command_latency": "latency of commands",
    "rate_gain": "flown per commanded body rate",
    "mass": "mass",
    "clock_offset": "clock of the stream",
    "attitude_scale": "scale of the attitude",
    "arms": "arms of the rotors",
}
"""Names of constants for people; those of an axis end in its letter."""

REASONS = {
    "interval": "its interval in this log is wider than its tolerance",
    "delay_not_shown": "the log moves too little, or has no sensor to compare it with",
    "little_turning": "the log turns too little about this axis",
    "slow_attitude": "gyro or attitude are logged at less than 50 Hz",
    "no_velocity": "the log has no velocity",
    "little_thrust": "the log changes the thrust too little",
    "no_rotor_speeds": "the log has no rotor speeds beside the commands",
    "commands_scaled": "the log has commands as shares without rotor speeds, and their scale follows from the thrust",
    "slow_commands": "the rotor data of the log are too slow for torques",
    "commands_of_firmware": "the log of a firmware samples its commands, and does not stamp their arrival on a link",
    "no_rate_setpoint": "the log has no commanded body rates (sp_omega_x, sp_omega_y, sp_omega_z)",
    "few_commands": "the log has too few commanded body rates, or rotor commands slower than 150 Hz",
}
"""Reasons for a constant that the log cannot show."""

REMEDIES = {
    "weigh": "Weigh the vehicle with its battery; if its mass is right, the thrust is wrong",
    "turn_accelerometer": "Log the accelerometer at rest on both sides; a scale changes sign with gravity, a bias does not",
    "turn_by_known_angle": "Turn the vehicle by a known angle, and integrate the gyro",
    "one_clock": "Stamp all streams by one clock",
    "swing_test": "Measure the inertia by a swing test",
    "measure_voltage": "Measure the battery with a voltmeter while the log runs",
}
"""Measurements that tell causes apart."""


def constant_label(name: str) -> str:
    """Return the name of a constant for people."""
    kind, _, axis = name.rpartition("_")
    return LABELS[name] if name in LABELS else f"{LABELS[kind]} about {axis}"


def _value_text(finding: Finding) -> str:
    values = finding.values
    value, low, high = (number_text(values[name], 4) for name in ("value", "low", "high"))
    return f"{value} [{low}, {high}]{values['unit'] and ' '}{values['unit']}"


def _sentence_on_measurement(finding: Finding) -> str:
    name, declared = constant_label(finding.subject), number_text(finding.values["declared"], 4)
    return f"{name[0].upper()}{name[1:]}: {_value_text(finding)}. The file has {declared}."


def _sentence_on_assumption(finding: Finding) -> str:
    name, values = constant_label(finding.subject), finding.values
    declared = f"{number_text(values['declared'], 4)}{values['unit'] and ' '}{values['unit']}"
    return f"{name[0].upper()}{name[1:]}: {declared} as in the file is assumed, since {REASONS[values['reason']]}."


def _sentence_on_contradiction(finding: Finding) -> str:
    values = finding.values
    sentence = f"{_sentence_on_measurement(finding)} Change {values['setting']} to {number_text(values['new'], 4)}."
    if not values["tied"]:
        return sentence
    causes = join_words(map(constant_label, values["tied"]), "or")
    remedy = REMEDIES.get(values["remedy"], "")
    return f"{sentence} An error of the {causes} looks the same in this log. {remedy}{remedy and '.'}"


def _order_sentence(finding: Finding) -> str:
    order = ", ".join(map(str, finding.values["order"]))
    return (
        f"Rotors {join_words(map(str, finding.values['rotors']))} are in another order than in the file. Columns 1 to "
        f"{len(finding.values['order'])} of the log drive the file's mounts {order}: reorder the mounts, or the outputs."
    )


def _spins_sentence(finding: Finding) -> str:
    if finding.values["all"]:
        return "All rotors turn the other way round than in the file. Change the sign of every spin in mounts."
    rotors = finding.values["rotors"]
    plural = "s" * (len(rotors) > 1)
    return (
        f"Rotor{plural} {join_words(map(str, rotors))}: the yaw torque has the other sign than the file's spin{plural}."
    )


PREFLIGHT: dict[str, Template] = {
    "constant_measured": _sentence_on_measurement,
    "constant_assumed": _sentence_on_assumption,
    "constant_contradicted": _sentence_on_contradiction,
    "gyro_sign_measured": "The gyro about {subject} has the sign of the attitude.",
    "gyro_sign_assumed": "The sign of the gyro about {subject} is assumed: the log turns too little about this axis.",
    "gyro_sign_contradicted": (
        "The gyro about {subject} has the wrong sign: it shows {gain_ratio:.2f} of the attitude's turning. Invert this axis."
    ),
    "rotor_layout_measured": "Order and spins of the rotors are those of the file.",
    "rotor_layout_assumed": (
        "Order and spins of the rotors are assumed: the log does not show each rotor about roll, pitch and yaw."
    ),
    "rotor_order_contradicted": _order_sentence,
    "spins_contradicted": _spins_sentence,
    "outside_training": (
        "The {subject} leaves the range of the training for {share:percent} of the time. It is {low:number} to {high:number} "
        "in the log, and {trained_low:number} to {trained_high:number} in training."
    ),
}
"""Templates of findings of the preflight check, by code."""

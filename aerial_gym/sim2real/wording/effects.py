"""Sentences of named effects, with physical names, units, and directions in a pilot's words.

A direction is stated only if the confidence interval of the change excludes zero.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding, unit_key
from aerial_gym.sim2real.wording.words import decimals, join_words, number, percent, round_value, tolerance

LEAST_CERTAIN = 0.95
"""Probability below which a sentence calls the effect probable."""


@dataclass(frozen=True)
class Number:
    """A fitted parameter with its declared value and half width, in the unit of its sentence."""

    value: float
    declared: float
    half_width: float | None

    @property
    def change(self) -> float:
        """Return the fitted minus the declared value."""
        return self.value - self.declared

    @property
    def certain(self) -> bool:
        """Return whether the interval of the change excludes zero; True without an interval."""
        return self.half_width is None or abs(self.change) > self.half_width

    def scale(self, factor: float) -> "Number":
        """Return the parameter multiplied by a unit factor."""
        half = None if self.half_width is None else abs(factor) * self.half_width
        return Number(factor * self.value, factor * self.declared, half)


Numbers = dict[str, Number]


def read_numbers(finding: Finding) -> Numbers:
    """Return the parameters in the finding of a named effect, by name."""
    params = {}
    for parameter in EFFECTS.get(finding.subject).parameters:
        values = finding.values.get(f"{parameter.name}_{unit_key(parameter.unit)}")
        if isinstance(values, dict):
            declared = values["value"] if values["declared"] is None else values["declared"]
            params[parameter.name] = Number(values["value"], declared, values["half_width"])
    return params


def effect_sentence(finding: Finding) -> str:
    """Return the sentence of a named effect: with ``Probably`` if uncertain, with ``If it is`` if tied."""
    params, ties = read_numbers(finding), finding.values["ties"]
    try:
        sentence = EFFECT_TEMPLATES.get(finding.subject, _by_parameters)(finding, params)
    except KeyError:  # a parameter of the template is not shown by the flights
        sentence = _by_parameters(finding, params)
    probability = float(finding.values["probability"])
    if ties:
        return f"If it is {finding.subject}, {_lower(sentence)}"
    return sentence if probability >= LEAST_CERTAIN else f"Probably ({percent(probability)}), {_lower(sentence)}"


def _lower(sentence: str) -> str:
    return sentence if sentence[:3] == "IMU" else sentence[0].lower() + sentence[1:]


def _widest(numbers: Sequence[Number]) -> float | None:
    widths = [one.half_width for one in numbers if one.half_width is not None]
    return max(widths) if len(widths) == len(numbers) and widths else None


def _shift(numbers: Sequence[tuple[Number, str, str]], unit: str, start: str, unsure: str) -> str:
    """Return a sentence on the certain changes and their widest half width; it starts with ``unsure`` if none is certain."""
    certain = [(one, more if one.change > 0.0 else less) for one, more, less in numbers if one.certain]
    width = _widest([one for one, _ in certain] or [one for one, *_ in numbers])
    if not certain:
        return f"{unsure}, {tolerance(width, unit)}."
    space = "" if unit == "°" else " "
    parts = [f"{round_value(abs(one.change), width)}{space}{unit} {word}" for one, word in certain]
    return f"{start.format(join_words(parts))}, {tolerance(width, unit)}."


def _com_offset(_: Finding, params: Numbers) -> str:
    words = {"x": ("ahead of", "behind"), "y": ("to the left of", "to the right of"), "z": ("above", "below")}
    axes = [(one.scale(1e3), *words[axis]) for axis, one in params.items()]
    unsure = "The centre of mass is shifted from the declared one, but its direction is not certain"
    return _shift(axes, "mm", "The centre of mass lies {} the declared one", unsure)


def _ratio(one: Number, start: str, more: str, less: str, end: str = "than declared") -> str:
    change = Number(one.value / one.declared - 1.0, 0.0, one.half_width and one.half_width / one.declared).scale(1e2)
    word = more if change.value > 0.0 else less
    size = round_value(abs(change.value), change.half_width)
    return f"{start} {size} % {word} {end}, {tolerance(change.half_width, '%')}."


def _rotor(finding: Finding, params: Numbers) -> str:
    place = finding.values.get("place")
    return f"otor {params['motor'].value:.0f}" + (f" ({place})" if place else "")


def _thrust_coefficient(_: Finding, params: Numbers) -> str:
    return _ratio(params["scale"], "All rotors give", "more thrust", "less thrust")


def _weak_motor(finding: Finding, params: Numbers) -> str:
    return _ratio(params["scale"], f"R{_rotor(finding, params)} gives", "more thrust", "less thrust")


def _torque_ratio(_: Finding, params: Numbers) -> str:
    return _ratio(params["scale"], "The drag torque of the rotors is", "higher", "lower")


def _rotor_speed_scale(_: Finding, params: Numbers) -> str:
    return _ratio(params["scale"], "The logged rotor speeds read", "too high", "too low", "against the true ones")


def _payload_mass(_: Finding, params: Numbers) -> str:
    one = params["dm"].scale(1e3)
    word = "heavier" if one.change > 0.0 else "lighter"
    size = round_value(abs(one.change), one.half_width)
    return f"The vehicle is {size} g {word} than declared, {tolerance(one.half_width, 'g')}."


def _motor_time_constant(_: Finding, params: Numbers) -> str:
    tau = params["tau"].scale(1e3)
    declared = round_value(tau.declared, tau.half_width)
    return f"The rotors lag with a time constant of {_plus(tau, 'ms')}; {declared} ms is declared."


def _plus(one: Number, unit: str) -> str:
    """Return ``value unit ± half width``."""
    width = "" if one.half_width is None or decimals(one.half_width) is None else f" {tolerance(one.half_width, '')}"
    return f"{round_value(one.value, one.half_width)}{width} {unit}".replace(" °", "°")


def _motor_asymmetry(_: Finding, params: Numbers) -> str:
    ways = {"tau_up": "rises", "tau_down": "falls"}
    parts = [f"{way} with {_plus(params[name].scale(1e3), 'ms')}" for name, way in ways.items() if name in params]
    return f"Rotor speed {join_words(parts)} of time constant."


def _actuation_delay(_: Finding, params: Numbers) -> str:
    delay = params["delay"].scale(1e3)
    return f"Commands act with a dead time of {_plus(delay, 'ms')}{_declaration(delay, 'ms')}."


def _declaration(one: Number, unit: str) -> str:
    return f"; {number(one.declared)} {unit} is declared" if one.declared else ""


def _battery_sag(_: Finding, params: Numbers) -> str:
    return f"Rotor speed falls by {_plus(params['gain'].scale(10.0), '%')} for 10 % less battery voltage."


def _rotor_inertia(_: Finding, params: Numbers) -> str:
    one = params["jr"].scale(1e6)
    return f"Each rotor has an inertia of {_plus(one, 'mg m²')} about its axis{_declaration(one, 'mg m²')}."


def _motor_tilt(finding: Finding, params: Numbers) -> str:
    words = {"roll": ("to the right", "to the left"), "pitch": ("forward", "backward")}
    axes = [(params[name].scale(degrees(1.0)), *words[name]) for name in words if name in params]
    rotor = _rotor(finding, params)
    unsure = f"The axis of r{rotor} is tilted, but its direction is not certain"
    return _shift(axes, "°", f"The axis of r{rotor} is tilted {{}}", unsure)


def _arms(params: Numbers, verb: str) -> str:
    bend = params["compliance"].scale(degrees(1.0))
    after = f" within {_plus(params['tau'], 's')}" if "tau" in params else ""
    return f"The arms {verb} by {_plus(bend, '°')} per N m of load{after}."


def _joint_spring(_: Finding, params: Numbers) -> str:
    return _arms(params, "bend elastically")


def _joint_creep(_: Finding, params: Numbers) -> str:
    return _arms(params, "creep")


def _slung_payload(_: Finding, params: Numbers) -> str:
    mass = _plus(params["mass"].scale(1e3), "g") if "mass" in params else "unknown mass"
    length = f" at {_plus(params['length'], 'm')} below the body origin" if "length" in params else ""
    return f"A payload of {mass} swings on a cable{length}."


def _inertia_error(_: Finding, params: Numbers) -> str:
    words = {"sx": "in roll", "sy": "in pitch", "sz": "in yaw"}
    axes = [
        (one.scale(1e2 / one.declared), f"higher {words[axis]}", f"lower {words[axis]}") for axis, one in params.items()
    ]
    unsure = "The moments of inertia differ from the declared ones, but no axis for certain"
    return _shift(axes, "%", "The moment of inertia is {} than declared", unsure)


def _along_world(params: Numbers) -> list[tuple[Number, str, str]]:
    return [(params[axis], f"towards world +{axis}", f"towards world -{axis}") for axis in "xyz" if axis in params]


def _constant_wind(_: Finding, params: Numbers) -> str:
    return _shift(_along_world(params), "m/s", "A steady wind blows {}", "A steady wind of unknown direction blows")


def _wind_shear(_: Finding, params: Numbers) -> str:
    height = f" at a height of {number(params['z_ref'].value)} m" if "z_ref" in params else ""
    start = f"A wind that grows with height blows {{}}{height}"
    return _shift(_along_world(params), "m/s", start, "A wind of unknown direction grows with height")


def _gusts(_: Finding, params: Numbers) -> str:
    std, time = _plus(params["std"], "m/s"), _plus(params["corr_time"], "s")
    return f"The wind gusts by {std} along each axis (standard deviation), with a correlation time of {time}."


def _ground_effect(_: Finding, params: Numbers) -> str:
    return f"Ground effect acts with a strength of {_plus(params['k'], '')} (1: one rotor by itself).".replace(
        "  ", " "
    )


def _ceiling_effect(_: Finding, params: Numbers) -> str:
    return f"Ceiling effect acts with a strength of {_plus(params['k'], '')} (1: one rotor by itself).".replace(
        "  ", " "
    )


def _downwash(_: Finding, params: Numbers) -> str:
    width = f" over a width of {_plus(params['sigma'], 'm')}" if "sigma" in params else ""
    return f"The wake of the other vehicle pushes down with up to {_plus(params['force'], 'N')}{width}."


def _imu_bias(_: Finding, params: Numbers) -> str:
    parts = []
    for sensor, key, unit in (("accelerometer", "a", "m/s²"), ("gyro", "g", "rad/s")):
        for axis in "xyz":
            if (one := params.get(f"{key}{axis}")) is not None and one.certain:
                word = "too high" if one.value > 0.0 else "too low"
                size = f"{round_value(abs(one.value), one.half_width)} {tolerance(one.half_width, '')} {unit}"
                parts.append(f"{sensor} {axis} reads {size} {word}")
    return f"{_upper(join_words(parts))}." if parts else "The inertial sensors have a bias, but on no axis for certain."


def _upper(sentence: str) -> str:
    return sentence[0].upper() + sentence[1:]


def _imu_misalignment(_: Finding, params: Numbers) -> str:
    words = {
        "roll": ("rolled right", "rolled left"),
        "pitch": ("pitched nose down", "pitched nose up"),
        "yaw": ("yawed left", "yawed right"),
    }
    axes = [(one.scale(degrees(1.0)), *words[name]) for name, one in params.items()]
    unsure = "The inertial sensors are turned against the body, but about no axis for certain"
    return _shift(axes, "°", "The inertial sensors are mounted {}", unsure)


def _coefficients(
    start: str, labels: dict[str, str], unit: str, factor: float = 1.0
) -> Callable[[Finding, Numbers], str]:
    """Return a template that lists coefficients, their widest half width, and declared values unless all are zero."""

    def sentence(_: Finding, params: Numbers) -> str:
        shown = {name: params[name].scale(factor) for name in labels if name in params}
        parts = [
            f"{round_value(one.value, one.half_width)} {unit} {labels[name]}".strip() for name, one in shown.items()
        ]
        width, old = _widest(list(shown.values())), any(one.declared for one in shown.values())
        declared = f"; declared: {join_words([number(one.declared) for one in shown.values()])}" if old else ""
        return f"{start} {join_words(parts)}, {tolerance(width, unit)}{declared}.".replace("  ", " ")

    return sentence


def _h_force_flapping(_: Finding, params: Numbers) -> str:
    units = {"kh": ("drag coefficient", "µN s²/(m rad)"), "kf": ("moment coefficient", "µN s²/rad")}
    parts = [
        f"a {word} of {_plus(params[name].scale(1e6), unit)}" for name, (word, unit) in units.items() if name in params
    ]
    return f"In sideways flight, rotors have {join_words(parts)}."


AXES = {"dx": "forward", "dy": "sideways", "dz": "vertically"}


def _by_parameters(finding: Finding, params: Numbers) -> str:
    """Return the sentence of an effect without its own template, such as a user's effect."""
    units = {p.name: "" if p.unit == "-" else p.unit for p in EFFECTS.get(finding.subject).parameters}
    parts = [f"{name} = {_plus(one, units[name])}".rstrip() for name, one in params.items()]
    return f"The flights show {finding.subject}: {', '.join(parts)}."


def _failure(verb: str, of: str) -> Callable[[Finding, Numbers], str]:
    def sentence(finding: Finding, params: Numbers) -> str:
        rotors = f"r{_rotor(finding, params)}" if "motor" in params else "all rotors"
        share = f" {_plus(params['scale'].scale(1e2), '%')}" if "scale" in params else ""
        ends = "duration" in params and params["duration"].value < 1e4
        span = f" for {params['duration'].value:.3g} s" if ends else " on"
        when = f" from {params['time'].value:.2f} s{span}" if "time" in params else ""
        return f"In every flight, {rotors} {verb}{share} {of}{when}."

    return sentence


EFFECT_TEMPLATES: dict[str, Callable[[Finding, Numbers], str]] = {
    "rotor_drag": _coefficients("Air drag per airspeed is", AXES, "N s/m"),
    "quadratic_drag": _coefficients("Air drag per squared airspeed is", AXES, "N s²/m²"),
    "h_force_flapping": _h_force_flapping,
    "axial_inflow": _coefficients("Rotor thrust falls in climb by", {"ka": ""}, "µN s²/(m rad)", 1e6),
    "translational_lift": _coefficients("Rotor thrust grows with squared airspeed by", {"kt": ""}, "N s²/m²"),
    "thrust_coefficient": _thrust_coefficient,
    "weak_motor": _weak_motor,
    "torque_ratio": _torque_ratio,
    "motor_time_constant": _motor_time_constant,
    "motor_asymmetry": _motor_asymmetry,
    "motor_failure": _failure("follows", "of its commands"),
    "stuck_rotor": _failure("keeps", "its speed"),
    "brown_out": _failure("follow", "of their commands"),
    "actuation_delay": _actuation_delay,
    "battery_sag": _battery_sag,
    "rotor_inertia": _rotor_inertia,
    "motor_tilt": _motor_tilt,
    "joint_spring": _joint_spring,
    "joint_creep": _joint_creep,
    "com_offset": _com_offset,
    "payload_mass": _payload_mass,
    "slung_payload": _slung_payload,
    "inertia_error": _inertia_error,
    "constant_wind": _constant_wind,
    "wind_shear": _wind_shear,
    "gusts": _gusts,
    "ground_effect": _ground_effect,
    "ceiling_effect": _ceiling_effect,
    "downwash": _downwash,
    "imu_bias": _imu_bias,
    "imu_misalignment": _imu_misalignment,
    "rotor_speed_scale": _rotor_speed_scale,
    "blade_element": _coefficients("Blade-element theory acts with a share of", {"share": "of 1"}, ""),
    "vortex_ring": _coefficients("Thrust is lost in fast descent, by a coefficient of", {"k": ""}, ""),
}
"""Template of each effect that flights can show."""

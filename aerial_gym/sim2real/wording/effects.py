"""Sentences of named effects, with physical names, units, and directions in a pilot's words.

A direction is stated only if the confidence interval of the change excludes zero.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.wording.words import (
    decimals_of_half_width,
    half_width_text,
    join_words,
    number_text,
    percent_text,
    value_text,
)

LEAST_CERTAIN = 0.95  # Probability below which a sentence calls the effect probable


@dataclass(frozen=True)
class ParameterChange:
    """A fitted and a declared value of a parameter with the half width of the interval, in the unit of the sentence."""

    value: float
    declared: float
    half_width: float | None

    @property
    def change(self) -> float:
        """Return the fitted minus the declared value."""
        return self.value - self.declared

    @property
    def is_certain(self) -> bool:
        """Return whether the interval of the change excludes zero; True without an interval."""
        return self.half_width is None or abs(self.change) > self.half_width

    def convert_unit(self, factor: float) -> "ParameterChange":
        """Return the parameter multiplied by a unit factor."""
        half = None if self.half_width is None else abs(factor) * self.half_width
        return ParameterChange(factor * self.value, factor * self.declared, half)


ParameterChanges = dict[str, ParameterChange]
EffectTemplate = Callable[[Finding, ParameterChanges], str]
DirectedNumber = tuple[ParameterChange, str, str]  # A number with the words for a rise and for a fall of it


def parameter_changes(finding: Finding) -> ParameterChanges:
    """Return the parameters in the finding of a named effect, by name."""
    params = {}
    for parameter in EFFECTS.get(finding.subject).parameters:
        values = finding.values.get(f"{parameter.name}_{unit_suffix(parameter.unit)}")
        if isinstance(values, dict):
            declared = values["value"] if values["declared"] is None else values["declared"]
            params[parameter.name] = ParameterChange(values["value"], declared, values["half_width"])
    return params


def effect_sentence(finding: Finding) -> str:
    """Return the sentence of a named effect: with ``Probably`` if uncertain, with ``If it is`` if tied.

    One that the test flights do not show to be material says so.
    """
    params, ties = parameter_changes(finding), finding.values["ties"]
    try:
        sentence = EFFECT_TEMPLATES.get(finding.subject, _parameter_sentence)(finding, params)
    except KeyError:  # a parameter of the template is not shown by the flights
        sentence = _parameter_sentence(finding, params)
    lower = sentence if sentence[:3] == "IMU" else sentence[0].lower() + sentence[1:]
    if not finding.values.get("material", True):
        return f"By the training flights alone, {'if it is ' + finding.subject + ', ' if ties else ''}{lower}"
    if ties:
        return f"If it is {finding.subject}, {lower}"
    probability = float(finding.values["probability"])
    return sentence if probability >= LEAST_CERTAIN else f"Probably ({percent_text(probability)}), {lower}"


def _parameter_sentence(finding: Finding, params: ParameterChanges) -> str:
    """Return the sentence of an effect without its own template, such as a user's effect."""
    units = {p.name: "" if p.unit == "-" else p.unit for p in EFFECTS.get(finding.subject).parameters}
    parts = [f"{name} = {_value_with_half_width(one, units[name])}".rstrip() for name, one in params.items()]
    return f"The flights show {finding.subject}: {', '.join(parts)}."


def _value_with_half_width(one: ParameterChange, unit: str) -> str:
    """Return ``value ± half width unit``."""
    width = "" if decimals_of_half_width(one.half_width) is None else f" {half_width_text(one.half_width, '')}"
    return f"{value_text(one.value, one.half_width)}{width} {unit}".replace(" °", "°")


def _rotor_name(finding: Finding, params: ParameterChanges) -> str:
    place = finding.values.get("place")
    return f"rotor {params['motor'].value:.0f}" + (f" ({place})" if place else "")


def _largest_half_width(numbers: Sequence[ParameterChange]) -> float | None:
    widths = [one.half_width for one in numbers if one.half_width is not None]
    return max(widths) if len(widths) == len(numbers) and widths else None


def _change_sentence(numbers: Sequence[DirectedNumber], unit: str, start: str, unsure: str) -> str:
    """Return a sentence on the certain changes and their widest half width; it starts with ``unsure`` if none is certain."""
    certain = [(one, more if one.change > 0.0 else less) for one, more, less in numbers if one.is_certain]
    width = _largest_half_width([one for one, _ in certain] or [one for one, *_ in numbers])
    if not certain:
        return f"{unsure}, {half_width_text(width, unit)}."
    space = "" if unit == "°" else " "
    parts = [f"{value_text(abs(one.change), width)}{space}{unit} {word}" for one, word in certain]
    return f"{start.format(join_words(parts))}, {half_width_text(width, unit)}."


def _change_template(
    start: str, unsure: str, words: Mapping[str, tuple[str, str]], unit: str, factor: float = 1.0
) -> EffectTemplate:
    """Return the template of changes of parameters, each with the words for a rise and for a fall."""

    def sentence(finding: Finding, params: ParameterChanges) -> str:
        axes = [(params[name].convert_unit(factor), *words[name]) for name in words if name in params]
        rotor = _rotor_name(finding, params) if "motor" in params else ""
        return _change_sentence(axes, unit, start.replace("ROTOR", rotor), unsure.replace("ROTOR", rotor))

    return sentence


def _ratio_template(start: str, more: str, less: str, end: str = "than declared") -> EffectTemplate:
    """Return the template of the relative change of the parameter ``scale``."""

    def sentence(finding: Finding, params: ParameterChanges) -> str:
        one, rotor = params["scale"], _rotor_name(finding, params) if "motor" in params else ""
        half_width = one.half_width and 1e2 * one.half_width / one.declared
        change = 1e2 * (one.value / one.declared - 1.0)
        size, word = value_text(abs(change), half_width), more if change > 0.0 else less
        return (
            f"{start.replace('ROTOR', rotor.capitalize())} {size} % {word} {end}, {half_width_text(half_width, '%')}."
        )

    return sentence


def _coefficient_template(start: str, labels: Mapping[str, str], unit: str, factor: float = 1.0) -> EffectTemplate:
    """Return the template of coefficients, their widest half width, and declared values unless all are zero."""

    def sentence(_: Finding, params: ParameterChanges) -> str:
        shown = {name: params[name].convert_unit(factor) for name in labels if name in params}
        parts = [
            f"{value_text(one.value, one.half_width)} {unit} {labels[name]}".strip() for name, one in shown.items()
        ]
        width, old = _largest_half_width(list(shown.values())), any(one.declared for one in shown.values())
        declared = f"; declared: {join_words([number_text(one.declared) for one in shown.values()])}" if old else ""
        return f"{start} {join_words(parts)}, {half_width_text(width, unit)}{declared}.".replace("  ", " ")

    return sentence


def _failure_template(verb: str, of: str) -> EffectTemplate:
    def sentence(finding: Finding, params: ParameterChanges) -> str:
        rotors = _rotor_name(finding, params) if "motor" in params else "all rotors"
        share = f" {_value_with_half_width(params['scale'].convert_unit(1e2), '%')}" if "scale" in params else ""
        ends = "duration" in params and params["duration"].value < 1e4
        span = f" for {params['duration'].value:.3g} s" if ends else " on"
        when = f" from {params['time'].value:.2f} s{span}" if "time" in params else ""
        return f"In every flight, {rotors} {verb}{share} {of}{when}."

    return sentence


def _value_template(start: str, units: Mapping[str, tuple[float, str]], **clauses: str) -> EffectTemplate:
    """Return the template of values with half widths.

    ``units`` has the factor and the unit of each parameter, ``clauses`` the end of the sentence for known parameters;
    ``{declared}`` is the clause of a declared value.
    """

    def sentence(_: Finding, params: ParameterChanges) -> str:
        texts, declared = {}, ""
        for name, (factor, unit) in units.items():
            if name in params:
                one = params[name].convert_unit(factor)
                texts[name] = _value_with_half_width(one, unit)
                declared += f"; {number_text(one.declared)} {unit} is declared" if one.declared else ""
        ends = [clause for name, clause in clauses.items() if name in texts]
        return f"{''.join([start, *ends]).format(**texts, declared=declared).strip()}."

    return sentence


def _payload_mass_sentence(_: Finding, params: ParameterChanges) -> str:
    one = params["dm"].convert_unit(1e3)
    word = "heavier" if one.change > 0.0 else "lighter"
    size = value_text(abs(one.change), one.half_width)
    return f"The vehicle is {size} g {word} than declared, {half_width_text(one.half_width, 'g')}."


def _motor_time_constant_sentence(_: Finding, params: ParameterChanges) -> str:
    tau = params["tau"].convert_unit(1e3)
    declared = value_text(tau.declared, tau.half_width)
    return f"The rotors lag with a time constant of {_value_with_half_width(tau, 'ms')}; {declared} ms is declared."


def _rise_and_fall_time_sentence(_: Finding, params: ParameterChanges) -> str:
    ways = [(params[name], way) for name, way in (("tau_up", "rises"), ("tau_down", "falls")) if name in params]
    parts = [f"{way} with {_value_with_half_width(one.convert_unit(1e3), 'ms')}" for one, way in ways]
    return f"Rotor speed {join_words(parts)} of time constant."


def _slung_payload_sentence(_: Finding, params: ParameterChanges) -> str:
    mass = _value_with_half_width(params["mass"].convert_unit(1e3), "g") if "mass" in params else "unknown mass"
    length = f" at {_value_with_half_width(params['length'], 'm')} below the body origin" if "length" in params else ""
    return f"A payload of {mass} swings on a cable{length}."


def _axis_ratio_template(one: str, several: str) -> EffectTemplate:
    """Return the template of ratios sx, sy and sz of a quantity about the body axes, in the singular and the plural."""
    words = {"sx": "in roll", "sy": "in pitch", "sz": "in yaw"}

    def sentence(_: Finding, params: ParameterChanges) -> str:
        ratios = [(ratio.convert_unit(1e2 / ratio.declared), words[axis]) for axis, ratio in params.items()]
        axes = [(ratio, f"higher {place}", f"lower {place}") for ratio, place in ratios]
        unsure = f"The {several} differ from the declared ones, but no axis for certain"
        return _change_sentence(axes, "%", f"The {one} is {{}} than declared", unsure)

    return sentence


def _wind_shear_sentence(finding: Finding, params: ParameterChanges) -> str:
    height = f" at a height of {number_text(params['z_ref'].value)} m" if "z_ref" in params else ""
    start, unsure = "A wind that grows with height blows {}", "A wind of unknown direction grows with height"
    return _change_template(f"{start}{height}", unsure, WORLD_WORDS, "m/s")(finding, params)


def _imu_bias_sentence(_: Finding, params: ParameterChanges) -> str:
    parts = []
    for sensor, key, unit in (("accelerometer", "a", "m/s²"), ("gyro", "g", "rad/s")):
        for axis in "xyz":
            if (one := params.get(f"{key}{axis}")) is not None and one.is_certain:
                word = "too high" if one.value > 0.0 else "too low"
                size = f"{value_text(abs(one.value), one.half_width)} {half_width_text(one.half_width, '')} {unit}"
                parts.append(f"{sensor} {axis} reads {size} {word}")
    if not parts:
        return "The inertial sensors have a bias, but on no axis for certain."
    return f"{parts[0][0].upper()}{join_words(parts)[1:]}."


def _thrust_curve_sentence(_: Finding, params: ParameterChanges) -> str:
    """Return the sentence on the exponent ``1 + k / 2`` over hover, the same for commands of speed and of thrust."""
    one = params["k"].convert_unit(0.5)
    size = f"{value_text(1.0 + one.value, one.half_width)} {half_width_text(one.half_width, '')}"
    return f"Relative to hover, thrust is the declared thrust to the power of {size}."


def _h_force_flapping_sentence(_: Finding, params: ParameterChanges) -> str:
    units = {"kh": ("drag coefficient", "µN s²/(m rad)"), "kf": ("moment coefficient", "µN s²/rad")}
    parts = [
        f"a {word} of {_value_with_half_width(params[name].convert_unit(1e6), unit)}"
        for name, (word, unit) in units.items()
        if name in params
    ]
    return f"In sideways flight, rotors have {join_words(parts)}."


ARM_UNITS = {"compliance": (degrees(1.0), "°"), "tau": (1.0, "s")}
AXES = {"dx": "forward", "dy": "sideways", "dz": "vertically"}
PLACE_WORDS = {"x": ("ahead of", "behind"), "y": ("to the left of", "to the right of"), "z": ("above", "below")}
TILT_WORDS = {"roll": ("to the right", "to the left"), "pitch": ("forward", "backward")}
WORLD_WORDS = {axis: (f"towards world +{axis}", f"towards world -{axis}") for axis in "xyz"}
MOUNT_WORDS = {
    "roll": ("rolled right", "rolled left"),
    "pitch": ("pitched nose down", "pitched nose up"),
    "yaw": ("yawed left", "yawed right"),
}


def _mount_template(state: str, several: str) -> EffectTemplate:
    unsure = f"The {several} are turned against the body, but about no axis for certain"
    return _change_template(f"The {state} {{}}", unsure, MOUNT_WORDS, "°", degrees(1.0))


EFFECT_TEMPLATES: dict[str, EffectTemplate] = {
    "rotor_drag": _coefficient_template("Air drag per airspeed is", AXES, "N s/m"),
    "rotor_drag_of_thrust": _coefficient_template("Air drag per airspeed is", AXES | {"k": "by thrust"}, "N s/m"),
    **dict.fromkeys(
        ("quadratic_drag", "quadratic_drag_of_axes"),
        _coefficient_template("Air drag per squared airspeed is", AXES, "N s²/m²"),
    ),
    "h_force_flapping": _h_force_flapping_sentence,
    "axial_inflow": _coefficient_template("Rotor thrust falls in climb by", {"ka": ""}, "µN s²/(m rad)", 1e6),
    "translational_lift": _coefficient_template("Rotor thrust grows with squared airspeed by", {"kt": ""}, "N s²/m²"),
    "thrust_curve": _thrust_curve_sentence,
    "thrust_coefficient": _ratio_template("All rotors give", "more thrust", "less thrust"),
    "weak_motor": _ratio_template("ROTOR gives", "more thrust", "less thrust"),
    "motor_gain": _ratio_template("ROTOR reaches", "more speed", "less speed", "than commanded"),
    "torque_ratio": _ratio_template("The drag torque of the rotors is", "higher", "lower"),
    "arm_length": _ratio_template("The arms are", "longer", "shorter"),
    "motor_time_constant": _motor_time_constant_sentence,
    "motor_asymmetry": _rise_and_fall_time_sentence,
    "motor_failure": _failure_template("follows", "of its commands"),
    "stuck_rotor": _failure_template("keeps", "its speed"),
    "brown_out": _failure_template("follow", "of their commands"),
    "actuation_delay": _value_template("Commands act with a dead time of {delay}{declared}", {"delay": (1e3, "ms")}),
    "battery_sag": _value_template("Rotor speed falls by {gain} for 10 % less battery voltage", {"gain": (10.0, "%")}),
    "thrust_voltage": _value_template(
        "At a rotor speed, thrust grows with the battery voltage to the power of {k}", {"k": (1.0, "")}
    ),
    "rotor_inertia": _value_template(
        "Each rotor has an inertia of {jr} about its axis{declared}", {"jr": (1e6, "mg m²")}
    ),
    "motor_tilt": _change_template(
        "The axis of ROTOR is tilted {}",
        "The axis of ROTOR is tilted, but its direction is not certain",
        TILT_WORDS,
        "°",
        degrees(1.0),
    ),
    "joint_spring": _value_template(
        "The arms bend elastically by {compliance} per N m of load", ARM_UNITS, tau=" within {tau}"
    ),
    "joint_creep": _value_template("The arms creep by {compliance} per N m of load", ARM_UNITS, tau=" within {tau}"),
    "com_offset": _change_template(
        "The centre of mass lies {} the declared one",
        "The centre of mass is shifted from the declared one, but its direction is not certain",
        PLACE_WORDS,
        "mm",
        1e3,
    ),
    "payload_mass": _payload_mass_sentence,
    "slung_payload": _slung_payload_sentence,
    "slung_payload_rod": _value_template(
        "A rod of {mass} swings below the body origin",
        {"mass": (1e3, "g"), "length": (1.0, "m"), "damping": (1.0, "N s/m")},
        length=". Its length is {length}",
    ),
    "inertia_error": _axis_ratio_template("moment of inertia", "moments of inertia"),
    "torque_gain": _axis_ratio_template("torque of the rotors", "torques of the rotors"),
    "products_of_inertia": _change_template(
        "Per moment of inertia, products of inertia are {} than declared",
        "Products of inertia differ from the declared ones, but none for certain",
        {pair: (f"higher in {pair}", f"lower in {pair}") for pair in ("xy", "xz", "yz")},
        "%",
        1e2,
    ),
    "constant_wind": _change_template(
        "A steady wind blows {}", "A steady wind of unknown direction blows", WORLD_WORDS, "m/s"
    ),
    "wind_shear": _wind_shear_sentence,
    "gusts": _value_template(
        "The wind gusts by {std} along each axis (standard deviation), with a correlation time of {corr_time}",
        {"std": (1.0, "m/s"), "corr_time": (1.0, "s"), "vertical": (1.0, ""), "vertical_time": (1.0, "")},
        vertical="; vertically {vertical}times that",
        vertical_time=", with {vertical_time}times the correlation time",
    ),
    "ground_effect": _value_template(
        "Ground effect acts with a strength of {k}(1: one rotor by itself)", {"k": (1.0, "")}
    ),
    "ceiling_effect": _value_template(
        "Ceiling effect acts with a strength of {k}(1: one rotor by itself)", {"k": (1.0, "")}
    ),
    **{
        f"{surface}_effect_curve": _value_template(
            f"Near the {surface} thrust follows a curve",
            {f"g{radii}": (1e2, "%") for radii in (1, 2, 4, 8)},
            **{f"g{radii}": f", part at {radii} rotor radii {{g{radii}}}" for radii in (1, 2, 4, 8)},
        )
        for surface in ("ground", "ceiling")
    },
    **{
        f"downwash{law}": _value_template(
            "The wake of the other vehicle pushes down with up to {force}" + at,
            {"force": (1.0, "N"), "sigma": (1.0, "m"), "spread": (1.0, ""), "power": (1.0, "")},
            sigma=" over a width of {sigma}",
            spread=". Its width per distance is {spread}",
            power=". Its edge has the power {power}",
        )
        for law, at in (("", ""), ("_jet", " at 1 m below it"), ("_core", ""))
    },
    "imu_bias": _imu_bias_sentence,
    "imu_misalignment": _mount_template("inertial sensors are mounted", "inertial sensors"),
    "attitude_bias": _mount_template("axes of the logged attitude are", "axes of the logged attitude"),
    "command_curve": _coefficient_template(
        "The command curve per hover speed has",
        {"offset": "as offset", "gain": "as gain", "power": "as exponent"},
        "",
    ),
    "rotor_speed_scale": _ratio_template(
        "The logged rotor speeds read", "too high", "too low", "against the true ones"
    ),
    "tachometer_scale": _ratio_template("ROTOR is logged", "too fast", "too slow", "against its true speed"),
    "blade_element": _coefficient_template("Blade-element theory acts with a share of", {"share": "of 1"}, ""),
    "vortex_ring": _coefficient_template("Thrust is lost in fast descent, by a coefficient of", {"k": ""}, ""),
}
"""Template of each effect that flights can show."""

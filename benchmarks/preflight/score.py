"""The judge of the benchmark: is the planted fault named, with its number, and nothing else?"""

from collections.abc import Callable, Mapping

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.preflight.check import Preflight

CODES = {
    "gyro_sign_contradicted": "gyro_sign",
    "rotor_order_contradicted": "rotor_order",
    "spins_contradicted": "spins",
}

EXPECTED: dict[str, Callable[[Mapping], tuple[str, ...]]] = {
    "gyro_scale": lambda v: (f"gyro_scale_{'xyz'[int(v['axis'])]}",),
    "gyro_sign": lambda v: (f"gyro_sign_{'xyz'[int(v['axis'])]}",),
    "acc_scale": lambda _: ("accelerometer_scale",),
    "rotor_order": lambda v: (f"rotor_order_{v['first']:.0f}_{v['second']:.0f}",),
    "spins_reversed": lambda _: ("spins_1_2_3_4",),
    "spin_of_one": lambda v: (f"spins_{v['rotor']:.0f}",),
    "thrust": lambda _: ("thrust_per_weight",),
    "mass": lambda _: ("thrust_per_weight",),
    "thrust_curve": lambda _: ("thrust_exponent",),
    "rate_curve": lambda _: ("rate_gain_x", "rate_gain_y", "rate_gain_z"),
    "command_latency": lambda _: ("command_latency",),
    "motor_latency": lambda _: ("motor_latency",),
    "state_latency": lambda _: ("attitude_latency", "lin_vel_latency", "position_latency"),
    "link": lambda _: ("link_rate", "link_jitter"),
    "packet_loss": lambda _: ("packet_loss",),
    "nominal_voltage": lambda _: ("nominal_voltage",),
    "voltage_reading": lambda _: ("voltage_reading",),
    "torque_ratio": lambda _: ("torque_ratio",),
}
"""Names that a fault should have, all of them."""


def true_values(truth: Mapping) -> dict[str, tuple[float, float]]:
    """Return the true value of each expected constant and the limit of its error."""
    values, kind, delay = truth["values"], truth["kind"], truth["delay_s"]
    name = EXPECTED[kind](values)[0] if kind else ""
    late = values.get("delay", 0.0)
    pose, gyro = delay["rotation"], delay["rate"]
    return {
        "gyro_scale": {name: (values.get("scale", 1.0), 0.01)},
        "acc_scale": {name: (values.get("scale", 1.0) * truth["acc_scale"], 0.01)},
        "thrust": {name: (truth["thrust_per_weight"], 0.02 * truth["thrust_per_weight"])},
        "mass": {name: (truth["thrust_per_weight"], 0.02 * truth["thrust_per_weight"])},
        "thrust_curve": {name: (2.0 + values.get("k", 0.0), 0.1)},
        "rate_curve": {f"rate_gain_{axis}": (values.get("scale", 1.0), 0.03 * values.get("scale", 1.0)) for axis in "xyz"},
        "command_latency": {name: (late, 0.005)},
        "motor_latency": {name: (late + delay["rotor"], 0.005)},
        "state_latency": {
            "attitude_latency": (late + pose - gyro, 0.005), "lin_vel_latency": (late + delay["velocity"] - gyro, 0.005),
        },
        "link": {"link_rate": (truth["link"]["rate"], 0.1 * truth["link"]["rate"]),
                 "link_jitter": (truth["jitter_s"], 0.1 * truth["jitter_s"])},
        "packet_loss": {name: (truth["loss"], 0.1 * truth["loss"])},
        "torque_ratio": {name: (0.014 * values.get("scale", 1.0), 0.05 * 0.014 * values.get("scale", 1.0))},
    }.get(kind, {})  # fmt: skip


def name_of_finding(finding: Finding) -> str:
    """Return the name of a contradiction, with its axis or rotors."""
    if finding.code not in CODES:
        return finding.subject
    parts = [finding.subject] if finding.subject else [f"{rotor}" for rotor in finding.values["rotors"]]
    return "_".join((CODES[finding.code], *parts))


def judge(result: Preflight, truth: Mapping) -> dict:
    """Return whether a result is right, its contradictions, the largest error over its limit, and true values in intervals."""
    named = {name_of_finding(one): one.values for one in result.contradictions}
    expected = EXPECTED[truth["kind"]](truth["values"]) if truth["kind"] else ()
    known = [(named[name], *pair) for name, pair in true_values(truth).items() if name in named]
    errors = [(values["value"] - value) / limit for values, value, limit in known]
    inside = int(sum(values["low"] <= value <= values["high"] for values, value, _ in known))
    worst = max(errors, key=abs, default=None)
    right = set(named) == set(expected) and all(abs(error) <= 1.0 for error in errors)
    row = {"right": right, "named": sorted(named), "error_share": worst, "expected": list(expected)}
    return row | {"intervals": [inside, len(known)]}

"""The hidden effects: parameters, three sizes of each, how they change the vehicle, and the vehicles of a case.

``EFFECTS`` are those that the package has a name for; ``UNKNOWN`` are causes that it has none for; ``OTHER_LAWS`` are effects
of the first kind by other published laws. The place in a table is the random stream of an effect: new ones go to its end. A
hidden effect changes the true vehicle only. The one exception is
``rotor_drag``: the declared vehicle has linear drag, which is taken out of the declaration where that drag is hidden.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.undeclared.other_laws import OTHER_LAWS
from benchmarks.undeclared.plant_effect import SIZES, Params, PlantEffect, Ranges, field_effect, set_extra
from benchmarks.undeclared.vehicle import DECLARED, PlantVehicle

FEATURES = ("battery", "low", "ceiling", "heights", "other", "hover")
"""Features of flights beyond the plain ones: a battery that empties, flights near the ground, flights below a ceiling, flights
at very different heights, another vehicle above, training flights that only hover."""


def _draw_drag(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return drag near ``size`` forward and sideways, and about half of it along the rotor axis."""
    return dict(zip(("dx", "dy", "dz"), size * rng.uniform((0.9, 0.9, 0.4), (1.1, 1.1, 0.7)), strict=True))


def _draw_scale(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"scale": 1.0 + rng.choice((-1.0, 1.0)) * size}


def _draw_horizontal(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return a vector of horizontal length ``size`` in any direction, and up to a third of it along z."""
    angle = rng.uniform(-np.pi, np.pi)
    return {"x": size * np.cos(angle), "y": size * np.sin(angle), "z": size * rng.uniform(-0.33, 0.33)}


def _draw_wind(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return wind of horizontal speed ``size`` from any direction, with up to a fifteenth of it along z."""
    wind = _draw_horizontal(rng, size, declared)
    return {**wind, "z": 0.2 * wind["z"]}


def _draw_asymmetry(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return a fall ``1 + size`` times as slow as the rise, the rise within 10 % of the declared lag."""
    up = declared.tau_up * rng.uniform(0.9, 1.1)
    return {"tau_up": up, "tau_down": up * (1.0 + size)}


def _draw_tilt(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return a tilt of ``size`` of one rotor in any direction."""
    angle = rng.uniform(-np.pi, np.pi)
    return {"motor": float(rng.integers(1, 5)), "roll": size * np.cos(angle), "pitch": size * np.sin(angle)}


def _draw_inertia(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return scales off by half to all of ``size`` such that principal moments remain those of a body."""
    while True:
        scale = 1.0 + rng.choice((-1.0, 1.0), 3) * rng.uniform(0.5, 1.0, 3) * size
        moments = np.linalg.eigvalsh(declared.inertia * np.sqrt(np.outer(scale, scale)))
        if moments[2] < moments[0] + moments[1]:
            return dict(zip(("sx", "sy", "sz"), scale, strict=True))


def _draw_shear(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    wind = _draw_horizontal(rng, size, declared)
    return {"x": wind["x"], "y": wind["y"], "z_ref": 10.0, "exponent": rng.uniform(0.15, 0.35)}


def _draw_bias(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return an accelerometer bias of length ``size`` [m/s²] and a gyro bias of length ``size`` / 10 [rad/s]."""
    directions = rng.standard_normal((2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return dict(zip(("ax", "ay", "az", "gx", "gy", "gz"), (size * directions * [[1.0], [0.1]]).ravel(), strict=True))


def _draw_misalignment(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    direction = rng.standard_normal(3)
    return dict(zip(("roll", "pitch", "yaw"), size * direction / np.linalg.norm(direction), strict=True))


def _draw_attraction(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    x, y, z = rng.uniform((-1.0, -1.0, 5.0), (1.0, 1.0, 7.0))
    return {"x": x, "y": y, "z": z, "force": size, "radius": rng.uniform(0.8, 1.4)}


def _rotor_row(params: Params) -> int:
    """Return the row of the rotor that ``motor`` counts from 1 on."""
    motor = int(params["motor"])
    if motor != params["motor"] or not 1 <= motor <= len(DECLARED.thrust_coeff):
        raise ValueError(f"motor = {params['motor']!r}: must be a whole number from 1 to {len(DECLARED.thrust_coeff)}")
    return motor - 1


def _weaken_rotor(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    coeff = vehicle.thrust_coeff.copy()
    coeff[_rotor_row(params)] *= params["scale"]
    return replace(vehicle, thrust_coeff=coeff)


def _tilt_rotor(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    """Return the vehicle with one axis turned about body x by ``roll``, then about body y by ``pitch``."""
    axis, row = vehicle.rotor_axis.copy(), _rotor_row(params)
    (cr, sr), (cp, sp) = ((np.cos(params[n]), np.sin(params[n])) for n in ("roll", "pitch"))
    x, y, z = axis[row]
    y, z = cr * y - sr * z, sr * y + cr * z
    axis[row] = cp * x + sp * z, y, cp * z - sp * x
    return replace(vehicle, rotor_axis=axis)


def _delay_commands(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    steps = params["delay"] * 2000.0
    if steps < 0.0 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"actuation_delay.delay = {params['delay']!r}: must be a multiple of 0.0005 s, >= 0")
    return set_extra(vehicle, delay=params["delay"])


def _scale_inertia(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    scale = np.array([params[name] for name in ("sx", "sy", "sz")])
    return replace(vehicle, inertia=vehicle.inertia * np.sqrt(np.outer(scale, scale)))


SOFT_ARMS: Ranges = ((0.7, 0.9), (1.4, 1.8), (2.4, 2.8))
DRAG: dict[str, float | None] = {"dx": 0.0, "dy": 0.0, "dz": 0.0}
VECTOR: dict[str, float | None] = {"x": 0.0, "y": 0.0, "z": 0.0}
ANGLES: dict[str, float | None] = {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}

EFFECTS: dict[str, PlantEffect] = {
    "rotor_drag": field_effect(  # N s/m
        "linear_drag", DRAG, ((0.07, 0.10), (0.17, 0.27), (0.35, 0.45)), _draw_drag, needs=()
    ),
    "quadratic_drag": field_effect(  # N s²/m²
        "quadratic_drag", DRAG, ((0.012, 0.018), (0.03, 0.05), (0.08, 0.11)), _draw_drag, needs=()
    ),
    "thrust_coefficient": PlantEffect(
        params={"scale": None},  # 1 is neutral
        ranges=((0.015, 0.025), (0.04, 0.06), (0.10, 0.14)),
        draw=_draw_scale,
        apply=lambda v, p: replace(v, thrust_coeff=p["scale"] * v.thrust_coeff),
        needs=(),
    ),
    "com_offset": field_effect(  # m
        "com", VECTOR, ((0.002, 0.003), (0.005, 0.007), (0.010, 0.013)), _draw_horizontal, needs=()
    ),
    "motor_time_constant": PlantEffect(
        params={"tau": None},  # s; drawn as a multiple of the declared one
        ranges=((1.15, 1.25), (1.5, 1.7), (2.0, 2.3)),
        draw=lambda _rng, size, declared: {"tau": size * 0.5 * (declared.tau_up + declared.tau_down)},
        apply=lambda v, p: replace(v, tau_up=p["tau"], tau_down=p["tau"]),
        needs=(),
    ),
    "constant_wind": field_effect(  # m/s, world
        "wind_world", VECTOR, ((0.8, 1.2), (2.0, 3.0), (4.0, 5.0)), _draw_wind, needs=()
    ),
    "h_force_flapping": PlantEffect(
        params={"kh": 0.0, "kf": 0.0},  # N s²/(m rad), N s²/rad; drawn with a lever of 4 to 8 mm
        ranges=((1.0e-5, 1.5e-5), (3.0e-5, 5.0e-5), (8.0e-5, 1.1e-4)),
        draw=lambda rng, size, _: {"kh": size, "kf": size * rng.uniform(0.004, 0.008)},
        apply=lambda v, p: set_extra(v, h_force=p["kh"], flapping=p["kf"]),
    ),
    "axial_inflow": field_effect(  # N s²/(m rad)
        "axial_inflow", {"ka": None}, ((1.5e-5, 2.5e-5), (5.0e-5, 8.0e-5), (1.2e-4, 1.6e-4))
    ),
    "translational_lift": field_effect(  # N s²/m², of each rotor
        "translational_lift", {"kt": None}, ((0.003, 0.005), (0.010, 0.016), (0.03, 0.04))
    ),
    "weak_motor": PlantEffect(
        params={"motor": None, "scale": None},  # from 1 on; 1 is neutral
        ranges=((0.02, 0.03), (0.05, 0.08), (0.12, 0.16)),
        draw=lambda rng, size, _: {"motor": float(rng.integers(1, 5)), "scale": 1.0 - size},
        apply=_weaken_rotor,
    ),
    "torque_ratio": PlantEffect(
        params={"scale": None},  # 1 is neutral
        ranges=((0.08, 0.12), (0.2, 0.3), (0.4, 0.5)),
        draw=_draw_scale,
        apply=lambda v, p: replace(v, torque_ratio=p["scale"] * v.torque_ratio),
    ),
    "motor_asymmetry": PlantEffect(
        params={"tau_up": None, "tau_down": None},  # s
        ranges=((0.2, 0.3), (0.5, 0.7), (1.0, 1.3)),
        draw=_draw_asymmetry,
        apply=lambda v, p: replace(v, tau_up=p["tau_up"], tau_down=p["tau_down"]),
    ),
    "actuation_delay": PlantEffect(
        params={"delay": None},  # s
        ranges=((0.003, 0.005), (0.008, 0.012), (0.018, 0.024)),
        draw=lambda _rng, size, _declared: {"delay": round(size * 2000.0) / 2000.0},
        apply=_delay_commands,
    ),
    "battery_sag": field_effect(  # 1: speed follows the voltage
        "battery_gain", {"gain": None}, ((0.15, 0.25), (0.4, 0.6), (0.9, 1.1))
    ),
    "rotor_inertia": field_effect(  # kg m²
        "rotor_inertia", {"jr": None}, ((1.0e-6, 1.5e-6), (3.0e-6, 5.0e-6), (1.0e-5, 1.5e-5))
    ),
    "motor_tilt": PlantEffect(
        params={"motor": None, "roll": 0.0, "pitch": 0.0},  # from 1 on, rad
        ranges=((0.015, 0.025), (0.04, 0.06), (0.10, 0.14)),
        draw=_draw_tilt,
        apply=_tilt_rotor,
    ),
    "payload_mass": PlantEffect(
        params={"dm": None},  # kg
        ranges=((0.012, 0.018), (0.04, 0.06), (0.10, 0.15)),
        draw=lambda _rng, size, _declared: {"dm": size},
        apply=lambda v, p: replace(v, mass=v.mass + p["dm"]),
    ),
    "slung_payload": field_effect(  # kg, m, N s/m
        "slung",
        {"mass": None, "length": None, "damping": 0.0},
        ((0.012, 0.018), (0.04, 0.06), (0.10, 0.15)),
        lambda rng, size, _: {"mass": size, "length": rng.uniform(0.5, 1.0), "damping": size * rng.uniform(0.2, 0.4)},
    ),
    "inertia_error": PlantEffect(
        params={"sx": 1.0, "sy": 1.0, "sz": 1.0},
        ranges=((0.06, 0.09), (0.15, 0.22), (0.3, 0.4)),
        draw=_draw_inertia,
        apply=_scale_inertia,
    ),
    "wind_shear": field_effect(  # m/s at z_ref, m
        "shear",
        {"x": 0.0, "y": 0.0, "z_ref": 10.0, "exponent": 0.2},
        ((0.8, 1.2), (2.0, 3.0), (4.0, 5.0)),
        _draw_shear,
        needs=("battery", "heights"),
    ),
    "gusts": field_effect(  # m/s, s
        "gust", {"std": None, "corr_time": 1.0}, ((0.3, 0.5), (0.9, 1.3), (2.0, 2.6)), drawn={"corr_time": (0.5, 2.0)}
    ),
    "ground_effect": field_effect(  # 1: a rotor by itself
        "ground", {"k": None}, ((0.7, 1.0), (1.5, 2.0), (2.8, 3.3)), needs=("battery", "low")
    ),
    "ceiling_effect": field_effect(
        "ceiling", {"k": None}, ((1.0, 1.3), (1.9, 2.4), (3.0, 3.4)), needs=("battery", "ceiling")
    ),
    "downwash": field_effect(  # N, m
        "downwash",
        {"force": None, "sigma": None},
        ((0.12, 0.18), (0.4, 0.6), (1.0, 1.4)),
        drawn={"sigma": (0.25, 0.4)},
        needs=("battery", "other"),
    ),
    "imu_bias": field_effect(  # m/s², rad/s
        "imu_bias",
        dict.fromkeys(("ax", "ay", "az", "gx", "gy", "gz"), 0.0),
        ((0.07, 0.10), (0.2, 0.3), (0.5, 0.8)),
        _draw_bias,
    ),
    "imu_misalignment": field_effect(  # rad
        "imu_turn", ANGLES, ((0.008, 0.012), (0.025, 0.035), (0.06, 0.09)), _draw_misalignment
    ),
    "rotor_speed_scale": field_effect(  # 1 is neutral
        "rotor_reading", {"scale": None}, ((0.01, 0.015), (0.03, 0.05), (0.08, 0.12)), _draw_scale
    ),
    "joint_spring": field_effect(  # rad/(N m), s
        "joint_spring", {"compliance": None, "tau": 0.03, "hinge": 0.4}, SOFT_ARMS, drawn={"tau": (0.02, 0.06)}
    ),
    "joint_creep": field_effect(  # rad/(N m), s
        "joint_creep", {"compliance": None, "tau": 3.0, "hinge": 0.4}, SOFT_ARMS, drawn={"tau": (1.5, 4.0)}
    ),
    "thrust_curve": field_effect(  # 0 is neutral
        "thrust_curve",
        {"k": None},
        ((0.05, 0.08), (0.15, 0.25), (0.4, 0.5)),
        lambda rng, size, _: {"k": rng.choice((-1.0, 1.0)) * size},
    ),
    "attitude_bias": field_effect(  # rad
        "tracked_turn", ANGLES, ((0.025, 0.035), (0.05, 0.07), (0.10, 0.14)), _draw_misalignment
    ),
    "thrust_voltage": field_effect(  # 0 is neutral
        "thrust_voltage", {"k": None}, ((0.15, 0.25), (0.4, 0.6), (0.9, 1.1))
    ),
}

UNKNOWN: dict[str, PlantEffect] = {
    "unknown_periodic": field_effect(  # N, Hz
        "periodic", {"force": None, "freq": 7.0}, ((0.05, 0.08), (0.15, 0.25), (0.5, 0.7))
    ),
    "unknown_position": field_effect(  # m, N, m
        "attraction",
        {"x": 0.0, "y": 0.0, "z": None, "force": None, "radius": 1.0},
        ((0.08, 0.12), (0.3, 0.5), (1.0, 1.4)),
        _draw_attraction,
    ),
    "unknown_time": field_effect(  # share of thrust, s
        "fading", {"loss": None, "time": 8.0}, ((0.02, 0.03), (0.06, 0.09), (0.15, 0.20)), drawn={"time": (6.0, 10.0)}
    ),
    "unknown_heading": field_effect(  # N, rad
        "shadow",
        {"force": None, "heading": 0.0},
        ((0.08, 0.12), (0.25, 0.4), (0.7, 1.0)),
        lambda rng, size, _: {"force": rng.choice((-1.0, 1.0)) * size, "heading": rng.uniform(-np.pi, np.pi)},
    ),
}

CAUSES: dict[str, PlantEffect] = {**EFFECTS, **UNKNOWN, **OTHER_LAWS}


def cause_names(name: str) -> tuple[str, ...]:
    """Return the names that state the cause of a hidden effect: ``ground_effect`` for ``ground_effect/exponential``."""
    return CAUSES[name].names or (name.partition("/")[0],)


def effect_parameters(
    effects: Mapping[str, str | Mapping[str, float]], *, declared: PlantVehicle, seed: int
) -> dict[str, Params]:
    """Return the parameters of each effect: drawn where a size is given, else as given and completed.

    Each effect draws from its own stream, so that its values do not depend on which other effects a case has.
    """
    return {name: _resolve_one(name, value, declared, seed) for name, value in effects.items()}


def _resolve_one(name: str, value: str | Mapping[str, float], declared: PlantVehicle, seed: int) -> Params:
    if name not in CAUSES:
        raise ValueError(f"no effect {name!r}. Known: {', '.join(CAUSES)}")
    effect = CAUSES[name]
    if isinstance(value, str):
        if value not in SIZES:
            raise ValueError(f"{name}: no size {value!r}. Known: {', '.join(SIZES)}")
        kind, table = next((k, t) for k, t in ((1, EFFECTS), (5, UNKNOWN), (6, OTHER_LAWS)) if name in t)
        rng = np.random.default_rng([seed, kind, list(table).index(name)])
        params = effect.draw(rng, rng.uniform(*effect.ranges[SIZES.index(value)]), declared)
    else:
        if unknown := set(value) - set(effect.params):
            raise ValueError(f"{name}: no parameter {sorted(unknown)}. Known: {', '.join(effect.params)}")
        params = {key: value.get(key, default) for key, default in effect.params.items()}
    for key, number in params.items():
        if number is None or not np.isfinite(number):
            raise ValueError(f"{name}.{key} = {number!r}: must be given and finite")
    return {key: float(number) for key, number in params.items()}


def split_vehicles(declared: PlantVehicle, params: Mapping[str, Params]) -> tuple[PlantVehicle, PlantVehicle]:
    """Return the vehicle as it will be declared and as it is, for resolved effects."""
    true = declared
    for name, values in params.items():
        true = CAUSES[name].apply(true, values)
    if any(name.startswith("rotor_drag") for name in params):
        declared = replace(declared, linear_drag=np.zeros(3))
    return declared, true


def flight_features(effects: Iterable[str], further: Iterable[str]) -> tuple[str, ...]:
    """Return the features of the flights of a case: those that its effects need, and further ones."""
    if unknown := set(further) - set(FEATURES):
        raise ValueError(f"no feature {sorted(unknown)}. Known: {', '.join(FEATURES)}")
    wanted = {*further, *(need for name in effects for need in CAUSES[name].needs)}
    return tuple(feature for feature in FEATURES if feature in wanted)

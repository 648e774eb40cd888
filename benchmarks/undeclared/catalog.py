"""The hidden effects: parameters, three sizes of each, and how they change the vehicle.

``EFFECTS`` are those that the package has a name for; ``UNKNOWN`` are causes that it has none for. The place in a table
is the random stream of an effect: new ones go to its end.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.undeclared.vehicle import DECLARED, PlantVehicle

SIZES = ("small", "moderate", "large")
FEATURES = ("battery", "low", "ceiling", "heights", "other", "hover")
"""What flights may have beyond the plain ones: a battery that empties, flights near the ground, flights below a ceiling,
flights at very different heights, another vehicle above, training flights that only hover."""

Params = dict[str, float]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PlantEffect:
    """One named effect."""

    params: dict[str, float | None]  # Parameter names and the value of one that is left out; None: it has to be given
    ranges: dict[str, Range]  # Size to the range that ``draw`` takes its magnitude from

    draw: Callable[[np.random.Generator, float, PlantVehicle], Params]
    """Parameters from a generator, a magnitude and the declared vehicle."""

    apply: Callable[[PlantVehicle, Params], PlantVehicle]  # The vehicle that has the effect
    needs: tuple[str, ...] = ("battery",)  # Features of the flights in which it shows


def _vec(params: Params, names: str) -> np.ndarray:
    return np.array([params[name] for name in names.split()])


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _draw_drag(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return drag near ``size`` forward and sideways, and about half of it along the rotor axis."""
    dx, dy, dz = size * rng.uniform((0.9, 0.9, 0.4), (1.1, 1.1, 0.7))
    return {"dx": dx, "dy": dy, "dz": dz}


def _draw_scale(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"scale": 1.0 + rng.choice((-1.0, 1.0)) * size}


def _draw_tau(_rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return ``size`` times the declared lag (mean of up and down)."""
    return {"tau": size * 0.5 * (declared.tau_up + declared.tau_down)}


def _draw_horizontal(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return a vector of horizontal length ``size`` in any direction, and up to a third of it along z."""
    angle = rng.uniform(-np.pi, np.pi)
    return {"x": size * np.cos(angle), "y": size * np.sin(angle), "z": size * rng.uniform(-0.33, 0.33)}


def _draw_wind(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return wind of horizontal speed ``size`` from any direction, with up to a fifteenth of it along z."""
    wind = _draw_horizontal(rng, size, declared)
    return {**wind, "z": 0.2 * wind["z"]}


def _draw_flapping(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return an in-plane force of ``size`` and a hub moment with a lever of 4 to 8 mm."""
    return {"kh": size, "kf": size * rng.uniform(0.004, 0.008)}


def _draw_weak_motor(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"motor": float(rng.integers(1, 5)), "scale": 1.0 - size}


def _draw_asymmetry(rng: np.random.Generator, size: float, declared: PlantVehicle) -> Params:
    """Return a fall ``1 + size`` times as slow as the rise, the rise within 10 % of the declared lag."""
    up = declared.tau_up * rng.uniform(0.9, 1.1)
    return {"tau_up": up, "tau_down": up * (1.0 + size)}


def _draw_delay(_rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"delay": round(size * 2000.0) / 2000.0}


def _draw_tilt(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    """Return a tilt of ``size`` of one rotor in any direction."""
    angle = rng.uniform(-np.pi, np.pi)
    return {"motor": float(rng.integers(1, 5)), "roll": size * np.cos(angle), "pitch": size * np.sin(angle)}


def _draw_slung(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"mass": size, "length": rng.uniform(0.5, 1.0), "damping": size * rng.uniform(0.2, 0.4)}


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


def _single_parameter(name: str) -> Callable[[np.random.Generator, float, PlantVehicle], Params]:
    return lambda _rng, size, _declared: {name: size}


def _set_extra(vehicle: PlantVehicle, **changes: object) -> PlantVehicle:
    """Return the vehicle with other numbers in ``extra``."""
    return replace(vehicle, extra=replace(vehicle.extra, **changes))  # type: ignore[arg-type]


def _place(params: Params) -> int:
    """Return the row of the rotor that ``motor`` counts from 1 on."""
    motor = int(params["motor"])
    if motor != params["motor"] or not 1 <= motor <= len(DECLARED.thrust_coeff):
        raise ValueError(f"motor = {params['motor']!r}: must be a whole number from 1 to {len(DECLARED.thrust_coeff)}")
    return motor - 1


def _weaken(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    coeff = vehicle.thrust_coeff.copy()
    coeff[_place(params)] *= params["scale"]
    return replace(vehicle, thrust_coeff=coeff)


def _tilt(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    """Return the vehicle with one axis turned about body x by ``roll``, then about body y by ``pitch``."""
    axis, row = vehicle.rotor_axis.copy(), _place(params)
    (cr, sr), (cp, sp) = ((np.cos(params[n]), np.sin(params[n])) for n in ("roll", "pitch"))
    x, y, z = axis[row]
    y, z = cr * y - sr * z, sr * y + cr * z
    axis[row] = cp * x + sp * z, y, cp * z - sp * x
    return replace(vehicle, rotor_axis=axis)


def _late(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    steps = params["delay"] * 2000.0
    if steps < 0.0 or abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"actuation_delay.delay = {params['delay']!r}: must be a multiple of 0.0005 s, >= 0")
    return _set_extra(vehicle, delay=params["delay"])


def _stretch(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    scale = _vec(params, "sx sy sz")
    return replace(vehicle, inertia=vehicle.inertia * np.sqrt(np.outer(scale, scale)))


def _tuple(params: Params, names: str) -> tuple[float, ...]:
    return tuple(params[name] for name in names.split())


def _ranges(small: Range, moderate: Range, large: Range) -> dict[str, Range]:
    return dict(zip(SIZES, (small, moderate, large), strict=True))


EFFECTS: dict[str, PlantEffect] = {
    "rotor_drag": PlantEffect(
        params={"dx": 0.0, "dy": 0.0, "dz": 0.0},  # N s/m
        ranges=_ranges((0.07, 0.10), (0.17, 0.27), (0.35, 0.45)),
        draw=_draw_drag,
        apply=lambda v, p: replace(v, linear_drag=_vec(p, "dx dy dz")),
        needs=(),
    ),
    "quadratic_drag": PlantEffect(
        params={"dx": 0.0, "dy": 0.0, "dz": 0.0},  # N s²/m²
        ranges=_ranges((0.012, 0.018), (0.03, 0.05), (0.08, 0.11)),
        draw=_draw_drag,
        apply=lambda v, p: replace(v, quadratic_drag=_vec(p, "dx dy dz")),
        needs=(),
    ),
    "thrust_coefficient": PlantEffect(
        params={"scale": None},  # 1 is neutral
        ranges=_ranges((0.015, 0.025), (0.04, 0.06), (0.10, 0.14)),
        draw=_draw_scale,
        apply=lambda v, p: replace(v, thrust_coeff=p["scale"] * v.thrust_coeff),
        needs=(),
    ),
    "com_offset": PlantEffect(
        params={"x": 0.0, "y": 0.0, "z": 0.0},  # m
        ranges=_ranges((0.002, 0.003), (0.005, 0.007), (0.010, 0.013)),
        draw=_draw_horizontal,
        apply=lambda v, p: replace(v, com=_vec(p, "x y z")),
        needs=(),
    ),
    "motor_time_constant": PlantEffect(
        params={"tau": None},  # s; drawn as a multiple of the declared one
        ranges=_ranges((1.15, 1.25), (1.5, 1.7), (2.0, 2.3)),
        draw=_draw_tau,
        apply=lambda v, p: replace(v, tau_up=p["tau"], tau_down=p["tau"]),
        needs=(),
    ),
    "constant_wind": PlantEffect(
        params={"x": 0.0, "y": 0.0, "z": 0.0},  # m/s, world
        ranges=_ranges((0.8, 1.2), (2.0, 3.0), (4.0, 5.0)),
        draw=_draw_wind,
        apply=lambda v, p: replace(v, wind_world=_vec(p, "x y z")),
        needs=(),
    ),
    "h_force_flapping": PlantEffect(
        params={"kh": 0.0, "kf": 0.0},  # N s²/(m rad), N s²/rad
        ranges=_ranges((1.0e-5, 1.5e-5), (3.0e-5, 5.0e-5), (8.0e-5, 1.1e-4)),
        draw=_draw_flapping,
        apply=lambda v, p: _set_extra(v, h_force=p["kh"], flapping=p["kf"]),
    ),
    "axial_inflow": PlantEffect(
        params={"ka": None},  # N s²/(m rad)
        ranges=_ranges((1.5e-5, 2.5e-5), (5.0e-5, 8.0e-5), (1.2e-4, 1.6e-4)),
        draw=_single_parameter("ka"),
        apply=lambda v, p: _set_extra(v, axial_inflow=p["ka"]),
    ),
    "translational_lift": PlantEffect(
        params={"kt": None},  # N s²/m², of each rotor
        ranges=_ranges((0.003, 0.005), (0.010, 0.016), (0.03, 0.04)),
        draw=_single_parameter("kt"),
        apply=lambda v, p: _set_extra(v, translational_lift=p["kt"]),
    ),
    "weak_motor": PlantEffect(
        params={"motor": None, "scale": None},  # from 1 on; 1 is neutral
        ranges=_ranges((0.02, 0.03), (0.05, 0.08), (0.12, 0.16)),
        draw=_draw_weak_motor,
        apply=_weaken,
    ),
    "torque_ratio": PlantEffect(
        params={"scale": None},  # 1 is neutral
        ranges=_ranges((0.08, 0.12), (0.2, 0.3), (0.4, 0.5)),
        draw=_draw_scale,
        apply=lambda v, p: replace(v, torque_ratio=p["scale"] * v.torque_ratio),
    ),
    "motor_asymmetry": PlantEffect(
        params={"tau_up": None, "tau_down": None},  # s
        ranges=_ranges((0.2, 0.3), (0.5, 0.7), (1.0, 1.3)),
        draw=_draw_asymmetry,
        apply=lambda v, p: replace(v, tau_up=p["tau_up"], tau_down=p["tau_down"]),
    ),
    "actuation_delay": PlantEffect(
        params={"delay": None},  # s
        ranges=_ranges((0.003, 0.005), (0.008, 0.012), (0.018, 0.024)),
        draw=_draw_delay,
        apply=_late,
    ),
    "battery_sag": PlantEffect(
        params={"gain": None},  # 1: speed follows the voltage
        ranges=_ranges((0.15, 0.25), (0.4, 0.6), (0.9, 1.1)),
        draw=_single_parameter("gain"),
        apply=lambda v, p: _set_extra(v, battery_gain=p["gain"]),
    ),
    "rotor_inertia": PlantEffect(
        params={"jr": None},  # kg m²
        ranges=_ranges((1.0e-6, 1.5e-6), (3.0e-6, 5.0e-6), (1.0e-5, 1.5e-5)),
        draw=_single_parameter("jr"),
        apply=lambda v, p: _set_extra(v, rotor_inertia=p["jr"]),
    ),
    "motor_tilt": PlantEffect(
        params={"motor": None, "roll": 0.0, "pitch": 0.0},  # from 1 on, rad
        ranges=_ranges((0.015, 0.025), (0.04, 0.06), (0.10, 0.14)),
        draw=_draw_tilt,
        apply=_tilt,
    ),
    "payload_mass": PlantEffect(
        params={"dm": None},  # kg
        ranges=_ranges((0.012, 0.018), (0.04, 0.06), (0.10, 0.15)),
        draw=_single_parameter("dm"),
        apply=lambda v, p: replace(v, mass=v.mass + p["dm"]),
    ),
    "slung_payload": PlantEffect(
        params={"mass": None, "length": None, "damping": 0.0},  # kg, m, N s/m
        ranges=_ranges((0.012, 0.018), (0.04, 0.06), (0.10, 0.15)),
        draw=_draw_slung,
        apply=lambda v, p: _set_extra(v, slung=_tuple(p, "mass length damping")),
    ),
    "inertia_error": PlantEffect(
        params={"sx": 1.0, "sy": 1.0, "sz": 1.0},
        ranges=_ranges((0.06, 0.09), (0.15, 0.22), (0.3, 0.4)),
        draw=_draw_inertia,
        apply=_stretch,
    ),
    "wind_shear": PlantEffect(
        params={"x": 0.0, "y": 0.0, "z_ref": 10.0, "exponent": 0.2},  # m/s at z_ref, m
        ranges=_ranges((0.8, 1.2), (2.0, 3.0), (4.0, 5.0)),
        draw=_draw_shear,
        apply=lambda v, p: _set_extra(v, shear=_tuple(p, "x y z_ref exponent")),
        needs=("battery", "heights"),
    ),
    "gusts": PlantEffect(
        params={"std": None, "corr_time": 1.0},  # m/s, s
        ranges=_ranges((0.3, 0.5), (0.9, 1.3), (2.0, 2.6)),
        draw=lambda rng, size, _: {"std": size, "corr_time": rng.uniform(0.5, 2.0)},
        apply=lambda v, p: _set_extra(v, gust=_tuple(p, "std corr_time")),
    ),
    "ground_effect": PlantEffect(
        params={"k": None},  # 1: a rotor by itself
        ranges=_ranges((0.7, 1.0), (1.5, 2.0), (2.8, 3.3)),
        draw=_single_parameter("k"),
        apply=lambda v, p: _set_extra(v, ground=p["k"]),
        needs=("battery", "low"),
    ),
    "ceiling_effect": PlantEffect(
        params={"k": None},
        ranges=_ranges((1.0, 1.3), (1.9, 2.4), (3.0, 3.4)),
        draw=_single_parameter("k"),
        apply=lambda v, p: _set_extra(v, ceiling=p["k"]),
        needs=("battery", "ceiling"),
    ),
    "downwash": PlantEffect(
        params={"force": None, "sigma": None},  # N, m
        ranges=_ranges((0.12, 0.18), (0.4, 0.6), (1.0, 1.4)),
        draw=lambda rng, size, _: {"force": size, "sigma": rng.uniform(0.25, 0.4)},
        apply=lambda v, p: _set_extra(v, downwash=_tuple(p, "force sigma")),
        needs=("battery", "other"),
    ),
    "imu_bias": PlantEffect(
        params=dict.fromkeys(("ax", "ay", "az", "gx", "gy", "gz"), 0.0),  # m/s², rad/s
        ranges=_ranges((0.07, 0.10), (0.2, 0.3), (0.5, 0.8)),
        draw=_draw_bias,
        apply=lambda v, p: _set_extra(v, imu_bias=_tuple(p, "ax ay az gx gy gz")),
    ),
    "imu_misalignment": PlantEffect(
        params={"roll": 0.0, "pitch": 0.0, "yaw": 0.0},  # rad
        ranges=_ranges((0.008, 0.012), (0.025, 0.035), (0.06, 0.09)),
        draw=_draw_misalignment,
        apply=lambda v, p: _set_extra(v, imu_turn=_tuple(p, "roll pitch yaw")),
    ),
    "rotor_speed_scale": PlantEffect(
        params={"scale": None},  # 1 is neutral
        ranges=_ranges((0.01, 0.015), (0.03, 0.05), (0.08, 0.12)),
        draw=_draw_scale,
        apply=lambda v, p: _set_extra(v, rotor_reading=p["scale"]),
    ),
    "joint_spring": PlantEffect(
        params={"compliance": None, "tau": 0.03, "hinge": 0.4},  # rad/(N m), s
        ranges=_ranges((0.7, 0.9), (1.4, 1.8), (2.4, 2.8)),
        draw=lambda rng, size, _: {"compliance": size, "tau": rng.uniform(0.02, 0.06), "hinge": 0.4},
        apply=lambda v, p: _set_extra(v, joint_spring=_tuple(p, "compliance tau hinge")),
    ),
    "joint_creep": PlantEffect(
        params={"compliance": None, "tau": 3.0, "hinge": 0.4},  # rad/(N m), s
        ranges=_ranges((0.7, 0.9), (1.4, 1.8), (2.4, 2.8)),
        draw=lambda rng, size, _: {"compliance": size, "tau": rng.uniform(1.5, 4.0), "hinge": 0.4},
        apply=lambda v, p: _set_extra(v, joint_creep=_tuple(p, "compliance tau hinge")),
    ),
}

UNKNOWN: dict[str, PlantEffect] = {
    "unknown_periodic": PlantEffect(
        params={"force": None, "freq": 7.0},  # N, Hz
        ranges=_ranges((0.05, 0.08), (0.15, 0.25), (0.5, 0.7)),
        draw=lambda _rng, size, _declared: {"force": size, "freq": 7.0},
        apply=lambda v, p: _set_extra(v, periodic=_tuple(p, "force freq")),
    ),
    "unknown_position": PlantEffect(
        params={"x": 0.0, "y": 0.0, "z": None, "force": None, "radius": 1.0},  # m, N, m
        ranges=_ranges((0.08, 0.12), (0.3, 0.5), (1.0, 1.4)),
        draw=_draw_attraction,
        apply=lambda v, p: _set_extra(v, attraction=_tuple(p, "x y z force radius")),
    ),
    "unknown_time": PlantEffect(
        params={"loss": None, "time": 8.0},  # share of thrust, s
        ranges=_ranges((0.02, 0.03), (0.06, 0.09), (0.15, 0.20)),
        draw=lambda rng, size, _: {"loss": size, "time": rng.uniform(6.0, 10.0)},
        apply=lambda v, p: _set_extra(v, fading=_tuple(p, "loss time")),
    ),
    "unknown_heading": PlantEffect(
        params={"force": None, "heading": 0.0},  # N, rad
        ranges=_ranges((0.08, 0.12), (0.25, 0.4), (0.7, 1.0)),
        draw=lambda rng, size, _: {"force": _sign(rng) * size, "heading": rng.uniform(-np.pi, np.pi)},
        apply=lambda v, p: _set_extra(v, shadow=_tuple(p, "force heading")),
    ),
}

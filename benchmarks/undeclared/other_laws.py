"""Other published laws of ceiling, ground, gusts, downwash, hanging loads and drag; README.md has formulas and sources.

``NAME/LAW`` hides the effect NAME by another law. Distances x are from a rotor hub to the surface, in rotor radii.
Letters: F flights, T samples.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.undeclared.plant_effect import Params, PlantEffect, Ranges, field_effect, set_extra
from benchmarks.undeclared.vehicle import GRAVITY, ROTOR_RADIUS, Array, PlantVehicle

NEAREST = 0.5  # Least distance to a surface [radii]; below it the gain is constant
LARGEST_CHANGE = (0.3, 2.0)  # Smallest and largest ratio of thrust near a surface to thrust far from it
ROTOR_DISTANCE = 0.1625 / ROTOR_RADIUS  # Between neighbouring rotors [radii], mean of both directions
HAYDEN = (0.9926, 0.03794)  # Power of a helicopter near the ground: Hayden 1976
FOOT = 0.3048  # [m]


def inverse_square(x: Array, k: float) -> Array:
    """Return ``1 + k / x²``."""
    return 1.0 + k / x**2


def offset_inverse_square(x: Array, k: float, offset: float) -> Array:
    """Return ``1 / (1 - k / (16 (x + offset)²))``."""
    return 1.0 / (1.0 - k / (16.0 * (x + offset) ** 2))


def ceiling_momentum(x: Array, blocked: float, inflow: float) -> Array:
    """Return the thrust ratio at constant speed of a rotor whose air comes through the gap below a ceiling.

    The far wake moves at ``2 g v`` for an inflow v, ``g = (1 + sqrt(1 + b / (8 x²))) / 2``, so that ``T = 2 rho A g² v²``. A
    rotor with ``T = T_s - s v`` has the ratio y² of ``y² + (s / g) y = 1 + s``, s in units of thrust over inflow in hover.
    """
    share = inflow / (0.5 + 0.5 * np.sqrt(1.0 + blocked / (8.0 * x**2)))
    return np.asarray((0.5 * (np.sqrt(share**2 + 4.0 * (1.0 + inflow)) - share)) ** 2)


def images_of_four(x: Array, body: float) -> Array:
    """Return the ratio of four rotors and their mirror images, with the lift of the body between them."""
    near, far = (x / np.sqrt((distance**2 + 4.0 * x**2) ** 3) for distance in (ROTOR_DISTANCE, 2**0.5 * ROTOR_DISTANCE))
    return 1.0 / (1.0 - (0.25 / x) ** 2 - near - 0.5 * far - 2.0 * body * far)


def exponential(x: Array, gain: float, decay: float) -> Array:
    """Return ``1 + gain exp(-decay x)``."""
    return 1.0 + gain * np.exp(-decay * x)


def exponential_with_loss(x: Array, gain: float, decay: float, loss: float, centre: float) -> Array:
    """Return ``1 + gain exp(-decay x) - loss exp(-(x - centre)²)``."""
    return exponential(x, gain, decay) - loss * np.exp(-((x - centre) ** 2))


def power_ratio(x: Array, k: float) -> Array:
    """Return the thrust ratio at constant power, ``(0.9926 + 0.03794 k (2 / x)²)^(2/3)``, at least 1."""
    return np.maximum(HAYDEN[0] + HAYDEN[1] * k * (2.0 / x) ** 2, 1.0) ** (2.0 / 3.0)


SURFACE_LAWS: dict[str, Callable[..., Array]] = {
    "inverse_square": inverse_square,
    "offset": offset_inverse_square,
    "momentum": ceiling_momentum,
    "images": images_of_four,
    "exponential": exponential,
    "loss": exponential_with_loss,
    "power": power_ratio,
}


def thrust_ratio(law: tuple, distance: Array) -> Array:
    """Return thrust near a surface over thrust far from it, from a law with its numbers and distances [m]; 1 without law."""
    if not law:
        return np.ones_like(distance)
    name, *numbers = law
    return np.clip(SURFACE_LAWS[name](np.maximum(distance / ROTOR_RADIUS, NEAREST), *numbers), *LARGEST_CHANGE)


def gust_series_by_law(law: tuple, count: int, rate: float, rng: np.random.Generator) -> Array:
    """Return a stationary series of wind [m/s], world, (T, 3)."""
    name, std, *numbers = law
    if name == "weak_vertical":
        corr_time, vertical = numbers
        return _filter_noise(count, rate, rng, (corr_time,) * 3, (1,) * 3) * std * np.array((1.0, 1.0, vertical))
    height, speed = numbers
    vertical = 0.177 + 0.000823 * height / FOOT
    length = height / vertical**1.2
    times = (length / speed, length / speed, height / speed)
    return _filter_noise(count, rate, rng, times, (1, 2, 2)) * std * np.array((1.0, 1.0, vertical**0.4))


def _filter_noise(count: int, rate: float, rng: np.random.Generator, times: tuple, orders: tuple) -> Array:
    """Return white noise behind ``1 / (1 + T s)`` or ``(1 + sqrt(3) T s) / (1 + T s)²``, of variance 1, (T, 3)."""
    start = round(8.0 * max(times) * rate)  # until the start of the filters is forgotten
    columns = []
    for time, order in zip(times, orders, strict=True):
        keep, zero = np.exp(-1.0 / (rate * time)), np.exp(-1.0 / (rate * time * 3**0.5))
        above, below = ([1.0], [1.0, -keep]) if order == 1 else ([1.0, -zero], [1.0, -2.0 * keep, keep**2])
        answer = np.asarray(lfilter(above, below, np.eye(1, start)[0]))
        columns.append(
            np.asarray(lfilter(above, below, rng.standard_normal(start + count)))[start:] / np.sqrt(answer @ answer)
        )
    return np.stack(columns, axis=1)


def downwash_force(law: tuple, apart: Array) -> Array:
    """Return the force down [N], (F,), from the position of the other vehicle relative to this one [m], (F, 3)."""
    name, force, width = law
    level, below = np.hypot(apart[:, 0], apart[:, 1]), np.maximum(apart[:, 2], 0.3)
    if name == "top_hat":
        wake = 0.5 - 0.5 * np.tanh((level - width) / 0.05)
    else:
        wake = (1.5 / below) ** 2 * np.exp(-((level / (width * below)) ** 2))
    return force * wake * (apart[:, 2] > 0.0)


def drag_force(law: tuple, air: Array, thrust: Array, weight: float) -> Array:
    """Return the drag [N], body, (F, 3), at airspeeds [m/s] (F, 3) and a sum of thrusts [N] (F,)."""
    name, *numbers = law
    share = (thrust / weight)[:, None] if name == "thrust" else np.abs(air)
    return -np.asarray(numbers) * share * air


def cable_tension(cable: tuple, rope: Array, rope_rate: Array) -> Array:
    """Return the pull of an elastic cable on its upper end [N], world, (F, 3); a slack cable does not push."""
    _, length, stiffness, damping, _ = cable
    now = np.linalg.norm(rope, axis=1, keepdims=True)
    along = rope / now
    speed = (rope_rate * along).sum(axis=1, keepdims=True)
    return np.maximum(stiffness * (now - length) + damping * speed, 0.0) * (now > length) * along


def _hang_rod(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    """Return the vehicle with a uniform rod: a quarter of its mass stays at the joint, the rest swings at two thirds."""
    mass, length, damping = (params[name] for name in ("mass", "length", "damping"))
    heavier = replace(vehicle, mass=vehicle.mass + 0.25 * mass)
    return set_extra(heavier, slung=(0.75 * mass, 2.0 / 3.0 * length, damping))


def _hang_cable(vehicle: PlantVehicle, params: Params) -> PlantVehicle:
    mass, length, stretch, hook = (params[name] for name in ("mass", "length", "stretch", "hook"))
    stiffness = mass * GRAVITY / (stretch * length)
    return set_extra(vehicle, cable=(mass, length, stiffness, 0.4 * np.sqrt(stiffness * mass), hook))


def _draw_thrust_drag(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return {"dx": size * rng.uniform(0.9, 1.1), "dy": size * rng.uniform(0.9, 1.1), "dz": 0.0}


def _draw_plate_drag(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
    return dict(zip(("dx", "dy", "dz"), size * rng.uniform((0.9, 0.9, 0.8), (1.1, 1.1, 1.2)), strict=True))


def _surface_effect(field: str, law: str, first: str, ranges: Ranges, **drawn: tuple[float, float]) -> PlantEffect:
    needs = ("battery", "low" if field == "ground_law" else "ceiling")
    return field_effect(field, {first: None, **dict.fromkeys(drawn)}, ranges, drawn=drawn, needs=needs, law=law)


LOADS: Ranges = ((0.012, 0.018), (0.04, 0.06), (0.10, 0.15))
DRAG: dict[str, float | None] = {"dx": 0.0, "dy": 0.0, "dz": 0.0}
LINEAR_DRAG: Ranges = ((0.07, 0.10), (0.17, 0.27), (0.35, 0.45))
PLATE_DRAG: Ranges = ((0.015, 0.02), (0.04, 0.06), (0.10, 0.13))

OTHER_LAWS: dict[str, PlantEffect] = {
    "ceiling_effect/inverse_square": _surface_effect(
        "ceiling_law", "inverse_square", "k", ((0.06, 0.08), (0.12, 0.16), (0.19, 0.22))
    ),
    "ceiling_effect/momentum": _surface_effect(
        "ceiling_law", "momentum", "blocked", ((2.5, 3.5), (5.0, 8.0), (12.0, 16.0)), inflow=(0.8, 1.2)
    ),
    "ceiling_effect/offset": _surface_effect(
        "ceiling_law", "offset", "k", ((2.0, 3.0), (5.0, 7.0), (10.0, 12.0)), offset=(0.5, 1.5)
    ),
    "ground_effect/images": _surface_effect("ground_law", "images", "body", ((0.0, 0.3), (1.0, 2.0), (3.0, 4.0))),
    "ground_effect/exponential": _surface_effect(
        "ground_law", "exponential", "gain", ((0.12, 0.18), (0.3, 0.5), (0.8, 1.1)), decay=(0.6, 1.0)
    ),
    "ground_effect/loss": _surface_effect(
        "ground_law",
        "loss",
        "gain",
        ((0.12, 0.18), (0.3, 0.5), (0.8, 1.1)),
        decay=(0.8, 1.2),
        loss=(0.02, 0.05),
        centre=(3.5, 4.5),
    ),
    "ground_effect/power": _surface_effect("ground_law", "power", "k", ((1.2, 1.6), (2.5, 3.5), (5.0, 7.0))),
    "gusts/dryden": field_effect(  # m/s along the mean wind, m, m/s
        "gust_law",
        {"std": None, "height": None, "speed": None},
        ((0.3, 0.5), (0.9, 1.3), (2.0, 2.6)),
        drawn={"height": (3.0, 6.0), "speed": (4.0, 8.0)},
        law="dryden",
    ),
    "gusts/weak_vertical": field_effect(  # m/s, s, 1
        "gust_law",
        {"std": None, "corr_time": None, "vertical": None},
        ((0.3, 0.5), (0.9, 1.3), (2.0, 2.6)),
        drawn={"corr_time": (0.5, 2.0), "vertical": (0.3, 0.5)},
        law="weak_vertical",
    ),
    "downwash/jet": field_effect(  # N at 1.5 m, rad
        "downwash_law",
        {"force": None, "spread": None},
        ((0.12, 0.18), (0.4, 0.6), (1.0, 1.4)),
        drawn={"spread": (0.2, 0.3)},
        needs=("battery", "other"),
        law="jet",
    ),
    "downwash/top_hat": field_effect(  # N, m
        "downwash_law",
        {"force": None, "radius": None},
        ((0.12, 0.18), (0.4, 0.6), (1.0, 1.4)),
        drawn={"radius": (0.3, 0.45)},
        needs=("battery", "other"),
        law="top_hat",
    ),
    "slung_payload/rod": PlantEffect(
        params={"mass": None, "length": None, "damping": 0.0},  # kg, m, N s/m
        ranges=LOADS,
        draw=lambda rng, size, _: {
            "mass": size,
            "length": rng.uniform(0.5, 1.0),
            "damping": size * rng.uniform(0.2, 0.4),
        },
        apply=_hang_rod,
    ),
    "slung_payload/elastic": PlantEffect(
        params={"mass": None, "length": None, "stretch": None, "hook": None},  # kg, m, 1, m
        ranges=LOADS,
        draw=lambda rng, size, _: {
            "mass": size,
            "length": rng.uniform(0.5, 1.0),
            "stretch": rng.uniform(0.01, 0.04),
            "hook": rng.uniform(0.01, 0.04),
        },
        apply=_hang_cable,
    ),
    "rotor_drag/thrust": field_effect(  # N s/m in hover
        "drag_law",
        DRAG,
        LINEAR_DRAG,
        _draw_thrust_drag,
        law="thrust",
        names=("rotor_drag", "h_force_flapping"),
        needs=(),
    ),
    "quadratic_drag/plate": field_effect(
        "drag_law", DRAG, PLATE_DRAG, _draw_plate_drag, law="plate", needs=()
    ),  # N s²/m²
}
"""The place in the table is the random stream, as in ``effects``."""

"""What blade elements say of a propeller at rest, against static tests.

    python -m benchmarks.devices.propellers --data DATA [--json]

DATA holds ``bench`` (docs/results/measured.md). At rest in still air the effect ``blade_element`` changes nothing: thrust and
torque are those of the robot file. Measured here is what it takes for granted there. Coefficients are those of the effect, in
units of ``rho pi R² (w R)²`` and that times R::

    C_T does not depend on the speed
    C_Q = kappa C_T^1.5 / sqrt(2) + P0,        P0 = s c_d / 8 for sections of drag coefficient c_d

with kappa from the inflow that differs along the blade, for the solidity s, lift slope and twist that the effect has by default
(Leishman 2006, Principles of Helicopter Aerodynamics, section 3.3, blade element momentum theory in hover). One number is
fitted to some of the rows, and the others are predicted: every second row, or the fast half from the slow one. Errors are rms
of the relative errors. Where no torque was measured, electrical power stands in for it: a share of it lost, the same at all
speeds, and a part that does not depend on the speed, two numbers.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects.induced_flow import AIR_DENSITY
from aerial_gym.robots import ROBOTS

Array = NDArray[np.float64]

RADIUS = 0.0635
"""Of the propeller of ``aerialgym_motor_static.csv`` [m]: 5 inches across, as its torque per thrust suggests. Not published."""

AIR_VISCOSITY = 1.5e-5
"""Kinematic [m²/s], at 20 °C."""

CHORD = 0.01
"""Of that propeller [m]: two blades of the solidity 0.1 at this radius, ``s pi R / 2``."""

LEAST_ROWS = 6
"""Of a test, so that three rows are fitted and three are left out."""

_DEFAULTS = EFFECTS.get("blade_element")
_VALUES = dict(
    zip(
        (parameter.name for parameter in _DEFAULTS.parameters),
        _DEFAULTS.neutral(ROBOTS.get("tinyprop")),
        strict=True,
    )
)
SOLIDITY, SLOPE, TWIST = (_VALUES[name] for name in ("solidity", "lift_slope", "twist"))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One prediction of one set of tests; errors are medians over its tests."""

    tests: str
    number: int
    predicted: str
    law: str
    fitted: float
    """What is fitted, in the median, to the first half of the rows."""

    every_second: float
    """Relative rms of the rows left out in between."""

    fast_half: float
    """The same of the fast half, from the slow one."""


def blade_inflow(root: float, radius: Array, *, solidity: float, slope: float, twist: float) -> Array:
    """Return the inflow per tip speed at shares of the radius, of blades with the pitch ``root + twist r`` in hover."""
    lift = solidity * slope
    return lift / 16.0 * (np.sqrt(1.0 + 32.0 * (root + twist * radius) * radius / lift) - 1.0)


def induced_factor(
    thrust: float, *, solidity: float = SOLIDITY, slope: float = SLOPE, twist: float = TWIST, rows: int = 400
) -> float:
    """Return kappa, the induced power over that of an even inflow, of the pitch that gives a coefficient of thrust.

    ``C_T = 4 int lambda² r dr`` and ``C_P = 4 int lambda³ r dr`` over the blade.
    """
    radius = (np.arange(rows) + 0.5) / rows

    def inflow(root: float) -> Array:
        return blade_inflow(root, radius, solidity=solidity, slope=slope, twist=twist)

    def missing(root: float) -> float:
        return float(4.0 * np.mean(inflow(root) ** 2 * radius)) - thrust

    found = inflow(float(brentq(missing, max(0.0, -twist), 5.0)))  # type: ignore[arg-type]
    return float(4.0 * np.mean(found**3 * radius) / (thrust**1.5 / sqrt(2.0)))


def relative_rms(predicted: Array, measured: Array) -> float:
    return float(np.sqrt(np.mean((predicted / measured - 1.0) ** 2)))


def left_out(
    measured: Array, columns: Callable[[Array], Array], known: Array | None = None
) -> tuple[Array, float, float]:
    """Return what is fitted to every second row, and the errors of the others and of the fast half.

    Args:
        measured: What is predicted, rows by rising speed, (T,).
        columns: Of a least-squares fit of relative errors, of rows by their numbers, (T, P).
        known: What is added to it, (T,).
    """
    count, known = len(measured), np.zeros_like(measured) if known is None else known
    weights = columns(np.arange(count)) / measured[:, None]

    def errors(fitted: Array) -> tuple[Array, float]:
        found = np.linalg.lstsq(weights[fitted], 1.0 - known[fitted] / measured[fitted], rcond=None)[0]
        others = np.setdiff1d(np.arange(count), fitted)
        return found, relative_rms((weights[others] @ found) * measured[others] + known[others], measured[others])

    found, between = errors(np.arange(0, count, 2))
    return found, between, errors(np.arange(count // 2))[1]


def of_torque(table: pd.DataFrame) -> list[Row]:
    """Return what predicts the torques of the propeller whose thrust and torque were measured."""
    speed, thrust, torque = (table[name].to_numpy(float) for name in ("omega", "thrust_N", "torque_Nm"))
    unit = AIR_DENSITY * pi * RADIUS**2 * (speed * RADIUS) ** 2
    coefficient = thrust / unit
    even = unit * RADIUS * coefficient**1.5 / sqrt(2.0)
    along = even * np.array([induced_factor(c) for c in coefficient])
    section = unit * RADIUS * SOLIDITY / 8.0
    laws = (
        ("torque ratio: Q / T [m]", thrust, None),
        ("even inflow and profile drag: c_d", section, even),
        ("inflow along the blade and profile drag: c_d", section, along),
        ("figure of merit: 1 / M", even, None),
    )
    return [_row("5 inch, thrust and torque", "torque", law, [(torque, (one,), known)]) for law, one, known in laws]


def of_power(name: str, tests: list[pd.DataFrame]) -> list[Row]:
    """Return what predicts thrust, and electrical power, of tests without a torque; the second number is the share."""
    thrusts, ratios, merits = [], [], []
    for table in tests:
        speed, thrust = table.omega.to_numpy(float), table.thrust_N.to_numpy(float)
        power, one = (table.voltage * table.current).to_numpy(float), np.ones_like(thrust)
        thrusts.append((thrust, (speed**2,), None))
        ratios.append((power, (thrust * speed, one), None))
        merits.append((power, (thrust**1.5, one), None))
    return [
        _row(name, "thrust", "coefficient: T / w² [N s²]", thrusts),
        _row(name, "electrical power", "torque ratio: P / (T w) [m]", ratios),
        _row(name, "electrical power", "figure of merit: P / T^1.5 [W/N^1.5]", merits),
    ]


def _row(tests: str, predicted: str, law: str, cases: list[tuple[Array, tuple[Array, ...], Array | None]]) -> Row:
    found = []
    for measured, parts, known in cases:
        columns = np.stack(parts, axis=-1)
        fitted, between, fast = left_out(measured, lambda rows, c=columns: c[rows], known)
        found.append((fitted[0], between, fast))
    fitted, between, fast = np.median(np.array(found), axis=0)
    return Row(
        tests=tests, number=len(cases), predicted=predicted, law=law, fitted=float(fitted), every_second=float(between),
        fast_half=float(fast),
    )  # fmt: skip


def propellers(folder: Path) -> Iterator[pd.DataFrame]:
    """Yield the tests of many propellers, rows by rising speed, that have enough of them."""
    table = pd.read_csv(folder / "strawson_static_tests.csv")
    table = table[(table.omega > 0.0) & (table.thrust_N > 0.05) & (table.current > 0.0)]
    for _, test in table.groupby("test"):
        if len(test) >= LEAST_ROWS and test.omega.max() >= 1.5 * test.omega.min():
            yield test.sort_values("omega")


def measure(folder: Path) -> tuple[list[Row], dict[str, float]]:
    """Return the predictions, and what the drag of the sections of the 5-inch propeller would have to be."""
    bench = pd.read_csv(folder / "aerialgym_motor_static.csv").iloc[1:]
    nano = pd.read_csv(folder / "bitcraze_cf20_static_2015.csv").iloc[1:]
    nano = nano.assign(omega=nano.omega_mean, thrust_N=nano.thrust_total_N / 4.0, current=nano.current_total / 4.0)
    rows = [
        _row(
            "5 inch, thrust and torque", "thrust", "coefficient: T / w² [N s²]",
            [(bench.thrust_N.to_numpy(float), (bench.omega.to_numpy(float) ** 2,), None)],
        ),
        *of_torque(bench),
        *of_power("Crazyflie 2.0", [nano]),
        *of_power("many propellers", list(propellers(folder))),
    ]  # fmt: skip
    return rows, of_sections(bench)


def of_sections(table: pd.DataFrame) -> dict[str, float]:
    """Return what theory gives for the 5-inch propeller without its torques, and what these say; medians over the rows.

    Returns:
        ``kappa`` of the induced power; ``friction``, the least drag coefficient of a section; ``share`` of the measured torque
        that both give; least and largest figure of merit.
    """
    speed, thrust, torque = (table[name].to_numpy(float) for name in ("omega", "thrust_N", "torque_Nm"))
    unit = AIR_DENSITY * pi * RADIUS**2 * (speed * RADIUS) ** 2
    even = (thrust / unit) ** 1.5 / sqrt(2.0)
    kappa = np.array([induced_factor(c) for c in thrust / unit])
    friction = flat_plate(speed)
    share = (kappa * even + SOLIDITY * friction / 8.0) * unit * RADIUS / torque
    merit = even * unit * RADIUS / torque
    return {
        "kappa": float(np.median(kappa)), "friction": float(np.median(friction)), "share": float(np.median(share)),
        "least_merit": float(merit.min()), "largest_merit": float(merit.max()),
    }  # fmt: skip


def flat_plate(speed: Array) -> Array:
    """Return the drag coefficient of a thin plate in laminar flow, both sides, at 3/4 of the radius: ``2.656 / sqrt(Re)``.

    Source: Blasius; Schlichting, Gersten (2017), Boundary-Layer Theory, chapter 6. No section has less.
    """
    return 2.656 / np.sqrt(0.75 * RADIUS * speed * CHORD / AIR_VISCOSITY)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--json", action="store_true", help="one object a line")
    options = parser.parse_args()
    if not (options.data / "bench").is_dir():
        parser.error(f"--data {options.data}: has no folder bench with the propeller tests")
    rows, theory = measure(options.data / "bench")
    if options.json:
        for found in (*map(asdict, rows), theory):
            print(json.dumps(found))
        return
    print(
        f"5 inch: kappa {theory['kappa']:.3f}, friction of a thin plate c_d = {theory['friction']:.4f}; both give "
        f"{theory['share']:.0%} of the torque; figure of merit {theory['least_merit']:.3f} to {theory['largest_merit']:.3f}"
    )
    print("| tests | number | predicted | one number fitted | it is | every second row | the fast half |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        print(
            f"| {row.tests} | {row.number} | {row.predicted} | {row.law} | {row.fitted:.3g} | {row.every_second:.1%} | "
            f"{row.fast_half:.1%} |"
        )


if __name__ == "__main__":
    main()

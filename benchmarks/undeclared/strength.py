"""How strong is a hidden effect? Residual of the declared equations over the noise floor, without any identification.

    python -m benchmarks.undeclared.strength [--seeds 1] [--duration-s 16] [--jobs 2]

Along noise-free flights the declared plant is evaluated at the true state and the logged rotor speeds; what it misses
in specific force, angular acceleration and rotor speed is low-passed at 10 Hz, and its rms (largest axis, all flights)
divided by what the sensor noise leaves in the same band.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.undeclared.cases import SETTLE_S, FlownCase, fly_case
from benchmarks.undeclared.catalog import EFFECTS, SIZES, UNKNOWN
from benchmarks.undeclared.dynamics import RATE, ROTOR, STATE_SIZE, Plant
from benchmarks.undeclared.sensors import NOISELESS, Noise
from benchmarks.undeclared.simulate import CONTROL_RATE
from benchmarks.undeclared.vehicle import Array

BAND_HZ = 10.0


def residuals(case: FlownCase) -> dict[str, Array]:
    """Return what the declared equations miss, each (T, F, axes), for a case flown without noise."""
    record = case.record
    rows, flights = record.state.shape[:2]
    seen = record.state[:, :, :STATE_SIZE].copy()
    seen[:, :, ROTOR] = record.measured["rotor"]
    plant, flat = Plant(case.declared), seen.reshape(-1, STATE_SIZE)
    slope = plant.derivative(flat, flat[:, ROTOR]).reshape(rows, flights, -1)[:, :, RATE]
    force = plant.specific_force(flat).reshape(rows, flights, 3)
    rotor, lag = seen[:, :, ROTOR], case.declared.tau_up
    ahead = record.command[:-1] + (rotor[:-1] - record.command[:-1]) * np.exp(-1.0 / CONTROL_RATE / lag)
    return {
        "specific_force": record.measured["acc"] - force,
        "angular_acceleration": np.gradient(record.measured["rate"], 1.0 / CONTROL_RATE, axis=0) - slope,
        "rotor_slope": (rotor[1:] - ahead) * CONTROL_RATE,
    }


def _floors(rows: int) -> dict[str, Array]:
    """Return what noise alone leaves of each signal in the band, by filtering drawn noise."""
    noise, rng = Noise(), np.random.default_rng(0)
    draw = rng.standard_normal((rows, 1, 1))
    slope = np.gradient(draw, 1.0 / CONTROL_RATE, axis=0)
    speed = noise.rotor * 1126.0
    floor = {
        "specific_force": noise.acc * draw,
        "angular_acceleration": noise.gyro * slope,
        "rotor_slope": speed * slope,
    }
    return {name: _rms(values) for name, values in floor.items()}


def _rms(values: Array) -> Array:
    """Return the rms over time and flights of each axis in the band, (axes,)."""
    low = sosfiltfilt(butter(4, BAND_HZ, fs=CONTROL_RATE, output="sos"), values, axis=0)
    return np.sqrt((low * low).mean(axis=(0, 1)))


def strength(name: str, size: str, *, seed: int, duration_s: float) -> dict[str, float]:
    """Return the residual over the noise floor of each signal, for its worst axis."""
    case = fly_case(effects={name: size}, seed=seed, duration_s=duration_s, noise=NOISELESS)
    first = round(SETTLE_S * CONTROL_RATE)
    missed = {key: values[first:] for key, values in residuals(case).items()}
    floors = _floors(4 * len(missed["specific_force"]))
    return {key: float((_rms(values) / floors[key]).max()) for key, values in missed.items()}


def _row(job: tuple[str, str, int, float]) -> tuple[str, str, dict[str, float] | str]:
    name, size, seed, duration_s = job
    try:
        return name, size, strength(name, size, seed=seed, duration_s=duration_s)
    except ValueError as error:
        return name, size, str(error)


def main() -> None:
    """Print a table: the strongest signal of each effect and size, over the noise floor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--duration-s", type=float, default=16.0)
    parser.add_argument("--effects", nargs="+", default=[*EFFECTS, *UNKNOWN])
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    jobs = [(n, s, seed, args.duration_s) for n in args.effects for s in SIZES for seed in args.seeds]
    print("| effect | size | specific force | angular acceleration | slope of rotor speed |")
    print("| --- | --- | --- | --- | --- |")
    with ProcessPoolExecutor(args.jobs) as pool:
        for name, size, found in pool.map(_row, jobs):
            cells = found if isinstance(found, str) else " | ".join(f"{value:.1f}" for value in found.values())
            print(f"| {name} | {size} | {cells} |", flush=True)


if __name__ == "__main__":
    main()

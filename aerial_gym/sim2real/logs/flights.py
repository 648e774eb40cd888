"""Load training and test flights: read, check, repair and complete their logs. Letters: T rows, R rotors."""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.conventions import body_rate_from_attitude, check_log
from aerial_gym.sim2real.logs.checks.copies import LogRegister
from aerial_gym.sim2real.logs.checks.duration import check_duration_and_rate
from aerial_gym.sim2real.logs.checks.rotors import (
    check_rotor_law,
    check_rotor_order,
    with_shared_rotor_quantities,
    without_copied_commands,
)
from aerial_gym.sim2real.logs.checks.time_courses import check_for_alternating_flights
from aerial_gym.sim2real.logs.clock_offset import check_rotor_clock, with_rotors_on_sensor_clock
from aerial_gym.sim2real.logs.command_scale import SCALED, with_common_command_scale
from aerial_gym.sim2real.logs.on_ground import check_airborne, rows_on_ground
from aerial_gym.sim2real.logs.pairs import LogPair, check_pairs, with_other_vehicle
from aerial_gym.sim2real.logs.position_jumps import mend_position_jumps
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import AT_REST, FlightLog, Recording, sample_rate, split_flight_number
from aerial_gym.sim2real.logs.rotor_model import SETTLE_S, fit_line_behind_lag, total_rotor_force
from aerial_gym.sim2real.logs.sample_repeats import mend_repeated_samples
from aerial_gym.sim2real.logs.signals import (
    DERIVED_BAND,
    check_gaps,
    log_at_equal_steps,
    lowpass,
    without_bad_quaternions,
)
from aerial_gym.sim2real.logs.stream_delays import correct_row_delays

MOST_LIFT = 30.0  # Largest plausible thrust at full command in weights; racing vehicles reach 15
POWERED = 0.3  # Least share of the usual input of the rotors at which they carry the vehicle
FEWEST_HIGH = 10  # At least one row in so many must lie above the height at which commands are scaled


@dataclass(frozen=True, kw_only=True)
class Flight(Recording):
    """A flight at equal time steps from 0 s, with unit quaternions of continuous sign."""

    name: str  # Short name, unique among the flights of one run
    rate: float  # Rows per second [Hz]
    ang_vel: Array  # [rad/s], body, (T, 3)
    torques: bool = True  # Whether the rotor data determine the torques
    gyro: bool  # Whether ``ang_vel`` was measured and rotor torques are known, as for angular acceleration
    accelerometer: bool  # Whether ``specific_force`` was measured; if not, it was derived from the velocity
    on_ground: Flags | None = None  # Rows on the ground, excluded from comparisons, (T,); None if there are none

    @property
    def num_rows(self) -> int:
        """Number of rows T."""
        return self.time.size

    @property
    def has_commands_scaled_by_speeds(self) -> bool:
        """Return whether measured rotor speeds scale the commands, which then share the common error of their sensors."""
        return any(one.code == SCALED and bool(one.values["by_speeds"]) for one in self.notes)

    def rows_without_comparison(self, near: int) -> Flags | None:
        """Return rows within ``near`` of the ground, losses or an unknown other vehicle, and ``SETTLE_S`` after lost commands.

        Rotors that follow commands forget their state by then. None: no row is excluded, (T,).
        """
        masks = [mask for mask in (self.on_ground, self.lost, self.rows_without_other) if mask is not None]
        if not masks:
            return None
        excluded = np.asarray(ndimage.maximum_filter1d(np.any(masks, axis=0), 2 * near + 1), dtype=bool)
        if self.lost is not None and self.rotor_command is not None:
            since = np.cumsum(self.lost)
            settle = round(SETTLE_S * self.rate)
            excluded[settle:] |= since[settle:] > since[:-settle]
            excluded[:settle] |= since[:settle] > 0
        return excluded


def flight_names(some: Sequence[Flight], flights: Sequence[Flight]) -> str:
    """Return the names of ``some`` flights, or 'all logs' if these are all of several."""
    return "all logs" if len(some) == len(flights) > 1 else ", ".join(flight.name for flight in some)


Had = TypeVar("Had")


def values_in_all_mappings(parts: Sequence[Mapping[str, Had]]) -> dict[str, list[Had]]:
    """Return the entries that all mappings share, by key, each as a list with one value per mapping."""
    return {name: [part[name] for part in parts] for name in parts[0] if all(name in part for part in parts)}


def merge_findings_of_flights(flights: Sequence[Flight]) -> list[Finding]:
    """Return the distinct findings on the logs; each subject names the affected flights."""
    notes = dict.fromkeys(note for flight in flights for note in flight.notes)
    return [
        replace(note, subject=flight_names([flight for flight in flights if note in flight.notes], flights))
        for note in notes
    ]


def findings_on_rigid_joints(robot: RobotCfg) -> list[Finding]:
    """Return a finding if a vehicle with joints is compared as a rigid body."""
    return [] if robot.joints is None else [Finding("joints_held", "", {"joints": list(robot.joints.names)})]


def load_flights(
    paths: Sequence[str | Path],
    robot: RobotCfg,
    *,
    mapping: LogMapping | None,
    bandwidth: float,
    learning: int | None = None,
    refused: list[DataError] | None = None,
    pairs: Sequence[LogPair] = (),
) -> list[Flight]:
    """Return the flights in the files, with unique names; errors of unusable files are raised, or go to ``refused``.

    The first ``learning`` files (None: all) decide the common clock offset of the rotor logs; nothing else depends on
    others. ``pairs``: logs of two vehicles in one flight.
    """
    given: dict[Path, tuple[FlightLog, bool]] = {}  # With whether it is among the first ``learning``
    seen = LogRegister()
    for index, (real, path) in enumerate(distinct_files(paths).items()):
        with _collect_refusals(refused):
            opened = open_log(path, mapping)
            for number in opened.numbers:
                with _collect_refusals(refused):
                    raw = with_other_vehicle(opened.flight(number), pairs, mapping, resample_log)
                    seen.add(raw)
                    log = derive_velocity(mend_position_jumps(resample_log(raw)))
                    given[real.with_name(Path(raw.path).name)] = (log, learning is None or index < learning)
    read: dict[Path, tuple[FlightLog, list[Finding]]] = {}
    learned, shared = 0, with_shared_rotor_quantities([log for log, _ in given.values()])
    for (real, (_, learns)), log in zip(given.items(), shared, strict=True):
        with _collect_refusals(refused):
            log = correct_row_delays(scale_relative_commands(log, robot))
            read[real] = (log, check_log(log, robot))
            learned += learns
    logs = with_common_command_scale([log for log, _ in read.values()], robot, learned)
    timed = with_rotors_on_sensor_clock(logs, robot, bandwidth, learned)
    flights: list[Flight] = []
    for (real, (_, notes)), log, moved in zip(read.items(), logs, timed, strict=True):
        with _collect_refusals(refused):
            check_rotor_clock(log, robot, bandwidth)
            log = scale_commands_to_hover_thrust(moved, robot)
            stands = rows_on_ground(log, robot)
            notes = [*notes, *check_rotor_order(log, robot, stands)]
            check_airborne(log, stands, bandwidth)
            check_rotor_law(log, robot, stands)
            flight = complete_flight(log, notes, on_ground=stands)
            name = flight.name if all(flight.name != f.name for f in flights) else f"{real.parent.name}/{flight.name}"
            flights.append(replace(flight, name=name))
    return flights


@contextmanager
def _collect_refusals(refused: list[DataError] | None) -> Iterator[None]:
    """Append a ``DataError`` to ``refused``, or raise it if there is no list."""
    try:
        yield
    except DataError as error:
        if refused is None:
            raise
        refused.append(error)


def distinct_files(paths: Sequence[str | Path]) -> dict[Path, str | Path]:
    """Return the paths by their real files; refuse a file that is given twice."""
    seen: dict[Path, str | Path] = {}
    for path in paths:
        file, number = split_flight_number(path)
        real = Path(os.path.realpath(file))  # unlike Path.resolve, accepts a loop of links until it is opened
        real = real if number is None else real.with_name(f"{real.name}#{number}")
        if real in seen:
            raise DataError(f"{path}: is given twice (also as {seen[real]}); a flight is for training or for testing")
        seen[real] = path
    return seen


def resample_log(log: FlightLog) -> FlightLog:
    """Return the log at equal time steps with repeated values repaired."""
    log = without_bad_quaternions(log)
    check_duration_and_rate(log)
    check_gaps(log)
    mended = mend_repeated_samples(without_copied_commands(log))
    check_for_alternating_flights(mended)
    return log_at_equal_steps(mended)


def derive_velocity(log: FlightLog) -> FlightLog:
    """Return the log with velocity derived from position if it was not logged."""
    if log.lin_vel is not None or log.position is None:
        return log
    rate = sample_rate(log)
    velocity = lowpass(log.position, rate, DERIVED_BAND * rate, derivative=True)
    return replace(log, lin_vel=velocity, notes=(*log.notes, Finding("velocity_derived")))


def scale_commands_to_hover_thrust(log: FlightLog, robot: RobotCfg) -> FlightLog:
    """Return the log with commands scaled by s, ``mean sum_r T(s w_r) = m mean f_z`` above ``hover_above``, if asked."""
    if log.hover_above is None or log.rotor_command is None:
        return log
    if log.position is None or log.specific_force is None:
        raise DataError(f"{log.path}: to scale commands above {log.hover_above:g} m it needs position and acc")
    high = log.position[:, 2] > log.hover_above
    if high.sum() * FEWEST_HIGH < log.time.size or not np.any(log.rotor_command[high]):
        raise DataError(f"{log.path}: hardly flies above {log.hover_above:g} m, where its commands are to be scaled")
    scale = _scale_to_thrust(log.rotor_command[high], log.specific_force[high, 2], robot)
    note = Finding("commands_scaled", "", {"factor": scale, "height_m": log.hover_above})
    return replace(log, rotor_command=scale * log.rotor_command, command_curve=None, notes=(*log.notes, note))


def _scale_to_thrust(speed: Array, force: Array, robot: RobotCfg) -> float:
    """Return the factor s with ``mean sum_r T(s w_r) = m mean f`` for speeds (T, R) and forces along z [m/s²], (T,)."""
    c0, c1, c2 = np.array([rotor.thrust_coefficients for rotor in robot.rotor_types]).T  # each (R,)
    weight = robot.body.mass * float(force.mean()) - c0.sum()
    linear, square = (speed @ c1).mean(), (speed**2 @ c2).mean()
    root = np.sqrt(max(linear**2 + 4.0 * square * weight, 0.0))
    return float(2.0 * weight / (linear + root))  # also for c2 = 0: force mode


def scale_relative_commands(log: FlightLog, robot: RobotCfg) -> FlightLog:
    """Return the log with shares of the largest speed as speeds: by measured speeds, else by the mean measured thrust.

    With speeds, the line ``w = a + b u`` is fitted behind the rotor lag. In force mode a thrust is the square of the share.
    """
    share = log.rotor_command
    if not log.relative_commands or share is None or share.shape[1] != robot.num_rotors:
        return log
    if log.rotor_speed is not None:
        if log.rotor_speed.shape != share.shape:
            raise DataError(
                f"{log.path}: has {log.rotor_speed.shape[1]} rotor speeds and {share.shape[1]} commands; both need "
                "one for each rotor"
            )
        line = fit_line_behind_lag(share, log.rotor_speed, robot, sample_rate(log))
        idle, slope = line.idle, line.slope
        command, full = idle + slope * share, idle + slope
    elif log.specific_force is None and log.lin_vel is None:
        raise DataError(
            f"{log.path}: its commands are shares of the largest speed, and without accelerometer and velocity no thrust "
            "scales them; map rotor_command with a gain in rad/s"
        )
    else:
        force = complete_flight(log).specific_force
        assert force is not None
        relative = share**2 if "force" in robot.rotor_traits else share
        if not np.any(relative):
            raise DataError(f"{log.path}: its rotor commands are 0 throughout; give a log of a flight")
        total = relative.sum(axis=1)
        carries = total > POWERED * np.quantile(total, 0.9)  # not on the ground, which also holds the vehicle
        full = _scale_to_thrust(relative[carries], force[carries, 2], robot)
        weight = robot.body.mass * STANDARD_GRAVITY
        if not full > 0.0 or total_rotor_force(robot, np.full((1, robot.num_rotors), full))[0] > MOST_LIFT * weight:
            raise DataError(
                f"{log.path}: its rotor commands are {share.mean():.2g} of full on average, too little to fly; give "
                "a log of a flight, or map rotor_command with a gain"
            )
        command, slope = full * relative, full
    values = {"full": full, "unit": "N" if "force" in robot.rotor_traits else "rad/s"}
    note = Finding(SCALED, "", values | {"by_speeds": log.rotor_speed is not None})
    log = replace(log, command_curve=(full - slope, slope, 2.0 if values["unit"] == "N" else 1.0))
    return replace(log, rotor_command=command, relative_commands=False, notes=(*log.notes, note))


def complete_flight(log: FlightLog, notes: Sequence[Finding] = (), *, on_ground: Flags | None = None) -> Flight:
    """Return the flight with missing specific force and angular velocity derived; ``on_ground``: (T,)."""
    rate, said = sample_rate(log), [*log.notes, *notes]
    band = DERIVED_BAND * rate
    specific_force, ang_vel = log.specific_force, log.ang_vel
    if log.lin_vel is None:
        said.append(Finding("velocity_unknown"))
    elif specific_force is None:
        acceleration = lowpass(log.lin_vel, rate, band, derivative=True) + AT_REST
        specific_force = Rotation.from_quat(log.attitude).apply(acceleration, inverse=True)
        said.append(Finding("force_derived"))
    if ang_vel is None:
        ang_vel = body_rate_from_attitude(log.attitude, rate, band)
        said.append(Finding("rates_derived"))
    if log.collective:
        said.append(Finding("one_command"))
    if not log.torques and not any(note.code == "rotors_too_slow" for note in said):
        said.append(Finding("torques_not_logged"))
    if on_ground is not None:
        said.append(Finding("on_ground", "", {"share": float(on_ground.mean())}))
    shared, torques = (
        {field.name: getattr(log, field.name) for field in fields(Recording)},
        log.torques and not log.collective,
    )
    completed = {"time": log.time - log.time[0], "specific_force": specific_force, "notes": tuple(said)}
    if log.pair is not None:
        completed["pair"] = replace(log.pair, clock=log.pair.clock + float(log.time[0]))
    completed["setpoints"] = {name: (time - log.time[0], one) for name, (time, one) in log.setpoints.items()}
    return Flight(
        **(shared | completed),
        name=log.name,
        rate=rate,
        ang_vel=ang_vel,
        torques=torques,
        gyro=log.ang_vel is not None and torques,
        accelerometer=log.specific_force is not None,
        on_ground=on_ground,
    )


@dataclass(frozen=True, kw_only=True)
class FlightInputs:
    """Usable flights, and a finding for each rejected log."""

    train: list[Flight]
    test: list[Flight]
    left_out: tuple[Finding, ...]  # One finding for each rejected log
    digests: dict[str, str]  # SHA-256 of every file by its path, rejected ones included


def read_flight_inputs(
    robot: RobotCfg,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    *,
    mapping: LogMapping | None,
    bandwidth: float,
    pairs: Sequence[LogPair] = (),
) -> FlightInputs:
    """Return the flights of the logs; unusable logs become findings as long as each role keeps a flight, else ``DataError``."""
    if not train or not test:
        raise DataError("needs at least one flight to train on (--train) and another one to test on (--test)")
    check_bandwidth(bandwidth)
    check_pairs(pairs, train, test)
    paths, refused = [*train, *test], list[DataError]()
    distinct_files(paths)
    digests = file_digests(
        dict.fromkeys(map(str, (*paths, *(log for pair in pairs for log in (pair.first, pair.second)))))
    )
    settings = {"mapping": mapping, "bandwidth": bandwidth, "pairs": pairs}
    flights = load_flights(paths, robot, learning=len(train), refused=refused, **settings)
    to_train = {str(path) for path in train}
    files = [{f.path, split_flight_number(f.path)[0]} for f in flights]
    groups = [
        [f for f, names in zip(flights, files, strict=True) if bool(names & to_train) is wanted]
        for wanted in (True, False)
    ]
    for role, given, left in zip(("train", "test"), (train, test), groups, strict=True):
        if not left:
            refusals = f" (none of {len(given)} flights to {role} on is left; the first refusal of {len(refused)})"
            raise DataError(f"{refused[0]}{refusals if len(refused) > 1 else ''}") from None
    notes = tuple(Finding("flight_left_out", "", {"error": str(error)}) for error in refused)
    return FlightInputs(train=groups[0], test=groups[1], left_out=notes, digests=digests)


def check_bandwidth(bandwidth: float) -> None:
    """Raise ``ConfigError`` for a comparison bandwidth outside 0.5 to 100 Hz."""
    if not 0.5 <= bandwidth <= 100.0:
        raise ConfigError(f"bandwidth_hz = {bandwidth!r}: must lie in [0.5, 100] Hz")


def load_train_and_test(
    robot: RobotCfg,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    mapping: str | Path | None,
    bandwidth: float,
    *,
    pairs: Sequence[LogPair] = (),
) -> tuple[list[Flight], list[Flight]]:
    """Return training and test flights; raise ``DataError`` if any log is unusable."""
    layout = None if mapping is None else find_mapping(mapping)
    inputs = read_flight_inputs(robot, train, test, mapping=layout, bandwidth=bandwidth, pairs=pairs)
    if inputs.left_out:
        raise DataError(f"left out: {inputs.left_out[0].values['error']}")
    return inputs.train, inputs.test


def file_digests(paths: Iterable[str | Path]) -> dict[str, str]:
    """Return the SHA-256 of files by their paths, for a folder of its files together."""
    groups: dict[str, str] = {}
    for path in paths:
        try:
            file = Path(split_flight_number(path)[0])
            parts = sorted(part for part in file.rglob("*") if part.is_file()) if file.is_dir() else [file]
            groups[str(path)] = hashlib.sha256(b"".join(part.read_bytes() for part in parts)).hexdigest()
        except FileNotFoundError:
            raise DataError(f"{path}: no such file") from None
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    return groups

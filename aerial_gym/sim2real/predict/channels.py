"""The compared channels: quantities that all flights have, and the comparison band."""

from collections.abc import Sequence
from dataclasses import dataclass

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import HIGHEST_BAND, comparable_rate

UNITS = {
    "specific_force": "m/s²",
    "angular_acceleration": "rad/s²",
    "rotor_speed": "rad/s",
    "kinematic_force": "m/s²",
    "kinematic_rate": "rad/s",
}
"""SI unit of each kind of channel, in the order of the channels."""

KINEMATIC = ("kinematic_force", "kinematic_rate")  # Kinds that need no dynamics


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One compared quantity."""

    kind: str  # specific_force, angular_acceleration, rotor_speed, kinematic_force or kinematic_rate
    axis: str  # x, y, z, or the number of the rotor

    @property
    def unit(self) -> str:
        """SI unit."""
        return UNITS[self.kind]

    @property
    def name(self) -> str:
        """Unique name."""
        return f"{self.kind}.{self.axis}"


def comparison_band(flights: Sequence[Flight], bandwidth: float) -> float:
    """Return the comparison bandwidth [Hz]: the requested one, limited by the slowest compared stream."""
    return min(bandwidth, HIGHEST_BAND * min(comparable_rate(flight, flight.rate) for flight in flights))


def find_channels(flights: Sequence[Flight], bandwidth: float = 0.0) -> tuple[Channel, ...]:
    """Return the channels that every flight has below ``bandwidth`` [Hz]. Raise ``DataError`` if there are none.

    Kinematics imply the motion up to half the rate of attitude and velocity (Nyquist), and is compared only so far.
    """

    def resolve(name: str) -> bool:
        return all(2.0 * bandwidth <= one.streams[name].rate for one in flights if name in one.streams)

    channels: list[Channel] = []
    if all(flight.specific_force is not None for flight in flights):
        channels += [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    if all(flight.gyro for flight in flights):
        channels += [Channel(kind="angular_acceleration", axis=axis) for axis in "xyz"]
    if all(flight.rotor_speed is not None and flight.rotor_command is not None for flight in flights):
        channels += [Channel(kind="rotor_speed", axis=str(n + 1)) for n in range(flights[0].num_rotors)]
    if not channels:
        raise DataError("the flights have no quantity in common that can be compared; log acc or omega in all of them")
    if resolve("lin_vel") and all(flight.accelerometer and flight.lin_vel is not None for flight in flights):
        channels += [Channel(kind="kinematic_force", axis=axis) for axis in "xyz"]
    if resolve("attitude") and all(flight.gyro and not flight.attitude_integrated for flight in flights):
        channels += [Channel(kind="kinematic_rate", axis=axis) for axis in "xyz"]
    return tuple(channels)

"""Cells of a robustness test, one condition each, and groups of cells that share a simulation."""

from collections.abc import Mapping
from dataclasses import dataclass, field

Values = Mapping[tuple[str, str], float]  # Parameters of effects, by effect and name


@dataclass(frozen=True, kw_only=True)
class Variant:
    """One vehicle of a cell: one rotor, direction or sign."""

    values: Values = field(default_factory=dict)  # Parameters that differ from those of the simulation's robot
    label: str = ""  # Rotor, direction or sign, for people


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One condition."""

    name: str  # Unique short name, such as ``com_offset/large``
    label: str  # Description for people
    subject: str  # Effect, or ``clean``, ``rate``, ``delay``, ``packet_loss``, ``noise``, ``ranges``
    variants: tuple[Variant, ...] = (Variant(),)  # Flight i has that of number i modulo their number
    loss: float = 0.0  # Probability that an observation packet is lost
    delay_steps: int | None = None  # Delay of the policy's commands in place of the task's own


CLEAN = Cell(name="clean", label="clean flight", subject="clean")


@dataclass(frozen=True, kw_only=True)
class CellGroup:
    """Cells that are environments of one simulation."""

    cells: tuple[Cell, ...]
    settings: tuple[str, ...] = ()  # Beyond those of the task
    robot: str | None = None  # Robot file in place of the task's robot
    compared: bool = False  # Whether the others are compared with the first cell, which is neutral


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All groups, and the effects that cannot be flown with the reason for each."""

    groups: tuple[CellGroup, ...]  # The first cell of the first group is clean flight
    not_flown: Mapping[str, str] = field(default_factory=dict)

    @property
    def num_conditions(self) -> int:
        """Number of cells besides clean flight."""
        return sum(len(group.cells) for group in self.groups) - 1

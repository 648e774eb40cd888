"""Medians of all rounds, and the ratio of ours to each peer."""

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """Figures of one simulator in one case."""

    name: str  # Simulator: aerial_gym or a peer
    case: str  # plant, rk4 or attitude
    substeps: int | None  # Substeps in one launch of ours; None for a peer
    rates: tuple[float, ...]  # Steps per second, all vehicles together, one figure a round
    version: str  # Versions of what ran
    dt_s: float  # Length of a step [s]
    call: str  # How many steps one call makes, and what fuses them

    @property
    def steps_per_s(self) -> float:
        """Median of the rounds."""
        return statistics.median(self.rates)


def gather_rounds(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Return one measurement per simulator, case and substeps, with the figures of all rounds."""
    result: dict[tuple[str, str, int | None], Measurement] = {}
    for new in measurements:
        key = (new.name, new.case, new.substeps)
        result[key] = replace(new, rates=result[key].rates + new.rates) if key in result else new
    return list(result.values())


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Ours against one peer in one case."""

    peer: Measurement
    package: Measurement

    @property
    def ratio(self) -> float:
        """Our rate over the peer's; above 1 ours is faster."""
        return self.package.steps_per_s / self.peer.steps_per_s

    def as_mapping(self) -> dict[str, object]:
        """Return the row as plain data."""
        row: dict[str, object] = {"case": self.peer.case, "peer": self.peer.name}
        for side, given in (("peer", self.peer), ("ours", self.package)):
            row |= {f"{side}_{name}": getattr(given, name) for name in ("version", "call", "dt_s", "steps_per_s")}
            row[f"{side}_rounds"] = given.rates
        return row | {"ratio": self.ratio}


def ratios(measurements: Sequence[Measurement]) -> list[Ratio]:
    """Return a row for every peer's case and every number of substeps of ours in that case, in order of the cases."""
    gathered = gather_rounds(measurements)
    own = [m for m in gathered if m.substeps is not None]
    peers = [m for m in gathered if m.substeps is None]
    return [Ratio(peer=peer, package=run) for peer in peers for run in own if run.case == peer.case]

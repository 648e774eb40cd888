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


def gather(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Return one measurement per simulator, case and substeps, with the figures of all rounds."""
    result: dict[tuple[str, str, int | None], Measurement] = {}
    for new in measurements:
        key = (new.name, new.case, new.substeps)
        result[key] = replace(new, rates=result[key].rates + new.rates) if key in result else new
    return list(result.values())


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Ours against one peer in one case."""

    case: str
    peer: str
    peer_version: str
    peer_call: str
    peer_dt_s: float
    peer_steps_per_s: float
    peer_rounds: tuple[float, ...]
    ours_call: str
    ours_version: str
    ours_dt_s: float
    ours_steps_per_s: float
    ours_rounds: tuple[float, ...]
    ratio: float  # Ours over the peer's; above 1 ours is faster


def ratios(measurements: Sequence[Measurement]) -> list[Ratio]:
    """Return a row for every peer's case and every number of substeps of ours in that case, in order of the cases."""
    gathered = gather(measurements)
    result = []
    for peer in (m for m in gathered if m.substeps is None):
        for own in (m for m in gathered if m.substeps is not None and m.case == peer.case):
            result.append(
                Ratio(
                    case=peer.case,
                    peer=peer.name,
                    peer_version=peer.version,
                    peer_call=peer.call,
                    peer_dt_s=peer.dt_s,
                    peer_steps_per_s=peer.steps_per_s,
                    peer_rounds=peer.rates,
                    ours_call=own.call,
                    ours_version=own.version,
                    ours_dt_s=own.dt_s,
                    ours_steps_per_s=own.steps_per_s,
                    ours_rounds=own.rates,
                    ratio=own.steps_per_s / peer.steps_per_s,
                )
            )
    return result

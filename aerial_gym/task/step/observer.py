"""Observations: terms concatenated in groups, with noise, dropout, faults, delay, history and scale.

A sensor fault of a term has a random start and duration in each episode.
Letters: E environments, O entries of a group, F faults, W entries of the widest term that has a fault.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.config.task_terms import FaultCfg, ObservationCfg, fewest_and_most_steps
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.kernels.draws import UniformDraws, WhiteNoise
from aerial_gym.task.step.row_kernels import HistoryLine, StepKernel
from aerial_gym.task.terms.term import BoundTerm
from aerial_gym.task.values import Values

STEPS, DRAWS = "fault_steps", "fault_draws"  # Begin and duration of faults, (E, 2 F); shares and offsets


class SensorFaults:
    """Sensor faults of a task: draws at reset and their effect on a term."""

    def __init__(
        self, terms: Iterable[tuple[object, ObservationCfg, int]], cfgs: Mapping[str, FaultCfg], values: Values,
        random: Randomness,
    ) -> None:  # fmt: skip
        """Declare the draws of the faults of observation terms, each with its width."""
        widths: dict[str, int] = {}  # of the widest term with each fault
        for _, cfg, width in terms:
            if cfg.fault is not None:
                widths[cfg.fault] = max(width, widths.get(cfg.fault, 0))
        self._cfgs = {name: cfgs[name] for name in widths}
        self._first: dict[str, int] = {}
        ranges, shares = [], []
        for name, width in widths.items():
            cfg = self._cfgs[name]
            self._first[name] = len(shares)
            ranges += [fewest_and_most_steps(cfg.begin_steps), fewest_and_most_steps(cfg.duration_steps)]
            shares += [(0.0, 1.0), *[(-cfg.size, cfg.size)] * width]
        self._draws: list[UniformDraws] = []
        self.reads: dict[str, Tensor] = {}  # Inputs of `apply_fault`
        if not ranges:
            return
        steps = values.declare(STEPS, (len(ranges),), unit="steps", meaning="when faults begin, how long they last")
        draws = values.declare(DRAWS, (len(shares),), meaning="which episodes have faults, and offsets of jumps")
        self._draws.append(UniformDraws(steps, ranges, purpose=Purpose.FAULT_STEPS, random=random, whole=True))
        self._draws.append(UniformDraws(draws, shares, purpose=Purpose.FAULT, random=random))
        self.reads = {STEPS: steps, DRAWS: draws, "sim_steps": values.gtd["sim_steps"]}

    def draw(self, mask: Tensor) -> None:
        """Draw the faults of new episodes, bool (E,)."""
        for each in self._draws:
            each.draw(mask)

    def apply_fault(self, cfg: ObservationCfg, values: Mapping[str, Tensor], value: Tensor) -> Tensor:
        """Return a term's value, (E, width), with its sensor fault where that acts; a pure function."""
        if cfg.fault is None:
            return value
        fault, first = self._cfgs[cfg.fault], self._first[cfg.fault]
        number = list(self._cfgs).index(cfg.fault)
        since = values["sim_steps"].float() - values[STEPS][:, 2 * number]
        lasts = (since >= 0.0) & (since < values[STEPS][:, 2 * number + 1])
        acts = (lasts & (values[DRAWS][:, first] < fault.share)).unsqueeze(-1)
        if fault.how == "lost":
            return torch.where(acts, cfg.dropout_value, value)
        offsets = values[DRAWS][:, first + 1 : first + 1 + value.shape[-1]]
        return torch.where(acts, value + offsets, value)


NOISE, DELAYS = "observation_noise", "observation_delay"  # Draws of this step, and delays drawn at a reset


@dataclass(frozen=True, kw_only=True)
class ObservationEntry:
    """A term of a group with its settings, buffers and columns."""

    term: BoundTerm
    cfg: ObservationCfg
    width: int
    noise: int | None  # First of its columns among the draws of noise
    line: HistoryLine
    past: tuple[str, ...]  # Buffers of its line, oldest first
    held: tuple[str, ...]  # Buffers of each entry's last value and of the steps since its dropout, if held
    delay: int | None  # Its column among the drawn delays; None where it has one delay

    def noisy_value(
        self, values: Mapping[str, Tensor], begun: Tensor | None
    ) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Return whether the term is finite, bool (E,), its value with noise and dropout, zeros where not, (E, width), and what
        is held as the next step finds it."""
        value = self.term.evaluate(values)
        finite, value = value.isfinite().all(dim=-1), value.nan_to_num(0.0, 0.0, 0.0)
        if self.noise is None:
            return finite, value, {}
        noise = values[NOISE][:, self.noise : self.noise + self.width]
        value = value + noise
        if not self.cfg.dropout:
            return finite, value, {}
        there = noise.isfinite()
        if not self.held:
            return finite, torch.where(there, value, self.cfg.dropout_value), {}
        last, age = (values[name] for name in self.held)
        if begun is not None:
            last = torch.where(begun.unsqueeze(-1), self.cfg.dropout_value, last)
            age = torch.where(begun.unsqueeze(-1), 0.0, age)
        age = torch.where(there, 0.0, age + 1.0)
        value = torch.where(there, value, torch.where(age <= self.cfg.hold_steps, last, self.cfg.dropout_value))
        return finite, value, dict(zip(self.held, (value, age), strict=True))

    def delay_value(
        self, values: Mapping[str, Tensor], value: Tensor, begun: Tensor | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the observation of a value, (E, history width), and its buffers as the next step finds them."""
        kept: dict[str, Tensor] = {}
        if self.line.length:
            past = torch.cat([values[name] for name in self.past], dim=-1)
            frames = self.line.frames_of_step(past, value, begun)
            widths = [count * self.width for count in self.line.buffer_lengths(self.width)]
            kept = dict(zip(self.past, self.line.next_line(frames).split(widths, dim=-1), strict=True))
            value = self.line.read_frames(frames, None if self.delay is None else values[DELAYS][:, self.delay])
        return value if self.cfg.scale == 1.0 else self.cfg.scale * value, kept


class Observer:
    """Observations by group: those of a step in one kernel, those before a reset in that of the judge."""

    def __init__(
        self, groups: Mapping[str, list[tuple[BoundTerm, ObservationCfg, int]]], values: Values, random: Randomness,
        faults: Mapping[str, FaultCfg] | None = None,
    ) -> None:  # fmt: skip
        self._faults = SensorFaults([term for terms in groups.values() for term in terms], faults or {}, values, random)
        self.groups: dict[str, list[ObservationEntry]] = {}  # Entries in order
        noise: dict[int, tuple[float, float]] = {}
        ranges: list[tuple[int, int]] = []
        column = 0
        for group, terms in groups.items():
            self.groups[group] = []
            for number, (term, cfg, width) in enumerate(terms):
                low, high = fewest_and_most_steps(cfg.delay_steps)
                line = HistoryLine(longest_delay=high, history=cfg.history)
                past = []
                for piece, count in enumerate(line.buffer_lengths(width)):
                    past.append(f"past_{group}_{number}_{piece}")
                    meaning = f"last values of {term.label}, oldest first"
                    values.declare(past[-1], (count * width,), meaning=meaning)
                held = tuple(f"{prefix}_{group}_{number}" for prefix in ("held", "dropped")) if cfg.hold_steps else ()
                for name, meaning in zip(held, ("last shown value of", "steps since a return of"), strict=False):
                    values.declare(name, (width,), meaning=f"{meaning} each entry of {term.label}")
                drawn = bool(cfg.noise_std or cfg.dropout)
                entry = ObservationEntry(
                    term=term, cfg=cfg, width=width, noise=len(noise) if drawn else None, line=line,
                    past=tuple(past), held=held, delay=len(ranges) if low < high else None,
                )  # fmt: skip
                if drawn:
                    noise |= {column + i: (cfg.noise_std, cfg.dropout) for i in range(width)}
                if low < high:
                    ranges.append((low, high))
                self.groups[group].append(entry)
                column += width
        self._noise = WhiteNoise(noise, values.gtd["sim_steps"], random)
        self._delays: UniformDraws | None = None
        delays = values.declare(DELAYS, (len(ranges),), unit="steps", meaning="how late terms are in this episode")
        if ranges:
            self._delays = UniformDraws(delays, ranges, purpose=Purpose.OBSERVATION_DELAY, random=random, whole=True)
        entries = [entry for group in self.groups.values() for entry in group]
        self.terms = [entry.term for entry in entries]  # Of all groups
        self.writes = {name: values[name] for entry in entries for name in (*entry.past, *entry.held)}
        """Buffers of delay lines and held values."""
        self.reads = {NOISE: self._noise.noise, DELAYS: delays} | self._faults.reads | self.writes
        self.reads |= values.term_inputs(*self.terms)
        """Inputs of ``observe``."""
        begun = {"begun": values.find("begun", "the observation")}
        self.rows = StepKernel(
            self._observation_and_buffers, "the observation", reads=begun | self.reads, writes=self.writes,
            terms=self.terms, graph=values.graph,
        )  # fmt: skip
        """The kernel of a step's observation."""

    def width(self, group: str) -> int:
        """Return the entries of a group, O."""
        return sum(entry.width * entry.cfg.history for entry in self.groups[group])

    def draw_episodes(self, mask: Tensor) -> None:
        """Draw the delays and faults of new episodes."""
        self._faults.draw(mask)
        if self._delays is not None:
            self._delays.draw(mask)

    def draw_noise(self, *, final: bool = False) -> None:
        """Draw the noise of this step; ``final``: for the observation before a reset."""
        self._noise.draw(final=final)

    def __call__(self) -> dict[str, Tensor]:
        """Return the observations of this instant, (E, O) by group, and move all lines on; launched, not waited for."""
        results = self.rows()
        return {group: results[group] for group in self.groups}

    def observe(
        self, values: Mapping[str, Tensor], begun: Tensor | None
    ) -> tuple[Tensor, dict[str, Tensor], dict[str, Tensor]]:
        """Return whether all terms are finite, bool (E,), the observations by group, and ``writes``, as a pure function.
        ``values`` are tensors by the names of ``reads``; ``begun`` marks new episodes, bool (E,), None for none."""
        flags, shown, lines = [], {}, {}
        for group, entries in self.groups.items():
            parts = []
            for entry in entries:
                finite, value, held = entry.noisy_value(values, begun)
                value = self._faults.apply_fault(entry.cfg, values, value)
                part, line = entry.delay_value(values, value, begun)
                flags.append(finite)
                parts.append(part)
                lines |= line | held
            shown[group] = torch.cat(parts, dim=-1)
        return torch.stack(flags, dim=-1).all(dim=-1), shown, lines

    def _observation_and_buffers(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        _, shown, lines = self.observe(values, values["begun"])
        return lines | shown

"""``python -m benchmarks.robustness.fuzz --count 3000 --seed 0``: mutated inputs, each of which must work or be refused.

An exception that is not the package's own, a refusal that is no sentence, and an input that takes longer than ``limit_s`` are
findings; their inputs are kept in ``out``. Exit status 1 if there is any. Input i of a seed is the same in every run.
"""

import logging
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import tyro

from aerial_gym.errors import AerialGymError
from benchmarks.robustness.fuzz.mutations import mutate
from benchmarks.robustness.fuzz.targets import Target, targets

LONGEST_SENTENCE = 1500
TELL_EVERY_S = 10.0
WAITING = 20.0  # Times the limit that an input may take by the clock, as other processes may have the processor


class TimeLimitError(BaseException):
    """An input took longer than the limit."""


@dataclass(frozen=True, kw_only=True)
class Fuzz:
    """Feed mutated inputs to the targets."""

    count: int = 3000  # Mutated inputs
    seed: int = 0  # Of the mutations
    only: tuple[str, ...] = ()  # Targets by name, or by its first word; all if none is given
    limit_s: float = 20.0  # Longest processor time of one input [s], unless its target has another limit
    out: Path = Path("out/fuzz")  # Receives the inputs of findings

    def run(self) -> int:
        """Print progress and a summary; return the exit status."""
        kinds: Counter[str] = Counter()
        result: Counter[str] = Counter()
        with tempfile.TemporaryDirectory() as name, _silence_logs():
            self._feed_targets(Path(name), kinds, result)
        for kind, number in sorted(kinds.items()):
            print(f"{number:6d}  {kind}")
        for finding, number in result.most_common():
            print(f"FINDING {number:4d}  {finding}")
        print(f"{self.count} inputs with seed {self.seed}: {result.total()} findings of {len(result)} kinds")
        return 1 if result else 0

    def _feed_targets(self, folder: Path, kinds: "Counter[str]", results: "Counter[str]") -> None:
        told = time.monotonic()
        chosen = [
            target
            for target in targets(folder)
            if not self.only or {target.name, target.name.split("_")[0]} & {*self.only}
        ]
        for target in chosen:  # compiles kernels and loads libraries before time and memory count
            file = folder / f"input{target.suffix}"
            file.write_bytes(target.inputs[0])
            with suppress(AerialGymError):
                target.use(file)
        for index in range(self.count):
            target = chosen[index % len(chosen)]
            outcome, finding = self._try_input(target, folder, index)
            kinds[f"{target.name}: {outcome}"] += 1
            if finding is not None:
                results[finding] += 1
            if time.monotonic() - told > TELL_EVERY_S:
                told = time.monotonic()
                print(f"{index + 1}/{self.count}, {results.total()} findings", file=sys.stderr, flush=True)

    def _try_input(self, target: Target, folder: Path, index: int) -> tuple[str, str | None]:
        draw = random.Random(f"{self.seed}:{target.name}:{index}")
        data = mutate(draw.choice(target.inputs), target.ways, draw)
        file = folder / f"input{target.suffix}"
        file.write_bytes(data)
        limit = target.limit_s or self.limit_s
        signal.setitimer(signal.ITIMER_PROF, limit)
        signal.setitimer(signal.ITIMER_REAL, WAITING * limit)
        try:
            with _limit_memory(target.limit_bytes):
                target.use(file)
        except AerialGymError as error:
            bad = _message_fault(str(error))
            outcome, finding = "refused", None if bad is None else f"{target.name}: {bad}: {str(error)[:150]!r}"
        except TimeLimitError:
            outcome, finding = "finding", f"{target.name}: takes longer than {limit} s"
        except Exception as error:
            outcome, finding = (
                "finding",
                f"{target.name}: {type(error).__name__} {_error_location(error)}: {str(error)[:120]!r}",
            )
        else:
            outcome, finding = "works", None
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        if finding is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            (self.out / f"{target.name}_{self.seed}_{index}{target.suffix}").write_bytes(data)
        return outcome, finding


@contextmanager
def _silence_logs() -> Iterator[None]:
    """Let warnings and logs of bad inputs be silent, and the alarm raise; put all back afterwards."""
    kept = {kind: signal.signal(kind, _raise_time_limit) for kind in (signal.SIGALRM, signal.SIGPROF)}
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
        for kind, handler in kept.items():
            signal.signal(kind, handler)


@contextmanager
def _limit_memory(size: int | None) -> Iterator[None]:
    """Let allocations of more bytes than ``size`` beside the present ones raise ``MemoryError``."""
    if size is None:
        yield
        return
    kept = resource.getrlimit(resource.RLIMIT_AS)
    present = resource.getpagesize() * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (present + size, kept[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, kept)


def _raise_time_limit(number: int, frame: FrameType | None) -> None:
    del number, frame
    raise TimeLimitError


def _message_fault(text: str) -> str | None:
    """Return the fault of a message, or None; several faults of one file stand below a heading, one in each line."""
    head, *faults = text.strip().splitlines() or [""]
    if faults and not head.endswith(" faults:"):
        return "several lines"
    if max(map(len, (head, *faults))) > LONGEST_SENTENCE:
        return "too long a sentence"
    return "advice of torch" if "weights_only" in text else None


def _error_location(error: BaseException) -> str:
    """Return the last line of the package on the way to an error."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "aerial_gym/" in frame.filename]
    last = frames[-1] if frames else traceback.extract_tb(error.__traceback__)[-1]
    return f"at {last.filename.rpartition('aerial_gym/')[2]}:{last.lineno}"


if __name__ == "__main__":
    sys.exit(tyro.cli(Fuzz, description=__doc__).run())

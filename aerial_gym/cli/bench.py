"""The command ``aerial-gym bench``: one subcommand per part of the simulator."""

import sys
from dataclasses import dataclass
from typing import Annotated

import tyro

from aerial_gym.workloads.memory import MemoryBench
from aerial_gym.workloads.physics import PhysicsBench
from aerial_gym.workloads.render import RenderBench
from aerial_gym.workloads.task import TaskBench


@dataclass(frozen=True, kw_only=True)
class BenchCmd:
    """Measure the speed of the physics alone, of whole task steps, or of cameras, or the memory of a simulator."""

    benchmark: tyro.conf.OmitArgPrefixes[
        tyro.conf.OmitSubcommandPrefixes[
            Annotated[PhysicsBench, tyro.conf.subcommand("physics")]
            | Annotated[TaskBench, tyro.conf.subcommand("task")]
            | Annotated[RenderBench, tyro.conf.subcommand("render")]
            | Annotated[MemoryBench, tyro.conf.subcommand("memory")]
        ]
    ]
    """What is measured."""

    def run(self) -> int:
        """Measure and print; return the exit status: 1 if the workload did not do its work."""
        from aerial_gym.workloads.measure import WorkloadError

        try:
            return self.benchmark.run()
        except WorkloadError as error:
            name = type(self.benchmark).__name__.removesuffix("Bench").lower()
            print(f"aerial-gym bench {name}: {error}", file=sys.stderr)
            return 1

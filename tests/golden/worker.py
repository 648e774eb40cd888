"""Measurements of golden results in processes whose numbers do not depend on the processor, as far as libraries allow."""

import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib import import_module
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.golden.compare import compact

SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "CUDA_VISIBLE_DEVICES": "",
    "ATEN_CPU_CAPABILITY": "default",
    "MKL_CBWR": "COMPATIBLE",
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR",
}
"""Environment of the measurements: libraries choose the same instructions on every x86-64 processor."""


def begin() -> None:
    """Prepare a worker: one thread, and kernels for any x86-64 processor in place of those for this one."""
    import torch
    import warp as wp

    torch.set_num_threads(1)
    wp.config.cpu_compiler_flags = (wp.config.cpu_compiler_flags or "").replace("-march=native", "").strip()


def measure(topic: str, item: str) -> tuple[dict[str, Any], float]:
    """Return one result in its compact form, or the error that it ended with, and its processor time [s]."""
    start, module = time.process_time(), import_module(f"tests.golden.{topic}")
    try:
        result = compact(module.measure(item), prose=not module.HAS_PROSE)
    except Exception as error:
        result = {"error": f"{type(error).__name__}: {error}"}
    return result, time.process_time() - start


def machine() -> str:
    """Return the processor and the library versions, on which exact results may depend."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.exists() else ""
    cpu = " ".join(re.findall(r"^(?:vendor_id|cpu family|model)\s*: (.*)", text, re.MULTILINE)[:3])
    libraries = " ".join(f"{name} {version(name)}" for name in ("torch", "warp-lang", "numpy", "scipy"))
    return f"{platform.machine()} {cpu}, {libraries}, {''.join(platform.libc_ver())}"


def measure_all(jobs: list[tuple[str, str]], workers: int) -> Iterator[tuple[str, str, Any, float]]:
    """Yield topic, item, result and seconds of every job, in the order in which they end. One worker is this process, if it
    has begun with ``SETTINGS``."""
    if workers == 1 and SETTINGS.items() <= os.environ.items():
        begin()
        yield from ((*job, *measure(*job)) for job in jobs)
        return
    os.environ.update(SETTINGS)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=begin) as pool:
        futures = {pool.submit(measure, *job): job for job in jobs}
        for number, future in enumerate(as_completed(futures), 1):
            topic, item = futures[future]
            print(f"\r{number}/{len(jobs)} {topic}/{item}\033[K", end="", file=sys.stderr, flush=True)
            yield topic, item, *future.result()
    print("\r\033[K", end="", file=sys.stderr)

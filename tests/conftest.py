"""Settings of all tests: as many threads as there are cores for each worker, reproducible draws."""

import os

_CORES = len(os.sched_getaffinity(0))
_THREADS = max(1, min(2, _CORES // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))

# Workers that have more threads than cores wait for each other; processes that tests start inherit the number.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(_THREADS)))

import torch  # noqa: E402

torch.set_num_threads(_THREADS)

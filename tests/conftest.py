"""Settings of all tests: two cores, reproducible draws."""

import torch

torch.set_num_threads(2)

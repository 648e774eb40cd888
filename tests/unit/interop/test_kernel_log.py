"""What Warp compiles is told, and nothing else that it says about itself."""

import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from aerial_gym.interop.kernel_log import KernelLog

CODE = """
import torch
from aerial_gym.interop.rows import RowFunction
RowFunction(lambda a: 2.0 * a, (torch.zeros(2, 3),))(torch.zeros(2, 3))
"""


@pytest.mark.slow
def test_a_compilation_is_told_once_per_machine(tmp_path: Path) -> None:
    environment = {"WARP_CACHE_PATH": str(tmp_path), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    run = partial(subprocess.run, capture_output=True, text=True, env=environment, check=True)
    said = [run([sys.executable, "-c", CODE]) for _ in range(2)]
    lines = said[0].stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("compiled aerial_gym_rows_")
    assert " for cpu in " in lines[0]
    assert f"kept in {tmp_path}" in lines[0]
    assert [each.stdout for each in said] == ["", ""]
    assert said[1].stderr == ""


def test_what_is_no_compilation_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    log = KernelLog()
    for message in ("Warp 1.19.0 initialized:", "Module a 1234abc load on device 'cpu' took 3.00 ms  (cached)"):
        log.info(message)
    assert caplog.text == ""
    log.info("Module a 1234abc load on device 'cuda:0' took 1250.00 ms  (compiled)")
    log.info("    Module b 1234abc load on device 'cuda:0' took 250.00 ms  (compiled)")
    assert "compiled a for cuda:0 in 1.2 s; once for this machine, kept in" in caplog.text
    assert caplog.messages[1] == "compiled b for cuda:0 in 0.2 s"

"""One environment of a training on a page, without a wait in the training.

The training's process copies the state of one environment some times a second, in a thread and on a CUDA stream of its own,
which neither the training's stream nor its graphs wait for. A process of its own draws the page, so that drawing takes no
time of the training's interpreter. As the copies do not wait either, position and attitude may be one step apart.
The thread starts with the first report of the training, when the CUDA graphs are recorded: another thread must not use the
device while one is.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING, Any

import torch

from aerial_gym.viewer.server import LOOPBACK, close_server, open_server
from aerial_gym.viewer.snapshot import SnapshotReader

if TYPE_CHECKING:
    from aerial_gym.task import Task

COPIES_PER_S = 20.0


class TrainingView:
    """Shows one environment of a training; its page chooses which one."""

    def __init__(self, *, host: str = LOOPBACK, port: int = 8080) -> None:
        """Start the process of the page; raise ``ConfigError`` if the port is not free."""
        close_server(open_server(host, port))  # a taken port is refused here, where the user reads it
        command = [sys.executable, "-m", "aerial_gym.viewer.observer", host, str(port)]
        self._page = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        self._ends, self._chosen = threading.Event(), 0
        self._thread: threading.Thread | None = None

    @contextlib.contextmanager
    def follow(self, task: "Task") -> Iterator[None]:
        """Show a task from its first report on, until the block ends."""
        self._task = task
        try:
            yield
        finally:
            self.close()

    def report(self) -> None:
        """Take notice that the training has made updates."""
        if self._thread is None and not self._ends.is_set():
            self._thread = threading.Thread(target=self._send_states, daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End the page; a second call does nothing."""
        self._ends.set()
        self._page.terminate()
        if self._thread is not None:
            self._thread.join()
        self._page.wait()
        for pipe in (self._page.stdin, self._page.stdout):
            assert pipe is not None
            pipe.close()

    @torch.no_grad()
    def _send_states(self) -> None:
        task, output, wishes = self._task, self._page.stdin, self._page.stdout
        assert output is not None
        assert wishes is not None
        os.set_blocking(wishes.fileno(), False)
        reader = SnapshotReader(task.env, task.values.own)
        on_gpu = task.device.type == "cuda"
        stream = torch.cuda.stream(torch.cuda.Stream(task.device)) if on_gpu else contextlib.nullcontext()
        with stream, contextlib.suppress(OSError):  # the page has ended
            pickle.dump(reader.content, output)
            while not self._ends.wait(1.0 / COPIES_PER_S):
                for wish in (wishes.read() or b"").splitlines():
                    self._chosen = min(max(int(wish), 0), task.num_envs - 1)
                pickle.dump(reader.read(self._chosen, alone=True), output)


def show_states(host: str, port: int, states: IO[bytes], wishes: IO[bytes]) -> None:
    """Serve a page that shows the snapshots that arrive, until they end; wishes for an environment go back."""
    from aerial_gym.viewer.scene import SceneView

    server = open_server(host, port)
    scene: SceneView | None = None
    line = server.gui.add_text("training", "waiting for the first update", disabled=True)

    def choose(event: Any) -> None:
        wishes.write(b"%d\n" % int(event.target.value))
        wishes.flush()

    with contextlib.suppress(EOFError, OSError):
        content = pickle.load(states)
        if content.num_envs > 1:
            server.gui.add_number("environment", 0, min=0, max=content.num_envs - 1, step=1).on_update(choose)
        while True:
            snapshot = pickle.load(states)
            if scene is None:
                scene = SceneView(server, content, alone=True)
                scene.aim(snapshot)
                scene.add_follow_switch(follows=True)
            with server.atomic():
                scene.update(snapshot)
                line.value = f"episode {snapshot.episode}, {snapshot.time:.1f} s"
    close_server(server)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the training ends first, and closes the pipe
    show_states(sys.argv[1], int(sys.argv[2]), sys.stdin.buffer, sys.stdout.buffer)

"""What a page receives: the present state at once, also after it left, and updates fast enough."""

import threading
from typing import TYPE_CHECKING

import pytest

from aerial_gym.env_manager import SimBuilder
from aerial_gym.robots.catalog import robot_by_name

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.effects import add_neutral_effects
from aerial_gym.viewer.live import LiveView
from aerial_gym.viewer.simulation import FlightInView
from tests.unit.viewer.client import count_updates, page_client, receive

if TYPE_CHECKING:
    from viser import ViserServer

NUM_ENVS = 64


@pytest.fixture(scope="module")
def view(server: "ViserServer") -> LiveView:
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="empty_env", robot_name=add_neutral_effects(robot_by_name("base_quadrotor")),
        controller_name="lee_position_control", num_envs=NUM_ENVS, device="cpu", seed=0,
    )  # fmt: skip
    return LiveView(server, FlightInView(env))


def last_state(port: int) -> str:
    """Return the text of the panel's first line that a new page receives."""
    with page_client(port) as line:
        texts: list[str] = []
        while True:
            for message in receive(line):
                if message["type"] == "ReplayDoneMessage":
                    return texts[-1]
                props = message.get("props") or message.get("updates") or {}
                texts += [props["value"]] if str(props.get("value", "")).endswith("m/s") else []


def test_page_that_returns_gets_the_present_state(server: "ViserServer", view: LiveView) -> None:
    for _ in range(2):
        view.advance(0.1)
        assert view.scene.last is not None
        assert last_state(server.get_port()).startswith(f"{view.scene.last.time:.1f} s")


def test_backlog_does_not_grow_with_time(server: "ViserServer", view: LiveView) -> None:
    """A page that comes late receives each node's last pose, not its history."""
    for _ in range(5):
        view.advance(0.05)
    buffer = server._websock_server._broadcast_buffer
    before = len(buffer.message_from_id)
    for _ in range(20):
        view.advance(0.05)
    assert len(buffer.message_from_id) <= before + 2


@pytest.mark.slow
def test_page_receives_64_vehicles_at_30_updates_a_second(server: "ViserServer", view: LiveView) -> None:
    """On two cores with this client beside; ``python -m benchmarks.speed.view`` prints the figure."""
    flying = threading.Thread(target=view.run, kwargs={"duration_s": 8.0})
    flying.start()
    count, span = count_updates(server.get_port(), "/others/blades", 5.0)
    flying.join()
    assert count / span > 24.0

"""A ground station, a simulated autopilot that routes, and the companion on another link."""

from typing import Any, Literal

import pytest
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mavlink.commands import CommandServer
from companion.mavlink.dialect import codec
from companion.mavlink.parameter_server import PARAMETERS, ParameterServer
from companion.mavlink.presence import Presence
from companion.mission.events import OrderKind
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import flat_world

OURS, GCS = (1, 195), (255, 190)
ON_GCS, ON_COMPANION = 0, 1
MISSION = load_mission("valley")


class Link:
    """Both ends of both links, and the companion's servers at one of them."""

    def __init__(self, autopilot: Literal["ardupilot", "px4"]) -> None:
        world = flat_world(
            "copter",
            autopilot,
            latitude_deg=47.0,
            longitude_deg=8.0,
            altitude_amsl_m=400.0,
            heading_deg=0.0,
        )
        self.simulation = Simulation(world, links=2)
        self.presence = Presence(version="1.2.3", sends_obstacles=False)
        self.commands = CommandServer(
            ours=OURS,
            commanders=((255, 0),),
            frame=MISSION.frame,
            limits=MISSION.task.limits,
            presence=self.presence,
        )
        self.parameters = ParameterServer(MISSION.task, ours=OURS, commanders=((255, 0),))
        self.orders: list[OrderKind] = []
        self._codec = codec(OURS[0])
        self._reader = codec(OURS[0])
        self._gcs = wire.MAVLink(None, *GCS)
        self.heard: list[Any] = []
        """What the ground station has heard."""

    def gcs_sends(self, message: Any) -> None:
        self.simulation.receive(ON_GCS, message.pack(self._gcs))

    def run(self, seconds: float) -> None:
        for _ in range(round(100 * seconds)):
            self.simulation.step()
            for link, frame in self.simulation.take_frames():
                if link == ON_COMPANION:
                    self._companion_hears(frame)
                else:
                    self.heard += self._gcs.parse_buffer(frame) or []
            now_s = self.simulation.now_us * 1e-6
            self._companion_sends(self.presence.on_time(now_s, status=4, around=None))
            self._companion_sends(self.parameters.on_time(now_s))

    def _companion_hears(self, frame: bytes) -> None:
        now_s = self.simulation.now_us * 1e-6
        for message in self._reader.parse_buffer(frame) or []:
            answer = self.commands.on_message(message, now_s)
            self._companion_sends(answer.replies)
            if answer.order is not None:
                self.orders.append(answer.order.kind)
                self._companion_sends(self.commands.order_done(answer.order, accepted=True))
            self._companion_sends(self.parameters.on_message(message, now_s).replies)

    def _companion_sends(self, messages: Any) -> None:
        for message in messages:
            self.simulation.receive(ON_COMPANION, message.pack(self._codec))

    def from_companion(self, kind: str) -> list[Any]:
        """What the ground station has heard of the companion."""
        return [
            message
            for message in self.heard
            if message.get_type() == kind
            and (message.get_srcSystem(), message.get_srcComponent()) == OURS
        ]


@pytest.fixture(params=["ardupilot", "px4"])
def link(request: pytest.FixtureRequest) -> Link:
    made = Link(request.param)
    made.gcs_sends(wire.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    made.run(3.0)
    return made


def command(number: int, *values: float, target: tuple[int, int] = OURS) -> Any:
    seven = (*values, *[0.0] * (7 - len(values)))
    return wire.MAVLink_command_long_message(*target, number, 0, *seven)


def test_an_order_gets_through_and_its_ack_back(link: Link) -> None:
    link.gcs_sends(command(wire.MAV_CMD_DO_PAUSE_CONTINUE))
    link.run(0.5)
    assert link.orders == [OrderKind.PAUSE]
    [ack] = link.from_companion("COMMAND_ACK")
    assert (ack.command, ack.result) == (wire.MAV_CMD_DO_PAUSE_CONTINUE, wire.MAV_RESULT_ACCEPTED)
    assert (ack.target_system, ack.target_component) == GCS


def test_what_is_for_the_autopilot_is_the_autopilots(link: Link) -> None:
    for target in ((1, 1), (1, 0)):
        link.gcs_sends(command(wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, target=target))
        link.run(0.5)
    assert link.orders == []
    assert link.from_companion("COMMAND_ACK") == []


def test_its_heartbeat_is_not_taken_for_a_vehicles(link: Link) -> None:
    beats = link.from_companion("HEARTBEAT")
    assert 2 <= len(beats) <= 4
    assert {beat.autopilot for beat in beats} == {wire.MAV_AUTOPILOT_INVALID}


def test_its_version_can_be_asked_for(link: Link) -> None:
    link.gcs_sends(command(wire.MAV_CMD_REQUEST_MESSAGE, 148.0))
    link.run(0.5)
    assert len(link.from_companion("AUTOPILOT_VERSION")) == 1


@pytest.mark.parametrize("component", [0, 195])
def test_its_parameters_are_listed_and_set(link: Link, component: int) -> None:
    link.gcs_sends(wire.MAVLink_param_request_list_message(1, component))
    link.run(2.0)
    listed = {value.param_id: value.param_value for value in link.from_companion("PARAM_VALUE")}
    assert list(listed) == [parameter.name for parameter in PARAMETERS]
    link.heard.clear()
    link.gcs_sends(wire.MAVLink_param_set_message(*OURS, b"PLN_SPEED", 5.5, 9))
    link.run(0.5)
    [value] = link.from_companion("PARAM_VALUE")
    assert (value.param_id, value.param_value) == ("PLN_SPEED", 5.5)
    assert link.parameters.task.limits.speed_m_s == 5.5

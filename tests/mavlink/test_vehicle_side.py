"""What a person hears of a vehicle's own fence, drawn by a ground station in flight or before."""

import math
from typing import Any

import pytest
from held import Held, circle, polygon

from companion.config import load_mission
from companion.mavlink.autopilots import autopilot_of
from companion.mavlink.dialect import wire
from companion.mavlink.vehicle import VehicleSide
from companion.mission.events import FenceChanged, Item, Prepared

FENCE = 1


class Side:
    """A vehicle side as a client, and the events that it tells."""

    def __init__(self, held: Held, mission: str) -> None:
        self._held, self._mission = held, mission
        self.side: VehicleSide | None = None
        self.events: list[Any] = []
        self.hears_home = True

    def on_message(self, message: Any, now_s: float) -> list[Any]:
        if self.side is None:
            autopilot = autopilot_of(message) if message.get_type() == "HEARTBEAT" else None
            if autopilot is None:
                return []
            self.side = VehicleSide(
                load_mission(self._mission),
                1,
                autopilot,
                message.autopilot,
                lockstep=True,
                sets_parameters=False,
            )
            return self.side.begin(now_s)
        if message.get_srcComponent() != 1:
            return []
        if message.get_type() == "HOME_POSITION" and not self.hears_home:
            return []
        replies = self.side.on_message(message, now_s)
        self.side.event_of(message, now_s)
        self.events += self.side.events(now_s)
        return replies

    def on_time(self, now_s: float) -> list[Any]:
        return [] if self.side is None else self.side.on_time(now_s, None)

    @property
    def refusals(self) -> list[str]:
        return [event.refusal for event in prepared_plans(self) if event.refusal]

    @property
    def said(self) -> list[str]:
        return [] if self.side is None else self.side.notes


def begun(firmware: Any) -> tuple[Held, Side]:
    held = Held(firmware)
    name = "sitl-px4" if firmware == "px4" else "sitl-arducopter"
    client = Side(held, name)
    held.run(60.0, client, until=lambda: bool(prepared_plans(client)))
    assert prepared_plans(client)
    return held, client


def prepared_plans(client: Side) -> list[Prepared]:
    told = (event for event in client.events if isinstance(event, Prepared))
    return [event for event in told if event.item is Item.PLANS]


def test_a_circle_without_an_end_that_is_drawn_later_is_said() -> None:
    held, client = begun("px4")
    before = len(client.refusals)
    held.upload(FENCE, [circle(math.inf)], client)
    held.run(10.0, client)
    assert "needs a radius" in client.refusals[before]


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_what_is_said_of_a_fence_is_said_once(firmware: Any) -> None:
    held, client = begun(firmware)
    held.upload(FENCE, polygon(5, command=5002), client)
    held.run(40.0, client)
    assert len(client.said) == len(set(client.said))
    assert any(isinstance(event, FenceChanged) and event.zones for event in client.events)


def test_plans_are_not_done_before_a_fence_about_home_is_drawn() -> None:
    """Else a vehicle whose home is heard last arms before its fence is held against the mission."""
    held = Held("ardupilot")
    for name, value in (("FENCE_ENABLE", 1.0), ("FENCE_TYPE", 2.0), ("FENCE_RADIUS", 60.0)):
        held.other(wire.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        held.run(0.5)
    client = Side(held, "sitl-arducopter")
    client.hears_home = False
    held.run(30.0, client)
    assert not prepared_plans(client)
    client.hears_home = True
    held.run(60.0, client, until=lambda: bool(prepared_plans(client)))
    assert "fence about home (radius 60 m)" in prepared_plans(client)[0].refusal

"""The terrain radar on the vehicle's links: its messages in and out."""

from typing import Any, final

from vehicle_sim.autopilots import Ack, Result, Sender
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.sensors.radar_component import (
    RadarBeat,
    RadarBlock,
    RadarComponent,
    RadarConditions,
)
from vehicle_sim.wire import messages
from vehicle_sim.wire.radio import Radio


@final
class RadarNode:
    """One component beside the autopilot, on the same radio."""

    def __init__(self, radar: RadarComponent, radio: Radio, component_id: int) -> None:
        self._radar, self._radio, self._id = radar, radio, component_id

    def say_hello(self) -> None:
        """A heartbeat, out of turn."""
        self._radio.broadcast(messages.radar_heartbeat(), self._id)

    def receive(self, message: Any, sender: Sender) -> None:
        """Handle a message that is for the radar; commands that name it are refused."""
        match message.get_type():
            case "TERRAIN_REQUEST":
                self._radar.ask(messages.scan_request(message), sender.link)
            case "TERRAIN_CHECK":
                self._radar.ask(messages.terrain_check(message), sender.link)
            case "COMMAND_LONG" | "COMMAND_INT" if message.target_component == self._id:
                refusal = Ack(to=sender, command=message.command, result=Result.UNSUPPORTED)
                self._radio.send(messages.ack(refusal), sender.link, self._id)

    def step(
        self, now_us: int, vehicle: Vehicle, conditions: RadarConditions, *, tick: bool
    ) -> None:
        """Answer what is due; `tick` ends a lockstep tick."""
        for reply in self._radar.step(
            now_us, ends_tick=tick, vehicle=vehicle, conditions=conditions
        ):
            if isinstance(reply, RadarBeat):
                self.say_hello()
            elif isinstance(reply, RadarBlock):
                data = messages.terrain_data(reply.request, reply.block)
                self._radio.send(data, reply.link, self._id)
            else:
                self._radio.send(messages.terrain_report(reply), reply.link, self._id)

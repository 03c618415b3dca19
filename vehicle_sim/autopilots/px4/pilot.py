"""Whom PX4 hears: the pilot's sticks (MANUAL_CONTROL) and ground stations."""

from typing import Final, final

from vehicle_sim.autopilots import Sender, Sticks

_GROUND_STATION, _ONBOARD_CONTROLLER = 6, 18
_CENTRED: Final = Sticks(
    sender=Sender(system=255, component=190), pitch=0.0, roll=0.0, throttle=0.5, yaw=0.0
)


@final
class Pilot:
    """The newest sticks and when they came.  Mutable."""

    def __init__(self) -> None:
        self.sticks: Sticks | None = None
        self.heard_us: int | None = None
        self.at_arming = False
        """There was a pilot when it was armed: only then losing one matters."""
        self._held = False
        self._ground_station_us: int | None = None
        self._companion_us: int | None = None

    def take(self, sticks: Sticks, now_us: int) -> bool:
        """A MANUAL_CONTROL; tells whether it is the first one."""
        first = self.sticks is None
        self.sticks, self.heard_us = sticks, now_us
        return first

    def hold(self, now_us: int) -> None:
        """Fault: a pilot is there from now on, hands off."""
        self._held = True
        self.sticks = self.sticks or _CENTRED
        self.heard_us = now_us

    def hear(self, vehicle_type: int, now_us: int, *, ours: bool) -> None:
        """A heartbeat of somebody else, of the same system or another."""
        if vehicle_type == _GROUND_STATION:
            self._ground_station_us = now_us
        elif vehicle_type == _ONBOARD_CONTROLLER and ours:
            self._companion_us = now_us

    def misses_companion(self, now_us: int, loss_s: float) -> bool:
        """A companion has gone silent; told once each time."""
        heard_us = self._companion_us
        lost = heard_us is not None and now_us - heard_us > loss_s * 1e6
        if lost:
            self._companion_us = None
        return lost

    def present(self, now_us: int, loss_s: float) -> bool:
        """Whether the sticks are heard."""
        if self._held:
            return True
        return self.heard_us is not None and now_us - self.heard_us <= loss_s * 1e6

    def ground_station_lost(self, now_us: int, loss_s: float) -> bool:
        """There was one, and it has gone silent."""
        heard_us = self._ground_station_us
        return heard_us is not None and now_us - heard_us > loss_s * 1e6

    def moves(self, threshold: float) -> bool:
        """A stick is out of the centre by more than this share of its travel."""
        sticks = self.sticks
        if sticks is None:
            return False
        return (
            max(
                abs(sticks.pitch),
                abs(sticks.roll),
                abs(sticks.yaw),
                abs(2.0 * sticks.throttle - 1.0),
            )
            > threshold
        )

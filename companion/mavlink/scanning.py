"""Scans, one at a time: of the terrain radar, or of nothing where there is none."""

from typing import final

from companion.mavlink.dialect import Message, wire
from companion.mavlink.terrain_download import TerrainDownload, no_scan
from companion.mission.events import ScanDone, Vector
from companion.mission.mission import Mission
from companion.mission.state import State

_TICKS = 2.0  # a radar's answer may be older by so many positions
MESSAGES = (wire.MAVLINK_MSG_ID_TERRAIN_DATA, wire.MAVLINK_MSG_ID_TERRAIN_REPORT)
"""What the radar says of a scan."""


@final
class Scanning:
    """The scan that is under way.  Sans-IO."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._download: TerrainDownload | None = None
        self._done: ScanDone | None = None
        self.is_on = False
        """Whether there is a scan under way, or one that is over and was not told yet."""

    def begin(self, centre_nea_m: Vector, state: State, now_s: float) -> int:
        """Look at what is within range of a point.  -> blocks of terrain to ask for."""
        mission, task, flight = self._mission, state.task, state.flight
        self.is_on = True
        if mission.scanner_component_id is None:
            self._done = ScanDone(time_s=now_s, scan=no_scan(), asked=0, answered=0)
            return 0
        self._download = TerrainDownload(
            flight.known,
            centre_ne_m=centre_nea_m[:2],
            towards_ne_m=state.targets_ne_m[flight.target],
            range_m=task.settings.scan_range_m,
            deadline_s=now_s + task.settings.scan_time_s,
            drift_m=_TICKS / mission.position_rate_hz * task.limits.speed_m_s,
            frame=mission.frame,
            complete=mission.scanner_complete,
            whole_width=mission.scanner_whole_width,
        )
        return self._download.asked

    def stop(self) -> None:
        """Forget the scan that is under way."""
        self._download = self._done = None
        self.is_on = False

    def on_message(self, message: Message, here_nea_m: Vector | None) -> None:
        """One of `MESSAGES`."""
        if here_nea_m is not None and self._download is not None:
            self._download.on_message(message, here_nea_m)

    def on_time(self, now_s: float) -> Message | None:
        """The next request, if it is time for one."""
        return None if self._download is None else self._download.on_time(now_s)

    def done(self, now_s: float) -> ScanDone | None:
        """The scan, once it is over."""
        download = self._download
        if download is not None and download.is_over(now_s):
            self.stop()
            return ScanDone(
                time_s=now_s,
                scan=download.scan(),
                asked=download.asked,
                answered=download.answered,
            )
        done, self._done = self._done, None
        self.is_on = download is not None
        return done

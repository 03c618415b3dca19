"""The page: a server on this computer that shows recordings, and what people do there.

Callbacks of the page only put jobs into a queue; one thread does all of them, reads and draws.
"""

import math
import queue
import time
import traceback
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import viser
from viser import uplot

from companion.geodesy import FloatArray
from companion.live_view import panel
from companion.live_view.ground import Ground, Replica, last_ground
from companion.live_view.panel import CHARTS, charts_of
from companion.live_view.recording import Recording
from companion.live_view.scene import Scene
from companion.views.words import clock_text

_PERIOD_S: Final = 0.1
_READ_S: Final = 0.3
_CHARTS_S: Final = 1.5
_REPLAY_S: Final = 0.06  # of processor time in a period, for what was known of the ground
_BEHIND_S: Final = 2.0  # between two grounds while it is read: a browser draws each anew
_SPEEDS: Final = ("1x", "5x", "20x", "60x", "300x")
_VIEWS: Final = ("overview", "follow", "top")
_FOLLOW: Final = np.array([-11.0, 0.0, 5.5])  # of the camera behind the vehicle
_NEAR, _FAR = 0.05, 2000.0


@final
@dataclass(slots=True)
class Shown:
    """What is shown: a recording, and what follows from it."""

    recording: Recording
    replica: Replica | None = None
    _last: Ground | None = None
    _ground: tuple[int, Ground | None] = (-1, None)

    @staticmethod
    def of(path: Path, system_id: int | None = None) -> "Shown":
        """Read as much as there is.  InputError if it is no flight."""
        recording = Recording(path, system_id)
        recording.read()
        shown = Shown(recording)
        if recording.flight.has_mission:
            shown.replica = Replica(path)
            shown._last = last_ground(path, recording.flight.mission)
        return shown

    def ground_at(self, time_s: float) -> tuple[Ground | None, str]:
        """What was known of the ground; and what of that is not up to date."""
        replica, time_of = self.replica, self.recording.flight.time_of
        if replica is None:
            return None, ""
        reached_s = time_of(*replica.now)
        behind = ""
        if reached_s + 1.0 < time_s and replica.ended is None:
            behind = f"the ground is read until {clock_text(reached_s)}"
            if self._last is not None:
                return self._last, f"{behind}; shown as at the end"
        times_s = [time_of(boot, t_s) for boot, t_s, _ in replica.grounds]
        at = bisect_right(times_s, time_s) - 1
        if at != self._ground[0]:
            self._ground = at, None if at < 0 else replica.ground(at)
        return self._ground[1], behind if replica.ended is None else f"ground: {replica.ended}"


@final
class Page:
    """What all browsers that are connected see."""

    def __init__(self, server: viser.ViserServer, shown: Shown) -> None:
        self._server, self._shown, self._recording = server, shown, shown.recording
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._scene: Scene | None = None
        self._time_s, self._speed, self._plays = 0.0, 1.0, False
        self._newest = True  # until somebody goes elsewhere
        self._views: dict[int, str] = {}
        self._here: FloatArray = np.zeros(3)
        self._shown_s, self._shown_ground = -1.0, (False, -1)
        self._read_at_s = self._charted_at_s = -math.inf
        self._charted: tuple[int, int] | None = None
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 80, 181))
        gui.set_panel_label("companion view")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self._build()
        server.initial_camera.near, server.initial_camera.far = _NEAR, _FAR
        position, look_at = _overview()
        server.initial_camera.position, server.initial_camera.look_at = position, look_at
        server.on_client_connect(lambda client: self._do(lambda: self._view(client, "overview")))
        server.on_client_disconnect(lambda client: self._do(lambda: self._forget(client)))

    # --- what is on it

    def _build(self) -> None:
        gui = self._server.gui
        self._slider: Any = gui.add_slider("time, s", 0.0, 1.0, 0.1, 0.0)
        self._slider.on_update(self._when_moved)
        self._play = gui.add_button("play")
        self._play.on_click(lambda _: self._do(self._toggle))
        speeds = gui.add_dropdown("speed", _SPEEDS, initial_value=_SPEEDS[0])
        speeds.on_update(lambda event: self._do(lambda: self._set_speed(event.target.value)))
        jumps = gui.add_button_group("go to", ("next plan", "next hold", "newest"))
        jumps.on_click(lambda event: self._do(lambda: self.jump(event.target.value)))
        views = gui.add_button_group("camera", _VIEWS)
        views.on_click(self._when_viewed)
        tabs = gui.add_tab_group()
        with tabs.add_tab("flight"):
            self._status = gui.add_html("")
        with tabs.add_tab("events"):
            self._events_style = gui.add_html("")
            self._events = gui.add_button_group("", ("none yet",))
            self._events.on_click(
                lambda event: self._do(lambda: self.go_to_event(event.target.value))
            )
        charts = gui.add_panel()
        with charts.add_tab("charts"):
            self._charts = [self._add_chart(*each) for each in CHARTS]
        charts.dock_left()
        charts.set_width(300)

    def _add_chart(self, title: str, lines: dict[str, str]) -> Any:
        lines_of = [uplot.Series(label=name, stroke=c, width=2) for name, c in lines.items()]
        series = [uplot.Series(label="time, s"), *lines_of]
        nothing = np.zeros(0)
        return self._server.gui.add_uplot(
            tuple(nothing for _ in series),
            tuple(series),
            title=title,
            scales={"x": uplot.Scale(time=False)},
            legend=uplot.Legend(show=len(lines) > 1, live=False),
            aspect=1.75,
        )

    # --- what people do

    def _do(self, job: Callable[[], None]) -> None:
        self._jobs.put(job)

    def _when_moved(self, event: Any) -> None:
        if event.client is not None:  # else it was moved from here
            time_s = float(event.target.value)  # now: a step that is under way sets it back
            self._do(lambda: self.go_to(time_s))

    @property
    def status(self) -> str:
        """What the panel says, as HTML."""
        return self._status.content

    def go_to(self, time_s: float) -> None:
        """Show the flight as it was then.  In the page's own thread, as all that has no _."""
        self._newest, self._time_s = False, time_s

    def _toggle(self) -> None:
        self._plays = not self._plays
        self._newest = False
        self._play.label = "pause" if self._plays else "play"

    def _set_speed(self, text: str) -> None:
        self._speed = float(text.rstrip("x"))

    def jump(self, where: str) -> None:
        """Go to the next plan, the next hold, or to what is newest."""
        recording = self._recording
        if where == "newest":
            self._newest, self._time_s = True, recording.ends_s
            return
        kind = "plan" if where == "next plan" else "hold"
        later = [
            e.time_s for e in recording.events if e.kind == kind and e.time_s > self._time_s + 0.05
        ]
        if later:
            self.go_to(later[0])

    def go_to_event(self, line: str) -> None:
        """Go to where an event of the list happened."""
        events = self._recording.events
        times_s = [event.time_s for event in events if panel.event_line(event) == line]
        if times_s:
            self.go_to(times_s[0])

    def _when_viewed(self, event: Any) -> None:
        if event.client is not None:
            self._do(lambda: self._view(event.client, event.target.value))

    def _forget(self, client: viser.ClientHandle) -> None:
        self._views.pop(client.client_id, None)

    def _view(self, client: viser.ClientHandle, view: str) -> None:
        self._views[client.client_id] = view
        camera = client.camera
        if view == "overview":
            position, look_at = _overview()
        elif view == "top":
            position, look_at = np.array([0.0, -0.5, 108.0]), np.zeros(3)
        else:
            heading_rad = self._heading_rad()
            ahead = np.array([math.sin(heading_rad), math.cos(heading_rad), 0.0])
            position = self._here + _FOLLOW[0] * ahead + [0.0, 0.0, _FOLLOW[2]]
            look_at = self._here + 4.0 * ahead
        with client.atomic():
            camera.position = position
            camera.look_at = look_at

    # --- what is shown

    def run(self, stopped: Callable[[], bool]) -> None:
        """Read, and show, until that is over."""
        before_s = time.monotonic()
        while not stopped():
            began_s = time.monotonic()
            self.step(began_s, began_s - before_s)
            before_s = began_s
            self._wait(began_s + _PERIOD_S)

    def _wait(self, until_s: float) -> None:
        """Do the jobs that come; a person does not wait for the next period."""
        while True:
            try:
                job = self._jobs.get(timeout=max(until_s - time.monotonic(), 0.001))
            except queue.Empty:
                return
            try:
                job()
            except Exception:  # noqa: BLE001 - of one browser, which may be gone: others look on
                traceback.print_exc()

    def step(self, now_s: float, passed_s: float) -> None:
        """One look at what there is."""
        shown, recording = self._shown, self._recording
        if now_s - self._read_at_s >= _READ_S:
            self._read_at_s = now_s
            recording.read()
        if shown.replica is not None:
            shown.replica.advance(_REPLAY_S)
        if not len(recording.flight.times_s):
            self._status.content = panel.waiting_html(recording)
            return
        if self._scene is None:
            self._server.scene.reset()
            self._scene = Scene(self._server, recording.flight)
            self._shown_s, self._shown_ground = -1.0, (False, -1)
        if self._newest:
            self._time_s = recording.ends_s
        elif self._plays:
            self._time_s = min(self._time_s + passed_s * self._speed, recording.ends_s)
        self._show(now_s)

    def _show(self, now_s: float) -> None:
        shown, recording, scene = self._shown, self._recording, self._scene
        assert scene is not None
        replica = shown.replica
        ground, behind = shown.ground_at(self._time_s)
        of_ground = False, 0 if replica is None else len(replica.grounds)
        if replica is not None and replica.ended is None and behind:
            of_ground = True, int(now_s / _BEHIND_S)
        if (self._time_s, of_ground) != (self._shown_s, self._shown_ground):
            if ground is not None and (not of_ground[0] or of_ground != self._shown_ground):
                scene.show_ground(ground)
            self._shown_s, self._shown_ground = self._time_s, of_ground
            self._follow(scene.show(self._time_s, self._heading_rad()))
            stretch = scene.scale.stretch
            status = panel.status_html(recording, replica, self._time_s, behind, stretch)
            self._set(self._status, status)
            self._events.options, style = panel.event_list(recording.events, self._time_s)
            self._set(self._events_style, style)
            ends_s = round(recording.ends_s + 0.05, 1)
            if self._slider.max != ends_s:
                self._slider.max = max(ends_s, 0.1)
            self._slider.value = round(self._time_s, 1)
        samples = 0 if replica is None else len(replica.samples)
        charted = len(recording.flight.times_s), samples
        if now_s - self._charted_at_s >= _CHARTS_S and charted != self._charted:
            self._charted_at_s, self._charted = now_s, charted
            for chart, data in zip(self._charts, charts_of(recording, replica), strict=True):
                chart.scales = _scales(data)
                chart.data = data

    def _set(self, part: Any, content: str) -> None:
        if part.content != content:
            part.content = content

    def _follow(self, here: FloatArray) -> None:
        moved, self._here = here - self._here, here
        for client in self._server.get_clients().values():
            if self._views.get(client.client_id) == "follow":
                client.camera.position = client.camera.position + moved

    def _heading_rad(self) -> float:
        flight = self._recording.flight
        row, track = flight.row_at(self._time_s), flight.track
        heading_deg = float(track.heading_deg[row])
        if math.isnan(heading_deg):
            return math.atan2(float(track.east_m_s[row]), float(track.north_m_s[row]))
        return math.radians(heading_deg)


def _scales(data: tuple[FloatArray, ...]) -> dict[str, uplot.Scale]:
    """Ranges of the axes, by hand: a gap in the data leaves the page none to find."""
    values = np.concatenate(data[1:])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = max(0.06 * (high - low), 1e-3 + 1e-3 * abs(high))
    last_s = float(data[0][-1]) if len(data[0]) else 1.0
    return {
        "x": uplot.Scale(time=False, range=(0.0, max(last_s, 1.0))),
        "y": uplot.Scale(range=(low - margin, high + margin)),
    }


def _overview() -> tuple[FloatArray, FloatArray]:
    """Camera and what it looks at: all of the map, from the south-west."""
    return np.array([-40.0, -76.0, 50.0]), np.array([2.0, -9.0, 0.0])

"""The page: a server on this computer that shows a recording, and what people do there.

What people do comes from threads of the server; one thread reads and draws, ten times a second.
"""

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import rich
import viser
from viser import uplot

from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.live_view import panel
from companion.live_view.ground import Replica, ground_of
from companion.live_view.recording import Recording
from companion.live_view.scene import Scene
from companion.sources.files import answer
from companion.views.words import clock_text
from companion.world.known_map import KnownMap

_HOST: Final = "127.0.0.1"
_PERIOD_S: Final = 0.1
_READ_S: Final = 0.3
_CHARTS_S: Final = 1.5
_REPLAY_S: Final = 0.06  # of processor time in a period, for what was known of the ground
_GROUND_S: Final = 1.0  # between two grounds: a browser draws each anew
_SPEEDS: Final = ("1x", "5x", "20x", "60x", "300x")
_OVERVIEW: Final = (np.array([-40.0, -76.0, 50.0]), np.array([2.0, -9.0, 0.0]))
"""All of the map, from the south-west: where the camera is, and what it looks at."""
_NEAR, _FAR = 0.05, 2000.0


def serve(
    path: Path,
    port: int,
    on_ready: Callable[[str], None],
    stopped: Callable[[], bool],
    *,
    system_id: int | None = None,
    is_flown: bool = False,
) -> None:
    """Serve a run folder or a log until stopped.  InputError if that cannot be done.

    port: 0: any that is free.  on_ready: told the address.  system_id: of the vehicle, of several
    in a log.  is_flown: the flight is flown now: it may not have begun to be recorded.
    """
    rich.get_console().quiet = True  # viser prints a box about itself
    server = viser.ViserServer(host=_HOST, port=port, verbose=False)
    server.request_share_url = lambda **_: None  # type: ignore[method-assign]
    try:
        if port not in (0, server.get_port()):  # it takes the next one: people would look elsewhere
            rule = f"{_HOST} cannot be served there: the port is taken, or not for users"
            raise InputError("--view-port", port, rule, "Give another port, or 0.")
        recording = None if is_flown else Recording(path, system_id)
        on_ready(f"http://{_HOST}:{server.get_port()}/")
        begun = [path / name for name in ("mission.toml", "flight.tlog")]
        while recording is None and not stopped():
            if all(answer(file.is_file) for file in begun):
                recording = Recording(path, system_id)
            time.sleep(_PERIOD_S)
        if recording is not None:
            Page(server, recording).run(stopped)
    finally:
        server.stop()


@final
class Page:
    """What all browsers that are connected see."""

    def __init__(self, server: viser.ViserServer, recording: Recording) -> None:
        """recording: read as far as there is something."""
        self._server, self._recording = server, recording
        self.replica = Replica(recording.path) if recording.flight.has_mission else None
        """What was known of the ground; of a log alone nothing."""
        self._lock = threading.Lock()
        self._scene: Scene | None = None
        self._time_s, self._speed, self._plays = 0.0, 1.0, False
        self._newest = True  # until somebody goes elsewhere
        self._followers: set[int] = set()
        self._aim: FloatArray = np.zeros(3)
        self._ground_at_s = self._read_at_s = self._charted_at_s = -math.inf
        self._map_shown, self._slid_to_s = -1, 0.0
        self._known: KnownMap | None = None
        self._shown: tuple[object, ...] = ()
        self._charted: tuple[object, ...] = ()
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 80, 181))
        gui.set_panel_label("companion view")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self._build(gui)
        camera = server.initial_camera
        camera.near, camera.far = _NEAR, _FAR
        camera.position, camera.look_at = _OVERVIEW

    def _build(self, gui: viser.GuiApi) -> None:
        self._slider: Any = gui.add_slider("time, s", 0.0, 1.0, 0.1, 0.0)
        self._slider.on_update(self._doing(lambda event: self.go_to(event.target.value)))
        self._play = gui.add_button("play")
        self._play.on_click(self._doing(lambda _: self._toggle()))
        speeds = gui.add_dropdown("speed", _SPEEDS, initial_value=_SPEEDS[0])
        speeds.on_update(self._doing(self._set_speed))
        newest = gui.add_button("newest")
        newest.on_click(self._doing(lambda _: self.go_to(None)))
        cameras = gui.add_button_group("camera", ("overview", "follow"))
        cameras.on_click(self._doing(self._set_camera))
        tabs = gui.add_tab_group()
        with tabs.add_tab("flight"):
            self._status = gui.add_html("")
        with tabs.add_tab("events"):
            self._events_style = gui.add_html("")
            self._events = gui.add_button_group("", ("none yet",))
            self._events.on_click(self._doing(lambda event: self.go_to_event(event.target.value)))
        charts = gui.add_panel()
        with charts.add_tab("charts"):
            self._charts = [_chart(gui, title, lines) for title, lines in panel.CHARTS.items()]
        charts.dock_left()
        charts.set_width(300)

    # --- what people do

    def _doing(self, job: Callable[[Any], None]) -> Callable[[Any], None]:
        """What is done about an event of a browser, and not while the page is drawn."""

        def done(event: Any) -> None:
            if event.client is not None:  # else it was changed from here
                with self._lock:
                    job(event)

        return done

    @property
    def status(self) -> str:
        """What the panel says, as HTML."""
        return self._status.content

    def go_to(self, time_s: float | None) -> None:
        """Show the flight as it was then; None: as it is now."""
        self._newest, self._time_s = time_s is None, time_s or 0.0

    def go_to_event(self, line: str) -> None:
        """Go to where an event of the list happened."""
        for event in self._recording.events:
            if panel.event_line(event) == line:
                return self.go_to(event.time_s)

    def _toggle(self) -> None:
        self._plays = not self._plays
        self._newest = False
        self._play.label = "pause" if self._plays else "play"

    def _set_speed(self, event: Any) -> None:
        self._speed = float(event.target.value.rstrip("x"))

    def _set_camera(self, event: Any) -> None:
        client, place = event.client, _OVERVIEW
        self._followers.discard(client.client_id)
        if event.target.value == "follow":
            self._followers.add(client.client_id)
            flight = self._recording.flight
            heading_rad = flight.heading_rad(flight.row_at(self._time_s))
            ahead = np.array([math.sin(heading_rad), math.cos(heading_rad), 0.0])
            place = self._aim - 11.0 * ahead + [0.0, 0.0, 5.5], self._aim + 4.0 * ahead
        with client.atomic():
            client.camera.position, client.camera.look_at = place

    # --- what is shown

    def run(self, stopped: Callable[[], bool]) -> None:
        """Read, and show, until that is over."""
        before_s = time.monotonic()
        while not stopped():
            began_s = time.monotonic()
            with self._lock:
                self.step(began_s, began_s - before_s)
            before_s = began_s
            time.sleep(max(began_s + _PERIOD_S - time.monotonic(), 0.001))

    def step(self, now_s: float, passed_s: float) -> None:
        """One look at what there is."""
        recording = self._recording
        if now_s - self._read_at_s >= _READ_S:
            self._read_at_s = now_s
            recording.read()
        if self.replica is not None:
            self.replica.advance(_REPLAY_S)
        if not len(recording.flight.times_s):
            self._status.content = panel.waiting_html(recording)
            return
        if self._scene is None:
            self._server.scene.reset()
            self._scene = Scene(self._server, recording.flight)
        if self._newest:
            self._time_s = recording.ends_s
        elif self._plays:
            self._time_s = min(self._time_s + passed_s * self._speed, recording.ends_s)
        behind = self._show_ground(self._scene, now_s)
        shown = self._time_s, self._map_shown, behind
        charted = recording.ends_s, self._map_shown
        if shown != self._shown:
            self._shown = shown
            self._show(self._scene, behind)
        if charted != self._charted and now_s - self._charted_at_s >= _CHARTS_S:
            self._charted_at_s, self._charted = now_s, charted
            charts = panel.charts_of(recording.flight, self._known)
            for chart, data in zip(self._charts, charts, strict=True):
                chart.scales, chart.data = _scales(data), data

    def _show_ground(self, scene: Scene, now_s: float) -> str:
        """Show what was known of the ground; what of that is not up to date."""
        replica, flight = self.replica, self._recording.flight
        if replica is None:
            return ""
        number = replica.number_at(flight, self._time_s)
        if number not in (-1, self._map_shown) and now_s - self._ground_at_s >= _GROUND_S:
            self._ground_at_s, self._map_shown = now_s, number
            self._known, here_ne_m = replica.known(number)
            scene.show_ground(ground_of(self._known, here_ne_m, flight.mission))
        if replica.ended is not None:
            return f"ground: {replica.ended}"
        reached_s = flight.time_of(*replica.now)
        is_behind = reached_s + 1.0 < self._time_s
        return f"the ground is read until {clock_text(reached_s)}" if is_behind else ""

    def _show(self, scene: Scene, behind: str) -> None:
        recording, before = self._recording, self._aim
        self._aim = scene.show(self._time_s)
        for client in self._server.get_clients().values():
            if client.client_id in self._followers:
                client.camera.position = client.camera.position + (self._aim - before)
        known = None if behind else self._known
        drawn = panel.status_html(recording, known, self._time_s, behind, scene.area.stretch)
        self._status.content = drawn
        lines, self._events_style.content = panel.event_list(recording.events, self._time_s)
        self._events.options = lines or ("none yet",)
        self._slider.max = max(round(recording.ends_s + 0.05, 1), 0.1)
        if self._time_s != self._slid_to_s:  # else it may have been moved just now, untold yet
            self._slid_to_s = self._time_s
            self._slider.value = round(self._time_s, 1)


def _chart(gui: viser.GuiApi, title: str, lines: dict[str, str]) -> Any:
    lines_of = [uplot.Series(label=name, stroke=c, width=2) for name, c in lines.items()]
    return gui.add_uplot(
        tuple(np.zeros(0) for _ in range(1 + len(lines))),
        (uplot.Series(label="time, s"), *lines_of),
        title=title,
        scales={"x": uplot.Scale(time=False)},
        legend=uplot.Legend(show=len(lines) > 1, live=False),
        aspect=1.75,
    )


def _scales(data: tuple[FloatArray, ...]) -> dict[str, uplot.Scale]:
    """Ranges of the axes, by hand: a gap in the data leaves the page none to find."""
    values = np.concatenate(data[1:])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = max(0.06 * (high - low), 1e-3 + 1e-3 * abs(high))
    return {
        "x": uplot.Scale(time=False, range=(0.0, float(max([1.0, *data[0][-1:]])))),
        "y": uplot.Scale(range=(low - margin, high + margin)),
    }

"""The page: a server on this computer that shows recordings, and what people do there.

Callbacks of the page only put jobs into a queue; one thread does all of them, reads and draws.
"""

import math
import queue
import time
import traceback
from collections.abc import Callable
from typing import Any, Final, final

import numpy as np
import viser
from viser import uplot

from companion.geodesy import FloatArray
from companion.live_view import panel
from companion.live_view.ground import Replica
from companion.live_view.recording import Event, Recording
from companion.live_view.scene import Scene
from companion.views.words import clock_text

_PERIOD_S: Final = 0.1
_READ_S: Final = 0.3
_CHARTS_S: Final = 1.5
_REPLAY_S: Final = 0.06  # of processor time in a period, for what was known of the ground
_GROUND_S: Final = 1.0  # between two grounds: a browser draws each anew
_SPEEDS: Final = ("1x", "5x", "20x", "60x", "300x")
_VIEWS: Final = ("overview", "follow", "top")
_NEAR, _FAR = 0.05, 2000.0


@final
class Page:
    """What all browsers that are connected see."""

    def __init__(self, server: viser.ViserServer, recording: Recording) -> None:
        """recording: read as far as there is something."""
        self._server, self._recording = server, recording
        self.replica = Replica(recording.path) if recording.flight.has_mission else None
        """What was known of the ground; of a log alone nothing."""
        self._jobs: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._scene: Scene | None = None
        self._time_s, self._speed, self._plays = 0.0, 1.0, False
        self._newest = True  # until somebody goes elsewhere
        self._views: dict[int, str] = {}
        self._here: FloatArray = np.zeros(3)
        self._shown: tuple[float, int, str] | None = None
        self._ground_at_s = self._read_at_s = self._charted_at_s = -math.inf
        self._ground_shown, self._slid_to_s = -1, 0.0
        self._charted: tuple[int, int] | None = None
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 80, 181))
        gui.set_panel_label("companion view")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(370)
        self._build(gui)
        camera = server.initial_camera
        camera.near, camera.far = _NEAR, _FAR
        camera.position, camera.look_at = self._camera("overview")
        jobs, views = self._jobs, self._views
        server.on_client_connect(lambda one: jobs.put(lambda: self._view(one, "overview")))
        server.on_client_disconnect(lambda one: jobs.put(lambda: views.pop(one.client_id, None)))

    def _build(self, gui: viser.GuiApi) -> None:
        self._slider: Any = gui.add_slider("time, s", 0.0, 1.0, 0.1, 0.0)
        self._slider.on_update(self._when_moved)
        self._play = gui.add_button("play")
        self._play.on_click(lambda _: self._jobs.put(self._toggle))
        speeds = gui.add_dropdown("speed", _SPEEDS, initial_value=_SPEEDS[0])
        speeds.on_update(self._when_chosen(self._set_speed))
        places = gui.add_button_group("go to", ("next plan", "next hold", "newest"))
        places.on_click(self._when_chosen(self.jump))
        gui.add_button_group("camera", _VIEWS).on_click(self._when_viewed)
        tabs = gui.add_tab_group()
        with tabs.add_tab("flight"):
            self._status = gui.add_html("")
        with tabs.add_tab("events"):
            self._events_style = gui.add_html("")
            self._events = gui.add_button_group("", ("none yet",))
            self._events.on_click(self._when_chosen(self.go_to_event))
        charts = gui.add_panel()
        with charts.add_tab("charts"):
            self._charts = [_chart(gui, title, lines) for title, lines in panel.CHARTS.items()]
        charts.dock_left()
        charts.set_width(300)

    # --- what people do

    def _when_chosen(self, job: Callable[[Any], None]) -> Callable[[Any], None]:
        def chosen(event: Any) -> None:
            value = event.target.value  # now: a step that is under way may set it back
            self._jobs.put(lambda: job(value))

        return chosen

    def _when_moved(self, event: Any) -> None:
        if event.client is not None:  # else it was moved from here
            self._when_chosen(self.go_to)(event)

    def _when_viewed(self, event: Any) -> None:
        if event.client is not None:
            self._when_chosen(lambda view: self._view(event.client, view))(event)

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
        if where == "newest":
            self._newest = True
            return
        kind, after_s = where.removeprefix("next "), self._time_s + 0.05
        self._go_to_first(lambda each: each.kind == kind and each.time_s > after_s)

    def go_to_event(self, line: str) -> None:
        """Go to where an event of the list happened."""
        self._go_to_first(lambda each: panel.event_line(each) == line)

    def _go_to_first(self, is_it: Callable[[Event], bool]) -> None:
        for event in self._recording.events:
            if is_it(event):
                return self.go_to(event.time_s)

    def _view(self, client: viser.ClientHandle, view: str) -> None:
        self._views[client.client_id] = view
        with client.atomic():
            client.camera.position, client.camera.look_at = self._camera(view)

    def _camera(self, view: str) -> tuple[FloatArray, FloatArray]:
        """Where the camera is, and what it looks at."""
        if view == "overview":  # all of the map, from the south-west
            return np.array([-40.0, -76.0, 50.0]), np.array([2.0, -9.0, 0.0])
        if view == "top":
            return np.array([0.0, -0.5, 108.0]), np.zeros(3)
        flight = self._recording.flight
        heading_rad = flight.heading_rad(flight.row_at(self._time_s))
        ahead = np.array([math.sin(heading_rad), math.cos(heading_rad), 0.0])
        return self._here - 11.0 * ahead + [0.0, 0.0, 5.5], self._here + 4.0 * ahead

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
        samples = 0 if self.replica is None else len(self.replica.samples)
        if self._shown != (self._time_s, samples, behind):
            self._shown = self._time_s, samples, behind
            self._show(self._scene, behind)
        charted = len(recording.flight.times_s), samples
        if now_s - self._charted_at_s >= _CHARTS_S and charted != self._charted:
            self._charted_at_s, self._charted = now_s, charted
            charts = panel.charts_of(recording, self.replica)
            for chart, data in zip(self._charts, charts, strict=True):
                chart.scales, chart.data = _scales(data), data

    def _show_ground(self, scene: Scene, now_s: float) -> str:
        """Show what was known of the ground; what of that is not up to date."""
        replica, flight = self.replica, self._recording.flight
        if replica is None:
            return ""
        number = replica.number_at(flight, self._time_s)
        if number not in (-1, self._ground_shown) and now_s - self._ground_at_s >= _GROUND_S:
            self._ground_at_s, self._ground_shown = now_s, number
            scene.show_ground(replica.ground(number))
        if replica.ended is not None:
            return f"ground: {replica.ended}"
        reached_s = flight.time_of(*replica.now)
        is_behind = reached_s + 1.0 < self._time_s
        return f"the ground is read until {clock_text(reached_s)}" if is_behind else ""

    def _show(self, scene: Scene, behind: str) -> None:
        recording, before = self._recording, self._here
        self._here = scene.show(self._time_s)
        for client in self._server.get_clients().values():
            if self._views.get(client.client_id) == "follow":
                client.camera.position = client.camera.position + (self._here - before)
        self._status.content = panel.status_html(
            recording, self.replica, self._time_s, behind, scene.area.stretch
        )
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

"""The pictures that README opens with, from a recorded flight: the whole of it, and how it went."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from companion.mission.journal import ScanAsked
from companion.replay.actions import flown_mission
from companion.replay.feed import outputs
from companion.replay.reporting import facts_of
from companion.views import figure as views
from companion.views.figure import FlightFigure, TerrainPicture
from companion.views.report_facts import FlightFacts
from companion.views.report_figures import flight_figure
from companion.world.known_map import KnownMap

FRAMES, FRAME_MS, STILL_MS = 80, 90, 2500
SIZE_IN, DPI, COLOURS = (9.2, 4.6), 100, 200
SCAN_SHOWN_S = 40.0
VEHICLE = {"ls": "", "marker": "o", "ms": 9, "mfc": "#d55e00", "mec": "white", "mew": 1.5}


def main(run_dir: Path, to: Path) -> None:
    """Write flight.png and flight.gif into a folder."""
    facts = facts_of(run_dir)
    whole = flight_figure(facts)
    assert whole is not None
    name, length_km = facts.flight.mission.name, facts.flown_m / 1e3
    views.draw(
        replace(whole, title=f"{name}: {length_km:.0f} km, as it was flown"), to / "flight.png"
    )
    maps = list(grown_maps(run_dir))
    begin = facts.flight.planned[0].begun_s or 0.0
    moments = np.linspace(begin, facts.times_s[-1], FRAMES)
    frames = [frame(facts, whole, maps, float(moment)) for moment in moments]
    palette = frames[-1].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=2)
    drawn = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    times_ms = [FRAME_MS] * (FRAMES - 1) + [STILL_MS]
    drawn[0].save(
        to / "flight.gif", save_all=True, append_images=drawn[1:], duration=times_ms, loop=0
    )


def grown_maps(run_dir: Path) -> Iterator[tuple[float, KnownMap]]:
    """When the known map has grown, and how it is then."""
    known: KnownMap | None = None
    for _, session, _ in outputs(run_dir, flown_mission(run_dir)):
        if session.state.flight.known is not known:
            known = session.state.flight.known
            yield session.now_s, known


def frame(
    facts: FlightFacts, whole: FlightFigure, maps: list[tuple[float, KnownMap]], now_s: float
) -> Image.Image:
    """The flight as it stood at a time."""
    known = [known for at_s, known in maps if at_s <= now_s][-1]
    flown = facts.track_nea_m[facts.times_s <= now_s]
    begun = sum((each.begun_s or np.inf) <= now_s for each in facts.flight.planned)
    scans = [e for _, _, e in facts.flight.entries if isinstance(e, ScanAsked) and e.t_s <= now_s]
    shown = replace(
        whole,
        terrain=TerrainPicture.of(known),
        legs_nea_m=whole.legs_nea_m[:begun],
        scans_nea_m=tuple(scan.centre_nea_m for scan in scans),
        track_nea_m=flown,
        altitudes_shown_m=whole.altitudes_m,
    )
    canvas = Figure(figsize=SIZE_IN, dpi=DPI)
    drawn = FigureCanvasAgg(canvas)
    oblique = canvas.add_axes((-0.08, -0.12, 0.70, 1.18), projection="3d", label="oblique")
    views.draw_oblique(oblique, shown, azimuth_deg=-60)
    oblique.set_axis_off()
    plan = canvas.add_axes((0.645, 0.11, 0.345, 0.72), label="plan")
    views.draw_plan(plan, shown)
    plan.child_axes[0].remove()  # the scale of heights
    plan.set(title="", xlabel="km", ylabel="")
    here = flown[-1] / 1e3
    oblique.plot(*here[[1, 0, 2]], **VEHICLE, zorder=9)
    plan.plot(here[1], here[0], **VEHICLE, zorder=9)
    if scans and now_s - scans[-1].t_s < SCAN_SHOWN_S:
        north, east, _ = (value / 1e3 for value in scans[-1].centre_nea_m)
        range_km = facts.flight.mission.task.settings.scan_range_m / 1e3
        style = {"fill": False, "ec": views.PATH, "lw": 1.5, "ls": "--"}
        plan.add_patch(Circle((east, north), range_km, **style))
    canvas.text(
        0.02, 0.93, "What the vehicle knows, and where it flies", fontsize=14, weight="bold"
    )
    past_km = float(np.hypot(*np.diff(flown[:, :2], axis=0).T).sum()) / 1e3
    past_s = now_s - (facts.flight.planned[0].begun_s or 0.0)
    said = f"{past_s:4.0f} s, {past_km:3.0f} km, subpath {begun}"
    canvas.text(0.98, 0.93, said, fontsize=12, ha="right")
    drawn.draw()
    return Image.fromarray(np.asarray(drawn.buffer_rgba())[..., :3])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

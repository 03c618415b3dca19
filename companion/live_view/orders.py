"""The buttons that matter: for who has the token, each behind a question."""

import hmac
import html
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, final

import viser

from companion.geodesy import LocalFrame
from companion.live_view import control
from companion.live_view.control import GroundStation
from companion.mavlink.dialect import Message, wire
from companion.views.words import metres

Place = tuple[float, float]
PlaceOf = Callable[[Sequence[float], Sequence[float]], Place | None]
"""North and east of where a ray meets the ground."""
_RADIUS_M: Final = 500.0
_PLAIN: Final = (
    ("go", "Take off, if it is ready?", partial(control.command, wire.MAV_CMD_MISSION_START)),
    ("hold", "Stop, and hold?", partial(control.command, wire.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)),
    (
        "continue",
        "Continue to the target?",
        partial(control.command, wire.MAV_CMD_DO_PAUSE_CONTINUE, 1.0),
    ),
    (
        "return",
        "Return along the flown path?",
        partial(control.command, wire.MAV_CMD_NAV_RETURN_TO_LAUNCH),
    ),
    ("land", "Land where it is?", partial(control.command, wire.MAV_CMD_NAV_LAND)),
)


@final
class Orders:
    """Gives orders for clients that know the token."""

    def __init__(
        self,
        station: GroundStation,
        frame: LocalFrame,
        token: str,
        is_trusted: Callable[[int], bool],
    ) -> None:
        """frame: of the mission; is_trusted: whether a client has come with the token."""
        self._station, self._frame, self._token = station, frame, token
        self._is_trusted = is_trusted

    def offer(self, client: viser.ClientHandle, place_of: PlaceOf) -> None:
        """Put the buttons on one client's page, or the question for the token."""
        self._offer(client, place_of, trusted=self._is_trusted(client.client_id))

    def _offer(self, client: viser.ClientHandle, place_of: PlaceOf, *, trusted: bool) -> None:
        folder = client.gui.add_folder("control", order=-1.0)
        with folder:
            says = client.gui.add_html("")
            if trusted:
                self._add_buttons(client, says, place_of)
                return
            asked = client.gui.add_text("token", "", hint="The terminal has printed it.")
            button = client.gui.add_button("unlock")

        def unlock(_: Any) -> None:
            if is_token(asked.value, self._token):
                folder.remove()
                self._offer(client, place_of, trusted=True)
            else:
                why = "this is not the token that the terminal has printed"
                _tell(says, "refused", why, is_good=False)

        button.on_click(unlock)

    def _add_buttons(
        self, client: viser.ClientHandle, says: viser.GuiHtmlHandle, place_of: PlaceOf
    ) -> None:
        for label, question, make in _PLAIN:
            button = client.gui.add_button(label)
            button.on_click(partial(self._ask, client, says, label, question, make))
        target = client.gui.add_button("new target", hint="Then click on the ground.")
        radius = client.gui.add_number("radius, m", _RADIUS_M, min=1.0, step=1.0)
        keep_out = client.gui.add_button("keep-out", hint="Then click on its centre.")
        lift = client.gui.add_button("lift keep-out", hint="Then click on the ground in it.")

        go_there = partial(control.go_to, frame=self._frame)
        circle_there = partial(control.keep_out, frame=self._frame)

        def ask_for_keep_out(_: Any) -> None:
            radius_m = float(radius.value)
            of, make = f" of radius {metres(radius_m)}", partial(circle_there, radius_m=radius_m)
            pick("keep-out", of, make)

        lift_there = partial(circle_there, radius_m=0.0)
        pick = partial(self._pick, client, says, place_of)
        target.on_click(lambda _: pick("new target", "", go_there))
        keep_out.on_click(ask_for_keep_out)
        lift.on_click(lambda _: pick("lift keep-out", "", lift_there))

    def _ask(
        self,
        client: viser.ClientHandle,
        says: viser.GuiHtmlHandle,
        label: str,
        question: str,
        make: Callable[[], Message],
        _event: Any = None,
    ) -> None:
        """Ask first; then order, and show the answer."""
        with client.gui.add_modal(question) as modal:
            yes, no = client.gui.add_button(f"yes, {label}"), client.gui.add_button("no")
        no.on_click(lambda _: modal.close())

        def order(_: Any) -> None:
            modal.close()
            _tell(says, label, "ordered", is_good=True)
            answer = self._station.order(make)
            _tell(says, label, answer, is_good=answer.startswith("accepted"))

        yes.on_click(order)

    def _pick(
        self,
        client: viser.ClientHandle,
        says: viser.GuiHtmlHandle,
        place_of: PlaceOf,
        label: str,
        of: str,
        make: Callable[[Place], Message],
    ) -> None:
        """Give an order with the place of the next click; of: what else there is to ask about."""

        def picked(event: viser.SceneClickEvent) -> None:
            client.scene.remove_click_callback()
            place = place_of(event.ray_origin, event.ray_direction)
            if place is None:
                _tell(says, label, "there is no ground there", is_good=False)
                return
            where = f"{metres(place[0])} north, {metres(place[1])} east"
            question = f"{label.capitalize()}{of}: {where}?"
            self._ask(client, says, label, question, lambda: make(place))

        client.scene.remove_click_callback()  # of a place that was wanted before
        client.scene.on_click()(picked)
        _tell(says, label, "click on the ground", is_good=True)


def is_token(given: str, token: str) -> bool:
    """Compared so that the time it takes tells nothing."""
    return hmac.compare_digest(given.strip().encode(), token.encode())


def _tell(says: viser.GuiHtmlHandle, title: str, text: str, *, is_good: bool) -> None:
    """In the panel: what lies over the scene takes the clicks that are meant for the ground."""
    how = "" if is_good else " class=r"
    said = f"<b>{html.escape(title)}</b>: <span{how}>{html.escape(text)}</span>"
    says.content = f"<div class=fl role=status>{said}</div>"

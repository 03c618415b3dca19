"""What goes wrong is one line and an exit code, and what a service makes of that."""

import io
import re
import sys
from pathlib import Path

import pytest

import companion
from companion import cli
from companion.errors import FlightFailed, FlightInterrupted, InputError

IN_FLIGHT = Path(__file__).parents[1] / "docs" / "in-flight.md"
SERVICE = Path(__file__).parents[1] / "deploy" / "companion.service"
STOPPED, CRASHED = 130, 70


def test_an_input_error_is_field_value_rule_and_remedy_in_one_line_of_printable_text() -> None:
    error = InputError("planner.evaluations", 3, "it must be 60 or more", "Raise it.")
    assert str(error) == "planner.evaluations = 3: it must be 60 or more. Raise it."
    for value in ("two\nlines", float("nan"), None, {"a": "b\r\n"}):
        assert len(str(InputError("field", value, "rule", "Remedy.")).splitlines()) == 1
    name = b"fl\xe9.plan".decode("utf-8", "surrogateescape")
    said = str(InputError(name, Path("n", name), f"{name} is", f"Move {name}."))
    assert said.count(r"fl\udce9.plan") == 4
    assert said.isascii()


def test_the_service_starts_again_what_may_go_on_and_nothing_that_was_decided() -> None:
    text = SERVICE.read_text(encoding="utf-8")
    [prevented] = re.findall(r"^RestartPreventExitStatus=(.*)$", text, re.MULTILINE)
    decided = {FlightFailed.exit_code, InputError.exit_code, STOPPED}
    assert set(map(int, prevented.split())) == decided == {1, 2, 130}
    assert not decided & {FlightInterrupted.exit_code, CRASHED}
    assert "Restart=on-failure" in text
    assert "StartLimitIntervalSec=0" in text  # a vehicle in the air is not given up for trying
    page = IN_FLIGHT.read_text(encoding="utf-8")
    for code in (0, *decided, FlightInterrupted.exit_code, CRASHED):
        assert f"| {code} |" in page


@pytest.mark.parametrize(
    ("part", "raised", "code"),
    [("app", ZeroDivisionError("made up"), CRASHED), ("main", KeyboardInterrupt(), STOPPED)],
)
def test_a_crash_is_a_traceback_with_a_code_of_its_own_and_ctrl_c_is_none(
    part: str,
    raised: BaseException,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Also while the program is loaded."""

    def breaks(**_: object) -> None:
        raise raised

    monkeypatch.setattr(cli, part, breaks)
    with pytest.raises(SystemExit) as ended:
        companion.main()
    assert ended.value.code == code
    assert ("ZeroDivisionError: made up" in capsys.readouterr().err) == (code == CRASHED)


def test_closed_streams_and_poor_encodings_are_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdin", None)
    monkeypatch.setattr(sys, "stderr", None)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding="ascii"))
    monkeypatch.setattr(sys, "argv", ["companion", "check", "nowhere"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == InputError.exit_code
    with sys.stdin, sys.stderr:
        assert sys.stdin.read() == ""
    sys.stdout.write("run folder: Übung")
    sys.stdout.flush()
    assert shown.getvalue() == rb"run folder: \xdcbung"

import io
import re
import sys
from pathlib import Path

import pytest

import companion
from companion import cli
from companion.errors import CompanionError, FlightFailed, FlightInterrupted, InputError

CONNECTING = Path(__file__).parents[1] / "docs" / "connecting.md"
SERVICE = Path(__file__).parents[1] / "deploy" / "companion.service"
STOPPED, CRASHED = 130, 70


def test_an_input_error_is_field_value_rule_and_remedy_in_one_line() -> None:
    error = InputError("planner.evaluations", 3, "it must be 60 or more", "Raise it.")
    assert str(error) == "planner.evaluations = 3: it must be 60 or more. Raise it."
    assert error.field == "planner.evaluations"


@pytest.mark.parametrize("value", ["two\nlines", float("nan"), None, ["x"], {"a": "b\r\n"}])
def test_whatever_the_value_is_the_line_is_one(value: object) -> None:
    assert len(str(InputError("field", value, "rule", "Remedy.")).splitlines()) == 1


def test_a_file_name_that_is_no_utf_8_is_told_in_ascii() -> None:
    name = b"fl\xe9.plan".decode("utf-8", "surrogateescape")
    said = str(InputError(name, Path("n", name), f"{name} is", f"Move {name}."))
    assert said.count(r"fl\udce9.plan") == 4
    assert said.isascii()


def test_a_failed_flight_is_its_reason_and_its_remedy() -> None:
    assert str(FlightFailed("the vehicle fell silent", "Check the link.")) == (
        "the vehicle fell silent. Check the link."
    )


def test_input_is_exit_code_2_and_flight_1_and_both_are_the_companions() -> None:
    assert (InputError.exit_code, FlightFailed.exit_code) == (2, 1)
    assert issubclass(InputError, CompanionError)
    assert issubclass(FlightFailed, CompanionError)


def test_the_service_starts_again_what_may_go_on_and_nothing_that_was_decided() -> None:
    text = SERVICE.read_text(encoding="utf-8")
    [prevented] = re.findall(r"^RestartPreventExitStatus=(.*)$", text, re.MULTILINE)
    decided = {FlightFailed.exit_code, InputError.exit_code, STOPPED}
    assert set(map(int, prevented.split())) == decided
    assert not decided & {FlightInterrupted.exit_code, CRASHED}
    assert "Restart=on-failure" in text
    assert "StartLimitIntervalSec=0" in text  # a vehicle in the air is not given up for trying
    page = CONNECTING.read_text(encoding="utf-8")
    for code in (0, *decided, FlightInterrupted.exit_code, CRASHED):
        assert f"| {code} |" in page


def test_a_crash_is_a_traceback_and_an_exit_code_that_no_decision_has(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def crash(**_: object) -> None:
        raise ZeroDivisionError("made up")

    monkeypatch.setattr(cli, "app", crash)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == CRASHED
    assert "ZeroDivisionError: made up" in capsys.readouterr().err


def test_ctrl_c_while_the_program_is_loaded_is_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "main", interrupted)
    with pytest.raises(SystemExit) as ended:
        companion.main()
    assert ended.value.code == STOPPED


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

import pytest

from companion.errors import CompanionError, FlightFailed, InputError


def test_an_input_error_is_field_value_rule_and_remedy_in_one_line() -> None:
    error = InputError("planner.evaluations", 3, "it must be 60 or more", "Raise it.")
    assert str(error) == "planner.evaluations = 3: it must be 60 or more. Raise it."
    assert error.field == "planner.evaluations"


@pytest.mark.parametrize("value", ["two\nlines", float("nan"), None, ["x"], {"a": "b\r\n"}])
def test_whatever_the_value_is_the_line_is_one(value: object) -> None:
    assert len(str(InputError("field", value, "rule", "Remedy.")).splitlines()) == 1


def test_a_failed_flight_is_its_reason_and_its_remedy() -> None:
    assert str(FlightFailed("the vehicle fell silent", "Check the link.")) == (
        "the vehicle fell silent. Check the link."
    )


def test_input_is_exit_code_2_and_flight_1_and_both_are_the_companions() -> None:
    assert (InputError.exit_code, FlightFailed.exit_code) == (2, 1)
    assert issubclass(InputError, CompanionError)
    assert issubclass(FlightFailed, CompanionError)

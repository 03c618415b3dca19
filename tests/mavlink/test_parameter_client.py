"""Parameters over the wire, against the simulator of all four autopilots and recorded flights."""

import math
import struct
from typing import Any

import pytest
from held import FOUR, Held, recorded
from hypothesis import given
from hypothesis import strategies as st
from wires import over_the_wire

from companion.mavlink.autopilots import ALL
from companion.mavlink.dialect import wire
from companion.mavlink.parameter_client import ANSWER_S, ParameterClient, decoded, encoded

GROUPS = {way: [rule.names for rule in each.rules] for way, each in zip(FOUR, ALL, strict=True)}
ALL_FOUR = pytest.mark.parametrize("way", FOUR, ids=" ".join)
READ = "PARAM_REQUEST_READ"


def client_of(firmware: str, *groups: tuple[str, ...]) -> ParameterClient:
    return ParameterClient(1, groups, bytewise=firmware == "px4")


def told(name: str, value: float, kind: int = 9, source: tuple[int, int] = (1, 1)) -> Any:
    message = wire.MAVLink_param_value_message(name.encode(), value, kind, 1, 0)
    return over_the_wire(message, source)


def asked(messages: list[Any]) -> list[tuple[str, str]]:
    return [(message.get_type(), message.param_id) for message in messages]


SETS = {
    "ardupilot": {"FENCE_TYPE": 3.0, "FENCE_RADIUS": 212.5},
    "px4": {"COM_OBL_RC_ACT": 5.0, "COM_OF_LOSS_T": 0.7, "COM_RCL_EXCEPT": -1.0},
}


@pytest.mark.sample(5)
@ALL_FOUR
@pytest.mark.parametrize(
    ("fault", "within_s"),
    [
        ("", 5.0),
        # five tries for what it has not, each once it was heard since: its heartbeat, once a second
        ("link_loss 25 %", 15.0),
        ("link_delay 700 ms", 15.0),
        ("link_duplication 50 %", 15.0),
        ("for 19 s: link_off", 30.0),
    ],
)
def test_what_there_is_is_read_and_set_and_read_back(way: Any, fault: str, within_s: float) -> None:
    held, client = Held(*way), client_of(way[0], *GROUPS[way], *((name,) for name in SETS[way[0]]))
    if fault:
        held.simulation.add_fault(fault)
    assert held.run(60.0, client, lambda: client.is_done) < within_s
    there = held.simulation.parameters
    known = {name for group in GROUPS[way] for name in group if name in there}
    assert client.values == pytest.approx({n: there[n] for n in known | {*SETS[way[0]]}}, rel=1e-6)
    times_s = [at_s for at_s, _ in held.sent if at_s < 20.0 and "off" in fault]
    for at_s in times_s:  # a silent link is not flooded
        assert sum(at_s <= other < at_s + ANSWER_S - 0.02 for other in times_s) <= 6
    for name, value in SETS[way[0]].items():
        client.set(name, value)
    held.run(30.0, client, lambda: client.is_done)
    assert (client.is_done, client.failed_sets) == (True, {})
    for values in (client.values, held.simulation.parameters):
        assert {name: values[name] for name in SETS[way[0]]} == pytest.approx(SETS[way[0]])


KEPT_OTHERWISE = (
    ("NAV_GPSF_LT", 9000.0, "it was told 9000 and says 3600"),
    ("COM_OBL_RC_ACT", 5e12, "5e+12 does not fit into its type"),
)


def test_a_value_that_the_vehicle_keeps_otherwise_is_a_failure() -> None:
    held, client = Held("px4", "plane"), client_of("px4", *((row[0],) for row in KEPT_OTHERWISE))
    held.run(20.0, client, lambda: client.is_done)
    for name, value, _ in KEPT_OTHERWISE:
        client.set(name, value)
    held.run(20.0, client, lambda: client.is_done)
    assert client.is_done
    assert client.failed_sets == {name: why for name, _, why in KEPT_OTHERWISE}


RECORDED = {
    "px4-offboard-8mps": {"COM_OBL_RC_ACT": 5.0, "CAL_ACC0_ROT": -1.0, "CAL_BARO0_ID": 6620172.0},
    "px4-offboard-short": {"SYS_AUTOSTART": 10040.0, "COM_OBL_RC_ACT": 5.0},
    "px4-fixedwing-offboard": {"FW_AIRSPD_TRIM": 15.0, "NAV_LOITER_RAD": 80.0},
    "arducopter-guided-10mps": {"ANGLE_MAX": 4500.0, "COMPASS_DEV_ID": 97539.0},
}


@pytest.mark.parametrize("log", RECORDED)
def test_reads_the_values_of_recorded_flights(log: str) -> None:
    client = client_of(log[:3], *((name,) for name in RECORDED[log]))
    for at_s, message in recorded(f"{log}.tlog"):
        client.on_message(message, at_s)
    assert client.values == RECORDED[log]


WHOLE = {1: (0, 255), 2: (-128, 127), 3: (0, 65535), 4: (-(2**15), 2**15 - 1)}
WHOLE |= {5: (0, 2**32 - 1), 6: (-(2**31), 2**31 - 1)}


@given(data=st.data(), kind=st.sampled_from([*WHOLE, 9]), bytewise=st.booleans())
def test_numbers_survive_the_wire(data: st.DataObject, kind: int, bytewise: bool) -> None:
    low, high = WHOLE.get(kind, (0, 0))
    most = high if bytewise else 2**24  # a float holds no more exactly
    floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
    value = float(data.draw(floats if kind == 9 else st.integers(max(low, -most), min(high, most))))
    sent = encoded(value, kind, bytewise=bytewise)
    message = told("NAME", 0.0 if math.isnan(sent) else sent, kind)
    if math.isnan(sent):  # a float on the way would change its bits, the bytes do not
        frame = bytearray(message.get_msgbuf())
        frame[10:14] = struct.pack("<i", int(value))
        message._msgbuf = frame
    assert decoded(message, bytewise=bytewise) == value


def test_a_parameter_error_says_at_once_that_there_is_none() -> None:
    client = client_of("ardupilot", ("A",), ("B",))
    client.on_time(0.0)
    missing, read_only = wire.MAV_PARAM_ERROR_DOES_NOT_EXIST, wire.MAV_PARAM_ERROR_READ_ONLY
    for name, why in ((b"A", missing), (b"B", read_only)):
        error = wire.MAVLink_param_error_message(1, 195, name, -1, why)
        client.on_message(over_the_wire(error), 0.1)
        assert client.waiting == ("B",)


@pytest.mark.parametrize("source", [(2, 1), (1, 100), (255, 190), (1, 1)])
def test_only_the_autopilot_tells_and_one_of_two_names_is_enough(source: tuple[int, int]) -> None:
    client = client_of("ardupilot", ("MAV_SYSID", "SYSID_THISMAV"))
    assert asked(client.on_time(0.0)) == [(READ, "MAV_SYSID"), (READ, "SYSID_THISMAV")]
    assert client.on_message(told("SYSID_THISMAV", 1.0, 4, source), 0.1) == []
    assert client.values == ({"SYSID_THISMAV": 1.0} if source == (1, 1) else {})
    assert client.is_done == (source == (1, 1))


def test_a_value_that_comes_late_counts() -> None:
    client = client_of("ardupilot", ("A",), ("B",))
    client.on_message(told("B", 1.0), 0.0)
    for step in range(100):
        client.on_time(0.1 * step)
        client.on_message(told("OTHER", 1.0), 0.1 * step + 0.05)
    assert client.is_done
    version = client.version
    client.on_message(told("A", 5.0), 20.0)
    client.on_message(told("B", 7.0), 21.0)  # somebody else has set it
    assert client.values == {"A": 5.0, "B": 7.0}
    assert client.version == version + 2
    client.restart()  # after a reboot
    assert (client.is_done, client.values) == (False, {})
    assert asked(client.on_time(22.0)) == [(READ, "A"), (READ, "B")]

"""The key of a signed link, and the time stamp beside it that never goes back."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.mavlink.dialect import codec, wire
from companion.mavlink.signing import TICKS_PER_S, key_of, timestamp_of
from companion.runtime.keys import SAVE_EVERY_S, SigningKey, first_timestamp

CLOCK_S = 1_790_000_000.0
PHRASE = "correct horse battery staple"
BEAT = wire.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec(1))


def key_file(folder: Path, content: bytes = PHRASE.encode(), mode: int = 0o600) -> Path:
    path = folder / "vehicle.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("ending", ["", "\n", "\r\n"])
@pytest.mark.parametrize("text", [PHRASE, "9f" * 32, "Zündschlüssel "])
def test_the_file_holds_a_phrase_or_hexadecimals(tmp_path: Path, text: str, ending: str) -> None:
    """By whose key pymavlink believes what is signed."""
    key = SigningKey(key_file(tmp_path, (text + ending).encode()), lambda: CLOCK_S)
    other = wire.MAVLink(None)
    other.signing.secret_key = key_of(text)
    assert other.check_signature(bytearray(key.signing.sign(BEAT)), 1, 195)


REFUSED = {
    "others may read or change it.*chmod 600 .*vehicle.key": [
        (PHRASE.encode(), mode, "") for mode in (0o644, 0o640, 0o604, 0o620, 0o602, 0o660)
    ],
    "a key is one line of text": [
        (text, 0o600, "") for text in (b"", b"\n", b"  \n", b"\xff\xfe\n", b"a\nb\n", b"k" * 5000)
    ],
    r"vehicle\.key\.time.*Delete it": [
        (PHRASE.encode(), 0o600, stamp)
        for stamp in (" ", "12", "a b", "1 2 3", "-1 5", "1 \0", f"{2**48} 5", "9" * 9999)
    ],
}


@pytest.mark.parametrize("why", REFUSED)
def test_a_file_that_others_can_read_or_that_holds_no_key_or_time_is_refused_and_not_shown(
    tmp_path: Path, why: str
) -> None:
    for content, mode, stamp in REFUSED[why]:
        if stamp:
            (tmp_path / "vehicle.key.time").write_text(stamp)
        with pytest.raises(InputError, match=why) as caught:
            SigningKey(key_file(tmp_path, content, mode))
        assert "kkk" not in str(caught.value)
        assert "\n" not in str(caught.value)
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            SigningKey(path)


def test_the_time_is_kept_for_us_alone_and_a_disk_that_fails_ends_no_flight(tmp_path: Path) -> None:
    key, kept = SigningKey(path := key_file(tmp_path), lambda: CLOCK_S), f"{path}.time"
    first = timestamp_of(CLOCK_S)
    assert key.signing.timestamp == first
    blocked = Path(f"{kept}.{os.getpid()}")
    blocked.mkdir()
    with pytest.raises(InputError, match="cannot be kept"):
        SigningKey(path)  # refused at the start
    for _ in range(7):
        key.signing.sign(BEAT)
    key.save()
    assert Path(kept).read_text().split()[0] == str(first)
    blocked.rmdir()
    key.save()
    assert Path(kept).stat().st_mode & 0o077 == 0
    assert sorted(each.name for each in tmp_path.iterdir()) == ["vehicle.key", "vehicle.key.time"]
    assert Path(kept).read_text().split()[0] == str(first + 7)


@given(
    ahead_s=st.floats(0, 1e6),
    ran_s=st.floats(0, SAVE_EVERY_S),
    jump_s=st.floats(-1e9, 1e9),
    down_s=st.floats(0, 1e6),
)
def test_a_new_process_is_above_all_that_the_last_one_used_and_hardly_farther_ahead_of_the_clock(
    ahead_s: float, ran_s: float, jump_s: float, down_s: float
) -> None:
    """Killed up to SAVE_EVERY_S after it kept its time, on a clock that may jump back.

    Who runs ahead takes the vehicle along, and locks out a ground station with a true clock.
    """
    kept = timestamp_of(CLOCK_S + ahead_s), CLOCK_S
    used = kept[0] + round(ran_s * TICKS_PER_S)
    clock_s = CLOCK_S + ran_s + down_s + min(jump_s, 0.0)
    first, now = first_timestamp(clock_s, kept), timestamp_of(clock_s)
    went_back_unseen = clock_s >= CLOCK_S and jump_s < 0.0
    if not went_back_unseen:
        assert first > used
    assert first <= max(now, kept[0] + 61 * TICKS_PER_S)
    if clock_s >= CLOCK_S:
        assert first <= now + (ahead_s + 1.01) * TICKS_PER_S

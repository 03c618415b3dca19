"""Texts as a ground station puts them together again."""

import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.mavlink.dialect import codec
from companion.mavlink.statustext import StatusTexts, to_ascii


def sent(texts: StatusTexts, now_s: float) -> list[tuple[int, bytes, int, int]]:
    """Severity, text, id and chunk, from the bytes: a decoded text hides which zeros it had."""
    payloads = [message.pack(codec(7))[10:-2].ljust(54, b"\0") for message in texts.due(now_s)]
    return [struct.unpack("<B50sHB", payload) for payload in payloads]


def put_together(chunks: list[tuple[int, bytes, int, int]]) -> str:
    """Common.xml: a zero in a chunk means that it is the last; id 0 is a text of one message."""
    whole = b""
    for place, (_, text, number, chunk) in enumerate(chunks):
        last = place == len(chunks) - 1
        assert chunk == place
        assert (b"\0" in text) == last or (number == 0 and len(chunks) == 1)
        whole += text.split(b"\0")[0]
    assert len({number for _, _, number, _ in chunks}) <= 1
    return whole.decode("ascii")


LENGTHS = (2, 49, 50, 51, 99, 100, 101, 149, 150, 151, 199, 200, 300)
WORDS = [("abcdefghi " * 30)[: length - 1] + "x" for length in LENGTHS]


@given(st.lists(st.tuples(st.text(max_size=400), st.booleans()), max_size=4))
@example([(words, True) for words in WORDS])
@example([(words, False) for words in WORDS])
def test_what_is_said_comes_whole_in_ascii_in_few_chunks(said: list[tuple[str, bool]]) -> None:
    """On one line, as far as a warning may be long; what is no warning is one message."""
    texts, numbers = StatusTexts(), list[int]()
    for at_s, (text, warning) in enumerate(said):
        texts.add(text, 10.0 * at_s, warning=warning)
        chunks, plain = sent(texts, 10.0 * at_s), to_ascii(text)
        whole, longest = put_together(chunks), 199 if warning else 50
        assert all(32 <= ord(letter) < 127 for letter in whole)
        assert plain.startswith(whole.removesuffix(".."))
        assert (whole == plain) == (len(plain) <= longest)
        assert len(whole) <= longest
        in_chunks = len(whole) > 50
        assert len(chunks) == (len(whole) // 50 + 1 if in_chunks else 1)
        assert {severity for severity, *_ in chunks} == {4 if warning else 6}  # WARNING, INFO
        numbers += [chunks[0][2]] if in_chunks else []
        assert sent(texts, 10.0 * at_s + 6.0) == []
    assert len({*numbers}) == len(numbers)  # chunks of two do not mix
    assert to_ascii("≥ 5 m,\n3 m/s² – Zürich") == ">= 5 m, 3 m/s2 - Zurich"


@given(
    st.lists(
        st.tuples(st.floats(0.0, 1.5), st.integers(0, 200), st.booleans()), min_size=1, max_size=60
    )
)
@example([(1.1497576567241352, 148, True), (0.0, 0, False), (1.0, 0, False)])  # 4 s, rounded
def test_never_more_than_one_message_a_second(said: list[tuple[float, int, bool]]) -> None:
    """One in chunks keeps the next waiting for as long."""
    texts, now_s, times_s = StatusTexts(), 0.0, list[float]()
    for wait_s, length, warning in said:
        now_s += wait_s
        texts.add(f"{len(times_s)} " + "x" * length, now_s, warning=warning)
        times_s += [now_s] * len(sent(texts, now_s))
    for until_s in times_s:
        assert sum(at_s < until_s for at_s in times_s) <= until_s + 1.0


STORIES: dict[str, Any] = {  # at what time what is said ("!": a warning; "kind="), what is heard
    "warnings first": [(0.0, "a, b, !c, !d", "c"), (1.0, "", "d"), (2.0, "", "a"), (3.0, "", "b")],
    "of a kind the newest": [
        *((0.0, "first", "first"), (0.5, "margin=0 m, margin=4 m, other", "")),
        *((1.0, "", "4 m"), (2.0, "", "other"), (3.0, "", "")),
    ],
    "not what has changed back": [
        *((10.0, "phase=flying", "flying"), (10.2, "!phase=holding", "")),
        *((10.4, "phase=flying", ""), (11.0, "", "")),
    ],
    "not the same for 5 s": [(0.0, "!out", "out"), (4.9, "!out", ""), (6.0, "!out", "out")],
    "a flood": [(4.0, ", ".join(f"text {n}" for n in range(1000)) + ", !matters", "matters")],
    "no old news, but old warnings, whatever the clock": [
        *((1000.0, "before", "before"), (1.0, "after, news, !warning", "warning")),
        *((60.0, "", ""), (61.0, "", "")),
    ],
}


@pytest.mark.parametrize("story", STORIES)
def test_what_is_said_when(story: str) -> None:
    texts = StatusTexts()
    for at_s, said, heard in STORIES[story]:
        for each in said.split(", ") if said else ():
            kind, _, text = each.removeprefix("!").rpartition("=")
            texts.add(text, at_s, warning=each[0] == "!", kind=kind)
        assert put_together(sent(texts, at_s)) == heard, at_s
        assert len(texts._waiting) < 20  # memory is bounded

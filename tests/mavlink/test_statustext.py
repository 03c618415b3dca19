"""Texts as a ground station puts them together again."""

import struct
from typing import NamedTuple

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.mavlink.dialect import codec
from companion.mavlink.statustext import StatusTexts, to_ascii

WARNING = 4


class Text(NamedTuple):
    """STATUSTEXT, one chunk."""

    severity: int
    text: bytes
    number: int
    chunk: int


def sent(texts: StatusTexts, now_s: float) -> list[Text]:
    """From the bytes: a decoded text does not show which zeros it had."""
    payloads = [message.pack(codec(7))[10:-2].ljust(54, b"\0") for message in texts.due(now_s)]
    return [Text(*struct.unpack("<B50sHB", payload)) for payload in payloads]


def put_together(chunks: list[Text]) -> str:
    """Common.xml: a zero in a chunk means that it is the last; id 0 is a text of one message."""
    whole = b""
    for number, chunk in enumerate(chunks):
        last = number == len(chunks) - 1
        assert chunk.chunk == number
        assert (b"\0" in chunk.text) == last or (chunk.number == 0 and len(chunks) == 1)
        whole += chunk.text.split(b"\0")[0]
    assert len({chunk.number for chunk in chunks}) <= 1
    return whole.decode("ascii")


def heard(texts: StatusTexts, *times_s: float) -> list[str]:
    """What is said at these times; "" for nothing."""
    return [put_together(sent(texts, at_s)) for at_s in times_s]


# --- one text


@pytest.mark.parametrize("length", [2, 49, 50, 51, 99, 100, 101, 149, 150, 151, 199])
def test_a_warning_comes_whole_in_as_few_chunks_as_it_takes(length: int) -> None:
    text, texts = ("abcdefghi " * 20)[: length - 1] + "x", StatusTexts()
    numbers = set()
    for at_s, words in ((3.0, text), (13.0, text.upper()), (23.0, text[::-1])):
        texts.add(words, at_s, warning=True)
        chunks = sent(texts, at_s)
        assert put_together(chunks) == words
        assert {chunk.severity for chunk in chunks} == {WARNING}
        assert (chunks[0].number == 0) == (length <= 50)
        numbers.add(chunks[0].number)
        assert sent(texts, at_s + 6.0) == []
    assert len(numbers) == 3 or length <= 50  # the chunks of two do not mix


def test_what_is_no_warning_is_shortened_at_a_word_and_signs_are_written_out() -> None:
    texts = StatusTexts()
    texts.add("replanned: 12.3 km to the target, clearance 45 m above the ridge", 3.0)
    assert heard(texts, 3.0) == ["replanned: 12.3 km to the target, clearance 45 m.."]
    assert to_ascii("clearance ≥ 5 m,\n3 m/s² – Zürich") == "clearance >= 5 m, 3 m/s2 - Zurich"


@given(st.text(max_size=400), st.booleans())
def test_whatever_is_said_is_sent_in_ascii_on_one_line(text: str, warning: bool) -> None:
    texts = StatusTexts()
    texts.add(text, 1.0, warning=warning)
    chunks = sent(texts, 1.0)
    assert 1 <= len(chunks) <= (5 if warning else 1)
    whole = put_together(chunks)
    assert all(32 <= ord(letter) < 127 for letter in whole)
    kept = whole.removesuffix("..")
    assert to_ascii(text).startswith(kept) or to_ascii(text) == whole


# --- one after the other


@given(
    st.lists(
        st.tuples(st.floats(0.0, 1.5), st.integers(0, 200), st.booleans()), min_size=1, max_size=60
    )
)
@example([(1.1497576567241352, 148, True), (0.0, 0, False), (1.0, 0, False)])  # 4 s, rounded
def test_never_more_than_one_message_a_second(said: list[tuple[float, int, bool]]) -> None:
    """On average from any text on: one in chunks keeps the next waiting for as long."""
    texts, now_s, times_s = StatusTexts(), 0.0, list[float]()
    for wait_s, length, warning in said:
        now_s += wait_s
        texts.add(f"{len(times_s)} " + "x" * length, now_s, warning=warning)
        times_s += [now_s] * len(sent(texts, now_s))
    for until_s in times_s:
        assert sum(at_s < until_s for at_s in times_s) <= until_s + 1.0


def test_warnings_are_said_first_and_then_in_order_and_a_flood_does_not_fill_the_memory() -> None:
    texts = StatusTexts()
    for text in "abcd":
        texts.add(text, 0.0, warning=text > "b")
    assert heard(texts, 0.0, 1.0, 2.0, 3.0) == ["c", "d", "a", "b"]
    for number in range(1000):
        texts.add(f"text {number}", 4.0)
    texts.add("the one that matters", 4.0, warning=True)
    assert heard(texts, 4.0) == ["the one that matters"]
    assert len(texts._waiting) < 20


def test_of_a_kind_the_newest_counts_and_what_changed_back_is_not_said() -> None:
    texts = StatusTexts()
    texts.add("first", 0.0)
    assert heard(texts, 0.0) == ["first"]
    for second in range(5):
        texts.add(f"margin {second} m", 0.1 * second, kind="margin")
    texts.add("other", 0.5)
    assert heard(texts, 1.0, 2.0, 3.0) == ["margin 4 m", "other", ""]
    texts.add("flying", 10.0, kind="phase")
    assert heard(texts, 10.0) == ["flying"]
    texts.add("holding", 10.2, warning=True, kind="phase")
    texts.add("flying", 10.4, kind="phase")
    assert heard(texts, 11.0) == [""]


def test_the_same_is_not_repeated_for_5_s() -> None:
    texts, times_s = StatusTexts(), list[float]()
    for at_s in (0.1 * tenth for tenth in range(121)):
        texts.add("target inside a keep-out", at_s, warning=True)
        times_s += [at_s] * len(sent(texts, at_s))
    assert times_s == pytest.approx([0.0, 5.0, 10.0], abs=0.11)


def test_old_news_are_not_said_but_old_warnings_are_whatever_the_clock() -> None:
    texts = StatusTexts()
    texts.add("before", 1000.0)
    assert heard(texts, 1000.0) == ["before"]
    texts.add("after", 1.0)
    texts.add("old news", 1.0)
    texts.add("old warning", 1.0, warning=True)
    assert heard(texts, 1.0, 60.0, 61.0) == ["old warning", "", ""]

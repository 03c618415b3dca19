"""Whoever prints never waits and never fails, whatever the reader does."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TextIO

import pytest

from companion.views.output import PatientOutput

LONG = "0123456789abcde\n" * 64  # 1 KiB


@pytest.fixture
def pipe() -> tuple[int, TextIO]:
    reader, writer = os.pipe()
    return reader, os.fdopen(writer, "w", encoding="utf-8")


def written(output: PatientOutput) -> None:
    """Wait until the reader has taken all."""
    deadline_s = time.monotonic() + 60.0
    while output.is_behind:
        assert time.monotonic() < deadline_s
        os.sched_yield()


def test_a_reader_gets_everything_in_its_order(pipe: tuple[int, TextIO]) -> None:
    reader, stream = pipe
    words = [f"{number} ä {LONG}" for number in range(500)]
    with ThreadPoolExecutor() as pool, os.fdopen(reader, encoding="utf-8") as file:
        found = pool.submit(file.read)
        with PatientOutput(stream) as output:
            for each in words:
                output.write(each)
            written(output)
        stream.close()
        assert found.result() == "".join(words)


def test_a_reader_that_does_not_read_holds_up_nobody_and_one_that_leaves_is_not_missed(
    pipe: tuple[int, TextIO],
) -> None:
    reader, stream = pipe
    with PatientOutput(stream) as output:
        for _ in range(5000):
            output.write(LONG)
        assert output.is_behind
        assert os.read(reader, 1 << 20).startswith(LONG.encode())
        os.close(reader)
        for _ in range(100):
            output.write(LONG)
        written(output)
    stream.close()

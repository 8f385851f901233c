"""Logs that were cut off or changed are read or refused in words, in bounded time and memory, with nothing printed."""

import time

import numpy as np
import pytest

from joulemap.model.errors import JoulemapError, RunsError, TooLargeError
from joulemap.model.runs.reader import parse_run
from joulemap.model.runs.table import TableLimits
from tests.fuzz.inputs import changed
from tests.reference import log_files as files

LIMITS = TableLimits(rows=1_000_000, columns=2_000, cells=20_000_000, text_mb=200.0)
WRITERS = {
    "bag": files.write_bag,
    "db3": files.write_db3,
    "mcap": files.write_mcap,
    "bin": files.write_dataflash,
    "tlog": files.write_tlog,
    "ulg": files.write_ulog,
    "fit": files.write_fit,
}


def _read_all(kind, folder, truncated, mutated, capfd):
    good = WRITERS[kind](folder / f"drive.{kind}", files.drive(20.0)).read_bytes()
    rng = np.random.default_rng(5)
    inputs = [good[: int(len(good) * (k + 0.5) / truncated)] for k in range(truncated)]
    inputs += [changed(rng, good, text=False) for _ in range(mutated)]
    said: list[JoulemapError] = []
    for number, content in enumerate(inputs):
        began = time.process_time()
        try:
            parse_run(content, name="run", crs=files.CRS, limits=LIMITS)
        except JoulemapError as error:
            said.append(error)
        assert time.process_time() - began < 10.0, f"{kind} number {number}"
    assert said or kind == "tlog"  # which has no index: one that was cut off is a shorter one
    assert all(isinstance(error, RunsError | TooLargeError) for error in said)
    assert all(error.message.startswith("run run") for error in said)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", WRITERS)
def test_broken_logs_are_read_or_refused_in_words(kind, tmp_path, capfd):
    _read_all(kind, tmp_path, 4, 8, capfd)


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_many_broken_logs_are_read_or_refused_in_words(kind, tmp_path, capfd):
    _read_all(kind, tmp_path, 20, 60, capfd)


def test_a_recording_that_was_cut_off_says_where_and_how_to_repair_it(tmp_path):
    content = files.write_mcap(tmp_path / "a.mcap", files.drive(20.0)).read_bytes()
    with pytest.raises(
        RunsError, match=r"truncated or corrupt after 0 messages.*`mcap recover IN -o OUT` may repair it"
    ):
        parse_run(content[: len(content) // 2], name="run", crs=files.CRS)
    content = files.write_fit(tmp_path / "a.fit", files.drive(20.0)).read_bytes()
    with pytest.raises(RunsError, match=r"after \d+ records: expected .* bytes"):
        parse_run(content[: len(content) // 2], name="run", crs=files.CRS)


def test_more_messages_than_the_limit_are_too_many(tmp_path):
    path = files.write_tlog(tmp_path / "a.tlog", files.drive(20.0))
    with pytest.raises(TooLargeError, match=r"more than 50 messages of .* split it"):
        parse_run(path, name="run", crs=files.CRS, limits=TableLimits(rows=50))

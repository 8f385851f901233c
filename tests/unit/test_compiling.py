"""A first call on a new machine says that it compiles, once and only if it takes long."""

import pytest
from numba.core import event

from joulemap.model import compiling


@pytest.mark.parametrize(("each_s", "kernels", "lines"), [(0.9, 2, 0), (0.9, 9, 1), (30.0, 1, 0), (30.0, 3, 1)])
def test_long_compilations_are_said_once(each_s, kernels, lines, monkeypatch, capsys):
    seconds = iter([k // 2 * 10.0 + k % 2 * each_s for k in range(2 * kernels)])
    monkeypatch.setattr(compiling.time, "perf_counter", lambda: next(seconds))
    notice = compiling._Notice()
    for _ in range(kernels):
        notice.on_start(event.Event("numba:compile", event.EventStatus.START))
        notice.on_end(event.Event("numba:compile", event.EventStatus.END))
    said = capsys.readouterr().err
    assert said.count("compiling kernels for this machine") == lines


def test_the_events_of_numba_reach_the_notice(monkeypatch):
    heard = []
    monkeypatch.setattr(compiling._Notice, "on_start", lambda self, event: heard.append(event.kind))
    import numba

    from joulemap.model import threads

    assert threads.say_when_compiling is compiling.say_when_compiling
    numba.njit(lambda x: x + 1)(1)
    assert "numba:compile" in heard

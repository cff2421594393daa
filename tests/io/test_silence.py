"""What libraries print beside an error is kept back, and after a signal all of it."""

import os
import threading

import pytest

from jaxisp.io.silence import silent_libraries
from jaxisp.process import signals


def test_it_opens_again_after_the_last_of_several_threads(capfd):
    inside, leave = threading.Event(), threading.Event()

    def other():
        with silent_libraries():
            inside.set()
            leave.wait(5)
            os.write(2, b"kept back\n")

    thread = threading.Thread(target=other)
    thread.start()
    inside.wait(5)
    with pytest.raises(ZeroDivisionError), silent_libraries():
        os.write(2, b"kept back\n")
        raise ZeroDivisionError
    os.write(2, b"kept back\n")
    leave.set()
    thread.join()
    os.write(2, b"told\n")
    assert capfd.readouterr().err == "told\n"


def test_it_does_not_open_what_a_signal_has_closed(capfd, monkeypatch):
    before = os.dup(2)
    try:
        with silent_libraries():
            monkeypatch.setattr(signals, "came", lambda: 15)
        os.write(2, b"kept back\n")
    finally:
        os.dup2(before, 2)
        os.close(before)
    assert capfd.readouterr().err == ""

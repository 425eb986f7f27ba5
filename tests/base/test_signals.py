"""Signals that wait."""

import os
import signal
import threading

import pytest

from wakefold.base.signals import held


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_the_block_is_done(number):
    def end(*_):
        raise KeyboardInterrupt

    def insisting(number, times):
        with held():
            for _ in range(times):
                os.kill(os.getpid(), number)
                done.append(1)

    before, done = signal.signal(number, end), []
    try:
        with pytest.raises(KeyboardInterrupt):
            insisting(number, 1)
        assert done == [1]
        assert signal.getsignal(number) is end
        with pytest.raises(KeyboardInterrupt):  # whoever insists does not wait
            insisting(number, 2)
        assert done == [1, 1]
        assert signal.getsignal(number) is end
    finally:
        signal.signal(number, before)


def test_errors_pass_and_other_threads_hold_nothing():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="mine"), held():
        raise ValueError("mine")
    assert signal.getsignal(signal.SIGINT) is before
    seen = []

    def work():
        with held():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]

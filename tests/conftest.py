"""Programs that tests start can be interrupted, also when the tests run in the background."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as after `make test &`; it is inherited
    signal.signal(signal.SIGINT, signal.default_int_handler)
